"""Checks of measured seas: what is realised of a buoy's spectrum against the summary that NDBC made of the same hour.

`NAME.spec` beside `NAME.data_spec` and the files of its directions. A summary belongs to the record of the hour, a few
minutes later. Of each, SEAS realisations, as a run has them:

    WVHT   significant height of the components, m
    APD    sqrt(m0 / m2) of the components, s
    MWD    mean direction of the components in the densest band, degrees from: NDBC's is that of the dominant period,
           not of all waves (which is tens of degrees elsewhere where wind sea and swell cross). Where other bands are
           within a hundredth of the densest, which the coding cannot tell from it, the nearest of them counts

Hours are left out of APD in which more than a tenth of m2 is in bands that the coding has sent as nothing: a wind sea
under a swell a hundred times as dense.

Allowed are 0.05 m, 0.1 s and 5 degrees, of which NDBC's rounding is 0.05 m, 0.05 s and 0.5 degrees; and 1 % of the
height, which the coding of the densities in hundredths of the largest leaves open (sea/measured/ndbc.py).
"""

from datetime import datetime
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.config.files import ndbc_set
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.measured import SpectraFile, band_moments, open_spectra, realised, records_of
from taichi_sim.surroundings.sea.measured.ndbc import is_ndbc, read_part
from tests.validation.case import Case
from tests.validation.tables import InputsMissingError, TableError

SEAS, SEED = 64, 1  # realisations, and of what they are drawn
LATER = np.timedelta64(30, "m")  # the record is of no more than this after its summary
HEIGHT, PERIOD, DIRECTION = 0.05, 0.1, 5.0  # m, s, deg
CODING = 0.01  # of the height
LOST = 0.1  # of m2
TIE = 0.01  # of the largest density: bands as dense as that could be the densest
NAMES = ("WVHT", "APD", "MWD")


def summary(case: Case) -> None:
    """*.spec: heights, mean periods and directions of the peak, realised and as NDBC says."""
    if not is_ndbc(case.path):
        return
    times, table = read_summary(case.path)
    source = case.folder.use(case.path.with_suffix(".data_spec"))
    for file in ndbc_set(source).values():
        case.folder.use(file)
    try:
        file = open_spectra(source)
        rows = [(row, found) for row, time in enumerate(times) if (found := _of_hour(file, time)) is not None]
        if not rows:
            raise InputsMissingError(f"{case.folder.name(source)} has no record of these hours")
        ours = np.array([_realised(file, t, table[row, 2]) for row, t in rows])
    except ConfigError as error:
        raise TableError(str(error)) from None
    hs, period, _ = table[[row for row, _ in rows]].T
    told = lost_share(source, file)[[t for _, t in rows]] <= LOST
    known = np.isfinite(hs), np.isfinite(period) & told, np.isfinite(ours[:, 2])
    if known[0].any():
        case.absolute("WVHT, m", ours[known[0], 0], hs[known[0]], HEIGHT, CODING * hs[known[0]])
    if known[1].any():
        case.absolute("APD, s", ours[known[1], 1], period[known[1]], PERIOD)
    if known[2].any():
        case.absolute("MWD, deg", ours[known[2], 2], np.zeros(known[2].sum()), DIRECTION)


def lost_share(source: Path, file: SpectraFile) -> np.ndarray:
    """Share of m2 in bands that were sent as nothing [t]."""
    sent, middle = read_part(source), (file.edges[1:] + file.edges[:-1]) / 2
    second = file.density * np.diff(file.edges) * middle**2
    lost = sent.values[np.argsort(sent.times, kind="stable")] == 0
    whole = np.where(second.sum(axis=1) > 0, second.sum(axis=1), 1.0)
    return (second * lost).sum(axis=1) / whole


def read_summary(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times [row] and WVHT, APD, MWD [row, 3] of a .spec file; NaN where it has no value.

    Raises:
        TableError: for a file of another form.
    """
    try:
        lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"cannot be read: {error}") from None
    header = [cell.lstrip("#") for cell in lines[0]] if lines else []
    if missing := [name for name in (*NAMES, "YY", "hh") if name not in header]:
        raise TableError(f"column {missing[0]!r} is missing; there are {', '.join(header)}")
    times, values = [], []
    for number, cells in enumerate(lines, 1):
        if cells[0].startswith("#"):
            continue
        if len(cells) != len(header):
            raise TableError(f"row {number} has {len(cells)} cells, the header has {len(header)}")
        try:
            times.append(np.datetime64(datetime(*(int(x) for x in cells[:5])), "m"))
            values.append([np.nan if cells[header.index(n)] in ("MM", "999", "99.0") else float(cells[header.index(n)])
                           for n in NAMES])  # fmt: skip
        except ValueError as error:
            raise TableError(f"row {number}: {error}") from None
    if not times:
        raise TableError("the table has no rows")
    return np.array(times), np.array(values)


def _of_hour(file: SpectraFile, time: np.datetime64) -> int | None:
    """The record that a summary of `time` belongs to, if it has all densities."""
    later = np.flatnonzero((file.times >= time) & (file.times <= time + LATER))
    return int(later[0]) if later.size and later[0] in file.whole() else None


def _realised(file: SpectraFile, t: int, mwd: float) -> tuple[float, float, float]:
    """Mean height (m) and mean period (s) of SEAS seas, and how far the direction of their peak is from `mwd` (degrees
    from), NaN where one of them is not known.
    """
    config = SeaConfig(
        spectrum=str(file.path), record=str(file.times[t]), realisations=SEAS, direction_deg=0.0, spreading_s=10.0
    )
    record, components = records_of(config)[0], Sea.from_config(config, SEED).components
    found = realised(components, record)
    off = np.nan
    if file.c1 is not None and np.isfinite(file.c1[t]).any():
        dense = record.density >= (1 - TIE) * record.density.max()
        comes_from = np.rad2deg(np.angle(band_moments(components, record).sum(axis=0)[dense])) + 180.0
        away = (comes_from - mwd + 180.0) % 360.0 - 180.0
        off = float(away[np.abs(away).argmin()])
    return float(found.hs.mean()), float(found.tm02.mean()), off
