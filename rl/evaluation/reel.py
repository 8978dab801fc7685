"""Recording of one environment of a mission while it runs, as a whole episode or in parts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from itertools import chain
from typing import TypedDict, Unpack

import numpy as np

from rl.mission import Mission, Step
from taichi_sim.recording import Episode, Event, Recorder, Scene
from taichi_sim.recording.overlays import Note, Overlay

Rows = Mapping[str, Mapping[str, np.ndarray]]
"""Team -> name -> values that a recording shows in one frame, besides the vehicles."""


class EpisodeOptions(TypedDict, total=False):
    """Arguments of `Recorder.episode` that are not the mission's."""

    name: str | None
    events: Iterable[Event]
    config_text: str | None
    like: Episode | None


class _Drawn(TypedDict):
    mission: dict[str, dict[str, np.ndarray]]
    overlays: tuple[Overlay, ...]
    scene: Scene | None


class EpisodeReel:
    """Frames of environment `env` of a mission."""

    def __init__(self, mission: Mission, env: int = 0, after: float = 0.0) -> None:
        """Record environment `env` of `mission`; the clock begins at `after` (s)."""
        self.mission, self.env = mission, env
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
            rows[name] = {key: value.detach().cpu().numpy().copy() for key, value in row.items()}
        self._frames.append((rows, frame.overlays))

    def episode(self, **parts: Unpack[EpisodeOptions]) -> Episode:
        """All frames; `parts` as Recorder.episode has them."""
        return self.recorder.episode(**self._drawn(), **parts)

    def part(self, **parts: Unpack[EpisodeOptions]) -> Episode:
        """The frames since the last part, which are then forgotten."""
        part = self.recorder.part(**self._drawn(), **parts)
        self._frames = []
        return part

    def _drawn(self) -> _Drawn:
        rows, overlays = zip(*self._frames, strict=True)
        mission = {name: {key: np.stack([row[name][key] for row in rows]) for key in rows[0][name]} for name in rows[0]}
        return {"mission": mission, "overlays": joined(overlays), "scene": self.mission.scene(self.env)}


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
