"""Seas from measured spectra: records as buoys give them, and what is realised of them."""

import shutil
import sys

import numpy as np
import pytest
from folders import REFERENCE

from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.errors import MissingExtraError
from taichi_sim.surroundings.sea import Sea, sea_size
from taichi_sim.surroundings.sea.measured import (
    MeasuredSystem,
    WaveRecord,
    band_moments,
    open_spectra,
    realised,
    records_of,
)
from taichi_sim.surroundings.sea.measured.ndbc import with_cut_off_returned
from taichi_sim.surroundings.sea.measured.wave_record import (
    ROOM,
    band_edges,
    direction_grid,
    maximum_entropy,
    normalised,
    possible,
)
from taichi_sim.surroundings.sea.sampling import draw_components
from taichi_sim.surroundings.sea.spectrum import jonswap

pytestmark = pytest.mark.usefixtures("f64")
BUOY = REFERENCE / "buoys" / "41010.data_spec"
NDBC = {  # record -> height (m), mean period (s) and direction of the peak (deg from) of NDBC's own summary
    "2020-06-08 03:50": (1.1, 4.9, 196), "2020-06-08 02:50": (1.2, 4.8, 175), "2020-06-07 20:50": (1.2, 5.2, 117),
    "2020-06-07 04:50": (1.2, 4.9, 108),
}  # fmt: skip
FREQUENCY = np.linspace(0.05, 0.5, 46)


def config(time=None, **more):
    return SeaConfig(spectrum=str(BUOY), **({} if time is None else {"record": time}), **more)


def apart(a, b):
    """Degrees from b to a."""
    return (np.asarray(a) - b + 180.0) % 360.0 - 180.0


HEADER = "#YY  MM DD hh mm Sep_Freq  < spec_1 (freq_1) ... >"


def write(folder, rows, header=HEADER, name="99999.data_spec", first="9.999 "):
    """A file of NDBC's: rows of values at FREQUENCY, an hour apart."""
    lines = [header] + [
        f"2021 01 02 {hour:02d} 50 {first}" + " ".join(f"{v} ({f:.3f})" for v, f in zip(row, FREQUENCY, strict=True))
        for hour, row in enumerate(rows)
    ]
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / name


def buoy(folder, density, alpha1=270.0, r1=0.9, alpha2=None, r2=0.7):
    """A set of files of one record."""
    path = write(folder, [[f"{x:.3f}" for x in density]])
    values = (alpha1, ".swdir"), (alpha1 if alpha2 is None else alpha2, ".swdir2"), (r1, ".swr1"), (r2, ".swr2")
    for value, ending in values:
        write(folder, [[f"{value:.2f}"] * len(density)], "#YY  MM DD hh mm x_1 (freq_1) ... >", f"99999{ending}", "")
    return path


def wind_waves(hs=1.5, tp=6.0):
    return 2 * np.pi * jonswap(2 * np.pi * FREQUENCY, hs, tp)


# -- what is realised -------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", NDBC)
def test_the_realised_sea_is_ndbcs_of_that_hour(time):
    """Height and mean period of every realisation, and the direction at the peak of all, within NDBC's rounding."""
    hs, period, direction = NDBC[time]
    sea, record = Sea.from_config(config(time), seed=4), records_of(config(time))[0]
    found = realised(sea.components, record)
    assert np.abs(found.hs - hs).max() <= 0.05
    assert np.abs(found.tm02 - period).max() <= 0.1
    peak = np.angle(band_moments(sea.components, record).sum(axis=0)[record.peak], deg=True) + 180.0
    assert abs(apart(peak, direction)) <= 5.0


@pytest.mark.parametrize("components", [1, 16, 64])
def test_height_and_mean_period_of_every_realisation_are_the_records(components):
    record = records_of(config("2020-06-07 20:50"))[0]
    found = realised(draw_components([[MeasuredSystem(record, components)]] * 20, seed=3), record)
    assert found.hs == pytest.approx(np.full(20, record.hs), rel=1e-12)
    assert found.tm02 == pytest.approx(np.full(20, record.tm02), rel=1e-12)


def test_energy_and_direction_by_frequency_are_the_records():
    """Of many realisations, in bands that have 2 % of the energy or more."""
    record = records_of(config("2020-06-07 04:50"))[0]
    components = Sea.from_config(config("2020-06-07 04:50", realisations=512), seed=2).components
    moments = band_moments(components, record).sum(axis=0) / 512
    energy = np.histogram(components.omega / (2 * np.pi), record.edges, weights=components.amplitude**2 / 2)[0] / 512
    large = record.energy > 0.02 * record.energy.sum()
    assert large.sum() > 10
    assert energy[large] == pytest.approx(record.energy[large], rel=0.12)  # bands are narrow
    assert np.abs(moments - record.energy * record.c1)[large] == pytest.approx(0, abs=0.05 * record.energy[large].max())


def test_more_realisations_keep_the_first_and_seeds_differ():
    few, many = (Sea.from_config(config(realisations=n), seed=5).components for n in (3, 8))
    for name in ("amplitude", "omega", "direction", "phase"):
        assert np.array_equal(getattr(few, name), getattr(many, name)[:3])
    assert np.unique(many.phase[:, 0]).size == 8 and np.unique(many.omega[:, 0]).size == 8
    assert not np.array_equal(Sea.from_config(config(realisations=3), seed=6).components.omega, few.omega)


def test_all_records_are_taken_in_turn():
    sea, records = Sea.from_config(config("all", realisations=6), seed=1), records_of(config("all"))
    assert sea.components.hs == pytest.approx([records[r % 4].hs for r in range(6)])
    assert sea_size(config("all")).hs == pytest.approx(np.mean([record.hs for record in records]))
    assert records_of(config())[0].hs == records[-1].hs  # the latest, if none is named


def test_random_amplitudes_have_the_energy_on_the_mean():
    sea = Sea.from_config(config(realisations=2000, amplitudes="random"), seed=1).components
    exact = Sea.from_config(config(realisations=2000), seed=1).components
    assert (sea.hs**2).mean() == pytest.approx(exact.hs[0] ** 2, rel=0.02)
    assert sea.hs.std() > 0.02 * exact.hs[0] and np.array_equal(sea.omega, exact.omega)
    ratio = sea.amplitude / exact.amplitude
    assert (ratio**2 > 3.0).mean() == pytest.approx(np.exp(-3.0), rel=0.05)  # Rayleigh's law


# -- records ----------------------------------------------------------------------------------------------


def test_waves_that_come_from_the_west_travel_east(tmp_path):
    path = buoy(tmp_path, wind_waves(), alpha1=270.0)
    record = open_spectra(path).record(0)
    assert np.rad2deg(record.direction) == pytest.approx(90.0, abs=1e-3)
    assert abs(record.c1_of_all) == pytest.approx(0.9, abs=1e-3)
    assert record.hs == pytest.approx(1.5, rel=0.02) and record.tp == pytest.approx(6.0, abs=0.2)
    sea = Sea.from_config(SeaConfig(spectrum=str(path.with_suffix(".swr1"))), seed=1).components  # any of the set
    mean = (sea.amplitude**2 * np.exp(1j * sea.direction)).sum()
    assert np.angle(mean, deg=True) == pytest.approx(90.0, abs=1.0)


def test_moments_of_a_record_are_in_closed_form():
    """A density constant between 0.1 and 0.2 Hz."""
    edges = np.linspace(0.05, 0.25, 5)
    density = np.array([0.0, 2.0, 2.0, 0.0])
    spread = normalised(np.ones((4, direction_grid().size)))
    record = WaveRecord("flat", edges, density, spread)
    m = {-1: 2 * np.log(2), 0: 0.2, 1: 0.03, 2: 2 * (0.008 - 0.001) / 3}
    assert [record.moment(n) for n in m] == pytest.approx(list(m.values()))
    assert record.hs == pytest.approx(4 * np.sqrt(0.2)) and record.tm02 == pytest.approx(np.sqrt(m[0] / m[2]))
    assert record.circular_deviation == pytest.approx(np.sqrt(2))


def test_edges_of_bands_are_ndbcs_and_halfway_elsewhere():
    file = open_spectra(BUOY)
    widths = np.diff(file.edges)
    assert widths == pytest.approx([0.005] * 13 + [0.01] * 26 + [0.02] * 7, abs=1e-9)
    assert file.edges[0] == pytest.approx(0.03) and file.edges[-1] == pytest.approx(0.495)
    growing = 0.03 * 1.1 ** np.arange(8)
    assert band_edges(growing)[1:-1] == pytest.approx((growing[1:] + growing[:-1]) / 2)


@pytest.mark.parametrize(("hs", "tp"), [(1.5, 6.0), (2.0, 4.5), (3.0, 7.5)])
def test_what_the_code_cuts_off_is_returned(hs, tp):
    """A spectrum in hundredths of its largest density, rounded down, has nearly its height and mean period back; one
    that is not so coded stays as it is.
    """
    exact = wind_waves(hs, tp)
    sent = np.floor(exact / (exact.max() / 100)) * (exact.max() / 100)
    sent[exact.argmax()] = exact.max()
    printed = np.round(sent, 3)[None]
    mended = with_cut_off_returned(printed, 0.001, FREQUENCY)[0]

    def sizes(x):
        m0, m2 = ((x * FREQUENCY**n).sum() for n in (0, 2))
        return np.array([4 * np.sqrt(m0 * 0.01), np.sqrt(m0 / m2)])

    error = {name: np.abs(sizes(x) / sizes(exact) - 1) for name, x in (("sent", printed[0]), ("mended", mended))}
    assert (error["mended"] < [0.005, 0.012]).all() and (error["sent"] > error["mended"]).all()
    assert error["sent"][0] > 0.01
    assert mended[exact.argmax()] == printed[0].max() and mended[0] == 0.0
    other = np.round(exact, 3)[None]
    assert np.array_equal(with_cut_off_returned(other, 0.001, FREQUENCY), other)


@pytest.mark.parametrize("r2", [0.2, 0.5])
def test_largest_entropy_has_the_moments_and_is_positive(r2):
    c1 = np.array([0.3, 0.6, 0.0]) * np.exp(1j * np.array([0.4, -2.0, 1.0]))
    c2 = r2 * np.exp(2j * np.array([0.5, -1.8, 2.0]))
    c1, c2 = possible(c1, c2)
    density, angle, cell = maximum_entropy(c1, c2), direction_grid(), 2 * np.pi / direction_grid().size
    assert (density > 0).all() and density.sum(axis=1) * cell == pytest.approx(np.ones(3))
    for n, c in ((1, c1), (2, c2)):
        assert np.allclose((density * np.exp(1j * n * angle)).sum(axis=1) * cell, c, atol=1e-9)


def test_moments_that_nothing_has_are_moved_inside():
    c1, c2 = possible(np.array([1.2, 0.8]), np.array([1.0, -0.9]))
    assert abs(c1[0]) == pytest.approx(ROOM)
    assert np.abs(c2 - c1**2) == pytest.approx(ROOM * (1 - np.abs(c1) ** 2) * np.array([1, 1]), rel=0.6)
    assert (maximum_entropy(np.array([1.2, 0.8]), np.array([1.0, -0.9])) > 0).all()


# -- bad and poor input -----------------------------------------------------------------------------------


def copied(folder, *endings):
    for ending in endings:
        shutil.copy(BUOY.with_suffix(ending), folder)
    return folder / BUOY.name


def refused(path, **more):
    with pytest.raises(ConfigError) as caught:
        Sea.from_config(SeaConfig(spectrum=str(path), **more), seed=1)
    return str(caught.value)


@pytest.mark.parametrize("keep", [0.995, 0.62, 0.3, 0.026])
def test_a_file_cut_in_the_middle_is_refused_by_its_line(tmp_path, keep):
    path = copied(tmp_path, ".data_spec", ".swdir", ".swdir2", ".swr1", ".swr2")
    text = path.read_text()
    path.write_text(text[: int(keep * len(text))].rstrip("0123456789. "))
    message = refused(path)
    assert path.name in message and ("cut short" in message or "no record" in message or "frequenc" in message)


def test_without_directions_those_of_the_scenario_are_needed_and_taken(tmp_path):
    path = copied(tmp_path, ".data_spec")
    message = refused(path)
    assert ".swdir" in message and "sea.direction_deg" in message and "sea.spreading_s" in message
    sea = SeaConfig(spectrum=str(path), direction_deg=120.0, spreading_s=20.0)
    record = records_of(sea)[0]
    assert np.rad2deg(record.direction) == pytest.approx(120.0, abs=0.1)
    assert abs(record.c1_of_all) == pytest.approx(20 / 21, abs=1e-3)
    shutil.copy(BUOY.with_suffix(".swdir"), tmp_path)
    shutil.copy(BUOY.with_suffix(".swr1"), tmp_path)  # alpha1 and r1 alone: cos^2s
    assert open_spectra(path).record(3).c1 == pytest.approx(open_spectra(BUOY).record(3).c1, abs=2e-3)


def test_no_value_of_a_direction_is_that_of_the_nearest_and_of_a_density_is_an_error(tmp_path):
    path = buoy(tmp_path, wind_waves())
    for ending in (".swdir", ".swdir2"):
        file = path.with_suffix(ending)
        file.write_text(file.read_text().replace("270.00 (0.160)", "999.0 (0.160)"))
    record = open_spectra(path).record(0)
    assert np.angle(record.c1, deg=True) == pytest.approx(np.full(46, 90.0), abs=1e-3)
    path.write_text(path.read_text().replace(f"{wind_waves()[11]:.3f} (0.160)", "999.00 (0.160)"))
    assert "0.16 Hz" in refused(path)


def test_a_calm_is_a_flat_sea(tmp_path):
    for sea in (SeaConfig(spectrum=str(buoy(tmp_path, np.zeros(46)))),):
        flat = Sea.from_config(sea, seed=1)
        assert not flat.components.amplitude.any() and np.isfinite(flat.components.omega).all()
        assert not flat.elevation(3.0, 4.0, 5.0).any() and sea_size(sea) == (0.0, 4.0)


@pytest.mark.parametrize(
    ("record", "parts"),
    [
        ("2020-06-08 03:20", ("no record", "'2020-06-08 02:50'")),
        ("2020-06-08", ("no record", "nearest is '2020-06-08 02:50'", "4, from 2020-06-07 04:50")),
        ("yesterday", ("sea.record = 'yesterday'", "not a time", "2020-06-08 03:50", "all")),
    ],
)
def test_an_hour_that_is_not_there_is_refused_with_the_nearest(record, parts):
    message = refused(BUOY, record=record)
    assert [part for part in parts if part not in message] == []


def test_other_files_are_refused(tmp_path):
    assert "name 41010.data_spec" in refused(BUOY.with_suffix(".spec"))
    assert "no such file" in refused(tmp_path / "nowhere.data_spec")
    assert "sea.site" in refused(BUOY, site=2)
    path = copied(tmp_path, ".swdir", ".swr1")
    assert "densities" in refused(path.with_suffix(".swdir"))
    copied(tmp_path, ".data_spec")
    file = path.with_suffix(".swr1")
    file.write_text(file.read_text().replace("(0.485)", "(0.500)"))
    assert "frequencies" in refused(path) and file.name in refused(path)


def test_a_library_that_is_missing_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    (tmp_path / "sea.nc").write_bytes(b"CDF")
    with pytest.raises(MissingExtraError, match=r'pip install "taichi-sim\[waves\]"'):
        open_spectra(tmp_path / "sea.nc")
    assert open_spectra(BUOY).times.size == 4  # NDBC's text needs none
