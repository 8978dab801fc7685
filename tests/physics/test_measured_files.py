"""Files of measured spectra other than NDBC's text, written here in the form of each model and buoy."""

import json

import numpy as np
import pytest

from taichi_sim.config import ConfigError
from taichi_sim.sea.measured import open_spectra
from taichi_sim.sea.spectrum import jonswap, spreading

xarray = pytest.importorskip("xarray")
pytest.importorskip("wavespectra")
pytest.importorskip("netCDF4")

FREQUENCY = 0.04 * 1.1 ** np.arange(28)
COMES_FROM = np.arange(5.0, 360.0, 10.0)  # deg
HS, TP, FROM, S = 2.0, 8.0, 300.0, 12.0
TIMES = np.array(["2022-05-01T00:00", "2022-05-01T06:00"], dtype="datetime64[ns]")


def energy():
    """A JONSWAP sea from the north-west, m^2/Hz/rad, [f, d]; and one of half its height."""
    offset = np.deg2rad((COMES_FROM - FROM + 180) % 360 - 180)
    whole = 2 * np.pi * jonswap(2 * np.pi * FREQUENCY, HS, TP)[:, None] * spreading(offset, S)
    return np.stack((whole, whole / 4))


def as_expected(file):
    record = file.record(0)
    assert file.times.astype("datetime64[m]").tolist()[0].isoformat() == "2022-05-01T00:00:00"
    assert record.hs == pytest.approx(HS, rel=0.03) and record.tp == pytest.approx(TP, rel=0.06)
    assert np.rad2deg(record.direction) % 360 == pytest.approx(FROM - 180, abs=1.0)
    assert abs(record.c1_of_all) == pytest.approx(S / (S + 1), abs=0.01)
    assert file.record(1).hs == pytest.approx(record.hs / 2, rel=1e-3)
    return record


def test_wavewatch_and_its_places(tmp_path):
    data = np.stack((energy(), 4 * energy()), axis=1)  # [time, station, f, d]
    toward = (COMES_FROM + 180.0) % 360.0  # WAVEWATCH III gives where waves go to
    dims = ("time", "station", "frequency", "direction")
    place = {"latitude": (("time", "station"), np.full((2, 2), 60.5)),
             "longitude": (("time", "station"), np.tile([3.25, -4.5], (2, 1)))}  # fmt: skip
    coords = {"time": TIMES, "station": [1, 2], "frequency": FREQUENCY, "direction": toward}
    xarray.Dataset({"efth": (dims, data), **place}, coords).to_netcdf(tmp_path / "ww3.nc")
    as_expected(open_spectra(tmp_path / "ww3.nc", 0))
    other = open_spectra(tmp_path / "ww3.nc", 1)
    assert other.place == "60.50 N 4.50 W" and other.record(0).hs == pytest.approx(2 * HS, rel=0.03)
    for site, part in ((None, "2 places, give one as sea.site .*0: 60.50 N 3.25 E"), (2, "allowed are 0 to 1")):
        with pytest.raises(ConfigError, match=part):
            open_spectra(tmp_path / "ww3.nc", site)


def test_era5(tmp_path):
    """Logarithms by number of frequency and direction, which go to, from 7.5 degrees on."""
    toward = np.arange(7.5, 360, 15)
    offset = np.deg2rad((toward - (FROM - 180) + 180) % 360 - 180)
    frequency = 0.03453 * 1.1 ** np.arange(30)
    whole = 2 * np.pi * jonswap(2 * np.pi * frequency, HS, TP)[:, None] * spreading(offset, S)
    data = np.log10(np.maximum(np.stack((whole, whole / 4)), 1e-12)).transpose(0, 2, 1)[..., None, None]
    coords = {"time": TIMES, "direction": np.arange(1, 25), "frequency": np.arange(1, 31), "latitude": [50.0],
              "longitude": [350.0]}  # fmt: skip
    dims = ("time", "direction", "frequency", "latitude", "longitude")
    xarray.Dataset({"d2fd": (dims, data)}, coords).to_netcdf(tmp_path / "era5.nc")
    file = open_spectra(tmp_path / "era5.nc")
    as_expected(file)
    assert file.place == "50.00 N 10.00 W"


def moments():
    """(r1, r2) of cos^2s."""
    return S / (S + 1), S * (S - 1) / ((S + 1) * (S + 2))


def test_ndbcs_netcdf_keeps_records_without_some_directions(tmp_path):
    density = 2 * np.pi * jonswap(2 * np.pi * FREQUENCY, HS, TP)
    values = {"spectral_wave_density": density, "mean_wave_dir": np.full(28, FROM),
              "principal_wave_dir": np.full(28, FROM)}  # fmt: skip
    values |= {f"wave_spectrum_r{n}": np.full(28, r) for n, r in zip((1, 2), moments(), strict=True)}
    values = {name: np.stack((x, x / 4 if name == "spectral_wave_density" else x)) for name, x in values.items()}
    values["mean_wave_dir"][0, :4] = np.nan
    shaped = {name: (("time", "frequency", "latitude", "longitude"), x[..., None, None]) for name, x in values.items()}
    coords = {"time": TIMES, "frequency": FREQUENCY, "latitude": [28.0], "longitude": [-79.0]}
    xarray.Dataset(shaped, coords).to_netcdf(tmp_path / "buoy.nc")
    as_expected(open_spectra(tmp_path / "buoy.nc"))


def test_spotter(tmp_path):
    """Moments of the direction of travel, counter-clockwise from east."""
    east = np.deg2rad(90.0 - (FROM - 180.0))
    r1, r2 = moments()
    density = 2 * np.pi * jonswap(2 * np.pi * FREQUENCY, HS, TP)
    rows = [
        {"frequency": FREQUENCY.tolist(), "df": [0.01] * 28, "varianceDensity": (density * share).tolist(),
         "a1": [r1 * np.cos(east)] * 28, "b1": [r1 * np.sin(east)] * 28, "a2": [r2 * np.cos(2 * east)] * 28,
         "b2": [r2 * np.sin(2 * east)] * 28, "direction": [FROM] * 28, "directionalSpread": [20.0] * 28,
         "timestamp": f"2022-05-01T0{hour}:00:00.000Z", "latitude": 1.0, "longitude": 2.0}
        for hour, share in ((0, 1.0), (6, 0.25))
    ]  # fmt: skip
    waves = [{"timestamp": row["timestamp"], "significantWaveHeight": 2.0} for row in rows]
    text = json.dumps({"data": {"spotterId": "SPOT-1", "waves": waves, "frequencyData": rows}})
    (tmp_path / "spotter.json").write_text(text, encoding="utf-8")
    as_expected(open_spectra(tmp_path / "spotter.json"))


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("sea.txt", "nothing of the kind", "not known as a spectrum"),
        ("sea.nc", "neither", "cannot read it"),
        ("sea.spec", "SWAN   1\nTIME\n", "cannot read it"),
    ],
)
def test_what_is_no_spectrum_is_refused(tmp_path, name, content, part):
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=part) as caught:
        open_spectra(tmp_path / name)
    assert name in str(caught.value)


def test_a_netcdf_of_something_else_is_refused_by_its_variables(tmp_path):
    xarray.Dataset({"temperature": ("time", [1.0])}, {"time": TIMES[:1]}).to_netcdf(tmp_path / "sst.nc")
    with pytest.raises(ConfigError, match="variables are temperature"):
        open_spectra(tmp_path / "sst.nc")
