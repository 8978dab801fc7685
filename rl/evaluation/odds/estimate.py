"""The odds of an ending in a scenario: a pilot finds levels, repeats of their own worlds and seas give the interval.

Each repeat has a mission of its own: other tracks, seas, starts, vehicles and noise, as held-out episodes have them. So
the interval covers all that differs between episodes.
"""

import gc
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from tqdm import tqdm

from rl.evaluation.episodes import mission_class
from rl.evaluation.odds.paths import EpisodePaths, Moments
from rl.evaluation.odds.splitting import (
    FEWEST_ANCESTORS,
    Floats,
    Levels,
    Odds,
    Repeat,
    find_levels,
    no_levels,
    pooled,
    repeat,
)
from rl.learn.policy import Policy
from rl.mission import Mission
from rl.runs import ranks
from rl.runs.folder import RunError
from rl.scenario import Scenario, derive_seed
from taichi_sim.errors import named
from taichi_sim.kernels import runtime
from taichi_sim.state.memory import StateError

POOL = 256  # worlds and seas of each repeat, from which its episodes draw
SLOTS = 128  # environments that run at once; more of them wait idly for the last path of a level
DIRECT_SLOTS = 512  # the same where there are no levels: all paths end together
REPEATS = 20  # the fewest; their spread says how many more are needed
MOST = 400  # repeats
SURPLUS = 1.5  # times `FEWEST_ANCESTORS`, for which further repeats are planned; assumed
BRANCH = 40  # decisions after which copies with noise of their own must differ, if anything is drawn


class Question(NamedTuple):
    """Whose odds of what."""

    config: Scenario
    policies: Mapping[str, Policy]  # of the teams that take part
    team: str
    ending: str
    seed: int
    source: Path | None = None
    controller: str = "policy"

    def among_its_teams(self) -> "Question":
        """The same among the teams with which this one learned: its stage's, and those before."""
        stage = self.config.stage_of(self.team)
        if stage is None:
            return self
        stages = list(self.config.stages.values())
        before = {name for each in stages[: stages.index(stage)] for name in each.learners}
        beside = {*stage.learners, self.team, *(before if stage.acting is None else stage.acting)}
        return self._replace(policies={name: of for name, of in self.policies.items() if name in beside})

    def mission(self, number: int, slots: int = SLOTS) -> Mission:
        """The mission of repeat `number` in `slots` environments; 0 is the pilot's."""
        kind = mission_class(self.config, self.source)
        pool = kind.one_each(self.config, POOL)
        return kind(
            pool, slots, seed=derive_seed(self.seed, "odds", number), teams=tuple(self.policies), source=self.source
        )

    def paths(self, number: int, tick: Callable[[int], object], slots: int = SLOTS) -> EpisodePaths:
        """The episodes of repeat `number`."""
        return EpisodePaths(self.mission(number, slots), self.policies, self.team, self.ending, tick)

    def rng(self, number: int) -> np.random.Generator:
        """Random numbers that choose which kept states start."""
        return np.random.default_rng(derive_seed(self.seed, "odds", "picks", number))


def slots_for(levels: Sequence[float], effort: int) -> int:
    """Environments for `effort` paths to each of `levels`."""
    return SLOTS if len(levels) > 1 else min(DIRECT_SLOTS, effort)


class Part(NamedTuple):
    """What one repeat found."""

    number: int
    repeat: Repeat
    conditions: dict[str, Floats]  # of its beginnings
    moments: Moments  # of the paths that came to the ending


class Pilot(NamedTuple):
    """What the pilot found."""

    levels: Levels
    duration: float  # s, mean of an episode
    vehicles: int  # of the team
    branches: bool  # whether episodes draw random numbers as they go on


def check(question: Question) -> bool:
    """Refuse what has no odds, before anything long begins; say whether episodes can branch."""
    config, name = question.config, question.team
    if name not in question.policies:
        raise RunError(f"--team {name}: there are {', '.join(question.policies)}")
    for other, policy in question.policies.items():
        if getattr(policy, "remembers", False):
            raise RunError(
                f"{other}: a {type(policy).__name__} has a memory of its own, which copies of an episode do "
                "not have: its odds are counted by taichi-sim evaluate"
            )
    mission = question.mission(0)
    team = mission.teams[name]
    if question.ending not in (ended := team.ended()):
        raise RunError(f"--of {question.ending}: {name} of {config.name!r} ends as {', '.join(ended)}")
    if failed := int(ended[question.ending].any(1).sum()):
        raise RunError(f"--of {question.ending}: {failed} of {SLOTS} episodes of {config.name!r} begin so")
    half = SLOTS // 2
    sources, copies = torch.arange(half), half + torch.arange(half)
    with runtime.torch_at_rest():
        with named(f"{config.name}: ", RunError, StateError):
            mission.step(question.policies, begin=False, observe=())
            mission.put(mission.keep(sources), copies)
        for _ in range(BRANCH):
            mission.step(question.policies, begin=False, observe=())
    branches = any(not torch.equal(each.fleet.state[:half], each.fleet.state[half:]) for each in mission.teams.values())
    return branches


def pilot(question: Question, effort: int, tick: Callable[[int], object], *, direct: bool = False) -> Pilot:
    """Find levels; none where the ending is common, or copies of an episode would all do the same."""
    branches, paths = check(question), question.paths(0, tick)
    levels = find_levels(paths, effort, question.rng(0)) if branches and not direct else no_levels(paths, effort)
    vehicles = paths.mission.teams[question.team].fleet.count
    return Pilot(levels, paths.duration, vehicles, branches)


def one(question: Question, levels: Levels, effort: int, number: int, tick: Callable[[int], object]) -> Part:
    """Repeat `number` (from 1)."""
    paths = question.paths(number, tick, slots_for(levels.levels, effort))
    found = repeat(paths, levels.levels, effort, question.rng(number))
    if paths.failed_at_once:
        raise RunError(
            f"--of {question.ending}: {paths.failed_at_once} of {paths.begun} episodes of {question.config.name!r} "
            "begin so"
        )
    conditions = {key: np.concatenate([part[key] for part in paths.conditions]) for key in paths.conditions[0]}
    return Part(number, found, conditions, paths.moments(found.states))


@dataclass
class Answer:
    """The odds, and what is known besides."""

    question: Question
    pilot: Pilot
    effort: int
    parts: list[Part]
    interrupted: KeyboardInterrupt | None = None

    @property
    def odds(self) -> Odds:
        """The odds by the parts so far."""
        levels = self.pilot.levels
        return pooled([part.repeat for part in self.parts], levels.levels, levels.cost)

    def more(self, relative: float) -> int:
        """Repeats beyond the first that a standard error of `relative` p and an interval need."""
        odds = self.odds
        if not odds.p > 0:
            return 0
        times = max(1.0, (odds.relative / relative) ** 2)
        if odds.decided:
            times = max(times, SURPLUS * FEWEST_ANCESTORS / odds.effective)
        return min(MOST, math.ceil(odds.repeats * times)) - odds.repeats


def find_odds(
    question: Question, effort: int, relative: float, *, direct: bool = False, show_progress: bool = True
) -> Answer | None:
    """Find the odds; processes share the repeats, and rank 0 alone has the answer.

    The first `REPEATS` say how many more a standard error of `relative` p needs; that number is then fixed. Ctrl-C
    leaves what is known, if that are two repeats or more.
    """
    place = ranks.here()
    with tqdm(desc=f"{question.team} {question.ending}", unit="step", unit_scale=True,
              disable=not (show_progress and place.first)) as bar:  # fmt: skip
        found = ranks.broadcast(lambda: pilot(question, effort, bar.update, direct=direct))
        answer = Answer(question, found, effort, [])
        try:
            _run(answer, range(1, REPEATS + 1), bar)
            extra = ranks.broadcast(lambda: answer.more(relative))
            _run(answer, range(REPEATS + 1, REPEATS + 1 + extra), bar)
        except KeyboardInterrupt as interrupt:
            if len(answer.parts) < 2:
                raise
            answer.interrupted = interrupt
    return answer if place.first else None


def _run(answer: Answer, numbers: range, bar: tqdm) -> None:
    """Run repeats `numbers`, and add them to the answer of rank 0."""
    place = ranks.here()

    def own() -> list[Part]:
        parts = []
        for number in numbers[place.rank :: place.count]:
            bar.set_postfix_str(f"repeat {number} of {numbers[-1]}{_so_far(answer)}")
            parts.append(one(answer.question, answer.pilot.levels, answer.effort, number, bar.update))
            gc.collect()  # a mission refers to itself; without this, those of many repeats stay in memory
            if place.count == 1:
                answer.parts.append(parts[-1])
        return parts

    gathered = ranks.gather(own)
    if place.count > 1:
        answer.parts.extend(sorted((part for of_rank in gathered for part in of_rank), key=lambda part: part.number))


def _so_far(answer: Answer) -> str:
    return f", {answer.odds.p:.2e}" if len(answer.parts) > 1 else ""
