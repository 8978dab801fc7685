"""One team's side of the formation mission: errors and surroundings of its vehicles."""

from typing import Any

import torch
from torch import Tensor

from rl.course.traffic import Bodies
from rl.guidance.geometry import Geometry
from rl.guidance.observations import ObservationWriter
from rl.guidance.residual import ResidualTeam
from rl.guidance.targets import Target, Targets
from rl.mission import Mission
from rl.missions.formation.measured import Measured
from rl.missions.formation.slots import Slots
from rl.perception.sensors import Sensor
from taichi_sim.kernels import runtime

GLIDE_SHARE = 0.15  # of the target's speed, with which slots glide to a new formation; assumed


class TeamTask(ResidualTeam):
    """Measures one team after each step; everything is [env, vehicle, ...].

    Attributes:
        target: what its leader tracks. now: errors as of the last step or reset (geometry.py).
        known: what its vehicles know of all this, which policies and controllers act by (measured.py).
        seen: what writes its observations (observations.py).
        sensor: obstacles and team mates.
        axes: 2 of vessels, whose errors are level, 3 of aircraft.
        slots: about the leader (slots.py). offsets: [env, vehicle, 2] of them, a live view, m.
    """

    STATE = ("slots", "sensor", "now", "known")

    def __init__(self, mission: Mission, name: str):
        """Prepare team `name`."""
        super().__init__(mission, name)
        state, model = self.fleet.state, self.fleet.model
        self.axes = 2 if model.medium == "water" else 3
        self.radius = model.collision_radius
        config = mission.config
        glide = self.section.formation.glide or GLIDE_SHARE * config.track.target_speed
        interval, steps = config.decision_interval, config.episode_steps
        self.slots = Slots(self.section, state, interval=interval, glide=glide, steps=steps)
        self.offsets = self.slots.offsets
        sensing, frame = config.sensing, "body" if self.axes == 3 else "heading"
        reach = sensing.detection_range
        # As many team mates in a team of one as in one of sixteen: what is not there is out of range.
        self.sensor = Sensor(self.fleet, sensing.obstacles, sensing.team_mates, reach, self.radius, frame)
        self.targets: Targets
        self.target: Target
        self.now: Geometry
        self.known: Any
        self.seen: ObservationWriter
        self._true: ObservationWriter | None = None

    def follow(self, targets: Targets, height: float) -> None:
        """Hold formation behind `targets`; those of aircraft fly at `height` (m)."""
        self.down = -height if self.fleet.model.medium == "air" else 0.0
        self.now = Geometry(self.fleet, targets.table, self.down, self.slots.table, self.axes)
        self.targets, self.target = targets, targets.seen_at(self.now.slot[:, 0])
        config = self.mission.config
        exact = config.radio is None and config.sensors.exact and config.sensors.scaled_contacts.exact
        self.known = self if exact else Measured(self, list(config.teams).index(self.name))
        self.seen = ObservationWriter(self.known, config.observations)

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        with runtime.torch_at_rest():
            return self.seen(self.action, self.action if self.residual is None else self.reference())

    @property
    def privileged(self) -> Tensor | None:
        """The truth [env, vehicle, n], where its vehicles do not know it: errors and surroundings, and what varies."""
        told = []
        if self.known is not self:
            if self._true is None:
                self._true = ObservationWriter(self, self.mission.config.observations)
            told.append(self._true(self.action, self.action if self.residual is None else self.reference()))
        if self.mission.config.varies:
            told.append(self.mission.world.truth[self.name])
        return torch.cat(told, dim=-1) if told else None

    def measure(self, obstacles: Tensor, bodies: Bodies, env_world: Tensor, which: Tensor, count: int) -> None:
        """Errors and surroundings, obstacles [world, m, 4] and `bodies` among them, of environments `which`
        (geometry.py), `count` of them.
        """
        self.forget()
        self.now.measure(which, count)
        self.sensor.look(obstacles, env_world, which, count, bodies)
        if self.known is not self:
            self.known.measure(which, count, self.mission.steps)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance
