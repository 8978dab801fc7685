import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.config import ConfigError, GustConfig
from taichi_sim.config.io import validate
from taichi_sim.kernels import runtime
from taichi_sim.surroundings.air.wind import Gust, gust_velocity

pytestmark = pytest.mark.usefixtures("precision")
ROUNDING = {"f64": 1e-12, "f32": 1e-4}
TIME = {"amplitude": (3.0, -1.0, -9.0), "start_time": 5.0, "rise_time": 2.0}
PLACE = {
    "amplitude": (0.0, 0.0, -9.0),
    "start_north": 100.0,
    "start_east": 40.0,
    "direction_deg": 90.0,
    "length": 25.0,
}


@ti.kernel
def _velocity(gust: ti.template(), points: ti.types.ndarray(ndim=2), out: ti.types.ndarray(ndim=2)):
    for i in range(points.shape[0]):
        v = gust_velocity(gust, ti.Vector([points[i, 0], points[i, 1], 0.0]), points[i, 2])
        for k in ti.static(range(3)):
            out[i, k] = v[k]


def _at(config, north, east, time):
    """Velocity [n, 3] at points and times."""
    points = np.stack(np.broadcast_arrays(*np.atleast_1d(north, east, time)), axis=1)
    points = torch.tensor(points, dtype=runtime.current().torch_dtype)
    out = torch.zeros_like(points)
    _velocity(Gust.of(GustConfig(**config)), points, out)
    return out.double().numpy()


def test_pulse_begins_peaks_and_ends(precision):
    """14 CFR 25.341: nothing, half, all, half, nothing at s = 0, H/2, H, 3H/2, 2H; nothing outside."""
    v = _at(TIME, 0.0, 0.0, np.array([0.0, 5.0, 6.0, 7.0, 8.0, 9.0, 20.0]))
    fraction = np.array([0, 0, 0.5, 1, 0.5, 0, 0])
    assert np.abs(v - fraction[:, None] * TIME["amplitude"]).max() < ROUNDING[precision]


def test_ramp_stays(precision):
    """MIL-F-8785C: the amplitude remains."""
    v = _at(TIME | {"shape": "ramp"}, 0.0, 0.0, np.array([4.0, 5.0, 6.0, 7.0, 8.0, 1000.0]))
    fraction = np.array([0, 0, 0.5, 1, 1, 1])
    assert np.abs(v - fraction[:, None] * TIME["amplitude"]).max() < ROUNDING[precision]


def test_impulse_of_a_pulse_is_amplitude_times_length(precision):
    """The integral of (1 - cos(pi s / H)) / 2 over 0..2H is H; the slope is at most pi / (2 H)."""
    t = np.linspace(4.0, 10.0, 6001)
    v = _at(TIME, 0.0, 0.0, t)
    step = t[1] - t[0]
    assert np.abs(v.sum(axis=0) * step - 2.0 * np.array(TIME["amplitude"])).max() < 1e-4
    slope = np.abs(np.diff(v[:, 2])).max() / step
    assert slope == pytest.approx(9.0 * np.pi / (2 * 2.0), rel={"f64": 1e-5, "f32": 5e-3}[precision])


def test_place_is_met_by_flying_into_it(precision):
    """Deepens eastward from east 40 m: peak at 65 m whatever north and time."""
    v = _at(
        PLACE, np.array([0.0, 500.0, -3.0, 0.0]), np.array([65.0, 65.0, 52.5, 39.0]), np.array([0.0, 9.0, 0.0, 0.0])
    )
    assert np.abs(v[:, 2] - np.array([-9.0, -9.0, -4.5, 0.0])).max() < 10 * ROUNDING[precision]


@pytest.mark.parametrize(
    "data",
    [
        {"amplitude": (1.0, 0.0, 0.0)},
        TIME | PLACE,
        {"amplitude": (1.0, 0.0, 0.0), "start_time": 1.0},
        {key: value for key, value in PLACE.items() if key != "direction_deg"},
    ],
)
def test_a_gust_has_one_time_or_one_place(data):
    with pytest.raises(ConfigError, match="give either start_time, rise_time, or start_north"):
        validate(GustConfig, data, "test.toml")


def test_a_gust_is_finite():
    with pytest.raises(ConfigError, match="amplitude.1 = nan"):
        validate(GustConfig, TIME | {"amplitude": (1.0, float("nan"), 0.0)}, "test.toml")
