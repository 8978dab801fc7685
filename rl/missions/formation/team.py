"""One team's side of the formation mission: errors and surroundings of its vehicles."""

from torch import Tensor

from rl.mission import Mission, Team
from rl.missions.formation.geometry import Geometry
from rl.missions.formation.observations import Observer
from rl.missions.formation.slots import formation_offsets
from rl.missions.formation.targets import Target, Targets
from rl.scene.sensors import Sensor


class TeamTask(Team):
    """Measures one team after each step; everything is [env, vehicle, ...].

    Attributes:
        target: what its leader tracks. now: errors as of the last step or reset (geometry.py).
        seen: what writes its observations (observations.py).
        sensor: obstacles and team mates.
        axes: 2 of vessels, whose errors are level, 3 of aircraft. offsets: [vehicle, 2], slots about the leader, m.
    """

    def __init__(self, mission: Mission, name: str):
        """Prepare team `name`."""
        super().__init__(mission, name)
        state, model = self.fleet.state, self.fleet.model
        self.axes = 2 if model.medium == "water" else 3
        self.radius = model.collision_radius
        offsets = formation_offsets(self.section.formation, self.section.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = mission.config.sensing
        mates = min(sensing.team_mates, self.section.count - 1)
        frame = "body" if self.axes == 3 else "heading"
        self.sensor = Sensor(self.fleet, sensing.obstacles, mates, sensing.detection_range, self.radius, frame)
        self.targets: Targets
        self.target: Target
        self.now: Geometry
        self.seen: Observer

    def follow(self, targets: Targets, height: float) -> None:
        """Hold formation behind `targets`; those of aircraft fly at `height` (m)."""
        down = -height if self.fleet.model.medium == "air" else 0.0
        self.now = Geometry(self.fleet, targets.table, down, self.offsets, self.axes)
        self.targets, self.target = targets, targets.seen_at(self.now.slot[:, 0])
        self.seen = Observer(self, self.mission.config.observations)

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        return self.seen(self.action)

    def measure(self, obstacles: Tensor, env_world: Tensor, which: Tensor, count: int) -> None:
        """Errors and surroundings, obstacles [world, m, 4] among them, of environments `which` (geometry.py)."""
        self.now.measure(which, count)
        self.sensor.look(obstacles, env_world, which, count)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance
