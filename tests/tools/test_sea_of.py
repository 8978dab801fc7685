"""tools/sea_of.py: a file's sea in words and systems, and what becomes of a vessel in it."""

import numpy as np
import pytest
from folders import REFERENCE

from taichi_sim.config import SeaConfig
from taichi_sim.surroundings.sea.measured import records_of
from taichi_sim.surroundings.sea.measured.wave_record import WaveRecord, direction_grid, normalised
from taichi_sim.surroundings.sea.spectrum import jonswap, spreading
from tools import sea_of

BUOY = REFERENCE / "buoys" / "41010.data_spec"


def two_systems():
    """A swell of 1 m and 13 s that goes north, a wind sea of 2 m and 6 s that goes east."""
    edges = np.linspace(0.03, 0.5, 48)
    omega, angle = np.pi * (edges[1:] + edges[:-1]), direction_grid()
    parts = ((1.0, 13.0, 0.0, 40.0), (2.0, 6.0, np.pi / 2, 15.0))
    density = [2 * np.pi * jonswap(omega, hs, tp) for hs, tp, _, _ in parts]
    spread = [spreading((angle - to + np.pi) % (2 * np.pi) - np.pi, s) for _, _, to, s in parts]
    both = sum(x[:, None] * y for x, y in zip(density, spread, strict=True)) + 1e-12
    return WaveRecord("two", edges, sum(density), normalised(both))


def test_wind_sea_and_swell_are_told_apart():
    pytest.importorskip("wavespectra")
    for wind in (None, (12.0, 270.0)):
        sea, *swells = sea_of.systems(two_systems(), wind)
        assert (sea.name, swells[0].name) == ("wind sea", "swell")
        assert (sea.hs, swells[0].hs) == pytest.approx((2.0, 1.0), rel=0.08)
        assert (sea.tp, swells[0].tp) == pytest.approx((6.0, 13.0), rel=0.08)
        assert (sea.comes_from, swells[0].comes_from) == pytest.approx((270.0, 180.0), abs=6)


def test_a_file_is_described_and_what_is_wrong_named(capsys):
    pytest.importorskip("wavespectra")
    assert sea_of.main([str(BUOY), "--time", "2020-06-07 04:50", "--vessels"]) == 0
    text = capsys.readouterr().out
    for part in ("41010, 2020-06-07 04:50", "Hs 1.17 m, sea state 3 (slight)", "Tp 7.7 s", "Tm02 4.90 s",
                 "from 108 at the peak", "4 records", "swell        Hs"):  # fmt: skip
        assert part in text
    assert sea_of.main([str(BUOY), "--time", "2020-06-07 05:00", "--vessels"]) == 2
    assert "nearest is '2020-06-07 04:50'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        sea_of.main([str(BUOY), "--envs", "0"])
    assert "--envs: 0: allowed are 1 to 4096" in capsys.readouterr().err


@pytest.mark.slow
def test_vessels_are_the_shipped_ones():
    names = sea_of.vessels()
    assert {"otter", "wamv", "barge", "unity_boat"} <= set(names) and "aerosonde" not in names


@pytest.mark.slow
def test_an_otter_survives_a_slight_sea_and_not_a_steep_one(tmp_path):
    sea = SeaConfig(spectrum=str(BUOY), realisations=16)
    found = sea_of.fate("otter", sea, 16, 20.0, seed=1, shown=False)
    assert found is not None and (found.capsized, found.swamped) == (0.0, 0.0)
    assert 0.5 < found.roll < 15.0 and records_of(sea)[0].hs > 1.0
    steep = sea_of.fate("otter", SeaConfig(hs=1.5, tp=4.0, components=8, realisations=16), 16, 60.0, 1, shown=False)
    assert steep is not None and steep.swamped + steep.capsized > 0.0
    assert sea_of.fate("unity_boat", sea, 4, 1.0, seed=1, shown=False) is None
