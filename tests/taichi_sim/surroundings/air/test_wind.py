import math

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.config import AirConfig, ConfigError
from taichi_sim.config.io import validate
from taichi_sim.kernels import runtime
from taichi_sim.surroundings.air.wind import (
    BEAUFORT,
    TWENTY_FEET,
    Wind,
    beaufort_speed,
    charnock_roughness,
    log_shear,
    mean_wind_factor,
    wind_factor,
    wind_speed,
)

pytestmark = pytest.mark.usefixtures("precision")
ROUNDING = {"f64": 1e-14, "f32": 2e-6}
KNOT = 1852 / 3600  # m/s
# columns of the table, with the profile and its shear; z0 of 0.15 ft and 2 ft are MIL-F-8785C's
TABLE = {
    "MIL_catC_z0=0.15ft": ("log", log_shear(0.15 * 0.3048)),
    "MIL_other_z0=2ft": ("log", log_shear(2 * 0.3048)),
    "log_open_sea_z0=0.2mm": ("log", log_shear(2e-4)),
    "power_law_0.11": ("power", 0.11),
}


@ti.kernel
def _factor(profile: ti.template(), shear: float, h: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
    for i in h:
        out[i] = mean_wind_factor(profile, shear, h[i])


def _kernel_factor(profile, shear, height):
    h = torch.as_tensor(height, dtype=runtime.current().torch_dtype)
    out = torch.zeros_like(h)
    _factor(profile, shear, h, out)
    return out.double().numpy()


def _noisy(num_envs=40_000, **numbers):
    config = {"speed": 8.0, "direction_deg": 60.0, "std": 1.5, "time_constant": 40.0} | numbers
    return Wind(AirConfig(**config), num_envs, seed=3)


@pytest.mark.parametrize(
    ("direction_deg", "velocity"),
    [(0.0, (-10, 0, 0)), (90.0, (0, -10, 0)), (180.0, (10, 0, 0)), (225.0, (50**0.5, 50**0.5, 0))],
)
def test_a_wind_blows_from_its_direction(direction_deg, velocity, precision):
    wind = Wind(AirConfig(speed=10.0, direction_deg=direction_deg), 3, seed=1)
    assert wind.velocity.shape == (3, 3)
    assert np.abs(wind.velocity.numpy() - np.array(velocity)).max() < 10 * ROUNDING[precision]


def test_no_speed_is_calm():
    wind = Wind(None, 2, seed=1)
    wind.advance(0.1)
    assert not wind.velocity.any()


@pytest.mark.parametrize("force", range(12))
def test_beaufort_ranges_follow_on_one_another(force):
    """WMO prints speeds to 0.1 m/s: each force ends one such step below the next; the middle is inside."""
    low, high = BEAUFORT[force]
    assert BEAUFORT[force + 1][0] == pytest.approx(high + 0.1)
    assert low < beaufort_speed(force) < high
    # Simpson's rule of the scale, v = 0.836 B^1.5 m/s (the formula behind the limits), within half a force
    assert 0.836 * max(force - 0.5, 0) ** 1.5 - 0.1 < beaufort_speed(force) < 0.836 * (force + 0.5) ** 1.5


def test_beaufort_is_the_middle_of_its_speeds():
    assert wind_speed(AirConfig(beaufort=5)) == pytest.approx((8.0 + 10.7) / 2)
    assert wind_speed(AirConfig(beaufort=12)) == 32.7
    with pytest.raises(ValueError, match="13: allowed are 0 to 12"):
        beaufort_speed(13)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"speed": -1.0}, "speed = -1.0: input should be greater than or equal to 0"),
        ({"speed": math.nan}, "speed = nan"),
        ({"direction_deg": math.inf}, "direction_deg = inf"),
        ({"speed": 5.0, "beaufort": 4}, "given twice, by speed = 5.0 and beaufort = 4: keep one"),
        ({"beaufort": 13}, "beaufort = 13"),
        ({"time_constant": 0.0}, "time_constant = 0.0"),
        ({"profile": "linear"}, "'log', 'power' or 'uniform'"),
        ({"sped": 5.0}, "did you mean 'speed'"),
    ],
)
def test_mistakes_are_named(data, message):
    with pytest.raises(ConfigError, match=message):
        validate(AirConfig, data, "test.toml")


@pytest.mark.parametrize("column", TABLE)
def test_mean_profiles_agree_with_the_table(column, reference, precision):
    """From the wind at 20 ft, by NumPy and by the kernel."""
    table = np.genfromtxt(reference / "dryden" / "mean_wind_profiles.csv", delimiter=",", names=None, skip_header=1)
    header = (reference / "dryden" / "mean_wind_profiles.csv").read_text().splitlines()[0].split(",")
    w20, height, expected = table[:, 0] * KNOT, table[:, 1], table[:, header.index(column)]
    profile, shear = TABLE[column]
    ours = w20 * wind_factor(profile, shear, height) / wind_factor(profile, shear, TWENTY_FEET)
    assert np.abs(ours / expected - 1).max() < 1e-7
    kernel = _kernel_factor(profile, shear, np.append(height, TWENTY_FEET))
    assert np.abs(w20 * kernel[:-1] / kernel[-1] / expected - 1).max() < {"f64": 1e-7, "f32": 2e-6}[precision]


@pytest.mark.parametrize("profile", ["log", "power", "uniform"])
def test_profile_is_one_at_ten_metres_rises_and_is_finite_in_a_trough(profile, precision):
    wind = Wind(AirConfig(speed=12.0, profile=profile), 1, seed=1)
    height = np.array([-5.0, 0.0, 0.01, 0.1, 1.0, 10.0, 100.0, 1000.0])
    factor = _kernel_factor(profile, wind.shear, height)
    assert np.abs(factor - wind_factor(profile, wind.shear, height)).max() < ROUNDING[precision]
    assert factor[5] == 1.0
    assert (factor >= 0).all() and (np.diff(factor) >= 0).all()
    assert np.ptp(factor[:4]) < ROUNDING[precision]
    assert (factor[-1] > 1.2) == (profile != "uniform")


@pytest.mark.parametrize("speed", [4.0, 8.0, 12.0, 16.0, 21.0])
def test_charnock_gives_the_drag_coefficient_of_the_sea(speed):
    """Garratt (1977): alpha 0.0144 and kappa 0.41 are 1000 C_DN = 0.75 + 0.067 U10 from 4 to 21 m/s."""
    z0 = charnock_roughness(speed, 0.0144, kappa=0.41)
    drag = (0.41 / math.log(10 / z0)) ** 2
    assert 1000 * drag == pytest.approx(0.75 + 0.067 * speed, rel=0.06)


def test_wind_at_twenty_feet_of_a_rough_sea():
    """10 m/s over z0 = 0.2 mm: the table's rows at 20 ft (15 kt) and 10 m, the other way round."""
    wind = Wind(AirConfig(speed=8.0865888, roughness=2e-4), 1, seed=1)
    assert 8.0865888 * wind.w20_factor == pytest.approx(15 * KNOT, rel=1e-7)
    assert Wind(AirConfig(), 1, seed=1).w20_factor < 1  # a calm sea has a profile too


def test_slow_variation_is_stationary_and_forgets_exponentially():
    """Mean, std, and correlation exp(-dt / T), for long steps and for the same time in short ones."""
    wind = _noisy()
    mean = -8 * np.array([math.cos(math.radians(60)), math.sin(math.radians(60))])
    bound = 4.5 / math.sqrt(wind.velocity.shape[0])
    for steps, dt in ((1, 20.0), (40, 0.5)):
        before = wind.velocity[:, :2].double().numpy().copy() - mean
        for _ in range(steps):
            wind.advance(dt)
        after = wind.velocity[:, :2].double().numpy() - mean
        assert np.abs(after.mean(axis=0)).max() < bound * 1.5
        assert np.abs(after.var(axis=0) / 1.5**2 - 1).max() < bound * math.sqrt(2)
        correlation = (before * after).mean(axis=0) / 1.5**2
        assert np.abs(correlation - math.exp(-20 / 40)).max() < bound * math.sqrt(2)
        assert abs((after[:, 0] * after[:, 1]).mean()) / 1.5**2 < bound
    assert not wind.velocity[:, 2].any()


def test_velocity_stays_in_its_place_and_reset_touches_only_its_environments():
    wind = _noisy(num_envs=6)
    velocity, before = wind.velocity, wind.velocity.clone()
    wind.reset(torch.tensor([1, 4]))
    changed = (velocity != before).any(dim=1)
    assert changed.tolist() == [False, True, False, False, True, False]
    wind.advance(1.0)
    assert wind.velocity is velocity and (velocity != before)[:, :2].all()


def test_seed_decides():
    same, other = _noisy(5), Wind(_noisy(1).config, 5, seed=4)
    assert torch.equal(same.velocity, _noisy(5).velocity)
    assert not torch.equal(same.velocity, other.velocity)
