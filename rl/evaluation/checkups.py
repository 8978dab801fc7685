"""Checkups of a training: figures of a team's mean policy at several checkpoints, and of the classical controller.

All of a stage run at once, side by side, in forks of the same few episodes, which nothing else uses. They are held when
a stage has ended, from its checkpoints: a training is the same with and without them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from rl.evaluation.episodes import mission_class, one_episode_each, run_episodes
from rl.judge import Episodes, Judge, finite
from rl.learn.history import CHECKUPS, HISTORY, read_rows, spent, write_rows
from rl.learn.policy import UNTRAINED, ClassicalPolicy, TrainedPolicy, checkpoints, load_policy
from rl.learn.policy_sources import given_policies
from rl.mission import ControllerError, Mission, Policy, Team, VehicleActions
from rl.runs import ranks
from rl.runs.folder import Figures
from rl.scenario import Scenario, derive_seed
from taichi_sim.config.arguments import ActionError
from taichi_sim.kernels import runtime

EPISODES = 32  # most episodes of a checkup
TIMES = 6  # most checkups of a stage after its begin
CLASSICAL = -1  # in place of a number of iterations


class _SideBySide:
    """Policy of forked environments: copy c of each episode acts by contestant c, and the last one may be classical."""

    def __init__(self, team: Team, learned: Sequence[TrainedPolicy], classical: bool):
        """Let `learned` act for `team`, and after them the classical controller if wanted."""
        self.learned, self.classical = learned, classical
        for policy in learned:
            policy.check(team)
            policy.actor.to(team.fleet.state.device)

    def __call__(self, team: Team) -> VehicleActions:
        """Actions of the vehicles."""
        copies, seen = len(self.learned) + self.classical, team.observations()
        wanted = seen.new_zeros((*seen.shape[:2], len(team.action_names)))
        memory = team.recall(max((policy.memory for policy in self.learned), default=0))
        for c, policy in enumerate(self.learned):
            wanted[c::copies], kept = policy.go_on(seen[c::copies], memory[c::copies] if policy.memory else None)
            memory[c::copies] = 0.0 if kept is None else kept
        team.policy_memory = memory
        taken = team.taken(wanted).clone()
        if self.classical:
            classical = team.taken(team.checked(ClassicalPolicy()(team)))
            taken[copies - 1 :: copies] = classical[copies - 1 :: copies]
        return VehicleActions(taken)


class _Plan(NamedTuple):
    """What a stage's checkups need."""

    learned: list[tuple[int, dict[str, TrainedPolicy]]]  # iterations of the stage, and the learners' policies then
    frozen: dict[str, Policy]
    given: list[str]  # frozen teams whose policy each process opens itself: it may not travel
    classical: bool


@runtime.loop.as_for_many()
def check_stage(
    config: Scenario, out: Path, name: str, *, source: Path | None = None, events: bool = True,
    show_progress: bool = True,
) -> None:  # fmt: skip
    """Hold the checkups of the finished stage `name`, unless they are in its teams' checkups.csv already.

    With several processes each takes its share of the contestants. `events` also writes TensorBoard's.
    """
    plan = ranks.broadcast(lambda: _plan(config, out, name))
    if plan is None:
        return
    if plan.given:
        plan.frozen.update({team: of for team, of in given_policies(config).items() if team in plan.given})
    contestants = [*(k for k, _ in plan.learned), *([CLASSICAL] if plan.classical else [])]
    place = ranks.here()
    own = contestants[place.rank :: place.count]
    with runtime.torch_at_rest(), tqdm(total=config.episode_steps, desc=f"checkup {name}", unit="step",
                                       disable=not (show_progress and place.first)) as bar:  # fmt: skip
        shares = ranks.gather(lambda: _figures(config, name, plan, own, source, bar))
    found = {number: of for share in shares for number, of in share.items()}
    if place.first:
        for team in config.stages[name].learners:
            _write(out / team, config.iterations_before(name, team), team, found, events)


def _plan(config: Scenario, out: Path, name: str) -> _Plan | None:
    """The contestants of a stage; None if its checkups have been held."""
    stage = config.stages[name]
    folder, first = out / stage.team, config.iterations_before(name)
    rows = read_rows(folder / CHECKUPS)
    held = {int(row["iteration"]) for row in rows if row["controller"] == "policy"}
    if first + stage.iterations in held:
        return None
    saved = np.array([int(file.stem.removeprefix("model_")) for file in checkpoints(folder)]) - first
    saved = saved[(saved > 0) & (saved <= stage.iterations)]
    wanted = np.linspace(0, stage.iterations, TIMES + 1)[1:]
    numbers = {int(saved[np.abs(saved - at).argmin()]) for at in wanted}
    if first not in held and (first or (folder / UNTRAINED).is_file()):
        numbers.add(0)
    begun = {team: config.iterations_before(name, team) for team in config.trained}
    learned = [
        (k, {team: load_policy(out, config, team, begun[team] + k) for team in stage.learners}) for k in sorted(numbers)
    ]
    given = given_policies(config)
    acting = stage.acting if stage.acting is not None else [*given, *(t for t in config.trained if begun[t])]
    others = [team for team in acting if team not in stage.learners]
    frozen: dict[str, Policy] = {t: load_policy(out, config, t, begun[t]) for t in others if t not in given}
    classical = not any(row["controller"] == "classical" for row in rows)
    return _Plan(learned, frozen, [t for t in others if t in given], classical)


def _figures(
    config: Scenario, name: str, plan: _Plan, own: Sequence[int], source: Path | None, bar: tqdm
) -> dict[int, dict[str, Figures]]:
    """Figures of contestants: number -> team -> figures. A classical controller that is missing or fails has none."""
    learned, learners = dict(plan.learned), config.stages[name].learners
    if not own:
        return {}
    classical = CLASSICAL in own
    mission = _episodes(config, [t for t in config.teams if t in learners or t in plan.frozen], len(own), source)
    acting: dict[str, Policy] = {
        t: _SideBySide(mission.teams[t], [learned[k][t] for k in own if k != CLASSICAL], classical) for t in learners
    }
    try:
        seen = run_episodes(mission, {**plan.frozen, **acting}, bar)
    except (ControllerError, ActionError):
        if not classical:
            raise
        return _figures(config, name, plan, [k for k in own if k != CLASSICAL], source, bar)
    kind = mission_class(config, source).Judge
    episodes = {team: kind.episodes([seen[team]], config) for team in learners}
    return {
        number: {
            team: _row(kind, {key: values[c :: len(own)] for key, values in of.items()})
            for team, of in episodes.items()
        }
        for c, number in enumerate(own)
    }


def _episodes(config: Scenario, teams: Sequence[str], copies: int, source: Path | None) -> Mission[Any, Any]:
    """A mission at the start of the checkup's episodes, `copies` environments for each."""
    count = min(EPISODES, config.evaluation.episodes)
    mission = one_episode_each(config, teams, count, derive_seed(config.seed, "checkup"), source)
    return mission.fork(range(count), copies)


def _row(kind: type[Judge], episodes: Episodes) -> Figures:
    """Reward per decision, the figures that the judge plots, the share of episodes in which errors were measured."""
    pooled = kind.pooled(episodes)
    shares = [float(np.isfinite(episodes[key]).mean()) for key in kind.plotted if key in episodes]
    return {
        "reward_per_step": finite(Judge.pooled(episodes)["reward_per_step"]),
        **{key: finite(pooled[key]) for key in kind.plotted},
        "measured": max(shares, default=1.0),
    }


def _write(folder: Path, first: int, team: str, found: Mapping[int, Mapping[str, Figures]], events: bool) -> None:
    """Add the rows of a team whose stage began after `first` iterations."""
    rows: list[dict[str, Any]] = list(read_rows(folder / CHECKUPS))
    writer = SummaryWriter(str(folder)) if events else None
    for number, of_teams in sorted(found.items()):
        who, at = ("classical", first) if number == CLASSICAL else ("policy", first + number)
        seconds, steps = spent(folder / HISTORY, at) if at else (0.0, 0)
        figures = of_teams[team]
        rows.append({"iteration": at, "agent_steps": steps, "wall_time_s": seconds, "controller": who, **figures})
        for key, value in figures.items() if writer is not None else ():
            if value is not None:
                for step in (at, first + max(found)) if number == CLASSICAL else (at,):  # a line, not a point
                    writer.add_scalar(f"Checkup/{key}/{who}", value, step)  # pyright: ignore[reportOptionalMemberAccess]
    if writer is not None:
        writer.close()
    write_rows(folder / CHECKUPS, rows)
