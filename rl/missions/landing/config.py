"""Configuration of the landing mission, besides world, stages and evaluation."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rl.missions.landing.rewards import AircraftReward, BoatReward
from rl.perception.contacts import SensorsConfig
from rl.perception.radio import RadioConfig
from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario
from taichi_sim.config import Fraction, NonNegative, Positive, Span, Strict, TeamConfig

Angle = Annotated[float, Field(gt=0, lt=90)]


class LandingConfig(Strict):
    """`[landing]`: the teams' parts, how an episode begins, and when an aircraft has landed."""

    boats: Annotated[str, Field(min_length=1)] = "usv"  # the team with decks
    aircraft: Annotated[str, Field(min_length=1)] = "uav"  # with legs; number i lands on boat i, modulo their number
    distance: Span = (20.0, 60.0)  # of an aircraft from its deck as an episode begins, level, m
    height: Span = (10.0, 20.0)  # above the mean level of the sea then, m
    apart: Positive = 200.0  # m between boats, abreast of each other
    hold_distance: Positive = 20.0  # where aircraft wait for their turn on a deck: from it, level, m; assumed
    hold_height: Positive = 12.0  # above its mean height, m, the first; the next ones 4 m more each; assumed
    stand: Positive = 5.0  # s that all soles must be on the deck without a break
    hard_speed: Positive = 1.0  # normal speed of a sole that comes down, at most, m/s
    hard_tilt_deg: Angle = 10.0  # of the aircraft to the deck at the first touch, at most
    toppled_tilt_deg: Angle = 45.0  # of the aircraft to the deck after it; assumed
    drift: Positive = 0.3  # on the deck, from where all soles were set down, at most, m

    @model_validator(mode="after")
    def _consistent(self):
        if self.boats == self.aircraft:
            raise ValueError(f"boats = {self.boats!r}, aircraft = {self.aircraft!r}: must be two teams")
        return self


class CourseConfig(Strict):
    """`[course]` of the boats."""

    speed: Span = (0.0, 1.8)  # that is ordered, of each episode, m/s; 0: it stays, as far as its heading allows
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 60.0  # by which a policy may leave the ordered course, each way
    change: NonNegative = 0.8  # by which it may leave the ordered speed, each way, m/s; never below 0
    turn_rate_deg: Positive = 4.0  # deg/s, of the course that is steered; assumed


class MarkerConfig(Strict):
    """`[TEAM.marker]`: a camera that looks straight down (on a gimbal) at a marker in the middle of the deck."""

    field_of_view_deg: Annotated[float, Field(gt=1, lt=179)] = 100.0  # full angle of a cone about the vertical
    axis_deg: Annotated[float, Field(ge=0, le=180)] = 0.0  # of that cone from straight down, toward the nose
    range: Positive = 25.0  # m, farther away it is not made out
    nearest: NonNegative = 0.3  # m, nearer than that it does not fit into the picture
    steepest_deg: Angle = 65.0  # between the line of sight and the deck's normal, at most
    size: Positive = 0.8  # m, side of the marker
    pixel_deg: NonNegative = 0.1  # standard deviation of a corner's line of sight
    loss: Fraction = 0.05  # of all looks
    spray: NonNegative = 0.02  # of all looks, for each metre of significant wave height

    @model_validator(mode="after")
    def _looks_down(self):
        if self.axis_deg - self.field_of_view_deg / 2 >= 90:
            raise ValueError(
                f"axis_deg = {self.axis_deg:g} with field_of_view_deg = {self.field_of_view_deg:g}: the camera looks "
                f"up, and never sees a deck below; axis_deg must be below {90 + self.field_of_view_deg / 2:g}"
            )
        if self.nearest >= self.range:
            raise ValueError(f"nearest = {self.nearest} m must be below range = {self.range} m")
        return self

    @property
    def cos_half(self) -> float:
        """Cosine of half the field of view."""
        return math.cos(math.radians(self.field_of_view_deg / 2))


class PilotConfig(Strict):
    """`[TEAM.pilot]`: numbers of the classical pilots (pilots.py), assumed but where it is said."""

    kind: Literal["descend", "forecast", "glide"] = "glide"
    approach: Positive = 5.0  # the most over the deck's own velocity, level, m/s
    braking: Positive = 2.0  # m/s^2, of the approach
    position: Positive = 2.0  # 1/s, of the position loop
    lag: NonNegative = 0.2  # s until a level command has its effect: rotors, attitude, half a decision
    hover: Positive = 3.0  # m above the deck, soles: "descend" begins its descent there
    wait: Positive = 1.2  # m above the deck, soles: "forecast" waits there
    near: Positive = 0.17  # m, level, from the deck's middle: near enough to come down
    fall: Positive = 0.5  # m/s over ground, at which "descend" comes down
    sink: Positive = 0.3  # m/s over the deck, at which the others touch
    steep: Positive = 0.6  # 1/s, by which that grows with the height above the deck
    flare: NonNegative = 0.15  # m above the deck, soles: below it the thrust turns to the deck's normal
    cone: Positive = 2.0  # height above the deck over the distance from its middle, at least, near it
    slope: Positive = 0.3  # the same from afar, beside `floor`
    floor: Positive = 1.0  # m
    quiet_heave: Positive = 0.5  # m/s, vertical speed of the deck in a quiescent window
    quiet_tilt_deg: Positive = 5.0  # of the deck in one
    patience: Positive = 8.0  # s: a window is twice as wide after each


class CorrectionConfig(Strict):
    """`[TEAM.correction]`: a policy corrects the velocity that the pilot wants, in the level frame of the deck."""

    level: NonNegative = 4.0  # m/s, the most, ahead and to starboard of the deck
    vertical: NonNegative = 4.0  # m/s, the most
    reach: Positive = 8.0  # m from the deck: nearer, both fall in proportion, to 0.15 of themselves at it


class LandingTeam(TeamConfig):
    """One team: its vehicle and size (TeamConfig), and the parameters of its part."""

    sensors: SensorsConfig = SensorsConfig()
    marker: MarkerConfig = MarkerConfig()  # of aircraft
    pilot: PilotConfig = PilotConfig()  # of aircraft
    correction: CorrectionConfig | None = None  # of aircraft; none: a policy gives the vehicle's own actions
    control: dict[str, float] = {}  # of boats: numbers of their classical controller
    plan: PlanConfig = PlanConfig()
    aircraft_reward: AircraftReward = AircraftReward()
    boat_reward: BoatReward = BoatReward()


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

    @model_validator(mode="after")
    def _fits(self):
        for key in ("boats", "aircraft"):
            name = getattr(self.landing, key)
            if name not in self.teams:
                raise ValueError(
                    f"landing.{key} = {name!r}: there is no such team; there are {', '.join(map(repr, self.teams))}"
                )
            if self.teams[name].script is not None:
                raise ValueError(f"{name}.script: the mission steers {name}, remove the script")
        boats, aircraft = (self.teams[getattr(self.landing, key)].count for key in ("boats", "aircraft"))
        if aircraft % boats:
            raise ValueError(
                f"{self.landing.aircraft}.count = {aircraft}: must be {self.landing.boats}.count = {boats}, where each "
                "lands on a boat of its own, or a multiple of it, where as many take turns on each deck"
            )
        return self

    @property
    def parts(self) -> dict[str, LandingTeam]:
        """Sections of the teams."""
        return dict(self.__pydantic_extra__ or {})
