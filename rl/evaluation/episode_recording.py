"""One episode with every state of every team, for recordings and figures. A recording's file name chooses its
format.
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
import torch
from tqdm import tqdm

from rl.evaluation.conditions import conditions_of
from rl.evaluation.episode_log import event_of
from rl.evaluation.episodes import Trial
from rl.judge import Judge
from rl.mission import Mission, Policy, Step
from rl.runs.folder import RunError
from rl.scenario import Scenario
from taichi_sim.config.io import toml_text
from taichi_sim.kernels import runtime
from taichi_sim.options import refuse_unwritable
from taichi_sim.vehicle import Vehicle
from taichi_sim.visualisation.recording import Episode, Event, Recorder, Scene
from taichi_sim.visualisation.recording.overlays import Note, Overlay
from taichi_sim.visualisation.recording.ros import FJORD, Origin, check_bag, write_mcap, write_rosbag2
from taichi_sim.visualisation.recording.rrd import write_recording

Rows = Mapping[str, Mapping[str, np.ndarray]]
"""Team -> name -> values that a recording shows in one frame, besides the vehicles."""


class EpisodeOptions(TypedDict, total=False):
    """Arguments of `Recorder.episode` that are not the mission's."""

    name: str | None
    events: Iterable[Event]
    config_text: str | None
    like: Episode | None


class _Drawn(TypedDict):
    mission: dict[str, dict[str, Any]]
    conditions: dict[str, Any]
    overlays: tuple[Overlay, ...]
    scene: Scene | None


class EpisodeReel:
    """Frames of environment `env` of a mission."""

    def __init__(
        self, mission: Mission, env: int = 0, after: float = 0.0, judges: Mapping[str, Judge] | None = None
    ) -> None:
        """Record environment `env` of `mission`; the clock begins at `after` (s). `judges` of its teams tell what they
        show over time, too.
        """
        self.mission, self.env, self.judges = mission, env, judges or {}
        self.recorder = Recorder(mission.world, env, after)
        self._frames: list[tuple[Rows, tuple[Overlay, ...]]] = []

    def __len__(self) -> int:
        """Number of frames since the last part."""
        return len(self.recorder)

    @property
    def now(self) -> float:
        """Time of the clock, s."""
        return self.recorder.now

    def add(self, step: Step) -> None:
        """Keep a frame: the world and the mission as they are now, after `step`."""
        self.recorder.add({name: team.action for name, team in self.mission.teams.items()})
        frame, rows = self.mission.frame(self.env), {}
        for name in self.mission.teams:
            row = {**frame.teams.get(name, {}), "reward": step.reward[name][self.env]}
            if series := self._series(name):
                row["measured"] = torch.stack([value[self.env] for value in series.values()], -1)
            rows[name] = {key: value.detach().cpu().numpy().copy() for key, value in row.items()}
            rows[name]["ending"] = step.endings[name].why()[self.env]
        self._frames.append((rows, frame.overlays))

    def episode(self, **parts: Unpack[EpisodeOptions]) -> Episode:
        """All frames; `parts` as Recorder.episode has them."""
        return self.recorder.episode(**self._drawn(), **parts)

    def part(self, keep: int = 0, **parts: Unpack[EpisodeOptions]) -> Episode:
        """The frames since the last part, which are then forgotten, but for the last `keep`."""
        part = self.recorder.part(keep, **self._drawn(), **parts)
        self._frames = self._frames[len(self._frames) - keep :]
        return part

    def _drawn(self) -> _Drawn:
        rows, overlays = zip(*self._frames, strict=True)
        mission: dict[str, dict[str, Any]] = {
            name: {key: np.stack([row[name][key] for row in rows]) for key in rows[0][name]}
            | {"measured_names": tuple(self._series(name))}
            for name in rows[0]
        }
        here = conditions_of(self.mission, slice(self.env, self.env + 1))
        conditions = {key: of[0].tolist() for key, of in here.items()}
        scene = self.mission.scene(self.env)
        return {"mission": mission, "conditions": conditions, "overlays": joined(overlays), "scene": scene}

    def _series(self, team: str) -> Mapping[str, torch.Tensor]:
        return self.judges[team].series() if team in self.judges else {}


def joined(frames: Iterable[tuple[Overlay, ...]]) -> tuple[Overlay, ...]:
    """Overlays of single frames as overlays of all frames, by name; notes are kept as they are."""
    notes: list[Overlay] = []
    by_name: dict[str, list[Overlay]] = {}
    for overlay in chain.from_iterable(frames):
        if isinstance(overlay, Note):
            notes.append(overlay)
        else:
            by_name.setdefault(overlay.name, []).append(overlay)
    return (*(_along_time(same) for same in by_name.values()), *notes)


def _along_time(same: Sequence[Overlay]) -> Overlay:
    first = same[0]
    names = [field.name for field in fields(first) if isinstance(getattr(first, field.name), np.ndarray)]
    return replace(first, **{name: np.concatenate([getattr(overlay, name) for overlay in same]) for name in names})


RRD, MCAP = ".rrd", ".mcap"
Seen = Callable[[Mission, int, Step, list[Event]], None]
"""Called after each step of an episode that is recorded: mission, its environment, the step, new events."""


@runtime.loop.as_for_many()
def record_episode(
    config: Scenario,
    policies: Mapping[str, Policy],
    *,
    seed: int,
    number: tuple[int, int] | None = None,
    duration: float | None = None,
    source: Path | None = None,
    show_progress: bool = False,
    seen: Seen | None = None,
) -> Episode:
    """Run one held-out episode (number 0 of evaluation seed `seed`) and record all of it.

    The episode goes on after a collision, to show what follows. It ends when a state is not finite or when all aircraft
    of a team are in the water.

    Args:
        config, policies: the scenario, and the policy of each team.
        seed: of the episodes.
        number: (i, n) repeats episode i of an evaluation of n episodes, with its chunk.
        duration: s; default the scenario's.
        source: the scenario's file.
        show_progress: show a progress bar.
        seen: called with each frame.
    """
    duration = config.episode_duration if duration is None else duration
    steps = max(2, round(duration / config.decision_interval))
    episode, count = number or (0, 1)
    trial = Trial(config, policies, count, seed, source=source)
    task, env = trial.mission(trial.chunk_of(episode)), episode - trial.chunk_of(episode)
    reel = EpisodeReel(task, env, judges={name: task.Judge(task, name) for name in task.teams})
    known: set[tuple[str, int, str]] = set()
    events: list[Event] = []
    with runtime.torch_at_rest():
        for i in tqdm(range(steps), desc="record", unit="step", disable=not show_progress):
            step = task.step({name: policies[name] for name in task.teams}, begin=False, observe=())
            new = events_of(step, (i + 1) * config.decision_interval, known, task.Judge.goals, env)
            events += new
            if any(bool(ended["diverged"][env].any()) for ended in step.endings.values()):
                break  # what follows is no motion
            reel.add(step)
            if seen is not None:
                seen(task, env, step, new)
            if any("crashed" in ended and bool(ended["crashed"][env].all()) for ended in step.endings.values()):
                break  # aircraft do not fly under water
    if not len(reel):
        raise RunError(f"nothing to record: {events[0].text} in the first step")
    for name, team in task.teams.items():
        events += _stalls(team.fleet.model, name, reel.recorder.aux(name), reel.recorder.time_s)
    which = "" if number is None else f", episode {number[0]} of {number[1]}"
    return reel.episode(
        events=events, config_text=f"# {config.name}, seed {seed}{which}\n\n```toml\n{toml_text(config)}```\n"
    )


def events_of(step: Step, time: float, known: set[tuple[str, int, str]], goals: Sequence[str], env: int) -> list[Event]:
    """Endings in a step of environment `env` at `time` (s) that are not `known` yet, and then are; `goals` of them are
    what a vehicle was to do.
    """
    found = []
    for team, ended in step.endings.items():
        for field in ended:
            kind, text = event_of(field)
            for vehicle in ended[field][env].nonzero().flatten().tolist():
                if (team, vehicle, kind) not in known:
                    known.add((team, vehicle, kind))
                    found.append(Event(time, team, vehicle, kind, f"{team}{vehicle} {text}", field in goals))
    return found


def _stalls(model: Vehicle, team: str, aux: np.ndarray, time: np.ndarray) -> list[Event]:
    """An event for each moment at which a wing begins to stall; `aux` [T, V, n] is the model's."""
    if "stall_time" not in model.aux_names:
        return []
    stalled = aux[..., model.aux_names.index("stall_time")] > 0
    began = stalled & ~np.concatenate([np.zeros_like(stalled[:1]), stalled[:-1]])
    return [
        Event(float(time[step]), team, int(vehicle), "stall", f"{team}{vehicle}'s wing has stalled")
        for step, vehicle in np.argwhere(began)
    ]


class Output(NamedTuple):
    """Path and format of a recording."""

    place: Path | None  # None: the default
    write: Callable[[Any, Path], Path]  # an Episode; a recording for rerun also takes several by caption
    reader: str  # the command that opens it


def output_of(out: str | None, origin: Sequence[float] | None = None, *, show_progress: bool = False) -> Output:
    """The output for `out`: FILE.rrd, FILE.mcap, or a rosbag2 folder, whose name has no suffix or ends with a slash.

    `origin` is the latitude and longitude (deg) of the world's origin in a bag.
    """
    place = None if out is None else Path(out)
    if place is not None:
        refuse_unwritable(place)
    folder = out is not None and (out.endswith(("/", os.sep)) or not Path(out).suffix)
    if place is None or (place.suffix == RRD and not folder):
        if origin is not None:
            raise RunError(f"--origin: only a bag has an origin: --out FILE{MCAP} or --out FOLDER/")
        return Output(place, write_recording, "rerun")
    if place.suffix != MCAP and not folder:
        raise RunError(f"--out {out}: allowed are FILE{RRD} (rerun), FILE{MCAP} (ROS 2) and FOLDER/ (rosbag2)")
    at = FJORD if origin is None else Origin(*origin)
    check_bag(place, folder=folder, origin=at)
    write = write_rosbag2 if folder else write_mcap
    return Output(place, partial(write, origin=at, show_progress=show_progress), "ros2 bag play")
