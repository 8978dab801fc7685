"""The aircraft of the escort: true errors from their circle about the vessel, their cameras, and what they know."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from rl.guidance.observations import squashed
from rl.guidance.residual import ResidualTeam
from rl.guidance.targets_and_errors import EAST, NORTH, SLOT_SIZE, TARGET_SIZE, SlotErrors, Target, to_starboard
from rl.missions.escort.circling import (
    CIRCLE_SCALE,
    FAR_SCALE,
    OBSERVED,
    SLOW_SCALE,
    CircleErrors,
    CircleKnowledge,
    CirclingForm,
    OrbitController,
    OrbitGains,
)
from rl.missions.escort.host import EscortHost
from rl.missions.escort.rewards import AIRCRAFT_TERMS
from rl.missions.escort.tracking import LOGGED, ObserverGroup, SharedTracking, SpiralSearch, log_of, margins_of
from rl.perception.instruments import InstrumentsConfig, Readings
from rl.perception.sensors import Sensor
from rl.perception.sightings import Camera
from rl.perception.tracked_objects import TrackedObjects
from rl.step import Due
from rl.team import Controller, Endings
from taichi_sim.config.io import validate
from taichi_sim.fleet import Views
from taichi_sim.kernels.conventions import DOWN, QUATERNION, STATE_SIZE
from taichi_sim.kernels.rotation import DERIVED_SIZE, HEADING_COS, HEADING_SIN, ROTATION, VELOCITY_N
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.state.memory import Remembers

SEARCH_PITCH, SEARCH_SPEED = 1.0, 0.5  # of the circle's radius; of the cruising speed, along the spiral; assumed
SCOUT_SPEED = 25.0  # m/s; assumed
FASTER = 1e6  # m/s, each way, than any command
SEARCHES = 1.5  # radii of the circle from the vessel's expected place, within which a search begins; assumed


def aircraft_observers(mission: EscortHost, name: str, first: int) -> ObserverGroup:
    """Make the observer group of the aircraft of team `name`, numbered from `first` on."""
    config, fleet = mission.config, mission.world.teams[name]
    section = config.parts[name]
    own = Readings(fleet, section.sensors, config.decision_interval, config.first_number(name))
    radius, cruise = section.orbit.radius, fleet.model.limits.speeds[1]
    return ObserverGroup(
        first, own, fleet, SpiralSearch(SEARCH_PITCH * radius, SEARCH_SPEED * cruise, SEARCHES * radius)
    )


class EscortAircraft(ResidualTeam):
    """The team of aircraft, measured after each step; every tensor is [env, aircraft, ...].

    Attributes:
        distance: m from the circle about the true vessel.
        gap_error: half the difference between the gaps ahead and behind on the circle, rad.
        sees: whether its camera sees the vessel.
        in_range: share of boats within radio range.
        sensor: surrounding obstacles and team mates.
    """

    terms = AIRCRAFT_TERMS
    logged = LOGGED
    meanings = OBSERVED
    mission: EscortHost
    axes = 3

    def __init__(self, mission: EscortHost, name: str, tracking: SharedTracking):
        """Make team `name`, whose aircraft are among the observers of `tracking`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        self.radius, self.interval, self.orbit = model.collision_radius, config.decision_interval, self.section.orbit
        sensing = config.sensing
        self.sensor = self.remember(
            Sensor(self.fleet, sensing.obstacles, sensing.team_mates, sensing.detection_range, self.radius, "body")
        )
        steps = torch.arange(self.fleet.count, device=state.device, dtype=state.dtype)
        self.down = -(self.orbit.height + self.orbit.height_step * steps)
        self.distance, self.gap_error, self.in_range = (
            self.remember(state.new_zeros(state.shape[:2])) for _ in range(3)
        )
        group, number = tracking.groups[name], config.first_number(name)
        assert isinstance(group.own, Readings)
        self.tracking, self.own = tracking, self.remember(group.own)
        self.camera = self.remember(Camera(
            self.section.camera, self.section.sensors, tracking.sightings, tracking.objects, mission.hs, self.fleet,
            self.own, first=group.first, vehicles=number,
        ))  # fmt: skip
        boats = tracking.groups.get(config.escort.boats)
        form = CirclingForm(group.first, (0, 0) if boats is None else (boats.first, boats.first + boats.count))
        self._errors = CircleErrors(self, form)
        self.measured = self.remember(MeasuredAircraft(self, number, form))

    @property
    def known(self) -> "MeasuredAircraft":
        """What is measured."""
        return self.measured

    def truth(self, due: Due) -> None:
        """Measure errors from the circle about the true vessel, and gaps to all around."""
        super().truth(due)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, due, mission.bodies)
        self._errors.measure(due)

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        self.own.read(due)

    def look(self, due: Due) -> None:
        """Look at the place where each aircraft believes the vessel to be."""
        self.camera.aim(self.measured.believed)
        self.camera.see(due)

    def conclude(self, due: Due) -> None:
        """Update the tangent of the circle, and tracks of what is near."""
        super().conclude(due)
        self.measured.conclude(due)

    def margins(self) -> dict[str, Tensor]:
        """To contact with an obstacle, the vessel or a team mate; to the edge of the area."""
        return margins_of(self.fleet, self.sensor, self.mission.config)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """See tracking.py."""
        return log_of(self.distance, self.tracking, ended, self.mission.arrived, self.mission.config)

    def info(self) -> dict[str, Tensor]:
        """distance: m, from the circle."""
        return {"distance": self.distance}

    def make_controller(self) -> Controller | None:
        """The vehicle's own controller, else that of circling.py for fixed wings."""
        own, model = super().make_controller(), self.fleet.model
        if own is not None or not isinstance(model, FixedWing6DOF):
            return own
        gains = validate(OrbitGains, dict(self.section.control), f"{self.name}.control")
        return OrbitController(model, self.orbit, gains)

    @property
    def sees(self) -> Tensor:
        """Whether each aircraft's camera saw the vessel when it last looked, bool [env, aircraft]."""
        return self.tracking.sees(self.name)

    @property
    def boats_result(self) -> Tensor:
        """How near the boats are to their slots, [env]."""
        return self.mission.boats_result()

    @property
    def written(self) -> Mapping[str, int]:
        """Terms of the team's observations and their widths (circling.py)."""
        return self.measured.circle.widths

    def write(self) -> Tensor:
        """Observations [env, aircraft, n], a fresh tensor each time."""
        return self.measured.circle.observe(self.action, self.reference())

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, aircraft, n]: vessel, circle, the boats' result, and the numbers that vary."""
        mission, fleet = self.mission, self.fleet
        to = mission.vessel_place.unsqueeze(1) - fleet.position_n[..., :2]
        parts = [
            squashed(to, FAR_SCALE), squashed(mission.vessel_velocity.unsqueeze(1).expand_as(to), SLOW_SCALE),
            squashed(self.distance.unsqueeze(-1), CIRCLE_SCALE), self.gap_error.unsqueeze(-1) / math.pi,
            self.in_range.unsqueeze(-1), self.boats_result.view(-1, 1, 1).expand(*to.shape[:2], 1),
        ]  # fmt: skip
        if mission.config.varies:
            parts.append(mission.world.truth[self.name])
        return torch.cat(parts, dim=-1)


class MeasuredAircraft(Remembers):
    """Knowledge of the aircraft (rl/guidance/knowledge.py), with the inputs of their orbit (circling.py).

    Attributes:
        fleet: own state as measured. orbit: the circle to fly.
        now: slot errors; only the velocity of the slot is used, `FASTER`: no slot holds an aircraft back that evades.
        centre, centre_velocity: [env, aircraft, 2] the vessel's place (m) and velocity (m/s) as each aircraft knows
            them; during a search, the place that it searches.
        believed: [env, aircraft, 2] the place that a camera on a gimbal looks at, m.
        gap_error: [env, aircraft] (rad) from the aircraft that have been heard.
        height_error: [env, aircraft] (m, down) height to be held less own height.
        target: the tangent of the circle at each aircraft. circle: writes what they know, and observations of it.
    """

    axes = EscortAircraft.axes
    radio = None

    def __init__(self, team: EscortAircraft, number: int, form: CirclingForm):
        """Measure for `team`, whose first aircraft has that `number` among the random numbers."""
        state, tracking = team.fleet.state, team.tracking
        self._team, self.fleet = team, team.own
        self.radius, self.orbit = team.radius, team.orbit
        self.now = self.remember(SlotErrors(state, self.axes))
        self.slot_table = state.new_zeros((*state.shape[:2], SLOT_SIZE))
        self.now.slot_velocity.fill_(FASTER)
        self.target = self.remember(
            Target(state.new_zeros((*state.shape[:2], TARGET_SIZE)), team.fleet.position_n[:, 0])
        )
        self.sensor = self.remember(
            TrackedObjects(
                team.section.sensors.scaled_objects, team.sensor, team.fleet, self.fleet, team.interval, number
            )
        )
        self.centre, self.centre_velocity = (
            tracking.of(team.name, tracking.targets)[..., NORTH : EAST + 1],  # a live view
            self.remember(state.new_zeros((*state.shape[:2], 2))),
        )
        self.believed = self.centre
        self.gap_error, self.height_error = (self.remember(state.new_zeros(state.shape[:2])) for _ in range(2))
        self._boats, self._farthest = (self.remember(state.new_zeros((*state.shape[:2], n))) for n in (2, 1))
        self.circle = CircleKnowledge(self, team, form)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def conclude(self, due: Due) -> None:
        """Update all where it is `due`."""
        self.circle.listen(due)
        self.sensor.update(due)

    @property
    def boats(self) -> tuple[Tensor, Tensor]:
        """Mean place [env, aircraft, 2] of the boats heard, distance [env, aircraft, 1] to the farthest, m, or 0."""
        return self._boats, self._farthest


def scout_observers(mission: EscortHost, name: str, first: int) -> ObserverGroup:
    """Make an observer group of scouts that replace the aircraft of team `name`, numbered from `first` on."""
    section, like = mission.config.parts[name], mission.hs
    rows = mission.num_envs, section.count
    views = Views(
        None,  # pyright: ignore[reportArgumentType] (there is no model: nothing is simulated)
        like.new_zeros((*rows, STATE_SIZE)), like.new_zeros((*rows, DERIVED_SIZE)), like.new_zeros((*rows, 1)),
    )  # fmt: skip
    views.state[..., QUATERNION.start] = 1.0
    return ObserverGroup(first, views, views, SpiralSearch(section.orbit.radius, SCOUT_SPEED, section.orbit.radius))


class Scouts(Remembers):
    """Scripted aircraft, which send sightings to the boats while the team of aircraft does not take part.

    There are as many as the scenario has aircraft. Each is a point that flies level at `SCOUT_SPEED` along the field of
    `OrbitController` (circling.py) about the true vessel, starting above the boats. It has a gimballed camera that
    looks at the vessel, and a radio. Its instruments have no errors; its camera has finite pixels, and the radio has
    its range, delay and loss.
    """

    def __init__(self, mission: EscortHost, name: str, tracking: SharedTracking):
        """Make one scout for each vehicle of team `name`; all are among the observers of `tracking`."""
        section, like = mission.config.parts[name], mission.hs
        self.mission, self.name, self.section, self.orbit = mission, name, section, section.orbit
        group = tracking.groups[name]
        self.views = self.remember(group.own)
        camera = section.camera.model_copy(update={"mount": "gimbal"})
        self.camera = self.remember(Camera(
            camera, InstrumentsConfig(), tracking.sightings, tracking.objects, mission.hs, self.views, self.views,
            first=group.first, vehicles=mission.config.first_number(name),
        ))  # fmt: skip
        steps = torch.arange(section.count, device=like.device, dtype=like.dtype)
        self._height = self.orbit.height + self.orbit.height_step * steps

    def begin(self, envs: Tensor, place: Tensor) -> None:
        """Begin episodes in environments `envs` [n], with scouts near `place` [n, 2] (m)."""
        state = self.views.state
        turn = 2 * math.pi / self.section.count * torch.arange(self.section.count, device=state.device)
        about = 20.0 * torch.stack((turn.cos(), turn.sin()), dim=-1)
        row = state[envs]
        row[..., :2] = place.unsqueeze(1).to(row) + about.to(row)
        row[..., DOWN] = -self._height
        state[envs] = row

    def truth(self, due: Due) -> None:
        """Advance the scouts by one decision where an episode goes on."""
        state, derived = self.views.state, self.views.derived
        R, sigma, dt = self.orbit.radius, self.orbit.turn, self.mission.config.decision_interval
        x = state[..., :2] - self.mission.vessel_place.unsqueeze(1)
        r = x.norm(dim=-1, keepdim=True).clamp(min=1.0)
        e = x / r
        d = (-(r * r - R * R) * e + 2 * sigma * r * R * to_starboard(e)) / (r * r + R * R)
        step = due.goes_on.to(d).view(-1, 1, 1)
        state[..., :2] += SCOUT_SPEED * dt * step * d
        c, s = d.unbind(-1)
        zero, one = torch.zeros_like(c), torch.ones_like(c)
        derived[..., ROTATION] = torch.stack((c, -s, zero, s, c, zero, zero, zero, one), dim=-1)
        derived[..., VELOCITY_N] = torch.cat((SCOUT_SPEED * d, torch.zeros_like(r)), dim=-1)
        derived[..., HEADING_COS], derived[..., HEADING_SIN] = c, s

    def look(self, due: Due) -> None:
        """Aim the cameras at the vessel, and look."""
        self.camera.aim(self.mission.vessel_place.unsqueeze(1).expand(-1, self.section.count, -1))
        self.camera.see(due)
