"""Conditions of realisations: where they come from, what follows from them, what cannot be."""

import numpy as np
import pytest

from taichi_sim.config import ConfigError, WorldConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.randomisation.conditions import TRUTH, bounds, nominal_conditions, realise
from taichi_sim.surroundings.sea import sea_size
from taichi_sim.surroundings.sea.wind_sea import developed_sea

pytestmark = pytest.mark.usefixtures("f64")
ALL = {
    "sea.hs": (0.5, 1.5),
    "sea.direction_deg": {"add": (-180.0, 180.0)},
    "sea.current.speed": (0.0, 0.6),
    "sea.current.direction_deg": (0.0, 360.0),
    "air.speed": {"factor": (0.5, 2.0)},
    "air.direction_deg": {"add": (-30.0, 30.0), "distribution": "normal"},
    "air.turbulence": (0.5, 1.5),
}
MANY = 2000


def world(vary=ALL, variation=1.0, realisations=3, sea=None, **sections):
    """A world's configuration with waves of two components."""
    size = sea if sea is not None else {"hs": 1.0, "tp": 5.0}
    return WorldConfig.model_validate(
        {
            "sea": {**size, "components": 2, "realisations": realisations},
            "air": {"speed": 6.0, "direction_deg": 200.0},
            "vary": vary,
            "variation": variation,
        }
        | sections
    )


@pytest.fixture(scope="module")
def many(f64):
    return realise(world(realisations=MANY), seed=4)


def test_a_realisation_does_not_depend_on_how_many_there_are_nor_on_what_else_varies():
    (few_sea, few), (more_sea, more) = (realise(world(realisations=n), seed=4) for n in (3, 7))
    assert few_sea.table.equal(more_sea.table[:3])
    for one, other in zip(few, more, strict=True):
        assert np.array_equal(one, other[:3])
    _, alone = realise(world({"air.speed": ALL["air.speed"]}), seed=4)
    assert np.array_equal(alone.wind_speed, few.wind_speed)
    assert not np.array_equal(few.wind_speed, realise(world(), seed=5)[1].wind_speed)


@pytest.mark.parametrize("how", [{"variation": 0.0}, {"vary": {}}])
def test_without_variation_there_are_the_nominal_conditions_alone(how):
    config = world(**how)
    sea, found = realise(config, seed=4)
    assert sea.table.equal(realise(world({"air.speed": (1.0, 2.0)}), seed=4)[0].table)  # waves of the same seed
    assert np.allclose(sea.components.hs, 1.0, rtol=1e-12)
    nominal = [value for key, value in nominal_conditions(config).items() if key != "sea.sea_state"]
    assert [set(values) for values in found] == [{value} for value in nominal]


def test_draws_fill_their_ranges_evenly(many):
    """Kolmogorov's statistic at 0.1 %, of uniform ones; a normal one has its spread, cut off at 2 deviations."""
    _, found = many
    uniform = {
        "hs": (0.5, 1.5), "current_speed": (0.0, 0.6), "current_direction_deg": (0.0, 360.0), "wind_speed": (3.0, 12.0),
        "turbulence": (0.5, 1.5),
    }  # fmt: skip
    for name, (low, high) in uniform.items():
        values = np.sort(getattr(found, name))
        assert low <= values[0] and values[-1] <= high, name
        assert np.abs((values - low) / (high - low) - (np.arange(MANY) + 0.5) / MANY).max() < 1.95 / MANY**0.5, name
    away = found.wind_direction_deg - 200.0
    assert np.abs(away).max() <= 30.0
    assert away.mean() == pytest.approx(0.0, abs=1.0)
    assert away.std() == pytest.approx(0.8796 * 15.0, rel=0.04)  # of a normal distribution cut off at 2 deviations
    drawn = np.stack([found.hs, found.current_speed, found.wind_speed, found.turbulence, away])
    assert np.abs(np.corrcoef(drawn) - np.eye(5)).max() < 0.1


def test_waves_are_those_of_their_conditions(many):
    sea, found = many
    assert sea.components.hs == pytest.approx(found.hs)
    assert found.tp == pytest.approx(5.0 * np.sqrt(found.hs))  # the nominal steepness
    apart = sea.components.direction - np.deg2rad(found.wave_direction_deg)[:, None]
    assert np.abs(np.sin(apart)).mean() < 0.5 < np.abs(np.sin(sea.components.direction)).mean()
    peak = 2 * np.pi / found.tp[:, None]
    assert (sea.components.omega > 0.6 * peak).all() and (sea.components.omega < 3 * peak).all()


def test_tables_are_of_order_one_and_name_what_they_hold(many):
    _, found = many
    tables = found.tables()
    told = dict(zip(TRUTH, tables.truth.numpy().T, strict=True))
    assert tables.truth.abs().max() < 4.0
    assert np.hypot(told["sea.current.north"], told["sea.current.east"]) == pytest.approx(found.current_speed)
    blows = np.deg2rad(found.wind_direction_deg + 180.0)
    assert 10 * told["air.east"] == pytest.approx(found.wind_speed * np.sin(blows))
    assert tables.wind.numpy() == pytest.approx(
        np.stack((10 * told["air.north"], 10 * told["air.east"], 0 * blows), -1)
    )
    assert np.arctan2(told["sea.direction.sin"], told["sea.direction.cos"]) == pytest.approx(
        np.deg2rad((found.wave_direction_deg + 180) % 360 - 180)
    )


def test_a_sea_that_could_not_be_is_lengthened_and_no_other():
    config = world({"sea.hs": (0.1, 4.0), "sea.tp": (2.0, 9.0)}, realisations=200)
    sea, found = realise(config, seed=1)
    steepness = found.hs / (GRAVITY * found.tp**2 / (2 * np.pi))
    assert steepness.max() == pytest.approx(1 / 15)
    assert 0.1 < (steepness > 1 / 15 - 1e-9).mean() < 0.9
    assert sea.components.sum_ka.max() < 0.98 + 1e-9
    gentle = steepness < 1 / 30
    low, high = found.tp[gentle].min(), found.tp[gentle].max()
    assert 2.0 < low < 4.0 and 8.0 < high < 9.0


def test_a_sea_state_is_between_the_middles_of_the_codes():
    for code in (0, 3, 4):
        _, found = realise(world({"sea.sea_state": (float(code), float(code))}), seed=1)
        if code:
            assert (found.hs[0], found.tp[0]) == pytest.approx(sea_size(world(sea={"sea_state": code}).sea))
        else:
            assert not found.hs.any()
    _, found = realise(world({"sea.sea_state": (3.5, 3.5)}), seed=1)
    assert found.hs[0] == pytest.approx((0.875 + 1.875) / 2)


def test_a_sea_that_follows_the_wind_is_that_of_its_realisation_s_own():
    vary = {"air.speed": (0.0, 12.0), "air.direction_deg": (0.0, 360.0)}
    sea, found = realise(world(vary, sea={"follows_wind": True}, realisations=20), seed=1)
    sizes = np.array([developed_sea(speed) for speed in found.wind_speed])
    assert found.hs == pytest.approx(sizes[:, 0]) and sea.components.hs == pytest.approx(found.hs)
    assert found.wave_direction_deg == pytest.approx(found.wind_direction_deg + 180.0)


@pytest.mark.parametrize(
    ("key", "given", "variation", "ends"),
    [
        ("air.speed", {"range": (2.0, 10.0)}, 2.0, (0.0, 14.0)),  # no wind blows with less than nothing
        ("air.direction_deg", {"add": (-180.0, 180.0)}, 2.0, (20.0, 380.0)),  # all round is as far as it goes
        ("air.direction_deg", {"add": (-180.0, 180.0)}, 0.5, (110.0, 290.0)),
        ("sea.sea_state", {"range": (1.0, 6.0)}, 2.0, (0.0, 6.0)),
        ("sea.hs", {"range": (0.2, 0.8)}, 0.0, (1.0, 1.0)),
    ],
)
def test_a_wider_range_stays_where_conditions_can_be(key, given, variation, ends):
    assert bounds(world({key: given}, variation), key) == pytest.approx(ends)


@pytest.mark.parametrize(
    ("key", "given", "told"),
    [
        ("sea.hs", {"factor": (0.5, 20.0)}, r"vary.sea.hs = .*from 0.5 to 20, allowed are 0 to 15 \(.* own is 1\)"),
        ("air.speed", {"add": (-7.0, 0.0)}, "from -1 to 6, allowed are 0 to 60"),
        ("sea.current.speed", {"factor": (0.5, 2.0)}, "vary.sea.current.speed: factor = .*nominal value is 0"),
    ],
)
@pytest.mark.parametrize("variation", [0.0, 1.0])
def test_a_range_of_what_cannot_be_is_refused(key, given, told, variation):
    with pytest.raises(ConfigError, match=told):
        realise(world({key: given}, variation), seed=1)
