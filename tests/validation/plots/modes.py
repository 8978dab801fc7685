"""Natural modes of the Aerosonde in the complex plane: eigenvalues of our linear model and of the table."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.models.uav.fixed_wing.trim import Trim, linear_modes
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import legend
from tests.validation.plots.trim_table import COLOURS, NAMES, Variant, variants
from tests.validation.tables import TableError, number

SLOWER, FASTER, STEPS = 0.6, 1.4, 65  # times the trim's airspeed: how far the modes are followed
SLOW = ("phugoid", "spiral")  # what the second chart is about
DAMPING = (0.1, 0.2, 0.3, 0.5, 0.7)
LOCUS, GUIDE = "#9AA5B1", "#DDE2E7"
MARKERS = {"A": ("x", 7.0), "B": ("+", 10.0)}
CIRCLE = {"linestyle": "none", "marker": "o", "markersize": 13, "markerfacecolor": "none", "markeredgewidth": 1.2}


def draw(folder: Folder) -> Figure:
    """The upper half plane, and what is near the origin; grey: the last variant's modes at other airspeeds."""
    figure = new_figure(12.0, 4.9, "Aerosonde: natural modes about steady flight")
    whole, close = figure.subplots(1, 2, width_ratios=(1.3, 1))
    flown = variants(folder)
    theirs = [_table(v) for v in flown]
    values = [x for modes in theirs for x in modes.values()]
    left, top = 1.12 * min(x.real for x in values), 1.25 * max(x.imag for x in values)
    slow = max((abs(x) for modes in theirs for name, x in modes.items() if name in SLOW), default=0.1 * top)
    for axes, title in ((whole, "All modes"), (close, "Near the origin")):
        dress(axes, title, "real part (1/s)", "imaginary part (rad/s)")
    whole.set(xlim=(left, 3.0), ylim=(-0.06 * top, top))
    close.set(xlim=(-1.2 * slow, 0.7 * slow), ylim=(-0.1 * slow, 1.7 * slow))
    for axes, names in ((whole, [n for n in theirs[-1] if n not in SLOW]), (close, SLOW)):
        _guides(axes)
        for variant, modes in zip(flown, theirs, strict=True):
            _eigenvalues(axes, variant, modes)
        _locus(axes, flown[-1])
        for name in names:
            found = [modes[name] for modes in theirs if name in modes]
            if found:
                _name(axes, name, max(found, key=lambda x: x.real))
    whole.plot([], [], color=INK, label="reference", **CIRCLE)
    legend(whole, loc="center left", labelspacing=0.9)
    return figure


def _table(variant: Variant) -> dict[str, complex]:
    """The table's eigenvalue of each mode, that of a pair with the positive imaginary part."""
    found = {}
    for name, mode in variant.given["modes"].items():
        pair = mode.get("eig") if isinstance(mode, dict) else None
        if isinstance(pair, list):
            if len(pair) != 2:
                raise TableError(f"modes.{name}.eig: not a number or a pair")
            found[name] = complex(pair[0], abs(pair[1]))
        else:
            found[name] = complex(number(mode, "eig"), 0.0)
    return found


def _ours(variant: Variant, at: Trim) -> dict[str, complex]:
    """Our eigenvalue of each mode about a trim."""
    modes = linear_modes(variant.aircraft, at).modes
    return {name: max(mode.eigenvalues, key=lambda x: x.imag) for name, mode in modes.items()}


def _eigenvalues(axes: Axes, variant: Variant, theirs: dict[str, complex]) -> None:
    letter, colour = variant.letter, COLOURS[variant.letter]
    at = variant.steady(number(variant.given, "trim", "Va"))
    if at is None:
        raise TableError(f"{letter}: no trim at Va of the table")
    ours = np.array(list(_ours(variant, at).values()))
    marker, size = MARKERS[letter]
    axes.plot(
        ours.real, ours.imag, marker, color=colour, ms=size, mew=1.8, zorder=5, label=f"this package, {NAMES[letter]}"
    )
    for x in theirs.values():
        axes.plot(x.real, x.imag, color=colour, zorder=4, **CIRCLE)


def _locus(axes: Axes, variant: Variant) -> None:
    """Each mode over airspeeds, and a dot at the fastest."""
    Va = number(variant.given, "trim", "Va")
    flown = [t for t in map(variant.steady, Va * np.linspace(SLOWER, FASTER, STEPS)) if t is not None]
    rows = [_ours(variant, t) for t in flown]
    label = f"variant {variant.letter} from {flown[0].airspeed:.0f} to {flown[-1].airspeed:.0f} m/s (dot)"
    for name in rows[-1]:
        path = np.array([row[name] for row in rows if name in row])
        axes.plot(path.real, path.imag, color=LOCUS, lw=1.2, zorder=2, label=label)
        axes.plot(path[-1].real, path[-1].imag, "o", color=LOCUS, ms=4, zorder=2)
        label = None


def _guides(axes: Axes) -> None:
    """Lines of equal damping ratio, and the axes."""
    axes.axhline(0, color=INK, lw=0.7, zorder=1)
    axes.axvline(0, color=INK, lw=0.7, zorder=1)
    left, top = axes.get_xlim()[0], axes.get_ylim()[1]
    for zeta in DAMPING:
        slope = np.sqrt(1 - zeta**2) / zeta
        x = max(left, -top / slope)
        axes.plot([0, x], [0, -slope * x], color=GUIDE, lw=0.9, ls="--", zorder=1)
        place = {"xytext": (2, -3), "textcoords": "offset points", "va": "top", "ha": "left"}
        axes.annotate(f"ζ {zeta:g}", (x, -slope * x), fontsize=7.5, color="#7A8794", **place)


def _name(axes: Axes, name: str, x: complex) -> None:
    """The mode's name beside its eigenvalue: of a pair to the right, of a real one above."""
    place = {"xytext": (11, 0), "ha": "left", "va": "center"} if x.imag else {"xytext": (0, 11), "ha": "center"}
    axes.annotate(name.replace("_", " "), (x.real, x.imag), textcoords="offset points", fontsize=9.5, color=INK,
                  bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"}, zorder=3, **place)  # fmt: skip
