"""What is kept of one environment of a mission while it runs, frame by frame: a whole episode, or parts of one."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch

from rl.mission import Step
from taichi_sim.recording import Episode, Recorder

Rows = Mapping[str, Mapping[str, np.ndarray]]
"""team -> what a recording shows of it in one frame, beside its vehicles."""


def rows_of(mission: Any, step: Step) -> Rows:
    """What the mission draws of its teams now, after `step`: to be asked once a step, for it may count them."""
    env = mission.shown
    told = {name: mission.frame(team) | {"reward": step.reward[name][env]} for name, team in mission.teams.items()}
    return {name: {key: _copy(value) for key, value in of.items()} for name, of in told.items()}


def _copy(value: torch.Tensor) -> np.ndarray:
    return value.detach().cpu().numpy().copy()


class Reel:
    """Frames of the environment that a mission shows (`mission.shown`)."""

    def __init__(self, mission: Any, after: float = 0.0) -> None:
        """Begin; the clock says by now `after` (s)."""
        self.mission = mission
        self.recorder = Recorder(mission.world, mission.shown, after)
        self._rows: dict[str, list[Mapping[str, np.ndarray]]] = {name: [] for name in mission.teams}

    def __len__(self) -> int:
        """Frames since the last part."""
        return len(self.recorder)

    @property
    def now(self) -> float:
        """The clock, s."""
        return self.recorder.now

    def add(self, rows: Rows) -> None:
        """Keep a frame: the world as it is now, the teams' actions, and `rows`."""
        self.recorder.add({name: team.action for name, team in self.mission.teams.items()})
        for name, kept in self._rows.items():
            kept.append(rows[name])

    def episode(self, **parts: Any) -> Episode:
        """All frames, with all that the mission draws; `parts` as Recorder.episode has them."""
        return self.recorder.episode(**self._drawn(), overlays=self.mission.overlays(), **parts)

    def part(self, **parts: Any) -> Episode:
        """The frames since the last part, which are forgotten, with the newest of what the mission draws."""
        overlays = tuple(_newest(overlay, len(self)) for overlay in self.mission.overlays())
        part = self.recorder.part(**self._drawn(), overlays=overlays, **parts)
        self._rows = {name: [] for name in self._rows}
        return part

    def _drawn(self) -> dict[str, Any]:
        stacked = {
            name: {key: np.stack([row[key] for row in rows]) for key in rows[0]} for name, rows in self._rows.items()
        }
        return {"mission": stacked, "scene": self.mission.scene()}


def _newest(overlay: Any, frames: int) -> Any:
    """An overlay (taichi_sim/recording/overlays.py) with the newest of its frames; what stands still has one."""
    arrays = {field.name: getattr(overlay, field.name) for field in fields(overlay)}
    cut = {key: of[-frames:] for key, of in arrays.items() if isinstance(of, np.ndarray) and len(of) > 1}
    return replace(overlay, **cut)
