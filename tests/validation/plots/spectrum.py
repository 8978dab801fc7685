"""A realised sea against the spectrum it was asked for."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.config import SeaConfig
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.sea import wave_systems
from taichi_sim.visualisation.plotting import dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import OTHER, OURS, legend, points
from tools.draw_sea import measure, target_density

SEA = {"hs": 1.0, "tp": 6.0, "realisations": 64, "components": 32}
SEED = 1


def draw(folder: Folder) -> Figure:
    """Welch's estimate from records at a point of many realisations, over the target; needs no table."""
    del folder
    config = SeaConfig(**SEA)
    (system,) = wave_systems(config)
    sea = Sea.from_config(config, SEED)
    measured = measure(sea, config.tp)
    omega = np.linspace(0.5 * system.bins[0], 1.1 * system.bins[-1], 600)
    figure = new_figure(9.0, 4.2, "A JONSWAP sea: realised against asked for")
    axes = figure.subplots()
    energy = sea.components.amplitude[0] ** 2 / 2 / np.diff(system.bins)
    axes.bar(system.bins[:-1], energy, np.diff(system.bins), align="edge", color="#A9CCE0", alpha=0.6, ec="white",
             lw=0.7, label=f"{config.components} components of one sea")  # fmt: skip
    axes.plot(omega, target_density(system, omega), color=OTHER, lw=2, label=f"target, Hs {config.hs:.2f} m")
    inside = (measured.omega >= omega[0]) & (measured.omega <= omega[-1])
    label = f"records of {sea.num_seas} seas, Hs {measured.hs:.3f} m"
    points(axes, measured.omega[inside], measured.density[inside], OURS, label, clip=False)
    dress(axes, f"γ = {config.gamma_js:g}, Tp = {config.tp:g} s", "frequency (rad/s)", "density (m² s/rad)")
    axes.set(xlim=(omega[0], omega[-1]), ylim=(0, None))
    legend(axes, loc="upper right")
    return figure
