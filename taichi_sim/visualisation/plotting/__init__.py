"""The style of plots: size, axes, and the colours of recordings."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

INK = "#22313F"
SPAN = 20.0  # ratio of largest to least value above which a scale is logarithmic
SMOOTH = 0.05  # width of the moving mean, as a share of a curve's length


def new_figure(width: float, height: float, title: str) -> Figure:
    """A white figure with a title, drawn by Agg, so that no display is needed; width and height in inches."""
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, fontweight="bold", color=INK)
    return figure


def rgb(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    """A recording's colour, each component from 0 to 1."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def dress(axes: Axes, title: str, x: str, y: str) -> None:
    """Set title, labels with units, and a faint grid."""
    axes.set_title(title, fontsize=11, loc="left", color=INK)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def log_where_spread(axes: Axes, values: NDArray[np.float64]) -> None:
    """Make the axis of `values` logarithmic where they span more than SPAN, so that the smaller ones stay visible."""
    values = values[np.isfinite(values)]
    if len(values) and values.min() > 0 and values.max() > SPAN * values.min():
        axes.set_yscale("log")


def moving_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centred moving mean that ignores NaN, over `SMOOTH` of the length; NaN where nothing is known."""
    if not len(values):
        return values
    width = max(1, round(SMOOTH * len(values))) | 1
    known, window = np.isfinite(values), np.ones(width)
    total = np.convolve(np.where(known, values, 0.0), window)[width // 2 :][: len(values)]
    count = np.convolve(known.astype(float), window)[width // 2 :][: len(values)]
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
