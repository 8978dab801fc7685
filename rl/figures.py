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

Liveries = Mapping[str, Livery]
"""team -> its colours in a recording; a team that is not there is drawn in ink."""


def _history_figure(histories: Histories, liveries: Liveries, column: str, title: str, y: str, zero: bool) -> Figure:
    """`column` of each team's history over agent steps, raw and smoothed."""
    figure = new_figure(5.6 * max(1, len(histories)), 4.3, title)
    panels = figure.subplots(1, len(histories), squeeze=False)[0]
    for axes, letter, (team, history) in zip(panels, ascii_lowercase, histories.items(), strict=False):
        steps = np.asarray(history["agent_steps"]) / 1e6
        values = np.asarray(history[column])
        known = np.isfinite(values)
        colour = rgb(liveries[team].first) if team in liveries else INK
        if zero:
            axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.plot(steps[known], values[known], color=colour, linewidth=0.9, alpha=0.35, label="each iteration")
        axes.plot(steps[known], moving_mean(values[known]), color=colour, linewidth=2.2, label="moving mean")
        if len(steps):
            axes.set_xlim(0.0, float(steps[-1]) or 1.0)
        dress(axes, f"({letter}) {team.upper()} team", "agent steps (millions)", y)
        axes.legend(loc="best", framealpha=0.9)
    return figure


def training_figures(histories: Histories, episode: Episode | None) -> dict[str, Figure]:
    """The figures of a training, in the colours of an episode if there is one: name -> figure."""
    if not histories:
        return {}
    liveries = {} if episode is None else episode.liveries
    return {"reward": reward_figure(histories, liveries), "policy_loss": policy_loss_figure(histories, liveries)}


def reward_figure(histories: Histories, liveries: Liveries) -> Figure:
    """Cumulative reward of an episode during training (paper, Fig. 3)."""
    return _history_figure(
        histories,
        liveries,
        "episode_reward",
        "Cumulative reward per episode during training",
        "cumulative reward per episode",
        zero=False,
    )


def policy_loss_figure(histories: Histories, liveries: Liveries) -> Figure:
    """PPO's policy loss during training (paper, Fig. 4)."""
    return _history_figure(histories, liveries, "policy_loss", "Policy loss during training", "policy loss", zero=True)


def save_figures(out: Path, figures: Mapping[str, Figure]) -> list[Path]:
    """Write each figure as NAME.png into the folder `out`; an old picture stays until the new one is complete."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{name}.png" for name in figures]
    for file, figure in zip(files, figures.values(), strict=True):
        with replacing(file) as part:
            figure.savefig(part, dpi=150)
    return files
