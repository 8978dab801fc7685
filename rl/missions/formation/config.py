"""Configuration of the formation mission, besides world, stages and evaluation."""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field, model_validator

from rl.guidance.course.obstacles import FixedObstacle
from rl.guidance.residual import ResidualConfig
from rl.guidance.shapes import Shape
from rl.perception.radio import RadioConfig
from rl.perception.tracked_objects import SensorsConfig
from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario, TeamSection
from taichi_sim.config import Fraction, NonNegative, Ordered, Positive, Strict
from taichi_sim.config.plausible import Plausible

TargetSpeed = Annotated[float, Field(gt=0, le=100), Plausible(0.05, 100.0, "m/s")]
SpeedOver = Literal["ground", "air"]


class Pace(NamedTuple):
    """How fast the target of a team moves along its track."""

    speed: float  # m/s
    over: SpeedOver  # over ground, or through the air at the flight height


class TrackConfig(Strict):
    """The closed tracks that the targets move along; one per world."""

    # waypoints of one track for all worlds (rl/guidance/course/route.py), in place of `length` and `checkpoints`
    file: str | None = None
    worlds: Annotated[int, Field(ge=1, le=8192)] = 256  # different tracks (and obstacle fields) in one run
    length: Annotated[float, Field(ge=400, le=50_000)] = 4000.0  # m
    checkpoints: Annotated[int, Field(ge=4, le=200)] = 22
    min_radius: Annotated[float, Field(ge=10, le=10_000)] = 100.0  # smallest radius of curvature, m
    # of the UAV target above mean sea level
    flight_height: Annotated[float, Field(gt=0, le=1000), Plausible(2.0, 1000.0, "m")] = 60.0
    target_speed: TargetSpeed = 12.0  # of targets along their tracks, m/s; a team may have its own
    speed_over: SpeedOver = "ground"  # target_speed is over ground, or through the air at flight height


class ObstacleConfig(Strict):
    """Vertical cylinders beside the track and in the lanes, some of which move (rl/guidance/course/obstacles.py)."""

    count: Annotated[int, Field(ge=0, le=500)] = 24  # generated ones, per lap
    clearance_min: Annotated[float, Field(ge=-500, le=500)] = 6.0  # from the outermost lane, m; < 0: in the lanes
    # from the track itself, whatever the lanes
    track_clearance: Annotated[float, Field(ge=0, le=500), Plausible(0.1, 500.0, "m")] = 12.0
    clearance_max: Annotated[float, Field(ge=-500, le=1000)] = 60.0  # m
    radius_min: Annotated[Positive, Plausible(0.05, 500.0, "m")] = 3.0
    radius_max: Annotated[Positive, Plausible(0.05, 500.0, "m")] = 10.0
    tall_fraction: Fraction = 0.4  # share that reaches above the flight height
    moving_fraction: Fraction = 0.0  # share that moves, of those that a team would meet
    drifting_fraction: Fraction = 0.25  # share of moving ones that the current carries
    overtaking_fraction: Fraction = 0.25  # share of moving ones that go the way of the team; the rest crosses
    speed_min: Annotated[NonNegative, Plausible(0.02, 50.0, "m/s")] = 2.0  # of moving ones
    speed_max: Annotated[Positive, Plausible(0.02, 50.0, "m/s")] = 6.0
    fixed: tuple[FixedObstacle, ...] = ()
    # those beside a team's lanes do not stand in its way to them when an episode begins, nor do mates that can stop
    off_ways: bool = True

    def _mistakes(self) -> Iterator[str]:
        for key in ("clearance", "radius", "speed"):
            low, high = getattr(self, f"{key}_min"), getattr(self, f"{key}_max")
            if high < low:
                yield f"{key}_max = {high} must not be below {key}_min = {low}"
        if self.drifting_fraction + self.overtaking_fraction > 1:
            yield (
                f"drifting_fraction = {self.drifting_fraction} and overtaking_fraction = {self.overtaking_fraction} "
                "must not be above 1 together"
            )


Spacing = Annotated[float, Field(gt=0, le=200), Plausible(0.3, 200.0, "m")]
SpacingRange = Annotated[tuple[Spacing, Spacing], Ordered]


class FormationConfig(Strict):
    """The shape of a team (shapes.py), and its changes; a plain string is a shape that does not change."""

    shape: Shape = "abreast"
    shapes: Annotated[tuple[Shape, ...], Field(min_length=1)] | None = None  # drawn anew for episodes and changes
    spacing_range: SpacingRange | None = None  # m, range of spacings drawn likewise; default: spacing
    # s between changes; default: no change in an episode
    change_every: Annotated[Positive, Plausible(1.0, 1e4, "s")] | None = None
    # m/s of a slot to its new place; default: 15 % of the target's speed; assumed
    glide: Annotated[Positive, Plausible(0.02, 50.0, "m/s")] | None = None

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, given: object) -> object:
        return {"shape": given} if isinstance(given, str) else given


class FormationTeam(TeamSection):
    """One team: its vehicle and size (TeamConfig), and formation; vehicle 0 leads."""

    formation: FormationConfig = FormationConfig()
    spacing: Spacing = 15.0  # between neighbours, m
    target_speed: TargetSpeed | None = None  # m/s; default: track.target_speed
    speed_over: SpeedOver | None = None  # default: track.speed_over
    # leaders start within this distance of the target
    start_distance: Annotated[NonNegative, Plausible(0.1, 5000.0, "m")] = 30.0
    # a vehicle this far from its slot is lost and ends the episode
    lost_distance: Annotated[Positive, Plausible(1.0, 2e4, "m")] = 150.0
    residual: ResidualConfig | None = None
    control: dict[str, float] = {}  # gains of its classical controller (rl/guidance/controllers); default: its own
    plan: PlanConfig = PlanConfig()

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Shapes that its formation takes."""
        return self.formation.shapes or (self.formation.shape,)

    @property
    def spacings(self) -> tuple[float, float]:
        """Least and greatest spacing of its formation, m."""
        return self.formation.spacing_range or (self.spacing, self.spacing)

    def _mistakes(self) -> Iterator[str]:
        if self.start_distance >= self.lost_distance:
            yield f"start_distance = {self.start_distance} must be below lost_distance"


class SensingConfig(Strict):
    """Partial observability: obstacles and team mates that a vehicle senses."""

    detection_range: Annotated[Positive, Plausible(1.0, 2e4, "m")] = 40.0
    obstacles: Annotated[int, Field(ge=0, le=8)] = 2  # nearest ones observed
    team_mates: Annotated[int, Field(ge=0, le=8)] = 2  # nearest ones observed


class FormationEvaluation(Evaluation):
    """Held-out episodes, and the criterion of success."""

    # m: an episode with a smaller rms error of every vehicle is a success
    success_error: Annotated[Positive, Plausible(0.05, 500.0, "m")] = 5.0


class FormationScenario(Scenario):
    """A scenario of the formation mission: every team holds formation behind a target of its own medium."""

    __pydantic_extra__: dict[str, FormationTeam] = Field(init=False)

    ways: ClassVar = {
        **Scenario.ways,
        "formation": (("shape",), ("shapes",)),
        "track": (("length", "checkpoints"), ("file",)),
    }
    plain: ClassVar[Mapping[str, str]] = {"formation": "shape"}

    area: Annotated[float, Field(ge=100, le=100_000)] = 3000.0  # side of the square centred at the origin, m
    observations: Literal["paper", "full"] = "full"
    reward: Literal["paper", "tracking"] = "tracking"
    track: TrackConfig = TrackConfig()
    obstacles: ObstacleConfig = ObstacleConfig()
    sensing: SensingConfig = SensingConfig()
    sensors: SensorsConfig = SensorsConfig()
    radio: RadioConfig | None = None  # omitted: followers know their leader exactly and without delay
    evaluation: FormationEvaluation = FormationEvaluation()

    @property
    def formations(self) -> dict[str, FormationTeam]:
        """Sections of the teams."""
        return dict(self.__pydantic_extra__ or {})

    def pace(self, team: str) -> Pace:
        """Speed of a team's target."""
        section = self.formations[team]
        return Pace(section.target_speed or self.track.target_speed, section.speed_over or self.track.speed_over)

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        over = {"track": self.track.speed_over, **{name: team.speed_over for name, team in self.formations.items()}}
        over_air = next((name for name, what in over.items() if what == "air"), None)
        if over_air and self.air.speed is None and self.air.beaufort is None:
            yield (
                f"{over_air}.speed_over = 'air' needs a wind: [air] gives neither speed nor beaufort "
                "(speed = 0 is calm)"
            )
        half = self.area / 2
        for i, o in enumerate(self.obstacles.fixed):
            if max(abs(o.north), abs(o.east)) + o.radius > half:
                yield (
                    f"obstacles.fixed[{i}] at ({o.north}, {o.east}) with radius {o.radius} reaches outside the "
                    f"area: |north| and |east| plus radius must be at most area / 2 = {half}"
                )
