"""Training figures of any mission, from progress.csv: reward and policy loss (paper, figs. 3 and 4)."""

from collections.abc import Mapping
from pathlib import Path
from string import ascii_lowercase

import numpy as np
from matplotlib.figure import Figure

from rl.mission import Histories
from taichi_sim.config.io import replacing
from taichi_sim.plotting import INK, dress, moving_mean, new_figure, rgb
from taichi_sim.recording import Episode
from taichi_sim.recording.palette import Livery


def _history_figure(histories: Histories, liveries: Mapping[str, Livery], column: str, title: str, y: str) -> Figure:
    """`column` of each team's history over agent steps, raw and smoothed; a team without a livery is drawn in ink."""
    figure = new_figure(5.6 * max(1, len(histories)), 4.3, title)
    panels = figure.subplots(1, len(histories), squeeze=False)[0]
    for axes, letter, (team, history) in zip(panels, ascii_lowercase, histories.items(), strict=False):
        steps = np.asarray(history["agent_steps"]) / 1e6
        values = np.asarray(history[column])
        known = np.isfinite(values)
        colour = rgb(liveries[team].first) if team in liveries else INK
        if column == "policy_loss":
            axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.plot(steps[known], values[known], color=colour, linewidth=0.9, alpha=0.35, label="each iteration")
        axes.plot(steps[known], moving_mean(values[known]), color=colour, linewidth=2.2, label="moving mean")
        if len(steps):
            axes.set_xlim(0.0, float(steps[-1]) or 1.0)
        dress(axes, f"({letter}) {team.upper()} team", "agent steps (millions)", y)
        axes.legend(loc="best", framealpha=0.9)
    return figure


def training_figures(histories: Histories, episode: Episode | None) -> dict[str, Figure]:
    """Cumulative reward per episode and PPO's policy loss during training (paper, figs. 3 and 4), in the colours of an
    episode if there is one: name -> figure.
    """
    liveries = {} if episode is None else episode.liveries
    drawn = {
        "reward": ("episode_reward", "Cumulative reward per episode during training", "cumulative reward per episode"),
        "policy_loss": ("policy_loss", "Policy loss during training", "policy loss"),
    }
    return {name: _history_figure(histories, liveries, *what) for name, what in drawn.items()} if histories else {}


def save_figures(out: Path, figures: Mapping[str, Figure]) -> list[Path]:
    """Write each figure as NAME.png into the folder `out`; an old picture stays until the new one is complete."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{name}.png" for name in figures]
    for file, figure in zip(files, figures.values(), strict=True):
        with replacing(file) as part:
            figure.savefig(part, dpi=150)
    return files
