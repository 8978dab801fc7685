"""Configuration of the landing mission, besides world, stages and evaluation."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from rl.perception.radio import RadioConfig
from rl.perception.tracked_objects import SensorsConfig
from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario, TeamSection
from taichi_sim.config import Fraction, NonNegative, Positive, Span, Strict
from taichi_sim.config.plausible import Plausible

Angle = Annotated[float, Field(gt=0, lt=90)]


class LandingConfig(Strict):
    """`[landing]`: the teams' parts, how an episode begins, and when an aircraft has landed."""

    boats: Annotated[str, Field(min_length=1)] = "usv"  # the team with decks
    aircraft: Annotated[str, Field(min_length=1)] = "uav"  # with legs; number i lands on boat i
    # of an aircraft from its deck as an episode begins, level
    distance: Annotated[Span, Plausible(0.5, 5000.0, "m")] = (20.0, 60.0)
    height: Annotated[Span, Plausible(0.5, 1000.0, "m")] = (10.0, 20.0)  # above the mean level of the sea then
    apart: Annotated[Positive, Plausible(2.0, 1e5, "m")] = 200.0  # m between boats, abreast of each other
    # s that all soles must be on the deck without a break
    stand: Annotated[Positive, Plausible(0.05, 600.0, "s")] = 5.0
    # normal speed of a sole that comes down, at most
    hard_speed: Annotated[Positive, Plausible(0.05, 20.0, "m/s")] = 1.0
    hard_tilt_deg: Angle = 10.0  # of the aircraft to the deck at the first touch, at most
    toppled_tilt_deg: Angle = 45.0  # of the aircraft to the deck after it; assumed
    # on the deck, from where all soles were set down, at most
    drift: Annotated[Positive, Plausible(5e-3, 20.0, "m")] = 0.3

    def _mistakes(self) -> Iterator[str]:
        if self.boats == self.aircraft:
            yield f"boats = {self.boats!r}, aircraft = {self.aircraft!r}: must be two teams"


class CourseConfig(Strict):
    """`[course]` of the boats."""

    # that is ordered, of each episode; 0: it stays, as far as its heading allows
    speed: Annotated[Span, Plausible(0.02, 20.0, "m/s")] = (0.0, 1.8)


class MarkerConfig(Strict):
    """`[TEAM.marker]`: a camera that looks straight down (on a gimbal) at a marker in the middle of the deck."""

    field_of_view_deg: Annotated[float, Field(gt=1, lt=179)] = 100.0  # full angle of a cone about the vertical
    axis_deg: Annotated[float, Field(ge=0, le=180)] = 0.0  # of that cone from straight down, toward the nose
    range: Annotated[Positive, Plausible(0.5, 1000.0, "m")] = 25.0  # farther away it is not made out
    # nearer than that it does not fit into the picture
    nearest: Annotated[NonNegative, Plausible(5e-3, 50.0, "m")] = 0.3
    steepest_deg: Angle = 65.0  # between the line of sight and the deck's normal, at most
    size: Annotated[Positive, Plausible(0.02, 20.0, "m")] = 0.8  # side of the marker
    # standard deviation of a corner's line of sight
    pixel_deg: Annotated[NonNegative, Plausible(1e-3, 5.0, "deg")] = 0.1
    loss: Fraction = 0.05  # of all looks
    # of all looks, for each metre of significant wave height
    spray: Annotated[NonNegative, Plausible(1e-4, 1.0, "1/m")] = 0.02

    def _mistakes(self) -> Iterator[str]:
        if self.axis_deg - self.field_of_view_deg / 2 >= 90:
            yield (
                f"axis_deg = {self.axis_deg:g} with field_of_view_deg = {self.field_of_view_deg:g}: the camera looks "
                f"up, and never sees a deck below; axis_deg must be below {90 + self.field_of_view_deg / 2:g}"
            )
        if self.nearest >= self.range:
            yield f"nearest = {self.nearest} m must be below range = {self.range} m"

    @property
    def cos_half(self) -> float:
        """Cosine of half the field of view."""
        return math.cos(math.radians(self.field_of_view_deg / 2))


class PilotConfig(Strict):
    """`[TEAM.pilot]`: numbers of the classical pilots (pilots.py), assumed but where it is said."""

    kind: Literal["descend", "forecast", "glide"] = "glide"
    approach: Annotated[Positive, Plausible(0.1, 50.0, "m/s")] = 5.0  # the most over the deck's own velocity, level
    braking: Annotated[Positive, Plausible(0.05, 20.0, "m/s^2")] = 2.0  # of the approach
    position: Annotated[Positive, Plausible(0.02, 20.0, "1/s")] = 2.0  # of the position loop
    # s until a level command has its effect: rotors, attitude, half a decision
    lag: Annotated[NonNegative, Plausible(2e-3, 5.0, "s")] = 0.2
    # m above the deck, soles: "descend" begins its descent there
    hover: Annotated[Positive, Plausible(0.1, 100.0, "m")] = 3.0
    wait: Annotated[Positive, Plausible(0.05, 50.0, "m")] = 1.2  # m above the deck, soles: "forecast" waits there
    # level, from the deck's middle: near enough to come down
    near: Annotated[Positive, Plausible(5e-3, 5.0, "m")] = 0.17
    fall: Annotated[Positive, Plausible(0.02, 10.0, "m/s")] = 0.5  # m/s over ground, at which "descend" comes down
    sink: Annotated[Positive, Plausible(0.02, 5.0, "m/s")] = 0.3  # m/s over the deck, at which the others touch
    steep: Annotated[Positive, Plausible(0.02, 10.0, "1/s")] = 0.6  # by which that grows with the height above the deck
    # m above the deck, soles: below it the thrust turns to the deck's normal
    flare: Annotated[NonNegative, Plausible(5e-3, 5.0, "m")] = 0.15
    # height above the deck over the distance from its middle, at least, near it
    cone: Annotated[Positive, Plausible(0.05, 50.0)] = 2.0
    slope: Annotated[Positive, Plausible(5e-3, 10.0)] = 0.3  # the same from afar, beside `floor`
    floor: Annotated[Positive, Plausible(0.02, 50.0, "m")] = 1.0
    # vertical speed of the deck in a quiescent window
    quiet_heave: Annotated[Positive, Plausible(0.02, 10.0, "m/s")] = 0.5
    quiet_tilt_deg: Annotated[Positive, Plausible(0.2, 45.0, "deg")] = 5.0  # of the deck in one
    patience: Annotated[Positive, Plausible(0.2, 600.0, "s")] = 8.0  # s: a window is twice as wide after each


class CorrectionConfig(Strict):
    """`[TEAM.correction]`: a policy corrects the velocity that the pilot wants, in the level frame of the deck."""

    level: Annotated[NonNegative, Plausible(0.05, 30.0, "m/s")] = 4.0  # the most, ahead and to starboard of the deck
    vertical: Annotated[NonNegative, Plausible(0.05, 30.0, "m/s")] = 4.0  # the most
    # m from the deck: nearer, both fall in proportion, to 0.15 of themselves at it
    reach: Annotated[Positive, Plausible(0.2, 500.0, "m")] = 8.0


class LandingTeam(TeamSection):
    """One team: its vehicle and size (TeamConfig), and the parameters of its part."""

    sensors: SensorsConfig = SensorsConfig()
    marker: MarkerConfig = MarkerConfig()  # of aircraft
    pilot: PilotConfig = PilotConfig()  # of aircraft
    correction: CorrectionConfig | None = None  # of aircraft; none: a policy gives the vehicle's own actions
    control: dict[str, float] = {}  # of boats: numbers of their classical controller
    plan: PlanConfig = PlanConfig()


class LandingEvaluation(Evaluation):
    """Episodes never trained on."""

    settle: NonNegative = 0.0


class LandingScenario(Scenario):
    """A scenario of the landing mission."""

    __pydantic_extra__: dict[str, LandingTeam] = Field(init=False)

    landing: LandingConfig = LandingConfig()
    course: CourseConfig = CourseConfig()
    radio: RadioConfig = RadioConfig()
    evaluation: LandingEvaluation = LandingEvaluation()

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        for key in ("boats", "aircraft"):
            name = getattr(self.landing, key)
            if name not in self.teams:
                yield f"landing.{key} = {name!r}: there is no such team; there are {', '.join(map(repr, self.teams))}"
            if self.teams[name].script is not None:
                yield f"{name}.script: the mission steers {name}, remove the script"
        boats, aircraft = (self.teams[getattr(self.landing, key)].count for key in ("boats", "aircraft"))
        if aircraft != boats:
            yield (
                f"{self.landing.aircraft}.count = {aircraft}: must be {self.landing.boats}.count = {boats}: each lands "
                "on a boat of its own"
            )

    @property
    def scripted(self) -> tuple[str, ...]:
        """The boats, too, which hold their courses."""
        return (*super().scripted, self.landing.boats)

    @property
    def parts(self) -> dict[str, LandingTeam]:
        """Sections of the teams."""
        return dict(self.__pydantic_extra__ or {})
