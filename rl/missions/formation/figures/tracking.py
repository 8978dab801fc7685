"""Fig. 5: distance of each vehicle from its slot over one episode."""

import math
from string import ascii_lowercase

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.plotting.style import INK, dress, new_figure, rgb
from taichi_sim.recording import Episode

NOT_MEASURED = "#C9CED3"


def tracking_error_figure(episode: Episode, settle: float = 0.0) -> Figure:
    """Distance of each vehicle from its slot over the episode (paper, Fig. 5); the first `settle` (s) do not count."""
    time = np.asarray(episode.time_s) - episode.time_s[0]
    errors = {name: team.error_m for name, team in episode.teams.items() if team.error_m is not None}
    figure = new_figure(10.0, 3.6 * len(errors) + 0.5, f"Tracking error of leaders and followers: {episode.name}")
    panels = figure.subplots(len(errors), 1, sharex=True, squeeze=False)[:, 0]
    measured = time >= settle if time[-1] > settle else np.ones(len(time), dtype=bool)
    for axes, letter, (name, of_team) in zip(panels, ascii_lowercase, errors.items(), strict=False):
        team, livery = episode.teams[name], episode.liveries[name]
        for vehicle in reversed(range(team.vehicles)):
            error = of_team[:, vehicle]
            mean = np.nanmean(error[measured]) if np.isfinite(error[measured]).any() else math.nan
            axes.plot(
                time, error, color=rgb(livery.of(vehicle)), linewidth=2.0 if vehicle == 0 else 1.2,
                label=f"{team.vehicle_name(vehicle)}: mean {mean:.2f} m", zorder=5 if vehicle == 0 else 3,
            )  # fmt: skip
        finite = of_team[measured][np.isfinite(of_team[measured])]
        ceiling = max(1.0, 1.35 * float(finite.max())) if len(finite) else 1.0
        if settle > 0:
            _shade_approach(axes, min(settle, time[-1]), ceiling)
        dress(axes, f"({letter}) {name.upper()} team", "", "distance from slot (m)")
        axes.set(xlim=(0.0, time[-1]), ylim=(0.0, ceiling))
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.0, 1.0), framealpha=0.9, fontsize=8,
        )  # fmt: skip
    panels[-1].set_xlabel("time (s)")
    return figure


def _shade_approach(axes, until: float, ceiling: float) -> None:
    """Grey the part of an episode, up to `until` (s), that is not measured."""
    axes.axvspan(0.0, until, color=NOT_MEASURED, alpha=0.5, linewidth=0)
    axes.text(
        0.5 * until, 0.96 * ceiling, "approach,\nnot measured", ha="center", va="top", fontsize=8, color=INK, zorder=6,
    )  # fmt: skip
