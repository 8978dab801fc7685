"""Recording of one environment of a mission while it runs, as a whole episode or in parts."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch

from rl.mission import Mission, Step
from taichi_sim.recording import Episode, Recorder
from taichi_sim.recording.overlays import Overlay

Rows = Mapping[str, Mapping[str, np.ndarray]]
"""team -> name -> what a recording shows of the team in one frame, besides its vehicles."""


def rows_of(mission: Mission, step: Step) -> Rows:
    """What the mission records of each team after `step`.

    Call it once for each step: a mission may keep frames when asked.
    """
    env = mission.shown
    rows = {name: mission.frame(team) | {"reward": step.reward[name][env]} for name, team in mission.teams.items()}
    return {name: {key: _copy(value) for key, value in row.items()} for name, row in rows.items()}


def _copy(value: torch.Tensor) -> np.ndarray:
    return value.detach().cpu().numpy().copy()


class Reel:
    """The frames of the environment that a mission shows (`mission.shown`)."""

    def __init__(self, mission: Mission, after: float = 0.0) -> None:
        """Begin a recording whose clock starts at `after` s."""
        self.mission = mission
        self.recorder = Recorder(mission.world, mission.shown, after)
        self._rows: dict[str, list[Mapping[str, np.ndarray]]] = {name: [] for name in mission.teams}

    def __len__(self) -> int:
        """Number of frames since the last part."""
        return len(self.recorder)

    @property
    def now(self) -> float:
        """Time of the clock, s."""
        return self.recorder.now

    def add(self, rows: Rows) -> None:
        """Add a frame: the current world, the teams' actions, and `rows`."""
        self.recorder.add({name: team.action for name, team in self.mission.teams.items()})
        for name, earlier in self._rows.items():
            earlier.append(rows[name])

    def episode(self, **parts: Any) -> Episode:
        """All frames with all overlays; `parts` as for `Recorder.episode`."""
        return self.recorder.episode(**self._drawn(), overlays=self.mission.overlays(), **parts)

    def part(self, **parts: Any) -> Episode:
        """The frames since the last part, which are then dropped, with the newest overlays; `parts` as for
        `Recorder.episode`.
        """
        overlays = tuple(_newest(overlay, len(self)) for overlay in self.mission.overlays())
        part = self.recorder.part(**self._drawn(), overlays=overlays, **parts)
        self._rows = {name: [] for name in self._rows}
        return part

    def _drawn(self) -> dict[str, Any]:
        stacked = {
            name: {key: np.stack([row[key] for row in rows]) for key in rows[0]} for name, rows in self._rows.items()
        }
        return {"mission": stacked, "scene": self.mission.scene()}


def _newest(overlay: Overlay, frames: int) -> Overlay:
    """The last `frames` frames of an overlay (taichi_sim/recording/overlays.py). An overlay that does not move has a
    single frame.
    """
    arrays = {field.name: getattr(overlay, field.name) for field in fields(overlay)}
    cut = {key: of[-frames:] for key, of in arrays.items() if isinstance(of, np.ndarray) and len(of) > 1}
    return replace(overlay, **cut)
