"""Configuration of the station mission, besides world, stages and evaluation."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from rl.perception.instruments import InstrumentsConfig
from rl.planning.planner import PlanConfig
from rl.scenario import Evaluation, Scenario, TeamSection
from taichi_sim.config import NonNegative, Positive, Span, Strict
from taichi_sim.config.plausible import Plausible

Degrees = Annotated[float, Field(gt=0, lt=180)]


class StationConfig(Strict):
    """`[station]`: how an episode begins, what is near enough, and the quay."""

    start: Annotated[NonNegative, Plausible(0.1, 1000.0, "m")] = 3.0  # from the place, at most, as an episode begins
    start_deg: Annotated[float, Field(ge=0, le=180)] = 20.0  # from the heading, likewise
    near: Annotated[Positive, Plausible(0.02, 100.0, "m")] = 0.5  # of the place: it is kept
    near_deg: Degrees = 5.0  # of the heading, likewise
    lost: Annotated[Positive, Plausible(0.5, 2e4, "m")] = 15.0  # from the place: ends the episode
    hold: Annotated[Positive, Plausible(1.0, 1e5, "s")] = 90.0  # that the place is kept before it goes to the quay
    distance: Span = (12.0, 20.0)  # from the place to that alongside, m
    speed: Annotated[Positive, Plausible(0.02, 10.0, "m/s")] = 0.5  # the most on the way there
    clear: Annotated[Positive, Plausible(0.05, 100.0, "m")] = 1.0  # between quay and side, alongside
    stand: Annotated[Positive, Plausible(1.0, 1e4, "s")] = 20.0  # at the end of the episode, that it is to be alongside


class StationTeam(TeamSection):
    """The boat, its instruments, its classical controller."""

    sensors: InstrumentsConfig = InstrumentsConfig()
    control: dict[str, float] = {}  # gains (keeper.py)
    plan: PlanConfig = PlanConfig()


class StationEvaluation(Evaluation):
    """Held-out episodes, and the criterion of success."""

    success_share: Annotated[float, Field(gt=0, le=1)] = 0.95  # of the time that place and heading are kept, at least


class StationScenario(Scenario):
    """A scenario of the station mission."""

    __pydantic_extra__: dict[str, StationTeam] = Field(init=False)

    station: StationConfig = StationConfig()
    evaluation: StationEvaluation = StationEvaluation()

    def _mistakes(self) -> Iterator[str]:
        yield from super()._mistakes()
        s, least = self.station, self.evaluation.settle
        for name, team in self.teams.items():
            if team.count != 1:
                yield f"{name}.count = {team.count}: must be 1: there is one place to keep"
        if s.hold <= least:
            yield f"station.hold = {s.hold:g} s must be above evaluation.settle = {least:g} s"
        if s.start >= s.lost:
            yield f"station.start = {s.start:g} m must be below station.lost = {s.lost:g} m"
