"""The aircraft of the escort: their circle about the vessel, their cameras, and what they know."""

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from rl.guidance.corrected import Corrected
from rl.guidance.geometry import SIZE as ERRORS
from rl.guidance.geometry import SLOT_VELOCITY
from rl.guidance.observations import RATE_SCALE, SPEED_SCALE
from rl.guidance.targets import COS, COURSE, EAST, NORTH, SIN, SIZE, SPEED, seen_at
from rl.missions.escort.boats import AGE_SCALE, SIGMA_SCALE, squashed
from rl.missions.escort.picture import CommonPicture, ObserverGroup, SearchPattern
from rl.perception.camera import Camera
from rl.perception.contacts import Contacts
from rl.perception.instruments import Readings
from rl.perception.sensors import Sensor

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

HEARD_OF = 5.0  # s, greatest age of another aircraft's message; assumed
CIRCLE_SCALE, FAR_SCALE, SLOW_SCALE = 20.0, 200.0, 2.0  # m, m, m/s at which an observation reaches 1/2
SEARCH_PITCH, SEARCH_SPEED = 1.0, 0.5  # spiral: in radii of the circle; in cruising speeds; assumed
BEGINS = 1.5  # radii from the expected vessel at which a search begins


def gap_errors(angle: Tensor, present: Tensor, turn: float) -> Tensor:
    """Half the difference between the gaps ahead and behind each aircraft on the circle, rad, [.., n].

    Args:
        angle: [.., n, n] rad, angles on the circle as each aircraft knows the others'.
        present: [.., n, n], whether it knows them.
        turn: 1 if they fly clockwise, else -1.
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


class EscortAircraft(Corrected):
    """The team of aircraft, measured after each step; every tensor is [env, aircraft, ...].

    Attributes:
        distance: m from the circle about the true vessel.
        gap_error: half the difference between the gaps ahead and behind on the circle, rad.
        sees: whether its camera sees the vessel.
        in_range: share of boats within radio range.
        sensor: surrounding obstacles and team mates.
    """

    STATE = ("sensor", "distance", "gap_error", "in_range", "own", "camera", "known")

    axes = 3

    def __init__(self, mission: "Escort", name: str):
        """Prepare team `name`."""
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
        self.known: Any

    def group(self, first: int, number: int) -> ObserverGroup:
        """The team as a group of observers.

        Args:
            first: index of its first observer.
            number: the team's index in the mission.
        """
        self.own = Readings(self.fleet, self.section.sensors, self.interval, 64 * number)
        cruise = self.fleet.model.limits.speeds[1]
        self._number = number
        radius = self.orbit.radius
        search = SearchPattern(SEARCH_PITCH * radius, SEARCH_SPEED * cruise, BEGINS * radius)
        return ObserverGroup(first, self.own, self.fleet, search)

    def join(self, picture: CommonPicture) -> None:
        """Connect cameras and knowledge to the `picture`."""
        mission, number = self.mission, 64 * self._number
        self.picture = picture
        self.camera = Camera(
            self.section.camera, self.section.sensors, picture.looks, picture.things, mission.hs, self.fleet, self.own,
            first=picture.groups[self.name].first, vehicles=number,
        )  # fmt: skip
        picture.lookers.append(self)
        self.known = KnownAircraft(self, picture, number)
        self.target = self.known.target

    def measure(self, which: Tensor, count: int) -> None:
        """Measure the truth and read the instruments in environments `which` [env] int32, `count` of them."""
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

    def see(self, which: Tensor, rows: int, count: Tensor) -> None:
        """Point the cameras at the believed vessel and look.

        At the start of an episode the vessel is believed where the cue says.
        """
        self.camera.aim(self.known.believed)
        self.camera.see(which, rows, count)

    def conclude(self, which: Tensor, count: int) -> None:
        """Update their knowledge after the picture."""
        self.known.measure(which, count)

    @property
    def sees(self) -> Tensor:
        """Whether each camera saw the vessel in its last look, bool [env, aircraft]."""
        return self.picture.sees(self.name)

    def terms(self) -> dict[str, Tensor]:
        """The observations of each aircraft, by name."""
        return self._observations(self.known)

    def _observations(self, known: "KnownAircraft") -> dict[str, Tensor]:
        fleet, model, picture = known.fleet, self.fleet.model, self.picture

        def own_frame(v: Tensor) -> Tensor:
            return (v.unsqueeze(-2) @ fleet.R_nb).squeeze(-2)

        level = torch.zeros_like(known.centre[..., :1])
        to = torch.cat((known.centre, level), dim=-1) - fleet.position_n
        far = to.norm(dim=-1, keepdim=True)
        t = known.targets.table
        vc, c, s = known.centre_velocity, t[..., COS], t[..., SIN]
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
            "track_age": squashed(picture.of(self.name, picture.age).unsqueeze(-1), AGE_SCALE),
            "track_sigma": squashed(picture.of(self.name, picture.sigma).unsqueeze(-1), SIGMA_SCALE),
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
        if self.residual is not None:
            terms["reference"] = self.reference()
        return terms

    @property
    def privileged(self) -> Tensor | None:
        """Ground truth for the critic, [env, aircraft, n]: vessel, circle, boats' result, and varied numbers."""
        mission, fleet = self.mission, self.fleet
        to = mission.vessel_place.unsqueeze(1) - fleet.position_n[..., :2]
        truth = [
            squashed(to, FAR_SCALE), squashed(mission.vessel_velocity.unsqueeze(1).expand_as(to), SLOW_SCALE),
            squashed(self.distance.unsqueeze(-1), CIRCLE_SCALE), self.gap_error.unsqueeze(-1) / math.pi,
            self.in_range.unsqueeze(-1), mission.boats_result().view(-1, 1, 1).expand(*to.shape[:2], 1),
        ]  # fmt: skip
        if mission.config.varies:
            truth.append(mission.world.truth[self.name])
        return torch.cat(truth, dim=-1)


class KnownAircraft:
    """What the aircraft know; any other attribute is that of the true team.

    Attributes:
        fleet: own state as measured.
        centre, centre_velocity: [env, aircraft, 2] the vessel, or the point about which they search for it.
        believed: the point at which a gimballed camera looks.
        gap_error: from the others' messages, rad.
        height_error: m, down, desired minus own.
        target: the tangent of the circle at each aircraft.
        boats: mean position [.., 2] and distance to the farthest [.., 1] from messages; 0 without any.
    """

    STATE = ("targets", "now", "centre_velocity", "gap_error", "height_error", "sensor", "_boats", "_farthest")

    def __init__(self, team: EscortAircraft, picture: CommonPicture, number: int):
        """Knowledge of `team`; `number` vehicles of other teams precede it in the streams of random numbers."""
        state = team.fleet.state
        self._team, self._picture, self.fleet = team, picture, team.own
        self.targets = SimpleNamespace(table=state.new_zeros((*state.shape[:2], SIZE)))
        errors = state.new_zeros((*state.shape[:2], ERRORS))
        self.now = SimpleNamespace(table=errors, slot_velocity=errors[..., SLOT_VELOCITY : SLOT_VELOCITY + 3])
        self.target = seen_at(self.targets.table, team.fleet.position_n[:, 0])
        self.sensor = Contacts(
            team.section.sensors.scaled_contacts, team.sensor, team.fleet, self.fleet, team.interval, number
        )
        self.centre, self.centre_velocity = (
            picture.rows(team.name)[..., NORTH : EAST + 1],  # a live view
            state.new_zeros((*state.shape[:2], 2)),
        )
        self.believed = self.centre
        self.gap_error, self.height_error = state.new_zeros(state.shape[:2]), state.new_zeros(state.shape[:2])
        self._boats, self._farthest = (state.new_zeros((*state.shape[:2], n)) for n in (2, 1))

    def __getattr__(self, name: str) -> Any:
        """Anything not measured falls through to the true team."""
        return getattr(self._team, name)

    def measure(self, which: Tensor, rows: int) -> None:
        """Update in environments `which` [env] int32, `rows` of them."""
        team, mission = self._team, self._team.mission
        known = self._picture.rows(team.name)
        self.centre = known[..., NORTH : EAST + 1]
        self.centre_velocity = known[..., SPEED, None] * torch.stack((known[..., COS], known[..., SIN]), dim=-1)
        self.believed = self.centre
        x = self.fleet.position_n[..., :2] - self.centre
        theta, turn = torch.atan2(x[..., 1], x[..., 0]), team.orbit.turn
        table = self.targets.table
        table[..., NORTH : EAST + 1] = self.centre
        course = theta + turn * math.pi / 2
        table[..., COURSE], table[..., COS], table[..., SIN] = course, course.cos(), course.sin()
        self.height_error = team.down - self.fleet.position_n[..., 2]
        self._others(theta)
        self.sensor.update(which, rows, mission.steps, mission.noise.table)

    @property
    def boats(self) -> tuple[Tensor, Tensor]:
        """Mean position of the boats [env, aircraft, 2] and distance to the farthest [env, aircraft, 1], m."""
        return self._boats, self._farthest

    def _others(self, theta: Tensor) -> None:
        """Update the gaps and the boats from messages."""
        team, picture = self._team, self._picture
        heard, age = picture.of(team.name, picture.radio.heard), picture.radio.said.shape[-1]
        group = picture.groups[team.name]
        n = theta.shape[1]
        of = heard[:, :, group.first : group.first + n]
        old = of[..., age]
        place = of[..., :2] + old.clamp(max=HEARD_OF).unsqueeze(-1) * of[..., 3:5] - self.centre.unsqueeze(2)
        angle = torch.atan2(place[..., 1], place[..., 0])
        itself = torch.eye(n, dtype=torch.bool, device=theta.device)
        angle = torch.where(itself, theta.unsqueeze(-1), angle)
        self.gap_error = gap_errors(angle, old < HEARD_OF, team.orbit.turn)
        boats = picture.groups.get(team.mission.config.escort.boats)
        if boats is None:
            return
        of = heard[:, :, boats.first : boats.first + boats.own.state.shape[1]]
        fresh = (of[..., age] < 4 * HEARD_OF).to(of).unsqueeze(-1)
        mean = (fresh * of[..., :2]).sum(2) / fresh.sum(2).clamp(min=1.0)
        far = (fresh * (of[..., :2] - self.fleet.position_n[..., None, :2])).norm(dim=-1).amax(-1)
        self._boats, self._farthest = mean, far.unsqueeze(-1)
