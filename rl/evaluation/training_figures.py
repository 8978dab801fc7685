"""Figures of a training, for any mission: reward per decision and policy loss (paper, figs. 3 and 4), and checkups."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rl.judge import SHARES
from rl.mission import Histories, History
from rl.team import TERM
from taichi_sim.config.io import replacing
from taichi_sim.visualisation.plotting import INK, dress, log_where_spread, moving_mean, new_figure, rgb
from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.palette import Livery

REWARD, LOSS, TERMS = "reward_per_step", "policy_loss", "terms of the reward"
ALWAYS = ("iteration", "agent_steps", "wall_time_s", REWARD, "measured")  # columns of checkups.csv that are no panels
FEW = 0.5  # an error measured in a smaller share of episodes is drawn hollow
NEAR = 0.08  # ticks of time nearer than this share of the axis are left out
LEVELS = {"classical": (0, (5, 3)), "before training": (0, (1, 2))}


def judged(history: History) -> list[str]:
    """Columns of a team's checkups that have a value somewhere, besides the reward."""
    of_all = history.checkups.values()
    return [
        key for key in dict.fromkeys(key for of in of_all for key in of)
        if key not in ALWAYS and any(np.isfinite(of[key]).any() for of in of_all)
    ]  # fmt: skip


def draw_iterations(axes: Axes, history: History, column: str, colour: object, label: str = "each iteration") -> None:
    """A column of progress.csv over agent steps (millions), raw and smoothed."""
    values = history.iterations[column]
    steps, known = history.iterations["agent_steps"] / 1e6, np.isfinite(values)
    axes.plot(steps[known], values[known], color=colour, linewidth=0.8, alpha=0.35)
    axes.plot(steps[known], moving_mean(values[known]), color=colour, linewidth=1.3, alpha=0.7, label=label)


def terms_of(history: History) -> list[str]:
    """Columns of a team's progress.csv that are parts of its reward."""
    return [key for key, values in history.iterations.items() if key.startswith(TERM) and np.isfinite(values).any()]


def draw_terms(axes: Axes, history: History, linestyle: str = "-", told: bool = True) -> None:
    """The mean part of each term in the reward per decision over agent steps (millions), smoothed."""
    steps = history.iterations["agent_steps"] / 1e6
    axes.axhline(0.0, color=INK, linewidth=0.8)
    for k, column in enumerate(terms_of(history)):
        values = history.iterations[column]
        known = np.isfinite(values)
        label = f"{column.removeprefix(TERM)}: {values[known][-1]:.2g}" if told else ""
        axes.plot(steps[known], moving_mean(values[known]), color=f"C{k}", linestyle=linestyle, linewidth=1.2,
                  label=label)  # fmt: skip


def draw_checkups(axes: Axes, history: History, column: str, colour: object, label: str, levels: bool = True) -> None:
    """A column of checkups.csv over agent steps (millions), and the levels of other controllers.

    Where nothing was measured, a cross stands above; where few episodes were, the point is hollow.
    """
    of = history.checkups.get("policy", {})
    if column not in of:
        return
    steps, values = of["agent_steps"] / 1e6, of[column]
    known, few = np.isfinite(values), (of["measured"] < FEW) & (column not in (REWARD, *SHARES))
    axes.plot(steps[known], values[known], color=colour, linewidth=1.8, label=label)
    dots = {"color": colour, "markersize": 4.5, "clip_on": False, "linestyle": "none"}
    if (known & ~few).any():  # a line of no points would widen the layout
        axes.plot(steps[known & ~few], values[known & ~few], marker="o", **dots)
    if (known & few).any():
        axes.plot(steps[known & few], values[known & few], marker="o", markerfacecolor="white",
                  label="few episodes lasted", **dots)  # fmt: skip
    if len(lost := steps[~known]):
        axes.plot(lost, np.full(len(lost), 0.95), marker="x", transform=axes.get_xaxis_transform(),
                  label="no episode lasted", **dots)  # fmt: skip
    for who, value in levels_of(history, column).items() if levels else ():
        axes.axhline(value, color=INK, linewidth=1.1, linestyle=LEVELS[who], label=f"{who}: {value:.3g}")


def levels_of(history: History, column: str) -> dict[str, float]:
    """Figures of the classical controller and of the policy before its training, where they were measured."""
    policy, classical = (history.checkups.get(who, {}) for who in ("policy", "classical"))
    found = {"classical": classical.get(column, np.empty(0))[:1]}
    if len(policy.get("iteration", ())) and not policy["iteration"][0]:
        found["before training"] = policy[column][:1]
    return {who: float(value[0]) for who, value in found.items() if np.isfinite(value).any()}


def draw_axes(axes: Axes, histories: Sequence[History], column: str) -> None:
    """Limits of a panel of `histories`, its scale, and the time of the first one (min) on a second axis above."""
    columns = [of.checkups[who].get(column) for of in histories for who in of.checkups]
    if column in SHARES:
        axes.set_ylim(-0.04, 1.04)
    elif column not in (REWARD, LOSS, TERMS):
        log_where_spread(axes, np.concatenate([np.empty(0), *(values for values in columns if values is not None)]))
    steps, minutes = (np.append(0.0, histories[0].iterations[key]) for key in ("agent_steps", "wall_time_s"))
    axes.set_xlim(0.0, 1.02 * max(float(np.append(0.0, of.iterations["agent_steps"])[-1]) for of in histories) / 1e6)
    if len(steps) > 1 and minutes[-1] > 0:
        above = axes.twiny()
        above.set_xlim(axes.get_xlim())
        ticks = np.asarray(MaxNLocator(4).tick_values(0.0, minutes[-1] / 60))
        ticks = ticks[(ticks >= 0) & (ticks <= minutes[-1] / 60)]
        at = np.interp(60 * ticks, minutes, steps / 1e6)
        free = np.append(np.diff(at) > NEAR * at[-1], True)
        above.set_xticks(at[free], [f"{tick:.3g}" for tick in ticks[free]])
        above.set_xlabel("min", loc="right", labelpad=-8.0, fontsize="small")
        above.tick_params(labelsize="small", length=2.0)
        above.spines[["right"]].set_visible(False)


def _grid(
    histories: Histories, liveries: Mapping[str, Livery], columns: Mapping[str, Sequence[str]], title: str, down: bool
) -> Figure:
    """A panel for each team and each of its `columns`; teams stand below each other if `down`, or side by side."""
    wide = max(len(of) for of in columns.values()) if down else len(histories)
    figure = new_figure(4.6 * max(wide, 2), 4.0 * (len(histories) if down else 1), title)
    panels = figure.subplots(*((len(histories), wide) if down else (1, wide)), squeeze=False)
    letters = iter(ascii_lowercase)
    for k, (team, history) in enumerate(histories.items()):
        colour = rgb(liveries[team].first) if team in liveries else INK  # a team without a livery
        line = panels[k] if down else panels[0][k : k + 1]
        for axes in line[len(columns[team]) :]:
            axes.set_visible(False)
        for axes, column in zip(line, columns[team], strict=False):
            if column == LOSS:
                axes.axhline(0.0, color=INK, linewidth=0.8)
            if column in history.iterations and column in (REWARD, LOSS):
                draw_iterations(axes, history, column, colour, "training, moving mean")
            if column == TERMS:
                draw_terms(axes, history)
            draw_checkups(axes, history, column, colour, "mean policy, held-out episodes")
            draw_axes(axes, [history], column)
            words = column.replace("_", " ").replace("per step", "per decision")
            dress(axes, f"({next(letters)}) {team.upper()} team", "agent steps (millions)", words)
            axes.legend(loc="best", framealpha=0.8, fontsize=8)
    return figure


def training_figures(histories: Histories, episode: Episode | None) -> dict[str, Figure]:
    """Reward per decision and PPO's policy loss during training (paper, figs. 3 and 4), and what checkups measured, in
    the colours of an episode if there is one: name -> figure.
    """
    if not histories:
        return {}
    liveries = {} if episode is None else episode.liveries
    titles = {REWARD: "Reward per decision during training", LOSS: "Policy loss during training"}
    figures = {
        name: _grid(histories, liveries, dict.fromkeys(histories, [column]), titles[column], down=False)
        for name, column in (("reward", REWARD), ("policy_loss", LOSS))
    }
    if all(terms_of(history) for history in histories.values()):
        figures["terms"] = _grid(histories, liveries, dict.fromkeys(histories, [TERMS]), TERMS.capitalize(), down=False)
    columns = {team: judged(history) for team, history in histories.items()}
    if any(columns.values()):
        title = "The mean policy on held-out episodes during training"
        figures["checkups"] = _grid(histories, liveries, columns, title, down=True)
    return figures


def save_figures(out: Path, figures: Mapping[str, Figure]) -> list[Path]:
    """Write each figure as NAME.png into the folder `out`; an old picture stays until the new one is complete."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{name}.png" for name in figures]
    for file, figure in zip(files, figures.values(), strict=True):
        with replacing(file) as part:
            figure.savefig(part, dpi=150)
    return files
