"""The aircraft of the escort: true errors from their circle about the vessel, their cameras, and what they know."""

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.guidance.geometry import SLOT_SIZE, SlotErrors
from rl.guidance.observations import RATE_SCALE, SPEED_SCALE
from rl.guidance.residual import ResidualTeam
from rl.guidance.targets import COS, COURSE, EAST, NORTH, SIN, SIZE, SPEED, Target
from rl.missions.escort.boats import AGE_SCALE, SIGMA_SCALE, squashed
from rl.missions.escort.tracking import ObserverGroup, SharedTracking, SpiralSearch
from rl.perception.camera import Camera
from rl.perception.columns import Message
from rl.perception.contacts import TrackedContacts
from rl.perception.instruments import Readings
from rl.perception.sensors import Sensor

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

HEARD_OF = 5.0  # s: older messages of other aircraft and boats are ignored; assumed
CIRCLE_SCALE, FAR_SCALE, SLOW_SCALE = 20.0, 200.0, 2.0  # m, m, m/s, at which a squashed observation is 1/2
SEARCH_PITCH, SEARCH_SPEED = 1.0, 0.5  # of the circle's radius; of the cruising speed, along the spiral; assumed
BEGINS = 1.5  # radii of the circle from the vessel's expected place, within which a search begins; assumed


def gap_errors(angle: Tensor, present: Tensor, turn: float) -> Tensor:
    """Half the difference between the gaps ahead and behind on the circle, [.., n] (rad).

    Row i of `angle` [.., n, n] (rad) holds the angles of all aircraft on the circle as aircraft i knows them. `present`
    [.., n, n] says which of them it knows. `turn` is 1 for clockwise, else -1.
    """
    n = angle.shape[-1]
    if n == 1:
        return torch.zeros_like(angle[..., 0])
    own = angle.diagonal(dim1=-2, dim2=-1).unsqueeze(-1)
    ahead = torch.remainder(turn * (angle - own), 2 * math.pi)
    others = present & ~torch.eye(n, dtype=torch.bool, device=angle.device)
    nearest = ahead.masked_fill(~others, 2 * math.pi).amin(-1)
    behind = 2 * math.pi - ahead.masked_fill(~others, 0.0).amax(-1)
    return torch.where(others.any(-1), 0.5 * (nearest - behind), 0.0)


def aircraft_observers(mission: "Escort", name: str, first: int) -> ObserverGroup:
    """The aircraft of team `name` as observers, numbered from `first` on."""
    config, fleet = mission.config, mission.world.teams[name]
    section = config.parts[name]
    own = Readings(fleet, section.sensors, config.decision_interval, config.first_number(name))
    radius, cruise = section.orbit.radius, fleet.model.limits.speeds[1]
    return ObserverGroup(first, own, fleet, SpiralSearch(SEARCH_PITCH * radius, SEARCH_SPEED * cruise, BEGINS * radius))


class EscortAircraft(ResidualTeam):
    """The team of aircraft, measured after each step; every tensor is [env, aircraft, ...].

    Attributes:
        distance: m from the circle about the true vessel.
        gap_error: half the difference between the gaps ahead and behind on the circle, rad.
        sees: whether its camera sees the vessel.
        in_range: share of boats within radio range.
        sensor: surrounding obstacles and team mates.
    """

    STATE = ("sensor", "distance", "gap_error", "in_range", "own", "camera", "known")

    mission: "Escort"
    axes = 3

    def __init__(self, mission: "Escort", name: str, tracking: SharedTracking):
        """Make team `name`, whose aircraft are among the observers of `tracking`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        self.radius, self.interval, self.orbit = model.collision_radius, config.decision_interval, self.section.orbit
        sensing = config.sensing
        self.sensor = Sensor(
            self.fleet, sensing.obstacles, sensing.team_mates, sensing.detection_range, self.radius, "body"
        )
        steps = torch.arange(self.fleet.count, device=state.device, dtype=state.dtype)
        self.down = -(self.orbit.height + self.orbit.height_step * steps)
        self.distance = state.new_zeros(state.shape[:2])
        self.gap_error, self.in_range = torch.zeros_like(self.distance), torch.zeros_like(self.distance)
        group, number = tracking.groups[name], config.first_number(name)
        assert isinstance(group.own, Readings)
        self.tracking, self.own = tracking, group.own
        self.camera = Camera(
            self.section.camera, self.section.sensors, tracking.sightings, tracking.objects, mission.hs, self.fleet,
            self.own, first=group.first, vehicles=number,
        )  # fmt: skip
        self.known = self.measured = MeasuredAircraft(self, number)

    def measure(self, which: Tensor, count: int) -> None:
        """Measure the truth in environments `which` [env] int32, `count` of them, and read the instruments."""
        self.forget()
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, which, count, mission.bodies)
        self.own.read(which, count, mission.noise.table)
        x = self.fleet.position_n[..., :2] - mission.vessel_place.unsqueeze(1)
        high = self.fleet.position_n[..., 2] - self.down
        self.distance = torch.hypot(x.norm(dim=-1) - self.orbit.radius, high)
        angle = torch.atan2(x[..., 1], x[..., 0]).unsqueeze(-2).expand(-1, self.fleet.count, -1)
        self.gap_error = gap_errors(angle, torch.ones_like(angle, dtype=torch.bool), self.orbit.turn)
        boats = mission.boats
        if boats is not None:
            place = boats.fleet.position_n[..., :2].contiguous()
            far = torch.cdist(self.fleet.position_n[..., :2].contiguous(), place)
            far = torch.hypot(far, self.fleet.position_n[..., 2:])
            self.in_range = (far < mission.config.radio.range).to(far).mean(-1)

    def look(self, which: Tensor, rows: int) -> None:
        """Look at the place where each aircraft believes the vessel to be."""
        self.camera.aim(self.measured.believed)
        self.camera.see(which, rows, self.mission.noise.table)

    def conclude(self, which: Tensor, count: int) -> None:
        """Update what the aircraft know, after the shared tracking."""
        self.measured.measure(which, count)

    @property
    def sees(self) -> Tensor:
        """bool [env, aircraft]: its camera sees the vessel."""
        return self.tracking.sees(self.name)

    def terms(self) -> dict[str, Tensor]:
        """Observations of each aircraft."""
        known, model, tracking = self.measured, self.fleet.model, self.tracking
        fleet = known.fleet

        def own_frame(v: Tensor) -> Tensor:
            return (v.unsqueeze(-2) @ fleet.R_nb).squeeze(-2)

        level = torch.zeros_like(known.centre[..., :1])
        to = torch.cat((known.centre, level), dim=-1) - fleet.position_n
        far = to.norm(dim=-1, keepdim=True)
        vc, c, s = known.centre_velocity, known.target.cos, known.target.sin
        carried = torch.stack((c * vc[..., 0] + s * vc[..., 1], c * vc[..., 1] - s * vc[..., 0]), dim=-1)
        off = torch.stack((to[..., :2].norm(dim=-1) - self.orbit.radius, known.height_error), dim=-1)
        mean, widest = known.boats
        to_boats = torch.where(widest > 0, torch.cat((mean, level), dim=-1) - fleet.position_n, 0.0)
        boats_far = to_boats.norm(dim=-1, keepdim=True)
        terms = {
            "velocity": squashed(fleet.velocity_b, SPEED_SCALE),
            "down": fleet.down_b,
            "rates": fleet.angular_velocity_b / RATE_SCALE,
            "vessel": own_frame(to / far.clamp(min=1.0)),
            "vessel_distance": squashed(far, FAR_SCALE),
            "vessel_velocity": squashed(carried, SLOW_SCALE),
            "circle": squashed(off, CIRCLE_SCALE),
            "gap": known.gap_error.unsqueeze(-1) / math.pi,
            "view": self.sees.unsqueeze(-1).to(far),
            "track_age": squashed(tracking.of(self.name, tracking.age).unsqueeze(-1), AGE_SCALE),
            "track_sigma": squashed(tracking.of(self.name, tracking.sigma).unsqueeze(-1), SIGMA_SCALE),
            "boats": own_frame(to_boats / boats_far.clamp(min=1.0)),
            "boats_distance": squashed(torch.cat((boats_far, widest), dim=-1), FAR_SCALE),
            "surroundings": known.sensor.signals,
            "previous_action": self.action,
        }
        if "airspeed" in model.aux_names and model.air is not None:
            low, cruise, high = model.limits.speeds
            terms["airspeed"] = (fleet.reading("airspeed") - cruise).unsqueeze(-1) * (2 / (high - low))
            wind = torch.stack([fleet.reading(name) for name in model.air], dim=-1)
            terms["wind"] = squashed(own_frame(wind), SPEED_SCALE)
        reference = self.reference()
        return terms if reference is None else terms | {"reference": reference}

    @property
    def privileged(self) -> Tensor | None:
        """Ground truth [env, aircraft, n]: vessel, circle, the boats' result, and the numbers that vary."""
        mission, fleet = self.mission, self.fleet
        to = mission.vessel_place.unsqueeze(1) - fleet.position_n[..., :2]
        parts = [
            squashed(to, FAR_SCALE), squashed(mission.vessel_velocity.unsqueeze(1).expand_as(to), SLOW_SCALE),
            squashed(self.distance.unsqueeze(-1), CIRCLE_SCALE), self.gap_error.unsqueeze(-1) / math.pi,
            self.in_range.unsqueeze(-1), mission.boats_result().view(-1, 1, 1).expand(*to.shape[:2], 1),
        ]  # fmt: skip
        if mission.config.varies:
            parts.append(mission.world.truth[self.name])
        return torch.cat(parts, dim=-1)


Aircraft = EscortAircraft  # its earlier name


class MeasuredAircraft:
    """Knowledge of the aircraft (rl/guidance/knowledge.py), with the inputs of their orbit (orbit.py).

    Attributes:
        fleet: own state as measured. orbit: the circle to fly.
        now: slot errors; only the velocity of the slot is used, and the controller writes it.
        centre, centre_velocity: [env, aircraft, 2] the vessel's place (m) and velocity (m/s) as each aircraft knows
            them; during a search, the place that it searches.
        believed: [env, aircraft, 2] the place that a camera on a gimbal looks at, m.
        gap_error: [env, aircraft] (rad) from the aircraft that have been heard.
        height_error: [env, aircraft] (m, down) height to be held less own height.
        target: the tangent of the circle at each aircraft.
    """

    STATE = ("target", "now", "centre_velocity", "gap_error", "height_error", "sensor", "_boats", "_farthest")

    axes = EscortAircraft.axes
    radio = None

    def __init__(self, team: EscortAircraft, number: int):
        """Measure for `team`, whose first aircraft has that `number` among the random numbers."""
        state, tracking = team.fleet.state, team.tracking
        self._team, self._tracking, self.fleet = team, tracking, team.own
        self.radius, self.orbit = team.radius, team.orbit
        self.now, self.slot_table = SlotErrors(state, self.axes), state.new_zeros((*state.shape[:2], SLOT_SIZE))
        self.target = Target(state.new_zeros((*state.shape[:2], SIZE)), team.fleet.position_n[:, 0])
        self.sensor = TrackedContacts(
            team.section.sensors.scaled_contacts, team.sensor, team.fleet, self.fleet, team.interval, number
        )
        self.centre, self.centre_velocity = (
            tracking.of(team.name, tracking.targets)[..., NORTH : EAST + 1],  # a live view
            state.new_zeros((*state.shape[:2], 2)),
        )
        self.believed = self.centre
        self.gap_error, self.height_error = state.new_zeros(state.shape[:2]), state.new_zeros(state.shape[:2])
        self._boats, self._farthest = (state.new_zeros((*state.shape[:2], n)) for n in (2, 1))

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def measure(self, which: Tensor, rows: int) -> None:
        """Measure in environments `which` [env] int32, `rows` of them."""
        team = self._team
        known = self._tracking.of(team.name, self._tracking.targets)
        self.centre = known[..., NORTH : EAST + 1]
        self.centre_velocity = known[..., SPEED, None] * torch.stack((known[..., COS], known[..., SIN]), dim=-1)
        self.believed = self.centre
        x = self.fleet.position_n[..., :2] - self.centre
        theta, turn = torch.atan2(x[..., 1], x[..., 0]), team.orbit.turn
        table = self.target.table
        table[..., NORTH : EAST + 1] = self.centre
        course = theta + turn * math.pi / 2
        table[..., COURSE], table[..., COS], table[..., SIN] = course, course.cos(), course.sin()
        self.height_error = team.down - self.fleet.position_n[..., 2]
        self._others(theta)
        self.sensor.update(which, rows, self.steps, team.mission.noise.table)

    @property
    def boats(self) -> tuple[Tensor, Tensor]:
        """Mean place of the boats heard [env, aircraft, 2] and distance to the farthest [env, aircraft, 1], m, or 0."""
        return self._boats, self._farthest

    def _others(self, theta: Tensor) -> None:
        """Update the gap errors, and the places of the boats, from the last messages."""
        team, tracking = self._team, self._tracking
        heard, age = tracking.of(team.name, tracking.radio.heard), tracking.radio.said.shape[-1]
        n = theta.shape[1]
        mates = heard[:, :, tracking.groups[team.name].rows]
        old = mates[..., age]
        place = mates[..., :2] + old.clamp(max=HEARD_OF).unsqueeze(-1) * mates[..., Message.VELOCITY][..., :2]
        place = place - self.centre.unsqueeze(2)
        angle = torch.atan2(place[..., 1], place[..., 0])
        itself = torch.eye(n, dtype=torch.bool, device=theta.device)
        angle = torch.where(itself, theta.unsqueeze(-1), angle)
        self.gap_error = gap_errors(angle, old < HEARD_OF, team.orbit.turn)
        boats = tracking.groups.get(team.mission.config.escort.boats)
        if boats is None:
            return
        said = heard[:, :, boats.rows]
        fresh = (said[..., age] < 4 * HEARD_OF).to(said).unsqueeze(-1)
        mean = (fresh * said[..., :2]).sum(2) / fresh.sum(2).clamp(min=1.0)
        far = (fresh * (said[..., :2] - self.fleet.position_n[..., None, :2])).norm(dim=-1).amax(-1)
        self._boats, self._farthest = mean, far.unsqueeze(-1)
