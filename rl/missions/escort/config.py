"""Configuration of the escort mission, besides world, stages and evaluation."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from rl.guidance.course.obstacles import FixedObstacle
from rl.guidance.residual import ResidualConfig
from rl.guidance.shapes import EscortShape
from rl.perception.radio import RadioConfig
from rl.perception.sightings import CameraConfig, LookoutConfig
from rl.perception.tracked_objects import SensorsConfig
from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario, TeamSection
from taichi_sim.config import Fraction, NonNegative, Positive, Span, Strict
from taichi_sim.config.plausible import Plausible

ROOM = 12.0  # m from an obstacle's surface to where a vehicle begins; assumed


class EscortConfig(Strict):
    """`[escort]`: the teams' parts, and how an episode begins."""

    vessel: Annotated[str, Field(min_length=1)] = "vessel"  # the scripted team that is escorted; its first vehicle
    boats: Annotated[str, Field(min_length=1)] = "usv"
    aircraft: Annotated[str, Field(min_length=1)] = "uav"
    worlds: Annotated[int, Field(ge=1, le=8192)] = 256  # different starts (and obstacle fields) in one run
    start_distance: Annotated[Span, Plausible(1.0, 5000.0, "m")] = (200.0, 500.0)  # of boats from the vessel
    near_fraction: Fraction = 0.0  # share of episodes that begin near the vessel: for training
    # speed at which the sea may lift a boat when an episode begins: at once in a steeper sea it is swamped; by trial
    start_lift: Annotated[Positive, Plausible(0.05, 50.0, "m/s")] = 0.9
    # standard deviation, each way, of the cue: the vessel's place given at the start
    cue_error: Annotated[NonNegative, Plausible(0.1, 5000.0, "m")] = 30.0
    cue_age: Annotated[NonNegative, Plausible(0.1, 5000.0, "s")] = 60.0  # age of the cue at the start
    # m: the leader has arrived when it is nearer to the vessel
    arrival: Annotated[Positive, Plausible(0.5, 1000.0, "m")] = 15.0
    # s: an older track does not count as knowledge of the vessel
    stale: Annotated[Positive, Plausible(0.1, 1000.0, "s")] = 5.0
    # s without a sighting or a message before a vehicle searches; assumed
    lost: Annotated[Positive, Plausible(0.5, 5000.0, "s")] = 20.0
    reports: Literal["all", "none", "others"] = "all"  # messages: as sent; none; those of another environment

    def _mistakes(self) -> Iterator[str]:
        if len({self.vessel, self.boats, self.aircraft}) < 3:
            yield (
                f"vessel = {self.vessel!r}, boats = {self.boats!r}, aircraft = {self.aircraft!r}: must be three teams"
            )


class VesselCourseConfig(Strict):
    """`[course]` of the vessel, which changes course and speed at random times."""

    speed: Annotated[Span, Plausible(0.05, 30.0, "m/s")] = (0.8, 2.0)
    # s between two changes, on average (exponentially distributed); assumed
    every: Annotated[Positive, Plausible(1.0, 1e4, "s")] = 40.0
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 120.0  # greatest change of course, either way; assumed
    turn_rate_deg: Annotated[Positive, Plausible(0.05, 180.0, "deg/s")] = 4.0  # rate of the commanded course; assumed
    evasive: bool = False  # whether it flees from boats within evasive_range
    evasive_range: Annotated[Positive, Plausible(1.0, 5000.0, "m")] = 40.0


class ObstaclesConfig(Strict):
    """`[obstacles]`: fixed and moving cylinders between the boats and the vessel and around it; assumed."""

    count: Annotated[int, Field(ge=0, le=64)] = 10  # fixed ones
    moving: Annotated[int, Field(ge=0, le=16)] = 2  # moving ones, which cross the boats' way
    radius: Annotated[Span, Plausible(0.05, 500.0, "m")] = (1.0, 5.0)
    speed: Annotated[Span, Plausible(0.02, 50.0, "m/s")] = (0.3, 1.0)  # of moving ones
    # m to either side of the boats' way, and around the vessel's
    spread: Annotated[Positive, Plausible(1.0, 5000.0, "m")] = 60.0
    fixed: tuple[FixedObstacle, ...] = ()  # in every world, m from the vessel's start

    def _mistakes(self) -> Iterator[str]:
        if self.radius[0] <= 0:
            yield f"radius = {list(self.radius)}: must be above 0"


class EscortSensingConfig(Strict):
    """Obstacles and team mates that a vehicle observes."""

    detection_range: Annotated[Positive, Plausible(1.0, 2e4, "m")] = 60.0  # m: farther objects are not avoided
    obstacles: Annotated[int, Field(ge=0, le=8)] = 3  # nearest ones observed
    team_mates: Annotated[int, Field(ge=0, le=8)] = 2


class OrbitConfig(Strict):
    """`[TEAM.orbit]`: the circle about the vessel on which aircraft fly at even phases."""

    radius: Annotated[Positive, Plausible(5.0, 1e4, "m")] = 150.0
    height: Annotated[Positive, Plausible(2.0, 5000.0, "m")] = 100.0  # m above the sea
    # m between the heights of successive aircraft
    height_step: Annotated[NonNegative, Plausible(0.2, 500.0, "m")] = 15.0
    direction: Literal["clockwise", "anticlockwise"] = "clockwise"

    @property
    def turn(self) -> float:
        """1 for clockwise, seen from above, else -1."""
        return 1.0 if self.direction == "clockwise" else -1.0


class EscortTeam(TeamSection):
    """One team: its vehicle and size (TeamConfig), and the parameters of its part."""

    formation: EscortShape = "astern"  # of boats about the vessel (shapes.py)
    spacing: Annotated[float, Field(gt=0, le=100), Plausible(0.3, 100.0, "m")] = 10.0  # between neighbours
    sensors: SensorsConfig = SensorsConfig()
    lookout: LookoutConfig = LookoutConfig()  # of boats
    camera: CameraConfig = CameraConfig()  # of aircraft
    orbit: OrbitConfig = OrbitConfig()
    residual: ResidualConfig | None = None
    control: dict[str, float] = {}  # gains of its classical controller; default: its own
    plan: PlanConfig = PlanConfig()


class EscortEvaluation(Evaluation):
    """Held-out episodes, and the criterion of success."""

    settle: NonNegative = 0.0  # s; unused, as errors are measured after the arrival
    # success: every boat's rms error after the arrival is below
    success_error: Annotated[Positive, Plausible(0.05, 500.0, "m")] = 5.0
    # s after the arrival at which errors begin to be measured
    settle_after: Annotated[NonNegative, Plausible(0.5, 5000.0, "s")] = 40.0


class EscortScenario(Scenario):
    """A scenario of the escort mission."""

    __pydantic_extra__: dict[str, EscortTeam] = Field(init=False)

    plain: ClassVar[Mapping[str, str]] = {}

    area: Annotated[float, Field(ge=500, le=100_000)] = 4000.0  # side of the square centred at the origin, m
    escort: EscortConfig = EscortConfig()
    course: VesselCourseConfig = VesselCourseConfig()
    obstacles: ObstaclesConfig = ObstaclesConfig()
    sensing: EscortSensingConfig = EscortSensingConfig()
    radio: RadioConfig = RadioConfig()
    evaluation: EscortEvaluation = EscortEvaluation()

    @property
    def parts(self) -> dict[str, EscortTeam]:
        """The sections of the teams."""
        return dict(self.__pydantic_extra__ or {})

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        for key in ("vessel", "boats"):
            name = getattr(self.escort, key)
            if name not in self.teams:
                yield f"escort.{key} = {name!r}: there is no such team; there are {', '.join(map(repr, self.teams))}"
        if self.teams[self.escort.vessel].script is None:
            yield (
                f"{self.escort.vessel}.script: the vessel that is escorted needs one, such as "
                '"rl.missions.escort.vessel:Wanderer"'
            )
        for i, o in enumerate(self.obstacles.fixed):
            if math.hypot(o.north, o.east) < o.radius + ROOM:
                yield (
                    f"obstacles.fixed[{i}] at ({o.north}, {o.east}) with radius {o.radius}: the vessel begins at "
                    f"(0, 0), and needs {ROOM} m of room"
                )
        if self.escort.start_distance[1] > self.area / 2:
            yield (
                f"escort.start_distance = {list(self.escort.start_distance)}: must be at most area / 2 = "
                f"{self.area / 2}"
            )
