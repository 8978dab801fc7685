"""Measured seas: spectra by frequency and direction that buoys and wave models give, and the components drawn of them.

files.py     a file as it is known by its content, its records by time: the whole way from `sea.spectrum`
ndbc.py      text of the US National Data Buoy Center;  gridded.py  all else, by the library wavespectra
record.py    one sea state: density, directions, and what is computed of them
entropy.py   a distribution of directions from its first moments
system.py    components of a record: the same contract as those of a spectrum by formula (sampling.py)
"""

from taichi_sim.sea.measured.files import SpectraFile, open_spectra, records_of
from taichi_sim.sea.measured.record import WaveRecord
from taichi_sim.sea.measured.system import MeasuredSystem, Realised, band_moments, realised

__all__ = [
    "MeasuredSystem", "Realised", "SpectraFile", "WaveRecord", "band_moments", "open_spectra", "realised", "records_of",
]  # fmt: skip
