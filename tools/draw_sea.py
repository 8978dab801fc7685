"""Draw the sea of a scenario: surface, spectrum, directions and wave heights, each with its target.

    python tools/draw_sea.py [SCENARIO] [--set KEY=VALUE ...] [--seed N] [--out FILE]

    python tools/draw_sea.py paper --set sea.hs=1 --set sea.tp=5.5 --out sea.png
    python tools/draw_sea.py paper --set sea.spectrum=41010.data_spec --set sea.record="2020-06-08 03:50"

- surface: one realisation as a landscape and as a map;
- spectrum: Welch's estimate from records of the elevation at a point, averaged over realisations, and the target; bars
  are the components of the drawn realisation, each spread over its bin;
- directions: energy of all realisations by direction, and the target, cos^2s or the measured distribution; for a
  measured sea also mean direction and spread by frequency, of the record and of the components;
- wave heights between zero up-crossings of the records, with Rayleigh's law exp(-2 (H / hs)^2), which holds for a
  narrow band, and Forristall's (1978) fit to storms, exp(-(H / sigma)^2.126 / 8.42). A sea of 16 components has fewer
  waves above 1.3 hs than either; one of 64 agrees with Forristall's.

Exit status: 0 drawn, 2 bad input.
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, LinearSegmentedColormap
from matplotlib.figure import Figure

from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.config.io import load_world
from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.options import parser_of, picture, seed
from taichi_sim.randomisation.conditions import resolved_sea
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.measured import MeasuredSystem, WaveRecord, band_moments
from taichi_sim.surroundings.sea.sampling import System
from taichi_sim.surroundings.sea.sea import wave_systems
from taichi_sim.surroundings.sea.spectrum import Components, spectral_moment, wavenumber
from taichi_sim.visualisation.plotting import INK, dress, new_figure

SEAS = 64  # largest number of realisations
RECORD, SAMPLES_PER_PERIOD = 1200.0, 20  # s of each record; samples per peak period
SEGMENT = 24  # peak periods of a Welch segment
TWO_PI = 2 * np.pi
LEAST = 0.002  # least energy of a band whose directions are drawn, in energies of the densest band
MEASURED = "#D55E00"
WAVELENGTHS, GRID = 5, 160  # peak wavelengths and points along a side of the surface drawn
RELIEF = 0.03  # height of the landscape, 4 standard deviations, over its side
FORRISTALL = (2.126, 8.42)  # exponent and scale of Forristall's law for H / sigma, sigma = hs / 4

WATER = LinearSegmentedColormap.from_list("water", ["#06243F", "#0B4A6F", "#1D7A94", "#63B4B8", "#D9F0EA"])
TARGET, REALISED, SWELL = "#D55E00", "#0072B2", "#8C3CBE"


class WaveStatistics(NamedTuple):
    """Spectrum and wave heights from records at a point."""

    omega: np.ndarray  # rad/s
    density: np.ndarray  # m^2 s
    heights: np.ndarray  # m, between zero up-crossings, all records
    hs: float  # 4 standard deviations, m


def measure(sea: Sea, tp: float) -> WaveStatistics:
    """Measure the elevation at the origin in up to SEAS realisations."""
    interval = tp / SAMPLES_PER_PERIOD
    time = np.arange(0, max(RECORD, 4 * SEGMENT * tp), interval)
    index = np.arange(min(SEAS, sea.num_seas))[:, None]
    record = sea.elevation(0.0, 0.0, time, sea=index).double().cpu().numpy()
    record -= record.mean(axis=1, keepdims=True)
    omega, density = welch(record, interval, SEGMENT * SAMPLES_PER_PERIOD)
    heights = np.concatenate([crossing_heights(row) for row in record])
    return WaveStatistics(omega, density, heights, 4 * float(np.sqrt((record**2).mean())))


def welch(record: np.ndarray, interval: float, length: int) -> tuple[np.ndarray, np.ndarray]:
    """One-sided density (m^2 s over rad/s) of records [record, sample]: Hann windows of `length`, half overlapping."""
    windows = np.lib.stride_tricks.sliding_window_view(record, length, axis=1)[:, :: length // 2]
    hann = np.hanning(length)
    power = (np.abs(np.fft.rfft(windows * hann, axis=-1)) ** 2).mean(axis=(0, 1))
    omega = 2 * np.pi * np.fft.rfftfreq(length, interval)
    return omega, power * interval / (np.pi * (hann**2).sum())


def crossing_heights(elevation: np.ndarray) -> np.ndarray:
    """Crest to trough height of each wave between two zero up-crossings, m."""
    starts = np.flatnonzero((elevation[:-1] < 0) & (elevation[1:] >= 0)) + 1
    if len(starts) < 2:
        return np.zeros(0)
    whole = elevation[: starts[-1]]
    return np.maximum.reduceat(whole, starts[:-1]) - np.minimum.reduceat(whole, starts[:-1])


def target_density(system: System, omega: np.ndarray) -> np.ndarray:
    """Target density of a wave system, scaled to its exact height, m^2 s."""
    if isinstance(system, MeasuredSystem):
        return system.density(omega)
    m0 = spectral_moment(system.density, 0, 2 * math.pi / system.tp)
    return system.density(omega) * system.hs**2 / 16 / m0


def directions_by_frequency(axes: Axes, components: Components, record: WaveRecord) -> None:
    """Draw mean direction of travel and circular deviation to both sides of it over angular frequency."""
    middle = np.pi * (record.edges[1:] + record.edges[:-1])
    drawn = record.energy > LEAST * record.energy.max()
    centre = np.rad2deg(record.direction)

    def degrees(moments: np.ndarray) -> np.ndarray:
        """Angles within 180 degrees of the overall mean."""
        return centre + (np.rad2deg(np.angle(moments)) - centre + 180.0) % 360.0 - 180.0

    mean, width = degrees(record.c1), deviation(record.c1)
    omega = np.where(drawn, middle, np.nan)
    shade = {"color": MEASURED, "alpha": 0.18, "lw": 0, "step": "mid", "label": "its spread"}
    axes.fill_between(omega, mean - width, mean + width, **shade)
    axes.plot(omega, mean, color=MEASURED, lw=2, drawstyle="steps-mid", label="measured")
    whole = band_moments(components, record).sum(axis=0)
    energy = band_energy(components, record)
    there = energy > 0
    moments = np.divide(whole, energy, out=np.zeros_like(whole), where=there)
    bars = {"fmt": "o", "color": REALISED, "ms": 4, "elinewidth": 1.2, "label": "components, and their spread"}
    axes.errorbar(middle[there], degrees(moments)[there], deviation(moments)[there], **bars)
    dress(axes, "Direction of travel by frequency", "angular frequency (rad/s)", "degrees clockwise from north")
    axes.set_xlim(0.9 * TWO_PI * record.edges[:-1][drawn][0], 1.05 * TWO_PI * record.edges[1:][drawn][-1])
    axes.set_ylim(centre - 185, centre + 185)
    ticks = np.arange(np.ceil((centre - 180) / 45) * 45, centre + 181, 45)
    axes.set_yticks(ticks, [f"{tick % 360:.0f}" for tick in ticks])
    axes.legend(frameon=False, fontsize=9, loc="upper right", ncols=2)


def deviation(moments: np.ndarray) -> np.ndarray:
    """Circular deviation sqrt(2 (1 - r1)), degrees, of moments c1."""
    return np.rad2deg(np.sqrt(2 * (1 - np.minimum(np.abs(moments), 1.0))))


def band_energy(components: Components, record: WaveRecord) -> np.ndarray:
    """Sum of a^2 / 2 of all realisations in each band [f], m^2."""
    alike = Components(components.amplitude, components.k, components.omega, 0 * components.direction, components.phase)
    return band_moments(alike, record).sum(axis=0).real


def draw(config: SeaConfig, seed: int, title: str) -> Figure:
    """Draw all panels."""
    systems = wave_systems(config)
    hs = math.hypot(*(system.hs for system in systems))
    if hs == 0:
        raise ConfigError("the sea is calm (hs = 0): there is nothing to draw")
    sea = Sea.from_config(config, seed)
    main = max(systems, key=lambda system: system.hs)
    measured = measure(sea, main.tp)
    record = main.record if isinstance(main, MeasuredSystem) else None
    figure = new_figure(12.0, 13.0 if record else 9.4, title)
    figure.set_layout_engine("constrained", h_pad=0.12, w_pad=0.12)
    heights = (5.0, 3.6, 4.0, 0.62) if record else (5.0, 4.0, 0.62)
    top, *extra, bottom, foot = np.ravel(figure.subfigures(len(heights), 1, height_ratios=heights))
    left, right = np.ravel(top.subfigures(1, 2, width_ratios=(1.35, 1)))
    _surface(left, right, sea, systems, 2 * math.pi / float(wavenumber(2 * math.pi / main.tp, config.depth)), hs)
    if record:
        directions_by_frequency(extra[0].add_subplot(), sea.components, record)
    panels = bottom.subfigures(1, 3, width_ratios=(1.15, 0.9, 1.15))
    _spectrum(panels[0].add_subplot(), sea, systems, measured)
    _directions(panels[1].add_subplot(projection="polar"), sea, systems)
    _heights(panels[2].add_subplot(), measured, hs)
    foot.text(0.5, 0.5, _caption(config, sea, systems, measured, hs), ha="center", va="center", fontsize=9.5, color=INK)
    return figure


def _surface(left, right, sea: Sea, systems: list[System], wavelength: float, hs: float) -> None:
    """Draw a landscape and a map of the first realisation."""
    side = WAVELENGTHS * wavelength
    axis = np.linspace(0, side, GRID)
    zeta = sea.elevation_grid(axis, axis).astype(float)
    stretch = RELIEF * side / hs  # heights are drawn this many times larger
    limit = 0.75 * hs
    light = LightSource(azdeg=300, altdeg=38)
    shade = {"cmap": WATER, "vmin": -limit, "vmax": limit, "blend_mode": "soft"}
    step = axis[1] - axis[0]
    colours = light.shade(zeta, vert_exag=stretch, dx=step, dy=step, **shade)

    # Three-dimensional axes are square and clip: a square as wide as the panel, taller than it, holds the landscape.
    width, height = left.bbox.size
    view = left.add_axes((0.0, (1 - width / height) / 2 - 0.01, 1.0, width / height), projection="3d", zorder=-1)
    view.patch.set_visible(False)
    east, north = np.meshgrid(axis, axis)
    view.plot_surface(
        east,
        north,
        zeta * stretch,
        facecolors=colours,
        rstride=1,
        cstride=1,
        linewidth=0,
        antialiased=False,
        shade=False,
    )
    tall = 1.1 * stretch * hs
    view.set(xlim=(0, side), ylim=(0, side), zlim=(-tall, tall))
    view.set_box_aspect((1, 1, 2 * tall / side), zoom=1.07)
    view.view_init(elev=24, azim=-62)
    view.set_axis_off()
    left.text(0.03, 0.97, f"Surface, {side:.0f} m square, heights x {stretch:.0f}", va="top", fontsize=11, color=INK)

    chart = right.add_subplot()
    image = chart.imshow(zeta, origin="lower", extent=(0, side, 0, side), cmap=WATER, vmin=-limit, vmax=limit)
    chart.imshow(colours, origin="lower", extent=(0, side, 0, side), interpolation="bilinear")
    dress(chart, "From above, and where waves travel", "east (m)", "north (m)")
    chart.grid(False)
    for n, system in enumerate(systems):
        first = "measured sea" if isinstance(system, MeasuredSystem) else "wind sea"
        _arrow(chart, side, system.direction, first if n == 0 else "swell", TARGET if n == 0 else SWELL, n)
    right.colorbar(image, ax=chart, fraction=0.046, pad=0.04).set_label("elevation (m)")


def _arrow(chart: Axes, side: float, direction: float, name: str, colour: str, place: int) -> None:
    length, middle = 0.13 * side, np.array([0.15 + 0.3 * place, 0.86]) * side
    along = length / 2 * np.array([math.sin(direction), math.cos(direction)])
    style = {"arrowstyle": "-|>,head_width=0.45,head_length=0.8", "color": colour, "lw": 3, "shrinkA": 0, "shrinkB": 0}
    chart.annotate("", xy=middle + along, xytext=middle - along, arrowprops=style)
    box = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    chart.text(
        middle[0], middle[1] - 0.105 * side, name, ha="center", va="center", fontsize=8.5, color=colour, bbox=box
    )


def _spectrum(axes: Axes, sea: Sea, systems: list[System], measured: WaveStatistics) -> None:
    low, high = systems[0].bins[0], systems[0].bins[-1]
    for system in systems[1:]:
        low, high = min(low, system.bins[0]), max(high, system.bins[-1])
    omega = np.linspace(0.7 * low, 1.05 * high, 600)
    first = 0
    for system in systems:
        widths = np.diff(system.bins)
        energy = sea.components.amplitude[0, first : first + system.components] ** 2 / 2
        label = "components" if first == 0 else None
        bars = {"align": "edge", "color": "#A9CCE0", "alpha": 0.6, "edgecolor": "white", "linewidth": 0.8}
        axes.bar(system.bins[:-1], energy / widths, widths, label=label, **bars)
        first += system.components
    target = sum(target_density(system, omega) for system in systems)
    axes.plot(omega, target, color=TARGET, lw=2, label="target")
    axes.plot(measured.omega, measured.density, ".", color=REALISED, ms=4.5, label="records (Welch)")
    dress(axes, "Spectrum", "angular frequency (rad/s)", "density (m² s)")
    axes.set_xlim(omega[0], omega[-1])
    axes.set_ylim(0)
    axes.legend(frameon=False, fontsize=9)


def _directions(axes, sea: Sea, systems: list[System]) -> None:
    """Draw the share of energy per radian by direction of travel."""
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    edges = np.linspace(-np.pi, np.pi, 49)
    c = sea.components
    share, _ = np.histogram((c.direction + np.pi) % (2 * np.pi) - np.pi, edges, weights=c.amplitude**2)
    share /= share.sum() * np.diff(edges)
    axes.bar(edges[:-1], share, np.diff(edges), align="edge", color="#CFE3EE", edgecolor="white", linewidth=0.6)
    angle = np.linspace(-np.pi, np.pi, 721)
    total = sum(system.hs**2 for system in systems)
    target = sum(system.hs**2 / total * system.by_direction(angle) for system in systems)
    axes.plot(angle, target, color=TARGET, lw=2)
    axes.set_xticks(np.deg2rad(np.arange(0, 360, 45)), ["N", "NE", "E", "SE", "S", "SW", "W", "NW"])
    axes.set_yticklabels([])
    axes.tick_params(labelsize=9, pad=0)
    axes.grid(color="#DDDDDD", linewidth=0.6)
    axes.spines["polar"].set_color("#BBBBBB")
    axes.set_title("Energy by direction of travel", fontsize=11, color=INK)


def _heights(axes: Axes, measured: WaveStatistics, hs: float) -> None:
    """Draw the share of waves higher than H on a logarithmic axis."""
    heights = np.sort(measured.heights)
    exceeded = 1 - (np.arange(len(heights)) + 0.5) / max(len(heights), 1)
    ratio = np.linspace(0, 2.2, 200)
    axes.semilogy(ratio, np.exp(-2 * ratio**2), color=TARGET, lw=2, label="Rayleigh")
    storms = np.exp(-((4 * ratio) ** FORRISTALL[0]) / FORRISTALL[1])
    axes.semilogy(ratio, storms, color="#777777", lw=1.5, ls="--", label="storms (Forristall 1978)")
    axes.semilogy(heights / hs, exceeded, color=REALISED, lw=2, label=f"records, {len(heights):,} waves")
    dress(axes, "Wave heights", "height / hs", "share of waves that are higher")
    axes.set_xlim(0, 2.2)
    axes.set_ylim(1e-4, 1.2)
    axes.legend(frameon=False, fontsize=9, loc="lower left")


def _caption(config: SeaConfig, sea: Sea, systems: list[System], measured: WaveStatistics, hs: float) -> str:
    c = sea.components
    water = "deep water" if config.depth is None else f"{config.depth:g} m of water"
    lines = [
        f"hs: {hs:.3f} m asked for, {c.hs.mean():.3f} m of components, {measured.hs:.3f} m of records    "
        f"sum k a: {c.sum_ka.max():.2f} at most (a surface exists below 1)    {water}, {sea.num_seas} realisations"
    ]
    first = 0
    for n, system in enumerate(systems):
        part = slice(first, first + system.components)
        first += system.components
        first_name = system.record.name if isinstance(system, MeasuredSystem) else f"wind sea ({config.spectrum})"
        name = "swell" if n else first_name
        if system.hs > 0:
            energy, direction = c.amplitude[:, part] ** 2, c.direction[:, part]
            mean = (energy * np.exp(1j * direction)).sum() / energy.sum()
            wanted = math.degrees(system.circular_deviation)
            spread = math.degrees(math.sqrt(2 * (1 - abs(mean))))
            lines.append(
                f"{name}: hs {system.hs:.2f} m, tp {system.tp:.1f} s, {system.components} components, "
                f"towards {math.degrees(system.direction) % 360:.0f}° asked for, "
                f"{math.degrees(float(np.angle(mean))) % 360:.0f}° realised, "
                f"circular deviation {wanted:.0f}° asked for, {spread:.0f}° realised"
            )
    return "\n".join(lines)


@command("draw_sea")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    parser = parser_of(__doc__)
    parser.add_argument("scenario", nargs="?", default="paper", help="a scenario's TOML, or a shipped name [paper]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE",
                        help="override a key, such as sea.hs=1; repeatable")  # fmt: skip
    parser.add_argument("--seed", type=seed, help="of the realisations, >= 0 [the scenario's]")
    parser.add_argument("--out", type=picture, default=Path("sea.png"),
                        help="file to write: png, pdf, svg, jpg [sea.png]")  # fmt: skip
    arguments = parser.parse_args(argv)
    world = load_world(arguments.scenario, arguments.set)
    runtime.init()
    which = world.seed if arguments.seed is None else arguments.seed
    draw(resolved_sea(world), which, f"Sea of the scenario {world.name!r}").savefig(arguments.out, dpi=100)
    print(arguments.out)


if __name__ == "__main__":
    sys.exit(main())
