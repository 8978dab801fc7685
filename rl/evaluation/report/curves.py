"""Learning curves of each stage."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episodes import mission_class
from rl.evaluation.report.sources import Run
from rl.runs.folder import CONFIG
from taichi_sim.plotting.page import COLOURS, blank, missing, panel, svg

SMOOTH = 0.05  # width of the moving mean, as a share of a curve's length
COLUMNS = ("episode_reward", "policy_loss")  # of every mission; its own columns follow


def curves(runs: Sequence[Run]) -> str:
    """A row of panels for each team; each panel shows all runs."""
    teams = list(dict.fromkeys(team for run in runs for team in run.histories))
    if not teams:
        return missing("No training yet.", f"python rl/train.py --out {runs[0].folder} --resume")
    of_mission = mission_class(runs[0].config, runs[0].folder / CONFIG).logged
    known = {column for run in runs for history in run.histories.values() for column in history}
    columns = [name for name in (*COLUMNS, *of_mission) if name in known]
    figure = blank(3.0 * len(columns), 2.3 * len(teams) + 0.3)
    grid = figure.subplots(len(teams), len(columns), squeeze=False)
    for row, team in enumerate(teams):
        under = "million agent-steps" if row == len(teams) - 1 else ""
        for column, axes in zip(columns, grid[row], strict=True):
            for run, colour in zip(runs, (COLOURS["policy"], COLOURS["other"]), strict=False):
                history = run.histories.get(team, {})
                if column not in history:
                    continue
                steps, values = np.asarray(history["agent_steps"]) / 1e6, np.asarray(history[column])
                axes.plot(steps, values, color=colour, linewidth=0.7, alpha=0.35)
                axes.plot(steps, _smooth(values), color=colour, linewidth=1.6, label=run.name)
            panel(axes, f"{team}: {column.replace('_', ' ')}", under, "")
    if len(runs) > 1:
        grid[0][0].legend()
    return svg(figure, "learning curves")


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centred moving mean that ignores NaN."""
    width = max(1, round(SMOOTH * len(values))) | 1
    known = np.isfinite(values)
    if not known.any():
        return values
    total = np.convolve(np.where(known, values, 0.0), np.ones(width))[width // 2 :][: len(values)]
    count = np.convolve(known.astype(float), np.ones(width))[width // 2 :][: len(values)]
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
