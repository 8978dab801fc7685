"""Trims of the Aerosonde over its airspeeds, through the points of the table."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import FAINT, points
from tests.validation.plots.trim_table import COLOURS, NAMES, Variant, variants
from tests.validation.tables import number
from tools.aircraft import flight_envelope, load_aircraft

AIRSPEEDS = 80
STYLE = {"A": "--", "B": "-"}
PANELS = {
    "alpha": ("Angle of attack", "α (deg)", 180 / math.pi, "alpha_rad"),
    "elevator": ("Elevator, positive trailing edge down", "elevator (deg)", 180 / math.pi, "elevator"),
    "throttle": ("Throttle", "throttle (part of full)", 1.0, "throttle"),
}


def draw(folder: Folder) -> Figure:
    """Angle of attack, elevator and throttle against airspeed, each variant at its climb and turn of the table."""
    figure = new_figure(12.5, 4.4, "Aerosonde: steady flight")
    axes = dict(zip(PANELS, figure.subplots(1, 3), strict=True))
    flown = variants(folder)
    stall, top = flight_envelope(flown[-1].aircraft).stall, flown[-1].aircraft.envelope.max_airspeed
    airspeeds = np.linspace(0.95 * stall, top, AIRSPEEDS)
    for variant in reversed(flown):  # the dashed one on top of the one with which it nearly agrees
        _curves(axes, variant, airspeeds)
    for name, (title, label, *_) in PANELS.items():
        dress(axes[name], title, "airspeed (m/s)", label)
        axes[name].set_xlim(airspeeds[0], top)
        axes[name].axvspan(airspeeds[0], stall, color=FAINT, zorder=0)
    axes["alpha"].text(stall, 0.03, " stall", transform=axes["alpha"].get_xaxis_transform(), fontsize=8.5, color=INK)
    axes["throttle"].text(airspeeds[0], 1.0, "  full throttle", fontsize=8.5, color=INK, va="bottom")
    axes["throttle"].axhline(1.0, color="#9AA5B1", lw=0.9, ls=":")
    axes["throttle"].set_ylim(0, 1.08)
    limit = -load_aircraft("aerosonde", []).actuators.elevator_limit_deg
    axes["elevator"].axhline(limit, color="#9AA5B1", lw=0.9, ls=":")
    axes["elevator"].text(
        top, limit, f"limit of the shipped aircraft, −{-limit:g}°", fontsize=8.5, color=INK, ha="right", va="bottom"
    )
    points(axes["alpha"], [], [], INK, "reference")
    handles = axes["alpha"].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9, labelcolor=INK)
    return figure


def _curves(axes: dict[str, Axes], variant: Variant, airspeeds: np.ndarray) -> None:
    letter = variant.letter
    flown = [t for t in map(variant.steady, airspeeds) if t is not None]
    for name, (_, _, scale, key) in PANELS.items():
        axes[name].plot([t.airspeed for t in flown], [scale * getattr(t, name) for t in flown], color=COLOURS[letter],
                        lw=2, ls=STYLE[letter], label=f"this package, {NAMES[letter]}")  # fmt: skip
        points(
            axes[name], number(variant.given, "trim", "Va"), scale * number(variant.given, "trim", key), COLOURS[letter]
        )
