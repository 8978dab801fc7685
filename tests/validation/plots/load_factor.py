"""V-n diagrams of the shipped aircraft: bounds from their files, and the lift of the loads that are flown."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads, stall_angles
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import OTHER, OURS, legend, points
from tools.aircraft import FlightEnvelope, flight_envelope, load_aircraft

AIRCRAFT = {"aerosonde": "Aerosonde", "zagi": "Zagi"}
ANGLES = 400  # of attack, looked through for the most and the least lift
PROBES = 7  # airspeeds at which they are
ROUND = 1.15  # of the limits: how far the charts reach


def draw(folder: Folder) -> Figure:
    """Load factor over airspeed; needs no table."""
    del folder
    figure = new_figure(12.0, 4.4, "Flight envelopes (V-n diagrams)")
    for axes, (file, name) in zip(figure.subplots(1, len(AIRCRAFT)), AIRCRAFT.items(), strict=True):
        p = load_aircraft(file, [])
        bounds = flight_envelope(p)
        _bounds(axes, bounds)
        for side, corner in ((1, bounds.corner), (-1, bounds.inverted_corner)):
            Va = np.linspace(0, min(corner, bounds.top), PROBES + 1)[1:]
            label = "lift of the kernel's loads" if side > 0 else None
            points(axes, Va, [lift_factor(p, v, side) for v in Va], OTHER, label)
        axes.plot([p.envelope.airspeed], [1.0], "D", color=INK, ms=6, label=f"cruise {p.envelope.airspeed:g} m/s")
        dress(axes, f"{name}, {p.physical.mass:g} kg", "airspeed (m/s)", "load factor n = lift / weight")
        legend(axes, loc="upper left")
    return figure


def lift_factor(p: FixedWingParams, Va: float, side: int) -> float:
    """The most (side 1) or the least (-1) lift over weight at Va (m/s), between the stalls, without propeller."""
    alpha = np.linspace(*stall_angles(p), ANGLES)
    v_r = Va * np.stack((np.cos(alpha), np.zeros(ANGLES), np.sin(alpha)), axis=1)
    found = loads(p, v_r, np.zeros(3), np.zeros(4))
    X, Z = found[:, 0] - found[:, 6], found[:, 2]
    lift = X * np.sin(alpha) - Z * np.cos(alpha)
    return float(side * (side * lift).max() / (p.physical.mass * GRAVITY))


def _bounds(axes: Axes, bounds: FlightEnvelope) -> None:
    Va = np.unique(
        [*np.linspace(0, bounds.top, 200), min(bounds.corner, bounds.top), min(bounds.inverted_corner, bounds.top)]
    )
    upper, lower = bounds.largest(Va), bounds.least(Va)
    axes.fill_between(Va, lower, upper, color=OURS, alpha=0.10, lw=0)
    axes.plot([*Va, *Va[::-1], 0], [*upper, *lower[::-1], 0], color=OURS, lw=2, label="limits")
    axes.axhline(0, color=INK, lw=0.7)
    axes.axhline(1, color="#9AA5B1", lw=0.9, ls=":")
    for v, n, name in ((bounds.stall, 1.0, "stall"), (bounds.corner, bounds.n_max, "corner")):
        axes.annotate(f"{name} {v:.1f} m/s", (v, n), (7, -13), textcoords="offset points", fontsize=9, color=INK)
    place = {"xytext": (-5, 0), "textcoords": "offset points", "ha": "right", "va": "bottom"}
    axes.annotate(f"at most\n{bounds.top:g} m/s", (bounds.top, 0.1), fontsize=9, color=INK, **place)
    axes.set(xlim=(0, 1.04 * bounds.top), ylim=(ROUND * bounds.n_min, 1.35 * bounds.n_max))
