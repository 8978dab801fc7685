"""Configuration of the encounter mission, besides world, stages and evaluation."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario, TeamSection
from taichi_sim.config import Fraction, NonNegative, Ordered, Positive, Span, Strict
from taichi_sim.config.plausible import Plausible

CASES: dict[str, tuple[int, ...]] = {
    "drawn": (),
    "imazu": (
        1,
        2,
        3,
        4,
        5,
        6,
        7,
        9,
        10,
        11,
        13,
        14,
        15,
        16,
        17,
        18,
        19,
        20,
        21,
    ),  # as printed; 8 is 5, 12 is 6, 22 is 15
    "clock": tuple(range(24)),
}
"""Set -> numbers of its situations."""
MOST_BODIES = 15  # own ships and ships, among the random numbers (kernels/random.py: TRAFFIC)


class BehavioursConfig(Strict):
    """`[encounter.behaviours]`: shares of ships that do so, as the danger of a collision with an own ship is near.

    keeps: its course and speed, whatever happens. obeys: SB-MPC (avoidance.py) by what it senses. late: the same when
    it is almost too late. port: turns to port. stops: it stops. weaves: changes course at random; no shipped policy
    was trained with it.
    """

    keeps: NonNegative = 0.3
    obeys: NonNegative = 0.5
    late: NonNegative = 0.07
    port: NonNegative = 0.07
    stops: NonNegative = 0.06
    weaves: NonNegative = 0.0

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares in the order of the keys; their sum is 1."""
        given = tuple(self.model_dump().values())
        return tuple(x / sum(given) for x in given)

    def _mistakes(self) -> Iterator[str]:
        if not sum(self.model_dump().values()):
            yield "all shares are 0: at least one must be above 0"


class KindsConfig(Strict):
    """`[encounter.kinds]`: shares of the kinds of encounters that are drawn, as they begin for the own ship."""

    head_on: NonNegative = 0.25
    crossing: NonNegative = 0.5
    overtaking: NonNegative = 0.15  # the own ship comes up
    overtaken: NonNegative = 0.1

    def _mistakes(self) -> Iterator[str]:
        if not sum(self.model_dump().values()):
            yield "all shares are 0: at least one must be above 0"


class EncounterConfig(Strict):
    """`[encounter]`: who meets whom, and when an encounter is safe. Gaps are between hulls."""

    own: Annotated[str, Field(min_length=1)] = "usv"  # the team of the own ships
    traffic: Annotated[str, Field(min_length=1)] = "traffic"  # the scripted team of ships
    # drawn: meeting times, courses and speeds are drawn; imazu, clock: tables (situations.py)
    set: Literal["drawn", "imazu", "clock"] = "drawn"
    cases: tuple[int, ...] = ()  # numbers of the situations of a table; none given: all
    # ships that are met in an episode, of those there are; of `drawn`
    ships: Annotated[tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]], Ordered] = (1, 3)
    speed: Annotated[Positive, Plausible(0.2, 30.0, "m/s")] = 2.0  # of the own ship along its route
    tcpa: Span = (60.0, 150.0)  # s from the beginning to the meeting
    aim: Annotated[NonNegative, Plausible(0.1, 5000.0, "m")] = 20.0  # standard deviation of a ship's miss
    course_deg: Annotated[NonNegative, Plausible(0.1, 45.0, "deg")] = 5.0  # the most that a course is off its kind
    clear: Annotated[Positive, Plausible(0.5, 5000.0, "m")] = 40.0  # a gap that is safe
    near: Annotated[Positive, Plausible(0.2, 5000.0, "m")] = 15.0  # a gap that is a near miss
    notice: Annotated[Positive, Plausible(5.0, 5000.0, "s")] = 90.0  # before a meeting at which ships (and rules) begin
    lookahead: Annotated[Positive, Plausible(1.0, 5000.0, "m")] = 30.0  # of line-of-sight guidance to the route
    corridor: Annotated[Positive, Plausible(5.0, 2e5, "m")] = 300.0  # an own ship this far from its route is lost
    kinds: KindsConfig = KindsConfig()
    behaviours: BehavioursConfig = BehavioursConfig()

    def _mistakes(self) -> Iterator[str]:
        if self.own == self.traffic:
            yield f"own = traffic = {self.own!r}: must be two teams"
        if wrong := [k for k in self.cases if k not in CASES[self.set]]:
            there = ", ".join(map(str, CASES[self.set])) or "none"
            yield f"cases: {wrong[0]} is none of set = {self.set!r}, which has {there}"
        if self.near >= self.clear:
            yield f"near = {self.near}: must be below clear = {self.clear}"
        if self.tcpa[0] <= 0:
            yield f"tcpa = {list(self.tcpa)}: must be above 0"


class AisConfig(Strict):
    """`[ais]`: what ships tell of themselves. Cadences are those of ITU-R M.1371."""

    carried: Fraction = 0.9  # share of ships that have it; assumed
    transponder: Literal["A", "B", "auto"] = "auto"  # class of all; auto: A from `class_a_length` on
    class_a_length: Annotated[Positive, Plausible(5.0, 300.0, "m")] = 45.0  # of about 300 GT, SOLAS V/19; assumed
    range: Annotated[Positive, Plausible(50.0, 1e5, "m")] = 8000.0
    silent: Annotated[NonNegative, Plausible(1.0, 1e5, "m")] = 0.0  # nearer ships are not heard
    loss: Fraction = 0.1  # of reports; assumed
    place_noise: Annotated[NonNegative, Plausible(0.05, 200.0, "m")] = 5.0  # standard deviation, each way; assumed
    speed_noise: Annotated[NonNegative, Plausible(5e-3, 5.0, "m/s")] = 0.1

    def _mistakes(self) -> Iterator[str]:
        if self.silent >= self.range:
            yield f"silent = {self.silent:g} m: must be below range = {self.range:g} m (carried = 0: nobody has AIS)"


class RadarConfig(Strict):
    """`[radar]`: scans of all that is around; IMO MSC.192(79), 5.25: 1 % of the range, 2 degrees."""

    range: Annotated[NonNegative, Plausible(20.0, 1e5, "m")] = 1500.0  # 0: there is none
    period: Annotated[Positive, Plausible(0.2, 60.0, "s")] = 2.5  # of a scan
    range_noise: Annotated[NonNegative, Plausible(0.05, 500.0, "m")] = 3.0  # standard deviation, at least
    range_share: Annotated[NonNegative, Plausible(5e-4, 0.1)] = 0.01  # of the range, if that is more
    bearing_noise_deg: Annotated[NonNegative, Plausible(0.02, 10.0, "deg")] = 1.0
    misses: Fraction = 0.1  # of echoes


class TracksConfig(Strict):
    """`[tracks]`: Kalman filters of constant velocity over both."""

    acceleration: Annotated[Positive, Plausible(1e-4, 5.0, "m/s^2")] = 0.05  # white, over one second; assumed
    speed: Annotated[Positive, Plausible(0.1, 50.0, "m/s")] = 5.0  # standard deviation at first; assumed
    forget: Annotated[Positive, Plausible(1.0, 5000.0, "s")] = 60.0  # age of the last measurement at which one ends


class CorrectionConfig(Strict):
    """`[TEAM.correction]`: a policy corrects the offsets that SB-MPC chooses."""

    course_deg: Annotated[Positive, Plausible(1.0, 180.0, "deg")] = 60.0  # the most, either way
    speed: Annotated[Positive, Plausible(0.05, 1.0)] = 0.5  # the most, of the planned speed


class EncounterTeam(TeamSection):
    """One team: its vehicle and size (TeamConfig), and numbers of SB-MPC."""

    control: dict[str, float] = {}
    correction: CorrectionConfig | None = None  # none: a policy gives the offsets itself
    plan: PlanConfig = PlanConfig()


class EncounterEvaluation(Evaluation):
    """Held-out episodes."""

    settle: NonNegative = 0.0


class EncounterScenario(Scenario):
    """A scenario of the encounter mission."""

    __pydantic_extra__: dict[str, EncounterTeam] = Field(init=False)

    encounter: EncounterConfig = EncounterConfig()
    ais: AisConfig = AisConfig()
    radar: RadarConfig = RadarConfig()
    tracks: TracksConfig = TracksConfig()
    evaluation: EncounterEvaluation = EncounterEvaluation()

    @property
    def parts(self) -> dict[str, EncounterTeam]:
        """The sections of the teams."""
        return dict(self.__pydantic_extra__ or {})

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        part = self.encounter
        for key in ("own", "traffic"):
            name = getattr(part, key)
            if name not in self.teams:
                yield f"encounter.{key} = {name!r}: there is no such team; there are {', '.join(map(repr, self.teams))}"
                return
        if self.teams[part.traffic].script is None:
            yield (f'{part.traffic}.script: the ships need one, such as "rl.missions.encounter.traffic:Traffic"')
        if self.parts[part.traffic].correction is not None:
            yield f"{part.traffic}.correction: no policy acts for this team"
        own, count = self.teams[part.own].count, self.teams[part.traffic].count
        if own + count > MOST_BODIES:
            yield f"{part.own}.count = {own}, {part.traffic}.count = {count}: must be at most {MOST_BODIES} together"
        if count < part.ships[1]:
            yield f"encounter.ships = {list(part.ships)}: {part.traffic}.count = {count} must be as many"
        if part.set == "imazu" and count < 3:
            yield f"{part.traffic}.count = {count}: encounter.set = 'imazu' has up to 3 ships"
