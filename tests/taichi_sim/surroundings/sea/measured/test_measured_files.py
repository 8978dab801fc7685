"""Files of measured spectra other than NDBC's text, written here in the form of each model and buoy."""

import json

import numpy as np
import pytest

from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.surroundings.sea.measured import open_spectra, records_of
from taichi_sim.surroundings.sea.spectrum import jonswap, spreading

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
    few = xarray.Dataset({"d2fd": (dims, data[:, :, 3:13])}, {k: v for k, v in coords.items() if k != "frequency"})
    few.to_netcdf(tmp_path / "few.nc")
    with pytest.raises(ConfigError, match="d2fd has 10 frequencies without their numbers"):
        open_spectra(tmp_path / "few.nc")


def test_parts_of_a_spectrum_are_no_places(tmp_path):
    sea = xarray.open_dataset(model(tmp_path / "sea.nc", GOES_TO))
    xarray.concat([sea, sea], "part").to_netcdf(tmp_path / "parts.nc")
    with pytest.raises(ConfigError, match=r"efth has 2 parts or realisations \(part\)"):
        open_spectra(tmp_path / "parts.nc")


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


SPOTTER = np.concatenate((0.029297 + 0.0097656 * np.arange(32), 0.3516 + 0.0293 * np.arange(6), [0.6543]))  # Hz
WIDTHS = np.concatenate((np.full(32, 0.0097656), np.full(6, 0.0293), [0.2832]))  # as Sofar's files have them


def spotter(**changes):
    """Two spectra of a Spotter: moments of the direction of travel, counter-clockwise from east."""
    east, ones = np.deg2rad(90.0 - (FROM - 180.0)), np.ones(SPOTTER.size)
    r1, r2 = moments()
    density = 2 * np.pi * jonswap(2 * np.pi * SPOTTER, HS, TP)
    rows = [
        {"timestamp": f"2022-05-01T0{hour}:00:00.000Z", "frequency": SPOTTER, "df": WIDTHS,
         "varianceDensity": density * share, "a1": r1 * np.cos(east) * ones, "b1": r1 * np.sin(east) * ones,
         "a2": r2 * np.cos(2 * east) * ones, "b2": r2 * np.sin(2 * east) * ones, "direction": FROM * ones,
         "directionalSpread": np.rad2deg(np.sqrt(2 * (1 - r1))) * ones} | changes
        for hour, share in ((0, 1.0), (6, 0.25))
    ]  # fmt: skip
    return [
        {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in row.items() if v is not None} for row in rows
    ]


def written(folder, rows):
    """The rows as the API's JSON, with parameters of other times, and as the dashboard's CSV."""
    waves = [{"timestamp": f"2022-05-01T{hour:02}:30:00.000Z", "significantWaveHeight": 2.0} for hour in range(3)]
    text = json.dumps({"data": {"spotterId": "SPOT-1", "waves": waves, "frequencyData": rows}})
    (folder / "spotter.json").write_text(text, encoding="utf-8")
    named = {"frequency": "f"}
    lists = [k for k, v in rows[0].items() if isinstance(v, list)]
    header = ["Epoch Time", *(f"{named.get(k, k)}_{n}" for k in lists for n in range(len(rows[0][k])))]
    lines = [[np.datetime64(row["timestamp"][:19]).astype(int), *(x for k in lists for x in row[k])] for row in rows]
    text = "\n".join(",".join("" if x is None else repr(x) for x in line) for line in lines)
    (folder / "spotter.csv").write_text(",".join(header) + "\n" + text.replace("np.int64(", "").replace(")", "") + "\n")
    return folder / "spotter.json", folder / "spotter.csv"


@pytest.mark.parametrize("lacks", [(), ("a1", "b1", "a2", "b2")])
def test_spotter(tmp_path, lacks):
    """Moments, or the mean direction and the spread sqrt(2 (1 - r1)) that replace them."""
    files = written(tmp_path, spotter(**dict.fromkeys(lacks)))
    (tmp_path / "list.json").write_text(f"[{files[0].read_text()}]")
    for file in (*files, tmp_path / "list.json"):
        as_expected(open_spectra(file))


def test_a_spotters_bands_are_as_wide_as_it_states(tmp_path):
    """m_n = sum S (high^(n+1) - low^(n+1)) / (n + 1), and a band that is left out has no energy: neighbours stay."""
    keep = np.r_[:20, 23:39]
    full = {"frequency": SPOTTER, "df": WIDTHS, "varianceDensity": np.linspace(1.0, 0.1, 39)}
    for chosen in (np.arange(39), keep):
        rows = spotter(**{k: v[chosen] for k, v in full.items()}, a1=None, direction=None)
        rows = [{k: v if k in (*full, "timestamp") else v[: chosen.size] for k, v in row.items()} for row in rows]
        low, high, s = (x[chosen] for x in (SPOTTER - WIDTHS / 2, SPOTTER + WIDTHS / 2, full["varianceDensity"]))
        for file in written(tmp_path, rows):
            record = open_spectra(file).record(0, 0.0, 10.0)
            for n in (0, 1, 2):
                exact = (s * (high ** (n + 1) - low ** (n + 1)) / (n + 1)).sum()
                assert record.moment(n) == pytest.approx(exact, rel=2e-4)  # widths are printed in four digits


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"a1": np.full(39, 0.9), "b1": np.zeros(39)}, "30 degrees apart: one has another convention"),
        ({"a1": np.full(39, 9.99), "direction": None}, "first moment of the directions is"),
        ({"df": np.zeros(39)}, "widths of its bands must be above 0"),
        ({"varianceDensity": np.ones(38)}, "cut short|38 columns"),
        (dict.fromkeys(("a1", "b1", "a2", "b2")) | {"directionalSpread": np.full(39, 0.6)}, "must be in degrees"),
        ({"timestamp": "2022-05-01T00:00:00Z"}, "2022-05-01 00:00 is there twice, and differs"),
        ({"varianceDensity": np.where(np.arange(39) == 7, -9999.0, 0.1)}, "has no density at 0.09766"),
        ({"varianceDensity": [None] * 39}, "has no spectrum"),
    ],
)
def test_what_a_spotter_did_not_measure_is_told(tmp_path, changes, part):
    for file in written(tmp_path, spotter(**changes)):
        with pytest.raises(ConfigError, match=part) as caught:
            open_spectra(file).record(0)
        assert file.name in str(caught.value)


def swan(path, direction, attributes, *, unit="m2 s rad-1", factor=1.0, f=FREQUENCY, f_unit="Hz"):
    dims = ("time", "points", "frequency", "direction")
    coords = {"time": TIMES, "frequency": ("frequency", f, {"units": f_unit}),
              "direction": ("direction", direction, attributes)}  # fmt: skip
    place = {"longitude": (("points",), [4.0]), "latitude": (("points",), [60.0])}
    data = {"density": (dims, factor * energy()[:, None], {"units": unit}), **place}
    xarray.Dataset(data, coords).to_netcdf(path)
    return path


def test_swans_directions_and_units_are_those_that_it_states(tmp_path):
    """One sea as nautical (from) and Cartesian (to, counter-clockwise from east); per degree, in rad/s, in J."""
    nautical, cartesian = (
        {"standard_name": "sea_surface_wave_from_direction"},
        {"standard_name": "sea_surface_wave_to_direction"},
    )
    for k, (direction, attributes, more) in enumerate((
        (np.deg2rad(COMES_FROM), nautical | {"units": "radians"}, {}),
        (np.deg2rad(90.0 - (COMES_FROM - 180.0)), cartesian | {"units": "radians"}, {}),
        (COMES_FROM, nautical | {"units": "degrees"}, {"unit": "m2 s degree-1", "factor": np.pi / 180}),
        (COMES_FROM, nautical | {"units": "degrees"}, {"unit": "J m-2 s rad-1", "factor": 1025 * 9.81}),
        (COMES_FROM, nautical | {"units": "degrees"}, {"f": 2 * np.pi * FREQUENCY, "f_unit": "rad/s"}),
        (COMES_FROM, nautical | {"units": "degrees"},
         {"f": 2 * np.pi * FREQUENCY, "f_unit": "rad/s", "unit": "m2 s rad-2", "factor": 0.5 / np.pi}),
    )):  # fmt: skip
        as_expected(open_spectra(swan(tmp_path / f"{k}.nc", direction, attributes, **more)))
    for attributes, part in (
        ({"units": "degrees"}, "does not state where it counts from"),
        (nautical | {"units": "gon"}, "is in gon"),
    ):
        with pytest.raises(ConfigError, match=part):
            open_spectra(swan(tmp_path / "what.nc", COMES_FROM, attributes))


def model(path, toward, *, unit="m2 s rad-1", factor=1.0, about=None, f=FREQUENCY, f_unit="Hz", name="efth"):
    """A file in the form of WAVEWATCH III, whose directions have the attributes `about`."""
    coords = {"time": TIMES, "frequency": ("frequency", f, {"units": f_unit} if f_unit else {}),
              "direction": ("direction", toward, about or {})}  # fmt: skip
    data = {name: (("time", "frequency", "direction"), factor * energy(), {"units": unit} if unit else {})}
    xarray.Dataset(data, coords).to_netcdf(path)
    return path


GOES_TO = COMES_FROM - 180.0


@pytest.mark.parametrize(
    ("toward", "about"),
    [
        (COMES_FROM, {"long_name": "direction from which waves come, clockwise from true north"}),
        (COMES_FROM, {"comment": "Nautical convention"}),
        (GOES_TO, {"long_name": "direction waves are travelling to, clockwise from north"}),
        (GOES_TO, {"long_name": "wave propagation direction"}),
        (GOES_TO, {}),
    ],
)
def test_a_convention_in_any_attribute_of_directions_is_used(tmp_path, toward, about):
    as_expected(open_spectra(model(tmp_path / "sea.nc", toward, about=about)))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"about": {"long_name": "to, counter-clockwise from east"}}, "counter-clockwise"),
        ({"about": {"long_name": "coming from", "comment": "oceanographic"}}, "both from and to"),
        ({"unit": "m2 s"}, "per degree or per radian is not said"),
        ({"unit": "cm2 s rad-1"}, "is in cm2"),
        ({"unit": "mm2 s rad-1"}, "is in mm2"),
        ({"factor": 1e4}, "are they in cm"),
        ({"f": 2 * np.pi * FREQUENCY, "f_unit": ""}, "steeper than a wave can be"),  # rad/s, unsaid
        ({"factor": 180 / np.pi, "unit": ""}, "steeper than"),  # per turn or so
        ({"name": "d2fd", "unit": "", "f": np.arange(1, 29), "f_unit": ""}, "no logarithms"),
    ],
)
def test_what_would_be_another_sea_is_refused(tmp_path, change, part):
    with pytest.raises(ConfigError, match=part):
        open_spectra(model(tmp_path / "sea.nc", GOES_TO, **change)).record(0)


def test_densities_alone_have_units_and_any_order_too(tmp_path):
    """In J/m^2/Hz, the highest frequency first."""
    density = energy().sum(axis=2)[:, ::-1] * np.deg2rad(10.0) * 1025 * 9.81
    coords = {"time": TIMES, "frequency": ("frequency", FREQUENCY[::-1], {"units": "Hz"})}
    xarray.Dataset({"efth": (("time", "frequency"), density, {"units": "J/m2/Hz"})}, coords).to_netcdf(
        tmp_path / "e.nc"
    )
    record = open_spectra(tmp_path / "e.nc").record(0, 120.0, 5.0)
    assert record.hs == pytest.approx(HS, rel=0.03) and record.tp == pytest.approx(TP, rel=0.06)


def test_no_spectrum_is_no_calm(tmp_path):
    """ERA5 masks ice and land whole, and tiny values one by one; a part of its frequencies keeps their numbers."""
    numbers, toward = np.arange(3, 27), np.arange(7.5, 360, 15)
    frequency = 0.03453 * 1.1 ** (numbers - 1)
    offset = np.deg2rad((toward - (FROM - 180) + 180) % 360 - 180)
    whole = 2 * np.pi * jonswap(2 * np.pi * frequency, HS, TP)[:, None] * spreading(offset, S)
    data = np.full((2, 24, 24, 1, 2), np.nan)
    data[0, ..., 0, 0] = np.log10(np.where(whole.T > 1e-5, whole.T, np.nan))
    coords = {"valid_time": TIMES, "directionNumber": np.arange(1, 25), "frequencyNumber": numbers, "latitude": [75.0],
              "longitude": [0.0, 20.0]}  # fmt: skip
    dims = ("valid_time", "directionNumber", "frequencyNumber", "latitude", "longitude")
    xarray.Dataset({"d2fd": (dims, data)}, coords).to_netcdf(tmp_path / "era5.nc")
    sea, ice = (open_spectra(tmp_path / "era5.nc", site) for site in (0, 1))
    assert sea.record(0).tp == pytest.approx(TP, rel=0.06) and sea.record(0).hs == pytest.approx(HS, rel=0.03)
    assert sea.whole() == [0] and ice.whole() == []
    spectrum = {"spectrum": str(tmp_path / "era5.nc")}
    assert [record.hs for record in records_of(SeaConfig(**spectrum, site=0, record="all"))] == [sea.record(0).hs]
    for site, record, part in (
        (0, None, "06:00 has no spectrum.*1 of 2 records are whole"),
        (1, "all", "every record"),
    ):
        with pytest.raises(ConfigError, match=part):
            records_of(SeaConfig(**spectrum, site=site, record=record))


def test_cdip(tmp_path):
    """Moments of where waves come from, clockwise from north; bands as it states them, records as it flags them."""
    r1, r2 = moments()
    angle = np.deg2rad(FROM)
    density = np.stack((energy()[0].sum(axis=1), energy()[1].sum(axis=1))) * np.deg2rad(10.0)
    ones = np.ones(density.shape)
    values = {"waveEnergyDensity": density, "waveMeanDirection": FROM * ones, "waveA1Value": r1 * np.cos(angle) * ones,
              "waveB1Value": r1 * np.sin(angle) * ones, "waveA2Value": r2 * np.cos(2 * angle) * ones,
              "waveB2Value": r2 * np.sin(2 * angle) * ones}  # fmt: skip
    edges = np.sqrt(FREQUENCY[1:] * FREQUENCY[:-1])
    width = np.diff(np.concatenate(([2 * FREQUENCY[0] - edges[0]], edges, [2 * FREQUENCY[-1] - edges[-1]])))
    data = {k: (("waveTime", "waveFrequency"), v) for k, v in values.items()} | {
        "waveBandwidth": ("waveFrequency", width)
    }
    coords = {"waveTime": TIMES, "waveFrequency": FREQUENCY}
    xarray.Dataset(data, coords).to_netcdf(tmp_path / "cdip.nc")
    as_expected(open_spectra(tmp_path / "cdip.nc"))
    flagged = data | {"waveFlagPrimary": ("waveTime", [1, 4])}
    xarray.Dataset(flagged, coords).to_netcdf(tmp_path / "bad.nc")
    assert open_spectra(tmp_path / "bad.nc").whole() == [0]


def swan_text(kind, directions, *, unit="m2/Hz/degr", factor=1.0, blocks=2):
    """Three places in no order, of which the second one has a sea; the third one has none."""
    lines = ["SWAN   1   standard", "$ comment", "TIME", "1 time coding", "LONLAT", "3 places", "5.0 60.0",
             "4.0 61.0 named", "5.0 61.0", "AFREQ", f"{FREQUENCY.size} n", *map(str, FREQUENCY), kind,
             f"{directions.size} n", *map(str, directions), "QUANT", "1 quantity", "VaDens density", f"{unit} unit",
             "-99 exception"]  # fmt: skip
    for time, spectrum in list(zip(("20220501.000000", "20220501.060000"), energy(), strict=True))[:blocks]:
        table = np.rint(spectrum * np.deg2rad(1.0) * factor / 1e-6).astype(int)
        lines += [f"{time} date", "ZERO", "FACTOR", "1e-6", *(" ".join(map(str, row)) for row in table), "NODATA"]
    return "\n".join(lines) + "\n"


def wavewatch_text():
    """Two places; directions in rad, where waves travel to, clockwise from north; frequencies within directions."""
    toward = np.deg2rad((COMES_FROM + 180.0) % 360.0)
    lines = [f"'WAVEWATCH III SPECTRA' {FREQUENCY.size} {toward.size} 2 'a grid'", " ".join(map(str, FREQUENCY)),
             " ".join(map(str, toward))]  # fmt: skip
    for time, spectrum in zip(("20220501 000000", "20220501 060000"), energy(), strict=True):
        lines.append(time)
        for name, share in (("'south'", 0.0), ("'north'", 1.0)):
            lines += [f"{name} 61.0 4.0 100.0 5.0 270.0 0.1 90.0", *map(str, (share * spectrum).T.reshape(-1))]
    return "\n".join(lines) + "\n"


def test_text_of_wave_models(tmp_path):
    """Places keep the order of the file; directions, exception values and units are those of the header."""
    cartesian = 90.0 - (COMES_FROM - 180.0)
    for k, text in enumerate((
        swan_text("NDIR", COMES_FROM), swan_text("CDIR", cartesian), wavewatch_text(),
        swan_text("NDIR", COMES_FROM, unit="J/m2/Hz/degr", factor=1025 * 9.81),
    )):  # fmt: skip
        path = tmp_path / f"{k}.spec"
        path.write_text(text)
        as_expected(open_spectra(path, 1))
        assert open_spectra(path, 0).record(0).calm
        for end in (0.97, 0.6, 0.1):
            (tmp_path / "cut.spec").write_text(text[: int(end * len(text))].rpartition("\n")[0] + "\n")
            with pytest.raises(ConfigError, match="cut short|in place of|line"):
                open_spectra(tmp_path / "cut.spec", 1)
    path = tmp_path / "0.spec"
    assert not open_spectra(path, 2).whole()
    first = swan_text("NDIR", COMES_FROM).replace("FACTOR\n1e-6\n0 ", "FACTOR\n1e-6\n-99 ", 1)
    path.write_text(first)
    with pytest.raises(ConfigError, match="no density at 0.04"):
        open_spectra(path, 1).record(0)


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("sea.txt", "nothing of the kind", "not known as a spectrum"),
        ("sea.nc", "neither", "cannot be read"),
        ("sea.spec", "SWAN   1\nTIME\n", "cut short"),
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
