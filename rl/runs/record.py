"""One episode, written down: every state of every team, for recordings and figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from rl.learn.policy import Policy
from rl.mission import Step
from rl.runs.evaluation import chunk_with, one_episode_each
from rl.runs.events import event_of
from rl.scenario import Scenario
from taichi_sim import runtime
from taichi_sim.config.io import toml_text
from taichi_sim.recording import Episode, Event, Recorder


def record_episode(
    config: Scenario,
    policies: Mapping[str, Policy],
    *,
    seed: int,
    number: tuple[int, int] | None = None,
    duration: float | None = None,
    source: Path | None = None,
    show_progress: bool = False,
) -> Episode:
    """Run one episode of an unseen world (number 0 of evaluation seed `seed`) and keep all of it.

    With `number` = (i, n) it is the very episode i of an evaluation of n, run again with its chunk.

    The episode goes on after a collision, so that one sees what follows, but not after a state that is no longer
    finite, nor when a whole team of aircraft is in the water. `duration` in s, default the scenario's.

    Raises:
        ValueError: if there is nothing to record, for a state diverged in the first step.
    """
    duration = config.episode_duration if duration is None else duration
    steps = max(2, round(duration / config.decision_interval))
    if number is None:
        task, env = one_episode_each(config, tuple(policies), 1, seed, source), 0
    else:
        task, first = chunk_with(config, tuple(policies), number[1], seed, source, number[0])
        env = number[0] - first
    task.shown = env
    recorder = Recorder(task.world, env)
    rows: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in task.teams}
    seen: set[tuple[str, int, str]] = set()
    events: list[Event] = []
    with runtime.torch_at_rest():
        for i in tqdm(range(steps), desc="record", unit="step", disable=not show_progress):
            step = task.step({name: policies[name](team) for name, team in task.teams.items()})
            events += _events(step, (i + 1) * config.decision_interval, seen, env)
            if any(bool(ended["diverged"][env].any()) for ended in step.endings.values()):
                break  # what follows is no motion
            recorder.add({name: team.action for name, team in task.teams.items()})
            for name, team in task.teams.items():
                rows[name].append(_row(task.frame(team) | {"reward": step.reward[name][env]}))
            if any("crashed" in ended and bool(ended["crashed"][env].all()) for ended in step.endings.values()):
                break  # nobody flies under water
    if not len(recorder):
        raise ValueError(f"nothing to record: {events[0].text} in the first step")
    for name, team in task.teams.items():
        events += _stalls(team.fleet.model, name, recorder.aux(name), recorder.time_s)
    told = "" if number is None else f", episode {number[0]} of {number[1]}"
    return recorder.episode(
        mission={name: _stacked(frames) for name, frames in rows.items()},
        scene=task.scene(),
        overlays=task.overlays(),
        events=events,
        config_text=f"# {config.name}, seed {seed}{told}\n\n```toml\n{toml_text(config)}```\n",
    )


def _row(values: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """Copies of what a mission draws in one frame."""
    return {key: value.detach().cpu().numpy().copy() for key, value in values.items()}


def _stacked(rows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Rows of arrays as arrays of rows."""
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


def _events(step: Step, time: float, seen: set[tuple[str, int, str]], env: int = 0) -> list[Event]:
    found = []
    for team, ended in step.endings.items():
        for field in ended:
            kind, text = event_of(field)
            for vehicle in ended[field][env].nonzero().flatten().tolist():
                if (team, vehicle, kind) not in seen:
                    seen.add((team, vehicle, kind))
                    found.append(Event(time, team, vehicle, kind, f"{team}{vehicle} {text}"))
    return found


def _stalls(model: Any, team: str, aux: np.ndarray, time: np.ndarray) -> list[Event]:
    """Each moment a wing began to stall, if the model's `aux` [T, V, n] tells for how long it has been stalled."""
    if "stall_time" not in model.aux_names:
        return []
    stalled = aux[..., model.aux_names.index("stall_time")] > 0
    began = stalled & ~np.concatenate([np.zeros_like(stalled[:1]), stalled[:-1]])
    return [
        Event(float(time[step]), team, int(vehicle), "stall", f"{team}{vehicle}'s wing has stalled")
        for step, vehicle in np.argwhere(began)
    ]
