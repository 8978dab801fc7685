"""What the pictures share: colours, points of tables, saving."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.visualisation.plotting import INK

OURS, OTHER, THIRD = "#0072B2", "#D55E00", "#009E73"
FAINT = "#EEF1F4"
DPI = 110
POINTS = {"linestyle": "none", "marker": "o", "markersize": 5.0, "markerfacecolor": "white", "markeredgewidth": 1.3}


def points(axes: Axes, x, y, colour: str, label: str | None = None, zorder: float = 4, clip: bool = True) -> None:
    """Values of a table: open circles; without `clip` whole ones on the edge of the chart."""
    axes.plot(x, y, color=colour, label=label, zorder=zorder, clip_on=clip, **POINTS)


def legend(axes: Axes, **where) -> None:
    """A legend without a frame."""
    axes.legend(frameon=False, fontsize=9, labelcolor=INK, **where)


def save(figure: Figure, file: Path) -> None:
    """Write a PNG, its folder made if need be."""
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=DPI, pil_kwargs={"optimize": True})
