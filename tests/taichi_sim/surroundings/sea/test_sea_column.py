"""The water under the surface in double precision: mass, momentum, bottom, tables of linear theory."""

import json

import numpy as np
import pytest

from taichi_sim.config import SeaConfig, SwellConfig
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("f64")
STEP = 1e-3  # m and s, of central differences
WEIGHT = np.array([0.0, 0.0, GRAVITY])


def _scaled(reference, name, factor):
    """The sea of a reference file with every amplitude times `factor`."""
    data = json.loads((reference / "waves" / f"{name}.json").read_text(encoding="utf-8"))
    parts = {key: np.array([[c[key] for c in data["components"]]]) for key in ("a", "k", "omega", "dir_rad", "phase")}
    parts["a"] = factor * parts["a"]
    return Sea(Components(*parts.values()), data["depth_m"])


def _gradient(f, north, east, down):
    """Central differences of f (any shape [..., *]) along north, east, down, stacked last."""
    point, parts = (north, east, down), []
    for axis in range(3):
        shift = [STEP * (axis == i) for i in range(3)]
        high = f(*(p + s for p, s in zip(point, shift, strict=True))).numpy()
        low = f(*(p - s for p, s in zip(point, shift, strict=True))).numpy()
        parts.append((high - low) / (2 * STEP))
    return np.stack(parts, -1)


def _points(depth, n=50):
    rng = np.random.default_rng(2)
    return rng.uniform(-50, 50, n), rng.uniform(-50, 50, n), rng.uniform(0.3, depth, n), rng.uniform(0, 60, n)


@pytest.mark.parametrize(("name", "depth"), [("sea6_deep", 8.0), ("sea8_depth6", 5.5)])
def test_linear_water_obeys_mass_momentum_and_no_spin(name, depth, reference):
    """div u = 0, curl u = 0, du/dt = -grad p / rho, by differences of Sea.airy."""
    sea = _scaled(reference, name, 1.0)
    n, e, d, t = _points(depth)
    strain = _gradient(lambda *p: sea.airy(*p, t)[0], n, e, d)
    rate = (sea.airy(n, e, d, t + STEP)[0] - sea.airy(n, e, d, t - STEP)[0]).numpy() / (2 * STEP)
    push = -_gradient(lambda *p: sea.airy(*p, t)[1], n, e, d) / RHO_SEA
    assert np.abs(strain).max() > 0.1
    assert np.abs(strain.trace(axis1=1, axis2=2)).max() < 1e-6
    assert np.abs(strain - strain.transpose(0, 2, 1)).max() < 1e-6
    assert np.abs(rate - push).max() < 1e-6


@pytest.mark.parametrize(("name", "depth"), [("sea6_deep", 8.0), ("sea8_depth6", 5.5)])
def test_small_waves_are_the_linear_table(name, depth, reference, columns):
    """Amplitudes times 1e-5: what is left of stretching and labels is second order."""
    factor = 1e-5
    sea, q = _scaled(reference, name, factor), columns(f"waves/{name}_airy_velocity_pressure.csv")
    dynamic = (sea.pressure(q.x, q.y, -q.z, q.t).numpy() + RHO_SEA * GRAVITY * q.z) / factor
    velocity = sea.kinematics(q.x, q.y, -q.z, q.t).velocity.numpy() / factor
    inside = q.z < -1e-3
    assert inside.sum() > 5
    assert np.abs(dynamic - q.p_dyn_Pa)[inside].max() < 1e-4 * np.abs(q.p_dyn_Pa).max()
    table = np.stack((q.vx, q.vy, -q.vz), 1)
    assert np.abs(velocity - table)[inside].max() < 1e-4 * np.abs(table).max()


@pytest.mark.parametrize(("name", "depth"), [("sea6_deep", 8.0), ("sea8_depth6", 5.5)])
def test_momentum_holds_to_second_order(name, depth, reference):
    """acceleration = g - grad p / rho + O(amplitude^2): half the waves, a quarter of the error."""

    def error(factor):
        sea = _scaled(reference, name, factor)
        n, e, d, t = _points(depth)
        push = WEIGHT - _gradient(lambda *p: sea.pressure(*p, t), n, e, d) / RHO_SEA
        acceleration = sea.kinematics(n, e, d, t).acceleration.numpy()
        return np.abs(push - acceleration).max(), np.abs(acceleration).max()

    (large, scale), (small, _) = error(0.1), error(0.05)
    assert large / small == pytest.approx(4.0, rel=0.15)
    assert large < 0.05 * scale


def test_pressure_differs_from_gerstners_by_second_order(single_wave):
    """Along orbits, p / (rho g) = -b - k a^2 (1 - exp 2kb) / 2 exactly (Lamb 1932, art. 251).

    Ours is higher by k a^2 (1 - exp kb)^2 / 2, and what is left of that is third order.
    """
    wavelength, b = 20.0, -2.0
    k = 2 * np.pi / wavelength
    omega = np.sqrt(GRAVITY * k)
    t = np.linspace(0, 2 * np.pi / omega, 60)

    def error(a):
        radius = a * np.exp(k * b)
        head = single_wave(wavelength, a).pressure(radius * np.sin(omega * t), 0.0, -b - radius * np.cos(omega * t), t)
        error = head.numpy() / (RHO_SEA * GRAVITY) + b + k * a**2 * (1 - np.exp(2 * k * b)) / 2
        second = k * a**2 * (1 - np.exp(k * b)) ** 2 / 2
        return np.abs(error).max(), np.abs(error - second).max()

    (large, large_rest), (small, small_rest) = error(0.4), error(0.2)
    assert large / small == pytest.approx(4.0, rel=0.05)
    assert large_rest / small_rest == pytest.approx(8.0, rel=0.05)


@pytest.fixture(scope="module")
def steep(f64):
    """Steep short waves on swell: sum k a about 0.9."""
    return Sea.from_config(SeaConfig(hs=1.2, tp=4.0, realisations=2, swell=SwellConfig(hs=1.5, tp=12.0)), seed=5)


def test_pressure_grows_with_depth_from_the_surface_down(steep):
    rng = np.random.default_rng(0)
    n, e = rng.uniform(-100, 100, (2, 200, 1))
    below = np.linspace(0, 6, 61)
    down = below - steep.elevation(n, e, 4.0, sea=1).numpy()
    pressure = steep.pressure(n, e, down, 4.0, sea=1).numpy()
    assert steep.components.sum_ka.max() > 0.7
    assert np.abs(pressure[:, 0]).max() < 1e-6
    assert (np.diff(pressure, axis=1) > 0).all()


def test_deep_below_the_water_is_at_rest(steep):
    water = steep.kinematics(3.0, 4.0, 400.0, 1.0)
    assert water.velocity.abs().max() < 1e-3 and water.acceleration.abs().max() < 1e-3
    assert float(steep.pressure(3.0, 4.0, 400.0, 1.0)) == pytest.approx(400 * RHO_SEA * GRAVITY, rel=1e-5)


@pytest.mark.parametrize("depth", [1.5, 20.0, 1e5])
def test_nothing_crosses_the_bottom(depth):
    """Vertical velocity and acceleration vanish at the bottom under trough and crest; nothing overflows."""
    sea = Sea.from_config(SeaConfig(hs=0.3, tp=5.0, depth=depth, components=8, realisations=1), seed=2)
    north, time = np.linspace(0, 60, 40), np.linspace(0, 9, 40)
    water = sea.kinematics(north, 0.0, depth, time)
    assert water.velocity[:, 2].abs().max() < 1e-12 and water.acceleration[:, 2].abs().max() < 1e-12
    for down in (-1.0, 0.0, depth / 2, depth, 3 * depth):
        assert np.isfinite(sea.pressure(north, 0.0, down, time).numpy()).all()
        assert np.isfinite(sea.kinematics(north, 0.0, down, time).acceleration.numpy()).all()
    under = sea.pressure(north, 0.0, depth + 1.0, time) - sea.pressure(north, 0.0, depth, time)
    assert np.allclose(under.numpy(), RHO_SEA * GRAVITY, rtol=1e-6)


def test_very_deep_water_is_deep_water():
    numbers = {"hs": 1.0, "tp": 5.0, "realisations": 1}
    deep, finite = (Sea.from_config(SeaConfig(**numbers, depth=d), seed=2) for d in (None, 2000.0))
    north, down = np.linspace(0, 60, 40), np.linspace(-0.5, 20, 40)
    for f in (Sea.pressure, lambda *a: Sea.kinematics(*a).velocity, lambda *a: Sea.kinematics(*a).acceleration):
        a, b = f(deep, north, 0.0, down, 3.0).numpy(), f(finite, north, 0.0, down, 3.0).numpy()
        assert np.abs(a - b).max() < 2e-3 * np.abs(a).max()
