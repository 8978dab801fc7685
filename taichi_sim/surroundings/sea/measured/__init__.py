"""Measured seas: directional spectra from buoys and wave models, and wave components drawn from them.

open_file.py     opens the file of `sea.spectrum` and selects its records
ndbc.py      reads text files of the US National Data Buoy Center
netcdf.py    reads netCDF of wave models, NDBC and CDIP
spotter.py   reads JSON and CSV of Sofar's Spotter
wave_models.py  reads text of SWAN and WAVEWATCH III
spectra.py   what these readers give, and the gate that it passes
wave_record.py  one sea state: density, directions from their first moments, statistics; wave components drawn from it
"""

from taichi_sim.surroundings.sea.measured.open_file import SpectraFile, open_spectra, records_of
from taichi_sim.surroundings.sea.measured.wave_record import (
    MeasuredSystem,
    Realised,
    WaveRecord,
    band_moments,
    realised,
)

__all__ = [
    "MeasuredSystem", "Realised", "SpectraFile", "WaveRecord", "band_moments", "open_spectra", "realised", "records_of",
]  # fmt: skip
