"""The part of a report on when and why episodes fail: the worst ones of each team with their conditions, and error and
success over each condition.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from rl.evaluation.conditions import unit
from rl.evaluation.episode_log import event_of
from rl.evaluation.episodes import in_order
from rl.evaluation.intervals import wilson
from rl.evaluation.report.numbers import short
from rl.evaluation.store import Run, StoredEvaluation
from taichi_sim.visualisation.plotting import rgb
from taichi_sim.visualisation.plotting.page import COLOURS, blank, folded, missing, panel, paragraph, svg, table, text
from taichi_sim.visualisation.recording.palette import ALARM

Array = NDArray[np.float64]
WORST = 8  # episodes of a team in its table
BINS = 5  # of as many episodes each, in which success is shown
NUMBERS = 4  # of a team's vehicles, with a panel each: those that matter most
ACROSS = 4  # panels in a row
LEAST = 20  # episodes, of which a correlation says something; assumed


class Spread(NamedTuple):
    """A condition that differs between episodes, for the panels of one team."""

    key: str
    values: Array  # [episode]; of vehicles, their mean


def failures(run: Run) -> str:
    """A table and pictures for each team of the policy's last evaluation."""
    of = run.evaluations.get("policy")
    if of is None or not of.of_each:
        return missing("When it fails is not known: evaluate it.", run.command("evaluate"))
    lead = (
        "The worst episodes of each team, their conditions, and the numbers of its vehicles that differ most from "
        "the others'. The commands repeat an episode."
    )
    return paragraph(lead, "faint") + "\n".join(_of_team(run, of, team) for team in of.episodes)


def _of_team(run: Run, of: StoredEvaluation, team: str) -> str:
    spreads = _spreads(of, team)
    return f"<h3>{text(team)}</h3>" + _worst(run, of, team, spreads) + _pictures(run, of, team, spreads)


def _spreads(of: StoredEvaluation, team: str) -> list[Spread]:
    """Conditions that differ between episodes: of sea and air, then the team's own numbers."""
    others = tuple(f"{name}." for name in of.episodes if name != team)
    keys = [key for key in of.of_each if not key.startswith(others)]
    found = [Spread(key, of.of_each[key].reshape(len(of.of_each[key]), -1).mean(1)) for key in keys]
    return [spread for spread in found if np.ptp(spread.values) > 0]


def _worst(run: Run, of: StoredEvaluation, team: str, spreads: Sequence[Spread]) -> str:
    """The worst episodes: why they ended, what was measured, conditions, and the command that repeats each."""
    episodes = of.episodes[team]
    worst = [int(k) for k in in_order(run.judge, {team: episodes})[:WORST] if not episodes["succeeded"][k] >= 1]
    if not worst:
        return paragraph(f"{team} succeeded in all {of.result['episodes']} episodes.")
    told = {key: label for key, label in run.judge.told.items() if np.isfinite(episodes.get(key, np.nan)).any()}
    around = [spread for spread in spreads if not spread.key.startswith(f"{team}.")]
    rows = []
    for k in worst:
        ends = [end for end in of.ends if end.episode == k and end.team == team and end.ending not in run.judge.goals]
        first = [end for end in ends if end.time_s == ends[0].time_s]
        why = "; ".join(f"{end.time_s:.1f} s: {end.team} {end.vehicle} {event_of(end.ending)[1]}" for end in first)
        rows.append([
            f"{k}", f'<span class="why">{text(why or "no vehicle ended")}</span>',
            f"<code>{text(run.command('play', '--episode', str(k)))}</code>",
            *(short(episodes[key][k]) for key in told), *(short(spread.values[k]) for spread in around),
            f'<span class="why">{text(_strange(of, team, k))}</span>',
        ])  # fmt: skip
    conditions = [f"{spread.key}{unit(spread.key)}" for spread in around]
    head = ("episode", "how it ended", "again by", *told.values(), *conditions, "vehicles")
    failed = int((episodes["succeeded"] < 1).sum())
    lead = paragraph(f"{failed} of {of.result['episodes']} episodes without success; the worst {len(worst)}:")
    return lead + table(head, rows)


def _strange(of: StoredEvaluation, team: str, k: int, most: int = 2) -> str:
    """The numbers of the vehicles of episode `k` that lie furthest from their middle, in standard deviations."""
    found = []
    for key, values in of.of_each.items():
        if key.startswith(f"{team}.") and values.std() > 0:
            off = (values[k] - values.mean()) / values.std()
            vehicle = int(np.abs(off).argmax())
            found.append((abs(off[vehicle]), f"{vehicle}: {key.removeprefix(f'{team}.')} {short(values[k, vehicle])}"))
    return "; ".join(line for _, line in sorted(found, reverse=True)[:most])


def _pictures(run: Run, of: StoredEvaluation, team: str, spreads: Sequence[Spread]) -> str:
    """Correlations of error and success with each condition; then both over the conditions, a panel each."""
    episodes = of.episodes[team]
    key = next((key for key in run.judge.told if np.isfinite(episodes.get(key, np.nan)).sum() > 1), None)
    if len(episodes["succeeded"]) < LEAST or not spreads:
        return ""
    success = episodes["succeeded"]
    error = np.full(len(success), np.nan) if key is None else episodes[key]
    ranks = {s.key: (correlation(s.values, error), correlation(s.values, 1.0 - success)) for s in spreads}
    own = [s for s in spreads if s.key.startswith(f"{team}.")]
    shown = [s for s in spreads if s not in own]
    shown += sorted(own, key=lambda s: -np.nanmax(np.abs((*ranks[s.key], 0.0))))[:NUMBERS]
    label = "" if key is None else run.judge.told[key]
    figure = blank(12.0, 2.2 * -(-len(shown) // ACROSS) + 0.2)
    grid = figure.subplots(-(-len(shown) // ACROSS), ACROSS, squeeze=False, sharey=True)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for spread, axes in zip(shown, grid.flat, strict=False):
        _panel(axes, spread, error, episodes)
        panel(axes, f"{spread.key.removeprefix(f'{team}.')}{unit(spread.key)}", "", label if axes in grid[:, 0] else "")
    lead = (
        f"Dots: {label or 'episodes'}; crosses: a vehicle collided, at the top if nothing was measured. Orange, right "
        f"axis: share of success in {BINS} groups of as many episodes, with 95 % intervals. Of the vehicles' numbers "
        f"(means over the team), those {NUMBERS} that go along with errors or failures most; the list below has all."
    )
    rows = [
        [f"<code>{text(name.removeprefix(f'{team}.'))}</code>", *("-" if np.isnan(x) else f"{x:+.2f}" for x in of_key)]
        for name, of_key in sorted(ranks.items(), key=lambda item: -np.nanmax(np.abs((*item[1], 0.0))))
    ]
    chance = 2.0 / np.sqrt(len(success))
    listed = paragraph(f"Rank correlations (Spearman); up to {chance:.2f} may be chance.", "faint")
    listed += table(("condition", label or "error", "failure"), rows)
    return paragraph(lead, "faint") + svg(figure, f"{team}: error and success over conditions") + folded(
        "what goes along with errors and failures", listed
    )


def _panel(axes: Axes, spread: Spread, error: Array, episodes: Mapping[str, Array]) -> None:
    """Errors of single episodes over a condition, on a logarithmic scale, and shares of success in groups."""
    collided, measured = episodes["collided"] > 0, np.isfinite(error) & (error > 0)
    axes.plot(spread.values[measured], error[measured], ".", color=COLOURS["policy"], markersize=2.5, alpha=0.6)
    for where, values, place in (
        (collided & measured, error, axes.transData),
        (collided & ~measured, np.full(len(error), 0.96), axes.get_xaxis_transform()),
    ):
        axes.plot(spread.values[where], values[where], "x", color=rgb(ALARM), markersize=4.5, transform=place)
    if measured.any():
        axes.set_yscale("log")
    right = axes.twinx()
    order = np.array_split(spread.values.argsort(kind="stable"), BINS)
    middle = [float(np.median(spread.values[of])) for of in order]
    share, low, high = np.array([wilson((episodes["succeeded"][of] >= 1).astype(float)) for of in order]).T
    right.errorbar(middle, share, (share - low, high - share), color=COLOURS["classical"], marker="o", markersize=3,
                   linewidth=1.2, elinewidth=0.8)  # fmt: skip
    right.set_ylim(-0.04, 1.04)
    right.tick_params(labelsize=7, colors=COLOURS["classical"])


def correlation(one: Array, other: Array) -> float:
    """Spearman's rank correlation over the episodes in which both are measured; NaN where either is constant."""
    both = np.isfinite(one) & np.isfinite(other)
    ranks = [_ranks(x[both]) for x in (one, other)]
    if min(len(ranks[0]), *(np.ptp(x) if len(x) else 0 for x in ranks)) <= 0:
        return float("nan")
    return float(np.corrcoef(np.stack(ranks)).flat[1])


def _ranks(values: Array) -> Array:
    """Ranks [n]; equal values share the mean of theirs."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.take(counts.cumsum() - (counts - 1) / 2, which)
