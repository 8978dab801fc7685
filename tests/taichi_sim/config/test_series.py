"""Current and wind over time: rows of a file, tides, and how a world follows them."""

import math
import time

import numpy as np
import pytest
import torch

from taichi_sim.config import AirConfig, ConfigError, CurrentConfig, SeaConfig
from taichi_sim.config.columns import missing_mark
from taichi_sim.config.series import read_series
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.air.wind import mean_wind
from taichi_sim.surroundings.sea import Current
from taichi_sim.world import World

pytestmark = pytest.mark.usefixtures("f64")
ROWS = "time, speed, direction_deg\n0, 1.0, 90\n100, 1.0, 180\n300, 2.0, 180\n"


def file(folder, text=ROWS, name="series.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def times(*values):
    return torch.tensor(values, dtype=torch.float64)


def everywhere(n):
    return torch.arange(n)


def test_a_current_is_linear_by_component_and_held_at_the_ends(tmp_path):
    current = Current(CurrentConfig(series=file(tmp_path)), 5, seed=1)
    assert np.allclose(current.velocity.numpy(), [[0, 1]] * 5)  # at time 0 it flows east
    current.follow(everywhere(5), times(-50, 50, 100, 200, 1e6))
    assert np.allclose(current.velocity.numpy(), [[0, 1], [-0.5, 0.5], [-1, 0], [-1.5, 0], [-2, 0]])


def test_a_wind_blows_from_its_direction_and_by_dates_begins_at_the_first(tmp_path):
    text = "time,speed,direction_deg,gust\n2021-03-01 00:00,10,270,12\n2021-03-01 01:00,10,0,12\n"
    config = AirConfig(series=file(tmp_path, text))
    wind = Wind(config, 3, seed=1)
    wind.follow(everywhere(3), times(0, 1800, 3600))
    assert np.allclose(wind.velocity.numpy(), [[0, 10, 0], [-5, 5, 0], [-10, 0, 0]])
    assert mean_wind(config) == pytest.approx((math.hypot(5, 5), 315.0))
    north_east = file(tmp_path, "time,north,east\n0,3,4\n", "to.csv")
    assert np.allclose(Wind(AirConfig(series=north_east), 1, seed=1).velocity.numpy(), [[3, 4, 0]])


def test_the_slow_variation_stays_about_the_mean_of_the_time(tmp_path):
    """Which moves by the series' own step, whatever has been drawn."""
    flow = Current(CurrentConfig(series=file(tmp_path), std=0.3), 4, seed=2)
    before = flow.velocity.clone()
    flow.follow(everywhere(4), times(200, 200, 200, 200))
    assert np.allclose((flow.velocity - before).numpy(), [[-1.5, -1]] * 4)
    air = Wind(AirConfig(series=file(tmp_path), std=0.3), 4, seed=2)
    before = air.velocity.clone()
    air.follow(everywhere(4), times(200, 200, 200, 200))
    assert np.allclose((air.velocity - before).numpy(), [[1.5, 1, 0]] * 4)


def test_a_tide_is_the_sum_of_its_constituents_along_its_direction():
    """M2 alone has its period of 12.4206 h; with S2 it beats from neaps to springs in 14.765 days."""
    m2, both = {"M2": {"amplitude": 0.6, "phase_deg": 40.0}}, {"M2": {"amplitude": 0.6}, "S2": {"amplitude": 0.2}}
    tide = Current(CurrentConfig.model_validate({"tide": {"direction_deg": 30.0, "constituents": m2}}), 3, seed=1)
    period = 12.4206012 * 3600
    tide.follow(everywhere(3), times(40 / 360 * period, 40 / 360 * period + period / 2, 0.0))
    along = np.array([math.cos(math.radians(30)), math.sin(math.radians(30))])
    assert np.allclose(tide.velocity.numpy(), np.outer([0.6, -0.6, 0.6 * math.cos(math.radians(40))], along), atol=1e-6)
    spring = Current(CurrentConfig.model_validate({"speed": 0.1, "tide": {"constituents": both}}), 2000, seed=1)
    hours = np.linspace(0, 14.765 * 24, 2000)
    spring.follow(everywhere(2000), torch.from_numpy(hours * 3600))
    speed = np.abs(spring.velocity.numpy()[:, 0] - 0.1)
    assert speed[hours < 13].max() == pytest.approx(0.8, abs=0.01)
    assert speed[np.abs(hours - hours[-1] / 2) < 6.5].max() == pytest.approx(0.4, abs=0.02)


def test_a_world_follows_the_time_of_each_environment(tmp_path, scenario):
    flow, air = file(tmp_path, name="flow.csv"), file(tmp_path, name="air.csv")
    path = scenario(end="[sea.current]\nseries = 'flow.csv'\n[air]\nseries = 'air.csv'\n")
    world = World.from_scenario(path, 3, overrides=["sea.hs=0", "sea.tp=4", "decision_interval=1", "dt=0.1"])
    assert world.config.air.series == air and world.config.sea.current.series == flow  # found beside the scenario
    world.time[:] = times(0, 49, 299)
    world.renew(everywhere(3))
    assert np.allclose(world.current.velocity.numpy()[2], [-1.995, 0])
    world.step({name: torch.zeros_like(team.action) for name, team in world.teams.items()})
    expected = [[-0.01, 0.99], [-0.5, 0.5], [-2, 0]]
    assert np.allclose(world.current.velocity.numpy(), expected)
    assert np.allclose(world.wind.velocity.numpy()[:, :2], -np.array(expected))
    assert world.around.current.equal(world.current.velocity)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("time,speed\n0,1\n", ("columns are time, speed", "speed and direction_deg", "north and east")),
        ("", ("columns are none",)),
        ("time,north,east\n", ("no row",)),
        ("time,north,east\n0,1,2\n0,1,3\n", ("line 3", "rise")),
        ("time,north,east\n0,1,two\n", ("line 2", "two")),
        ('time,north,east\n0,"1,5",2\n', ("line 2", "decimal points")),
        ("time,north,east\n0,1\n", ("line 2", "cut short")),
        ("time,north,east\n0,nan,1\n", ("line 2", "finite")),
        ("time,speed,direction_deg\n0,-1,20\n", ("line 2", "0 or more")),
        ("time,speed,direction_deg\n0,1,20\n9,11,20\n", ("line 3", "11 m/s", "0 to 10")),
        ("time,speed,direction_deg\nnoon,1,20\n", ("line 2", "noon")),
    ],
)
def test_a_wrong_file_is_refused_by_its_line(tmp_path, text, parts):
    with pytest.raises(ConfigError) as caught:
        Current(CurrentConfig(series=file(tmp_path, text)), 1, seed=1)
    assert [part for part in (*parts, "series.csv") if part not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("kind", "data", "part"),
    [
        (CurrentConfig, {"series": "a.csv", "speed": 1.0}, "given twice"),
        (CurrentConfig, {"tide": {"constituents": {"M3": {"amplitude": 1.0}}}}, "M3: unknown; allowed are M2, S2"),
        (CurrentConfig, {"tide": {"constituents": {}}}, "at least 1"),
        (AirConfig, {"series": "a.csv", "beaufort": 4}, "given twice"),
        (SeaConfig, {"record": "all"}, "give spectrum = FILE"),
    ],
)
def test_what_contradicts_itself_is_refused(kind, data, part):
    with pytest.raises(ValueError, match=part):
        kind.model_validate(data)


def test_what_a_file_states_of_its_times_and_units_is_used(tmp_path, monkeypatch):
    """Every hour once across the end of summer time, whatever the machine's zone; seconds since 1970 begin at 0."""
    monkeypatch.setenv("TZ", "Europe/Oslo")
    time.tzset()
    try:
        naive = [f"2024-10-27 0{hour}:30" for hour in range(5)]
        offset = ["2024-10-27T00:30Z", "2024-10-27T03:30+02:00", "2024-10-27 02:30+00:00"]
        for stamps in (naive, offset, [str(1_730_000_000 + 3600 * k) for k in range(3)]):
            text = "time,north,east\n" + "".join(f"{stamp},1,0\n" for stamp in stamps)
            assert read_series(file(tmp_path, text))[0].tolist() == [3600.0 * k for k in range(len(stamps))]
    finally:
        monkeypatch.undo()
        time.tzset()
    text = "\ufefftime [min];speed (kn);direction_deg [rad]\n0;1,0;0,0\n10;2,5;1,5707963267948966\n"
    found, velocity = read_series(file(tmp_path, text, "logger.csv"))
    assert found.tolist() == [0.0, 600.0]
    np.testing.assert_allclose(velocity, np.array([[1.0, 0.0], [0.0, 2.5]]) * 1852 / 3600, atol=1e-12)


@pytest.mark.parametrize(
    ("row", "part"),
    [
        ("600,1,999", "direction_deg = 999 marks a missing value: leave out"),
        ("600,1,-9999", "direction_deg = -9999 marks"),
        ("600,1,-361", "directions are from 0 to 360, or from -180"),
        ("600,1,-99", "direction_deg = -99 marks"),
        ("600,99,90", "speed = 99 marks"),
        ("600,9.96921e36,90", "allowed are 0 to 60"),
        ("600,,90", "speed is not a number: ''"),
        ("600,1_0,90", "'1_0'"),
        ("2024-05-01,1,90", "numbers and dates are mixed"),
        ("1714521600000,1,90", "no time in s"),
        ("0,1,90", "is there twice"),
        ("600,1,90,5", "4 cells under 3 names"),
    ],
)
def test_what_marks_a_missing_value_is_none(tmp_path, row, part):
    with pytest.raises(ConfigError, match=part) as caught:
        read_series(file(tmp_path, f"time,speed,direction_deg\n0,6,90\n{row}\n1200,6,80\n"), blows_from=True)
    assert "series.csv, line 3" in str(caught.value)


@pytest.mark.parametrize(
    ("times", "told"),
    [
        (("45413", "45413.0417"), "line 2: time = 45413: days of a spreadsheet"),
        (("2460432", "2460433"), "days of a spreadsheet"),
        (("122.0", "122.5"), "days of a spreadsheet"),
        (("20240501", "20240502"), "line 2: time = 20240501 reads as a date"),
        (("43200", "43260"), "line 2: time begins at 43200 s, later than episodes"),  # of the day
        (("2024050112", "2024050113"), "reads as a date"),
        (("2024-05-01 12:00+02:00", "2024-05-01 13:00"), "line 3: .* others have none"),
    ],
)
def test_days_and_dates_are_no_seconds(tmp_path, times, told):
    text = "time,north,east\n" + "".join(f"{time},1,0\n" for time in times)
    with pytest.raises(ConfigError, match=told):
        read_series(file(tmp_path, text))


def test_days_and_seconds_are_read_by_their_unit(tmp_path):
    for unit, factor in (("days", 86400.0), ("s", 1.0)):
        text = f"time [{unit}],north,east\n0,1,0\n0.5,1,0\n"
        assert read_series(file(tmp_path, text, f"{unit}.csv"))[0].tolist() == [0.0, 0.5 * factor]


def test_two_statements_of_one_velocity_must_agree(tmp_path):
    """A wind of 5 m/s from the east goes west, at north 0 and east -5."""
    text = "time,speed,direction_deg,north,east\n0,5,90,0,{}\n"
    assert np.allclose(read_series(file(tmp_path, text.format(-5)), blows_from=True)[1], [[0, -5]])
    with pytest.raises(ConfigError, match="line 2: north and east are 10 m/s from speed and direction_deg"):
        read_series(file(tmp_path, text.format(5), "other.csv"), blows_from=True)


def test_directions_are_counted_in_one_way(tmp_path):
    """-10 among directions above 180 is a mark, or of another convention; alone it is 350."""
    text = "time,speed,direction_deg\n0,6,{}\n600,6,-10\n1200,6,20\n"
    assert read_series(file(tmp_path, text.format(-20)))[1][1] == pytest.approx(
        6 * np.array([0.9848, -0.1736]), abs=1e-3
    )
    with pytest.raises(ConfigError, match="line 3: direction_deg = -10: directions are"):
        read_series(file(tmp_path, text.format(340), "other.csv"))


def test_a_mark_that_its_neighbours_approach_is_a_value():
    """A boat passes 99 m and 999 m from its start; a wind of 9.99 m/s follows one of 9.5."""
    for values in ([98.0, 99.0, 100.0], [9.5, 9.99, 3.0], [0.0, 600.0, 999.0], [-31000.0, -32768.0]):
        assert missing_mark(np.array(values)) is None
    for values, k in (([6.0, 99.0, 7.0], 1), ([999.0, 999.0, 80.0], 0), ([99.0, 99.0], 0), ([0.1, -9.99], 1)):
        assert missing_mark(np.array(values)) == k
