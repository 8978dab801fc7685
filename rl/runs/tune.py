"""Tuning of classical controllers: a search for the numbers with the lowest loss on training worlds.

The search is the cross-entropy method (Rubinstein 1999) on the logarithms of the numbers. Each round draws candidates
around the current mean, runs the same episodes with each, and moves to the mean of the best quarter. Every round has
new episodes, so that no candidate wins by luck. The result is the mean after the last round, or the start if that is
better on further episodes. The mission defines the loss (`Judge.loss`).
"""

import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from tqdm import tqdm

from rl.evaluation.episodes import mission_class, run_episodes
from rl.missions import make_mission
from rl.scenario import Scenario, derive_seed
from rl.team import ControllerError
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, replacing, vehicle_file, write_toml
from taichi_sim.kernels import runtime

SPREAD = 0.3  # initial standard deviation of the logarithms
LEAST_SPREAD = 0.03
ELITE = 0.25  # share of a round's candidates that gives the next mean
KEEP = 0.5  # weight of the previous round's spread


class Tuned(NamedTuple):
    """The result of a search."""

    numbers: dict[str, float]  # of the controller: found by the search, or given by the scenario
    loss: float
    loss_before: float
    figures: dict[str, float | None]  # of the judge, with the new numbers
    figures_before: dict[str, float | None]


def tune(
    config: Scenario,
    team: str,
    *,
    source: Path | None = None,
    names: tuple[str, ...] = (),
    rounds: int = 12,
    candidates: int = 12,
    episodes: int = 128,
    seed: int = 0,
    show_progress: bool = True,
) -> Tuned:
    """Search for numbers of a team's classical controller: those in `names`, default all."""
    mission = make_mission(config, episodes, seed=derive_seed(seed, "tune"), teams=(team,), source=source)
    model, judge = mission.teams[team].fleet.model, mission_class(config, source).Judge
    kind: Any = type(mission.teams[team].make_controller())
    if not hasattr(kind, "Gains"):
        raise ControllerError(f"{team}: its classical controller has no numbers to tune")
    given = {**kind.Gains().model_dump(), **mission.teams[team].section.control}
    wrong = [name for name in names if name not in given]
    if wrong:
        raise ConfigError(f"{team}.control has no {', '.join(wrong)}; allowed are {', '.join(given)}")
    if zero := [name for name in names if not given[name] > 0]:
        raise ConfigError(f"{team}.control.{zero[0]} = 0 has no logarithm to search on: set it above 0")
    searched = [name for name in given if (not names or name in names) and given[name] > 0]

    def run(numbers: Mapping[str, float], episode: int) -> tuple[float, dict[str, float | None]]:
        controller = kind(model, kind.Gains(**{**given, **numbers}))
        mission.reseed(derive_seed(seed, "tune", episode))
        mission.reset()
        seen = run_episodes(mission, {team: lambda t: t.classical(controller)})[team]
        return float(judge.loss(judge.episodes([seen], config), config).mean()), judge.figures([seen], config)

    rng = np.random.default_rng(derive_seed(seed, "candidates"))
    mean = np.log([given[name] for name in searched])
    spread = np.full(len(searched), SPREAD)
    with runtime.torch_at_rest(), tqdm(total=rounds * candidates, unit="run", disable=not show_progress) as bar:
        for number in range(rounds):
            drawn = [mean, *(mean + spread * rng.standard_normal(len(mean)) for _ in range(candidates - 1))]
            losses = []
            for x in drawn:
                losses.append(run(_numbers(searched, x), number)[0])
                bar.update(1)
            best = np.argsort(losses)[: max(2, math.ceil(ELITE * candidates))]
            elite = np.stack([drawn[k] for k in best])
            mean = elite.mean(axis=0)
            spread = np.maximum(KEEP * spread + (1 - KEEP) * elite.std(axis=0), LEAST_SPREAD)
            bar.set_postfix(loss=f"{losses[0]:.3f}", best=f"{min(losses):.3f}")
        found = _numbers(searched, mean)
        after, figures = run(found, rounds)
        before, figures_before = run({}, rounds)
    if not after <= before:
        found, after, figures = {name: given[name] for name in searched}, before, figures_before
    kept = {**mission.teams[team].section.control, **found}
    return Tuned(kept, after, before, figures, figures_before)


def _numbers(names: list[str], logarithms: np.ndarray) -> dict[str, float]:
    return {name: float(f"{math.exp(x):.3g}") for name, x in zip(names, logarithms, strict=True)}


def write_numbers(file: Path, team: str, numbers: Mapping[str, float], comment: str) -> None:
    """Write `[TEAM.control]` into a scenario's file, in place of an existing one; the rest of it stays."""
    text = file.read_text(encoding="utf-8")
    head = f"[{team}.control]"
    section = f"{head}  # {comment}\n{tomli_w.dumps(dict(numbers))}"
    old = re.compile(rf"^\[{re.escape(team)}\.control\][^\n]*\n(?:(?!\[)[^\n]*\n?)*", re.MULTILINE)
    if old.search(text):
        text = old.sub(lambda _: section + "\n", text, count=1).rstrip("\n") + "\n"
    else:
        text = text.rstrip("\n") + "\n\n" + section
    with replacing(file) as part:
        part.write_text(text, encoding="utf-8")


def write_scenario(out: Path, config: Scenario, source: Path, team: str, numbers: Mapping[str, float]) -> None:
    """Write `config`, read from the file `source`, with `[TEAM.control]` as a new scenario file `out`."""
    sections = {}
    for name, section in config.teams.items():
        file = vehicle_file(section, source)
        shipped = file.parent == config_folder() / "vehicles"
        changed: dict[str, object] = {"vehicle": file.stem if shipped else os.path.relpath(file, out.parent)}
        sections[name] = section.model_copy(update=changed | ({"control": dict(numbers)} if name == team else {}))
    with replacing(out) as part:
        write_toml(config.model_copy(update=sections), part)


def summary(tuned: Tuned, line: Callable[[dict[str, float | None]], str]) -> str:
    """The result of a search as readable lines; `line` formats figures (Judge.line)."""
    better = tuned.loss < tuned.loss_before
    return f"before: loss {tuned.loss_before:.3f}: {line(tuned.figures_before)}\n" + (
        f"after:  loss {tuned.loss:.3f}: {line(tuned.figures)}" if better
        else "nothing better was found: the numbers stay (more --rounds, --candidates or --episodes search further)"
    )  # fmt: skip
