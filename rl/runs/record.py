"""One episode, written down: every state of both teams, for recordings and figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from rl.learn.policy import Policy
from rl.missions.formation.mission import FormationTask, Step
from rl.runs.evaluation import one_episode_each, one_thread
from taichi_sim.config import ScenarioConfig
from taichi_sim.config.io import toml_text
from taichi_sim.conventions import FREEBOARD, NO_DECK
from taichi_sim.recording import Episode, Event, Scene, Signal, TeamTrack
from taichi_sim.recording.model import air_of, airframe_of, body_of, columns_of, forces_of, medium_of, signals_of

EVENTS = {
    "collided": ("collision", "hit an obstacle or a team mate"),
    "lost": ("lost", "is too far from its slot"),
    "crashed": ("crashed", "has touched the water, with a wing tip or else"),
    "stalled": ("stalled", "has not recovered from a stall"),
    "capsized": ("capsized", "has turned over"),
    "swamped": ("swamped", "has water on deck"),
    "grounded": ("grounded", "has touched the ground"),
    "left": ("left", "has left the area"),
    "diverged": ("diverged", "has no finite state any more"),
}
"""Field of Endings -> kind of event and what is said of it; a field that is not here speaks for itself."""


NEVER = torch.zeros(1, dtype=torch.bool)  # boats do not crash


def record_episode(
    config: ScenarioConfig,
    policies: Mapping[str, Policy],
    *,
    seed: int,
    duration: float | None = None,
    source: Path | None = None,
    show_progress: bool = False,
) -> Episode:
    """Run one episode of an unseen world (number 0 of evaluation seed `seed`) and keep all of it.

    The episode goes on after a collision, so that one sees what follows, but not after a state that is no longer
    finite, nor when a whole team of aircraft is in the water. `duration` in s, default the scenario's.

    Raises:
        ValueError: if there is nothing to record, for a state diverged in the first step.
    """
    duration = config.episode_duration if duration is None else duration
    steps = max(2, round(duration / config.decision_interval))
    task = one_episode_each(config, tuple(policies), 1, seed, source)
    rows: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in task.teams}
    flows: list[list[np.ndarray]] = []
    seen: set[tuple[str, int, str]] = set()
    events: list[Event] = []
    begin = float(task.world.time[0])
    with one_thread():
        for i in tqdm(range(steps), desc="record", unit="step", disable=not show_progress):
            step = task.step({name: policies[name](team) for name, team in task.teams.items()})
            events += _events(step, (i + 1) * config.decision_interval, seen)
            if any(bool(ended.diverged.any()) for ended in step.endings.values()):
                break  # what follows is no motion
            for name in task.teams:
                rows[name].append(_row(task, name, step))
            flows.append([flow[0].cpu().numpy().copy() for flow in (task.world.around.current, task.world.around.wind)])
            if any(bool(getattr(ended, "crashed", NEVER).all()) for ended in step.endings.values()):
                break  # nobody flies under water
    if not flows:
        raise ValueError(f"nothing to record: {events[0].text} in the first step")
    time = (np.arange(len(flows)) + 1) * config.decision_interval
    for name, frames in rows.items():
        aux = np.stack([frame["aux"] for frame in frames])
        events += _stalls(task.world.teams[name].model, name, aux, time)
    sea, index = task.world.sea, int(task.world.env_sea[0])

    def elevation(north: np.ndarray, east: np.ndarray, time_s: float) -> np.ndarray:
        return sea.elevation(north, east, begin + time_s, index).cpu().numpy()

    return Episode(
        name=config.name,
        time_s=time,
        teams={name: _track(task, name, frames) for name, frames in rows.items()},
        scene=_scene(task),
        elevation=elevation,
        config_text=f"# {config.name}, seed {seed}\n\n```toml\n{toml_text(config)}```\n",
        events=tuple(events),
        current_n=np.stack([current for current, _ in flows]),
        wind_n=np.stack([wind for _, wind in flows]),
    )


def _row(task: FormationTask, name: str, step: Step) -> dict[str, np.ndarray]:
    team = task.teams[name]
    position = team.team.position_n[0]
    surface = task.world.elevation(torch.zeros(1, dtype=torch.int64), position[None, :, 0], position[None, :, 1])
    slot = team.now.slot[0].clone()
    if medium_of(team.team.model) == "water":
        slot[:, 2] = 0.0
    values = {
        "position_n": position,
        "quaternion_nb": team.team.quaternion_nb[0],
        "velocity_n": team.team.velocity_n[0],
        "target_n": team.target.position[0],
        "target_course": team.target.course[0],
        "slot_n": slot,
        "error_m": team.distance[0],
        "reward": step.reward[name][0],
        "action": team.action[0],
        "wave_height": surface[0],
        "aux": team.team.aux[0, :, : columns_of(team.team.model)],
        "freeboard": team.team.surface[0, :, FREEBOARD],
    }
    return {key: value.detach().cpu().numpy().copy() for key, value in values.items()}


def _track(task: FormationTask, name: str, frames: list[dict[str, np.ndarray]]) -> TeamTrack:
    model = task.world.teams[name].model
    arrays = {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}
    aux, freeboard = arrays.pop("aux"), arrays.pop("freeboard")
    signals = signals_of(model, aux)
    if np.any(freeboard < NO_DECK):
        signals["freeboard"] = Signal(("freeboard",), "m", freeboard[..., None])
    return TeamTrack(
        name=name,
        medium=medium_of(model),
        action_names=model.action_names,
        size_m=model.params.size,
        body=body_of(model),
        airframe=airframe_of(model),
        air_n=air_of(model, aux),
        forces=forces_of(model, aux),
        signals=signals,
        **arrays,
    )


def _scene(task: FormationTask) -> Scene:
    track = task.tracks.table[0, :, :2].cpu().numpy()
    flown = task.config.track.flight_height
    heights = {name: 0.0 if medium_of(team.team.model) == "water" else flown for name, team in task.teams.items()}
    obstacles = task.obstacles[0].cpu().numpy()
    half = task.config.area / 2
    return Scene(
        area_m=task.config.area,
        tracks_n={name: np.column_stack((track, np.full(len(track), -heights[name]))) for name in task.teams},
        checkpoints_n=task.tracks.checkpoints[0].cpu().numpy(),
        obstacles=obstacles[np.abs(obstacles[:, :2]).max(axis=1) <= half],
    )


def _events(step: Step, time: float, seen: set[tuple[str, int, str]]) -> list[Event]:
    found = []
    for team, ended in step.endings.items():
        for field in ended._fields:
            kind, text = EVENTS.get(field, (field, f"has ended: {field.replace('_', ' ')}"))
            for vehicle in getattr(ended, field)[0].nonzero().flatten().tolist():
                if (team, vehicle, kind) not in seen:
                    seen.add((team, vehicle, kind))
                    found.append(Event(time, team, vehicle, kind, f"{team}{vehicle} {text}"))
    return found


def _stalls(model: Any, team: str, aux: np.ndarray, time: np.ndarray) -> list[Event]:
    """Each moment a wing began to stall, if the model's `aux` [T, V, n] tells for how long it has been stalled."""
    if "stall_time" not in getattr(model, "aux_names", ()):
        return []
    stalled = aux[..., model.aux_names.index("stall_time")] > 0
    began = stalled & ~np.concatenate([np.zeros_like(stalled[:1]), stalled[:-1]])
    return [
        Event(float(time[step]), team, int(vehicle), "stall", f"{team}{vehicle}'s wing has stalled")
        for step, vehicle in np.argwhere(began)
    ]
