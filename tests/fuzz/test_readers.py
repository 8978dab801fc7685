"""Damaged files of every kind that is read: each is refused by name, or gives finite figures; none is read for ever.

A file that was cut and is read all the same comes with a warning, or is one that somebody could have written so (a text
that ends with a whole line).
"""

import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from folders import REFERENCE
from fuzz.mutate import mutations
from rosbags.rosbag2 import StoragePlugin

from taichi_sim.applications.fit.log import read_log
from taichi_sim.applications.fit.synthetic_logs import write_logs
from taichi_sim.config import ConfigError, series
from taichi_sim.config.series import read_series
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.surroundings.sea.measured import open_spectra
from tests.taichi_sim.applications.fit.test_fit import _bag, _dataflash
from tests.taichi_sim.surroundings.sea.measured import test_measured_files as seas

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("f64")]
COUNT, LONGEST = 2000, 20  # files of each kind; s, for one of them
BUOY = REFERENCE / "buoys"
DATAFLASH = b"\xa3\x95"  # begin of a message: a log that ends before one is whole
SERIES = "time,speed,direction_deg\n" + "".join(f"{600 * k},{6 + 0.1 * k:.1f},{90 + k}\n" for k in range(20))
DATES = "time;north;east\n" + "".join(f"2024-05-01T00:{k:02}+02:00;{0.1 * k:.1f};-0,2\n" for k in range(20))

Read = Callable[[Path], list[np.ndarray]]


def of_series(path: Path) -> list[np.ndarray]:
    series._read.cache_clear()  # by the time of change, whose clock is too coarse for this test
    return list(read_series(str(path), blows_from=True))


def of_log(path: Path) -> list[np.ndarray]:
    log = read_log(path, load_vehicle("otter_3dof"))
    return [log.t, log.motion, log.actions]


def of_spectra(path: Path) -> list[np.ndarray]:
    file = open_spectra(path, None if path.suffix in (".data_spec", ".json", ".csv") else 1)
    records = [file.record(t) for t in file.whole()]
    return [x for record in records for x in (record.edges, record.density, record.spread)]


@contextmanager
def no_longer_than(seconds: int) -> Iterator[None]:
    def stop(*_) -> None:
        raise TimeoutError(f"{seconds} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)


def check(read: Read, path: Path, damaged: Path, seed: int, count: int, *, text: bool) -> None:
    """Damage one file of those that `path` stands for, `count` times, and read `path`."""
    right = damaged.read_bytes()
    whole, faults = read(path), []
    for number, (done, wrong) in enumerate(mutations(right, count, seed, text=text)):
        damaged.write_bytes(wrong)
        said, word = f"seed {seed}, file {number} of {damaged.name}: {done}: ", False
        try:
            with no_longer_than(LONGEST), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                figures = read(path)
                word = any(damaged.name in str(one.message) or path.name in str(one.message) for one in caught)
        except ConfigError as error:
            if path.name not in str(error) and damaged.name not in str(error):
                faults.append(f"{said}{error}")
        except Exception as error:  # noqa: BLE001
            faults.append(f"{said}{type(error).__name__}: {error}")
        else:
            if not all(np.isfinite(x).all() for x in figures):
                faults.append(f"{said}not finite")
            whole_lines = wrong.endswith((b"\n", b"\r")) if text else right[len(wrong) :].startswith(DATAFLASH)
            same = len(figures) == len(whole) and all(map(np.array_equal, figures, whole))
            if done.startswith("cut") and not (word or whole_lines or same):
                faults.append(f"{said}read as if it were whole")
    damaged.write_bytes(right)
    assert not faults, f"{len(faults)} of {count}:\n" + "\n".join(faults[:20])


@pytest.fixture(scope="module")
def log(f64, tmp_path_factory):
    [file] = write_logs("otter_3dof", {"X_u": 1.0}, tmp_path_factory.mktemp("log"), count=1, seconds=6.0)
    return file


@pytest.mark.parametrize("text", [SERIES, DATES], ids=["numbers", "dates"])
def test_series(text, tmp_path):
    file = tmp_path / "series.csv"
    file.write_text(text)
    check(of_series, file, file, 1, COUNT, text=True)


def test_logs_of_text(log):
    check(of_log, log, log, 2, COUNT, text=True)


def test_dataflash(log, tmp_path):
    file = _dataflash(tmp_path / "log.bin", read_log(log, load_vehicle("otter_3dof")))
    check(of_log, file, file, 3, COUNT, text=False)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_bags(storage, log, tmp_path):
    folder = _bag(tmp_path / "bag", read_log(log, load_vehicle("otter_3dof")), storage)
    [data] = [file for file in folder.iterdir() if file.suffix in (".db3", ".mcap")]
    check(of_log, folder, data, 4, COUNT // 2, text=False)
    check(of_log, folder, folder / "metadata.yaml", 5, COUNT // 4, text=True)
    if storage == StoragePlugin.MCAP:
        check(of_log, data, data, 6, COUNT // 2, text=False)


@pytest.mark.parametrize("ending", [".data_spec", ".swdir", ".swr1"])
def test_ndbc(ending, tmp_path):
    for file in BUOY.glob("41010.*"):
        shutil.copy(file, tmp_path)
    check(of_spectra, tmp_path / "41010.data_spec", tmp_path / f"41010{ending}", 7, COUNT // 2, text=True)


def test_spotter(tmp_path):
    for file in seas.written(tmp_path, seas.spotter()):
        check(of_spectra, file, file, 8, COUNT, text=True)


def test_text_of_wave_models(tmp_path):
    for name, text in (("swan", seas.swan_text("NDIR", seas.COMES_FROM)), ("ww3", seas.wavewatch_text())):
        file = tmp_path / f"{name}.spec"
        file.write_text(text)
        check(of_spectra, file, file, 9, COUNT, text=True)


def test_netcdf(tmp_path):
    seas.test_wavewatch_and_its_places(tmp_path)
    file = tmp_path / "ww3.nc"
    check(of_spectra, file, file, 10, COUNT, text=False)
    with seas.xarray.open_dataset(file) as data:
        data.load().to_netcdf(tmp_path / "classic.nc", format="NETCDF3_CLASSIC")
    check(of_spectra, tmp_path / "classic.nc", tmp_path / "classic.nc", 11, COUNT, text=False)
