"""One team's side of the formation mission: errors and surroundings of its vehicles."""

from torch import Tensor

from rl.mission import Mission, Team
from rl.missions.formation.config import ResidualConfig
from rl.missions.formation.geometry import Geometry
from rl.missions.formation.observations import Observer
from rl.missions.formation.slots import Slots
from rl.missions.formation.targets import Target, Targets
from rl.scene.sensors import Sensor
from rl.scene.traffic import Bodies
from taichi_sim import runtime
from taichi_sim.config import ConfigError

GLIDE_SHARE = 0.15  # of the target's speed, with which slots glide to a new formation; assumed


class TeamTask(Team):
    """Measures one team after each step; everything is [env, vehicle, ...].

    Attributes:
        target: what its leader tracks. now: errors as of the last step or reset (geometry.py).
        seen: what writes its observations (observations.py).
        sensor: obstacles and team mates.
        axes: 2 of vessels, whose errors are level, 3 of aircraft.
        slots: about the leader (slots.py). offsets: [env, vehicle, 2] of them, a live view, m.
    """

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
        self._controller, self._reference = None, None
        self.targets: Targets
        self.target: Target
        self.now: Geometry
        self.seen: Observer

    def follow(self, targets: Targets, height: float) -> None:
        """Hold formation behind `targets`; those of aircraft fly at `height` (m)."""
        down = -height if self.fleet.model.medium == "air" else 0.0
        self.now = Geometry(self.fleet, targets.table, down, self.slots.table, self.axes)
        self.targets, self.target = targets, targets.seen_at(self.now.slot[:, 0])
        self.seen = Observer(self, self.mission.config.observations)

    @property
    def residual(self) -> ResidualConfig | None:
        """How its policy corrects the classical controller; None if it acts alone."""
        residual = self.section.residual
        return residual if residual is not None and residual.share > 0 else None

    @property
    def action_names(self) -> tuple[str, ...]:
        """What its policy commands, each in [-1, 1]: the vehicle's actions, or corrections of them."""
        names = super().action_names
        return names if self.residual is None else tuple(f"{name} (correction)" for name in names)

    def command(self, action: Tensor) -> Tensor:
        """The vehicles' actions: the policy's, or the classical ones that they correct (config.ResidualConfig)."""
        if self.residual is None:
            return action
        correction = self.residual.share * (action.clamp(-1.0, 1.0) + 0.0 * action)  # what is not finite stays so
        if self.residual.gate is not None:
            near = (2 - self.sensor.gap * (2 / self.residual.gate)).clamp(0.0, 1.0)
            correction = correction * near.unsqueeze(-1)
        return (self.reference() + correction).clamp(-1.0, 1.0)

    def reference(self) -> Tensor:
        """Actions of the classical controller now [env, vehicle, action]."""
        if self._reference is None:
            if self._controller is None:
                self._controller = self.mission.controller(self)
                if self._controller is None:
                    raise ConfigError(
                        f"{self.name}.residual: there is no classical controller to correct for "
                        f"{self.name}.vehicle = {self.section.vehicle!r}"
                    )
            self._reference = self._controller(self)
        return self._reference

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        with runtime.torch_at_rest():
            return self.seen(self.action, self.action if self.residual is None else self.reference())

    def measure(self, obstacles: Tensor, bodies: Bodies, env_world: Tensor, which: Tensor, count: int) -> None:
        """Errors and surroundings, obstacles [world, m, 4] and `bodies` among them, of environments `which`
        (geometry.py), `count` of them.
        """
        self._reference = None
        self.now.measure(which, count)
        self.sensor.look(obstacles, env_world, which, count, bodies)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance
