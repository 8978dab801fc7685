"""Two sides on the same episodes: every figure of the mission's judge, paired, with 95 % intervals.

A side is one or more runs (training seeds of one recipe), or "classical", or "pretrained". All act in the first run's
scenario, each with what belongs to its policies (`OWN`). A stored evaluation (store.py) counts if it is of these
episodes and not older than the run's checkpoints; otherwise its policies are judged again. Intervals draw episodes,
each with the results of all seeds of both sides; that other seeds would train other policies is not in them.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episodes import judge_episodes, mission_class
from rl.evaluation.intervals import Interval, differences, intervals, paired, ratios
from rl.evaluation.store import EvaluationConditions, evaluation_file, load_evaluation
from rl.judge import Judge
from rl.learn.policy import checkpoints, policies_of
from rl.learn.policy_sources import given_policies, shipped_policies
from rl.mission import Policy
from rl.runs.folder import RunError, load_config
from rl.scenario import PRETRAINED, Scenario

Array = NDArray[np.float64]
OWN = ("terms", "observe", "residual", "correction", "plan")  # keys of a team that belong to its policy
NOT_EPISODES = {"name", "seed", "stages", "evaluation", "replaced"}
CLASSICAL = "classical"


class Member(NamedTuple):
    """One contestant of a side, ready to act in the common episodes."""

    name: str
    config: Scenario
    source: Path
    policies: dict[str, Policy]
    run: Path | None  # None: no run of its own
    elsewhere: bool  # it learned in another scenario
    otherwise: bool = False  # its own evaluation measures otherwise


class Contest(NamedTuple):
    """The episodes of all sides: by side and team, numbers [seed * episode] and figures of the judge, mean of seeds."""

    judge: type[Judge]
    episodes: int
    seed: int
    numbers: tuple[dict[str, dict[str, Array]], ...]
    figures: tuple[dict[str, dict[str, float | None]], ...]
    seeds: tuple[int, ...]
    notes: tuple[str, ...]


def conditions(config: Scenario) -> dict[str, object]:
    """What the episodes of a scenario depend on, apart from its policies."""
    data = config.model_dump(mode="json", exclude_none=True, exclude=NOT_EPISODES)
    for team in config.teams:
        data[team] = {key: value for key, value in data[team].items() if key not in OWN}
    return data


def member(name: str, first: tuple[Scenario, Path], overrides: Sequence[str]) -> Member:
    """A contestant by its name, in the scenario and file of the `first` run."""
    base, source = first
    if name == CLASSICAL:
        return Member(name, base, source, policies_of(CLASSICAL, source.parent, base), None, False)
    if name == PRETRAINED:
        return Member(name, base, source, shipped_policies(base.name), None, False)
    run = Path(name)
    config, own = load_config(run, overrides)
    policies = {**policies_of("policy", run, config), **given_policies(config)}
    if conditions(config) == conditions(base):
        new = config.evaluation != base.evaluation
        return Member(name, config.model_copy(update={"evaluation": base.evaluation}), own, policies, run, False, new)
    if config.mission != base.mission:
        raise RunError(f"{run}: its mission is {config.mission!r}, that of {source.parent} {base.mission!r}")
    sections = {
        team: section.model_copy(update={key: getattr(config.teams[team], key) for key in OWN if hasattr(section, key)})
        for team, section in base.teams.items() if team in config.teams
    }  # fmt: skip
    return Member(name, base.model_copy(update=sections), own, policies, run, True)


def contest(
    sides: Sequence[Sequence[str]], overrides: Sequence[str] = (), *, episodes: int | None = None,
    seed: int | None = None, show_progress: bool = True,
) -> Contest:  # fmt: skip
    """Judge the members of all `sides`, the first of which is a run, on the same episodes."""
    first = load_config(Path(sides[0][0]), overrides)
    config, source = first
    members = [[member(name, first, overrides) for name in side] for side in sides]
    acting = [set(one.policies) for side in members for one in side]
    teams = tuple(team for team in config.teams if all(team in of for of in acting))
    if not teams:
        raise RunError(f"{' and '.join(name for side in sides for name in side)}: no team has a policy in all of them")
    asked = config.evaluation.episodes if episodes is None else episodes
    number = config.evaluation.seed if seed is None else seed
    numbers, figures, notes = [], [], []
    for side in members:
        found = [_judged(one, teams, asked, number, overrides, show_progress) for one in side]
        notes += [note for _, _, note in found]
        notes += [f"{one.name} learned in another scenario, and acts in that of {sides[0][0]}"
                  for one in side if one.elsewhere]  # fmt: skip
        numbers.append({
            team: {key: np.concatenate([of[team][key] for of, _, _ in found]) for key in found[0][0][team]}
            for team in teams
        })  # fmt: skip
        figures.append({team: _means([of[team] for _, of, _ in found]) for team in teams})
    paid = [[one.config.teams[team].model_dump()["terms"] for team in teams] for side in members for one in side]
    if any(terms != paid[0] for terms in paid):
        notes.append("reward_per_step: each by the terms of its own reward")
    return Contest(mission_class(config, source).Judge, asked, number, tuple(numbers), tuple(figures),
                   tuple(map(len, sides)), tuple(notes))  # fmt: skip


def _judged(
    one: Member, teams: Sequence[str], episodes: int, seed: int, overrides: Sequence[str], show_progress: bool
) -> tuple[dict[str, dict[str, Array]], dict[str, dict[str, float | None]], str]:
    """A member's numbers of each episode, its figures, and where they are from."""
    if one.run is not None and not one.elsewhere and not one.otherwise:
        stored, file = load_evaluation(one.run, "policy"), evaluation_file(one.run, "policy")
        saved = [last for team in teams for last in checkpoints(one.run / team)[-1:]]
        fresh = stored is not None and all(last.stat().st_mtime <= file.stat().st_mtime for last in saved)
        wanted = seed, episodes, teams, EvaluationConditions(None, tuple(overrides))
        if stored is not None and fresh and stored.trial == wanted:
            return stored.episodes, stored.result["teams"], f"{one.name}: its last evaluation"
    policies = {team: one.policies[team] for team in teams}
    outcome = judge_episodes(one.config, policies, episodes=episodes, seed=seed, source=one.source,
                             show_progress=show_progress)  # fmt: skip
    return outcome.episodes, outcome.result["teams"], f"{one.name}: judged now"


def _means(of_seeds: Sequence[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of each figure over seeds; None if some seed has none."""
    known = {key: [x for of in of_seeds if (x := of.get(key)) is not None] for key in of_seeds[0]}
    return {key: float(np.mean(of)) if len(of) == len(of_seeds) else None for key, of in known.items()}


def compared(of: Contest, team: str) -> dict[str, tuple[Interval, Interval, Interval | None, Interval | None]]:
    """Every figure of a team: of either side, their difference, and their ratio if it cannot be negative.

    A figure that is not made of numbers of episodes has no intervals.
    """
    one, other = (side[team] for side in of.numbers)
    alone = [
        intervals(of.judge, side) if times == 1 else paired(lambda x: x, of.judge, side, times=times)
        for side, times in zip((one, other), of.seeds, strict=True)
    ]
    times = math.lcm(*of.seeds)  # as many copies of either, so that they can be drawn together
    one, other = ({key: np.tile(values, times // k) for key, values in side.items()}
                  for side, k in zip((one, other), of.seeds, strict=True))  # fmt: skip
    apart, over = differences(of.judge, one, other, times), ratios(of.judge, one, other, times)
    rows = {}
    for key in dict.fromkeys([*of.judge.definitions, *alone[0]]):
        values = [Interval(side[team].get(key), None, None) for side in of.figures]
        sides = [found.get(key, value) for found, value in zip(alone, values, strict=True)]
        signed = key in of.judge.signed or any((x.low if x.low is not None else x.value or 0.0) < 0 for x in sides)
        if any(side.value is not None for side in sides):
            rows[key] = (*sides, apart.get(key), None if signed or key in of.judge.shares else over.get(key))
    return rows


def table(of: Contest, team: str) -> str:
    """`compared` as Markdown; a difference whose interval excludes zero is bold."""
    head = f"| {team}, {of.episodes} episodes, seed {of.seed} | A | B | A - B | A / B |"
    lines = [head, "|---" * 5 + "|"]
    for key, (one, other, apart, over) in compared(of, team).items():
        clear = apart is not None and None not in apart and (apart.low > 0 or apart.high < 0)  # pyright: ignore
        cells = [_cell(one), _cell(other), f"**{_cell(apart)}**" if clear else _cell(apart), _cell(over)]
        lines.append(f"| `{key}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(of: Interval | None) -> str:
    if of is None or of.value is None:
        return "-"
    known = of.low is not None and of.high is not None
    return f"{of.value:.3g} ({of.low:.3g} to {of.high:.3g})" if known else f"{of.value:.3g}"
