"""The style of plots: size, axes, and the colours of recordings."""

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

INK = "#22313F"


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
