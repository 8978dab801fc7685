"""What a scenario may say: mission, teams, training, evaluation, and all sections together."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from taichi_sim.config.air import AirConfig
from taichi_sim.config.base import Finite, Fraction, NonNegative, Positive, Strict
from taichi_sim.config.sea import SeaConfig


class TrackConfig(Strict):
    """The closed tracks that the targets move along; one per world."""

    worlds: Annotated[int, Field(ge=1, le=8192)] = 256  # different tracks (and obstacle fields) in one run
    length: Annotated[float, Field(ge=400, le=50_000)] = 4000.0  # m
    checkpoints: Annotated[int, Field(ge=4, le=200)] = 22
    min_radius: Annotated[float, Field(ge=10, le=10_000)] = 100.0  # smallest radius of curvature, m
    flight_height: Annotated[float, Field(gt=0, le=1000)] = 60.0  # of the UAV target above mean sea level, m
    target_speed: Annotated[float, Field(gt=0, le=100)] = 12.0  # of both targets along their tracks, m/s
    speed_over: Literal["ground", "air"] = "ground"  # target_speed is over ground, or through the air at flight height


class FixedObstacle(Strict):
    """One vertical cylinder that stands in every world."""

    north: Finite  # m
    east: Finite  # m
    radius: Positive  # m
    height: Positive  # above mean sea level, m


class ObstacleConfig(Strict):
    """Vertical cylinders beside the track."""

    count: Annotated[int, Field(ge=0, le=500)] = 24  # generated, per world
    clearance_min: Annotated[float, Field(ge=-30, le=500)] = 6.0  # from the outermost lane, m; < 0: in the lanes
    clearance_max: Annotated[float, Field(ge=0, le=1000)] = 60.0  # m
    radius_min: Positive = 3.0  # m
    radius_max: Positive = 10.0  # m
    tall_fraction: Fraction = 0.4  # that reach above the flight height
    fixed: tuple[FixedObstacle, ...] = ()

    @model_validator(mode="after")
    def _ordered(self):
        if self.clearance_max < self.clearance_min:
            raise ValueError(f"clearance_max = {self.clearance_max} must not be below clearance_min")
        if self.radius_max < self.radius_min:
            raise ValueError(f"radius_max = {self.radius_max} must not be below radius_min")
        return self


class TrackingReward(Strict):
    """Weights and scales of `reward = "tracking"`; one function each in rl/missions/formation/rewards.py."""

    coarse: NonNegative = 1.0  # exp(-(d / coarse_scale)^2)
    coarse_scale: Positive = 8.0  # m
    fine: NonNegative = 1.0  # 1 / (1 + (d / fine_scale)^2)
    fine_scale: Positive = 0.5  # m
    approach: NonNegative = 0.02  # -d per metre
    action_rate: NonNegative = 0.02  # -|a - a_previous|^2
    clearance: NonNegative = 0.5  # -(1 - gap / clearance_range)^2 inside the range
    clearance_range: Positive = 4.0  # m, gap to the nearest obstacle or team mate
    ending: NonNegative = 10.0  # -1 at a collision, or any other early ending


class TeamConfig(Strict):
    """One team: its vehicle, size, formation and rewards."""

    vehicle: Annotated[str, Field(min_length=1)]  # a file of configs/vehicles, without .toml, or a path
    count: Annotated[int, Field(ge=1, le=64)] = 3  # vehicle 0 leads
    formation: Literal["abreast", "astern"] = "abreast"  # line abreast or line astern of the leader
    spacing: Annotated[float, Field(gt=0, le=200)] = 15.0  # between neighbours, m
    start_distance: NonNegative = 30.0  # leaders start within this distance of the target, m
    lost_distance: Positive = 150.0  # a vehicle this far from its slot is lost and ends the episode, m
    tracking_reward: TrackingReward = TrackingReward()

    @model_validator(mode="after")
    def _start_within_reach(self):
        if self.start_distance >= self.lost_distance:
            raise ValueError(f"start_distance = {self.start_distance} must be below lost_distance")
        return self


class SensingConfig(Strict):
    """Partial observability: what a vehicle sees of obstacles and team mates."""

    detection_range: Positive = 40.0  # m
    obstacles: Annotated[int, Field(ge=0, le=8)] = 2  # nearest ones observed
    team_mates: Annotated[int, Field(ge=0, le=8)] = 2  # nearest ones observed


class StageConfig(Strict):
    """One training stage: which team learns (the other acts from frozen weights), and PPO's numbers."""

    team: Literal["usv", "uav"]
    iterations: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    num_envs: Annotated[int, Field(ge=1, le=1_000_000)] = 512
    steps_per_iteration: Annotated[int, Field(ge=2, le=1000)] = 24
    hidden_dims: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(min_length=1)] = (64, 64)
    activation: Literal["elu", "relu", "tanh"] = "elu"
    learning_rate: Positive = 1e-3
    learning_epochs: Annotated[int, Field(ge=1, le=100)] = 2
    mini_batches: Annotated[int, Field(ge=1, le=1000)] = 8
    discount: Annotated[float, Field(gt=0, lt=1)] = 0.97
    gae_lambda: Annotated[float, Field(ge=0, le=1)] = 0.95
    clip: Positive = 0.2
    entropy: NonNegative = 0.0
    desired_kl: Positive = 0.01
    initial_std: Positive = 0.6
    checkpoint_interval: Annotated[int, Field(ge=1)] = 25  # iterations


class EvaluationConfig(Strict):
    """Episodes never trained on."""

    episodes: Annotated[int, Field(ge=1, le=100_000)] = 256
    seed: Annotated[int, Field(ge=0)] = 1000
    settle: NonNegative = 20.0  # s at the start of an episode that are not measured
    success_error: Positive = 5.0  # rms of the leader and of every follower below this is a success, m


class ScenarioConfig(Strict):
    """A whole scenario: physics, mission, training, evaluation."""

    name: Annotated[str, Field(min_length=1)]
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1
    dt: Annotated[float, Field(gt=0, le=0.1)] = 0.02  # physics step, s
    decision_interval: Annotated[float, Field(gt=0, le=5)] = 0.1  # a policy acts this often, s
    episode_duration: Annotated[float, Field(gt=0, le=100_000)] = 60.0  # s
    area: Annotated[float, Field(ge=100, le=100_000)] = 3000.0  # side of the square centred at the origin, m
    observations: Literal["paper", "full"] = "full"
    reward: Literal["paper", "tracking"] = "tracking"
    sea: SeaConfig = SeaConfig()
    air: AirConfig = AirConfig()
    track: TrackConfig = TrackConfig()
    obstacles: ObstacleConfig = ObstacleConfig()
    sensing: SensingConfig = SensingConfig()
    usv: TeamConfig
    uav: TeamConfig
    stages: dict[str, StageConfig] = {}
    evaluation: EvaluationConfig = EvaluationConfig()

    @property
    def substeps(self) -> int:
        """Physics steps per decision."""
        return round(self.decision_interval / self.dt)

    @property
    def episode_steps(self) -> int:
        """Decisions per episode."""
        return max(1, round(self.episode_duration / self.decision_interval))

    def team(self, name: str) -> TeamConfig:
        """The section of team "usv" or "uav"."""
        return {"usv": self.usv, "uav": self.uav}[name]

    @model_validator(mode="after")
    def _consistent(self):
        ratio = self.decision_interval / self.dt
        if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
            raise ValueError(f"decision_interval = {self.decision_interval} must be a whole multiple of dt = {self.dt}")
        if self.track.speed_over == "air" and self.air.speed is None and self.air.beaufort is None:
            raise ValueError(
                "track.speed_over = 'air' needs a wind: [air] gives neither speed nor beaufort (speed = 0 is calm)"
            )
        half = self.area / 2
        for i, o in enumerate(self.obstacles.fixed):
            if max(abs(o.north), abs(o.east)) + o.radius > half:
                raise ValueError(
                    f"obstacles.fixed[{i}] at ({o.north}, {o.east}) with radius {o.radius} reaches outside the "
                    f"area: |north| and |east| plus radius must be at most area / 2 = {half}"
                )
        teams = [s.team for s in self.stages.values()]
        if len(set(teams)) != len(teams):
            raise ValueError(f"stages train {teams}: each team may be trained by one stage only")
        return self
