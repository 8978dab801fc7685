"""A buoy's spectrum and what is realised of it, by frequency and by direction."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.config import SeaConfig
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.measured import open_spectra, realised, records_of
from taichi_sim.visualisation.plotting import dress, new_figure
from tests.validation.buoys import SEED
from tests.validation.case import Folder
from tests.validation.plots.style import legend
from tests.validation.tables import TableError
from tools.draw_sea import MEASURED, REALISED, band_energy, directions_by_frequency

SEAS, COMPONENTS = 64, 32
TWO_PI = 2 * np.pi


def draw(folder: Folder) -> Figure:
    """The record with the highest waves of the first buoy."""
    found = sorted(folder.root.rglob("*.data_spec"))
    if not found:
        raise TableError("no *.data_spec")
    file = open_spectra(folder.use(found[0]))
    energy = (file.density * np.diff(file.edges)).sum(axis=1)
    whole = list(file.whole())
    highest = max(whole, key=lambda t: energy[t])
    config = SeaConfig(
        spectrum=str(file.path), record=str(file.times[highest]), realisations=SEAS, components=COMPONENTS,
        direction_deg=0.0, spreading_s=10.0,
    )  # fmt: skip
    record, components = records_of(config)[0], Sea.from_config(config, SEED).components
    size = realised(components, record)
    figure = new_figure(12.0, 4.6, f"Buoy {found[0].stem}, {file.times[highest]}: measured and realised")
    left, right = figure.subplots(1, 2)
    edges = TWO_PI * record.edges
    label = f"measured: Hs {record.hs:.2f} m"
    left.stairs(record.density / TWO_PI, edges, color=MEASURED, lw=2, label=label)
    ours = band_energy(components, record) / SEAS / np.diff(edges)
    label = f"{SEAS} seas of {COMPONENTS} components: Hs {size.hs.mean():.2f} m"
    left.plot((edges[1:] + edges[:-1]) / 2, ours, "o", ms=4, color=REALISED, label=label)
    dress(left, "Energy by frequency", "angular frequency (rad/s)", "density (m² s/rad)")
    drawn = np.flatnonzero(record.energy > 1e-3 * record.energy.max())
    left.set(xlim=(0.9 * edges[drawn[0]], edges[drawn[-1] + 1]), ylim=(0, None))
    legend(left, loc="upper right")
    directions_by_frequency(right, components, record)
    return figure
