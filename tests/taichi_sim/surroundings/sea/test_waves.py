import json

import numpy as np
import pytest
import torch

from taichi_sim.config import SeaConfig, SwellConfig
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.surroundings.sea import Sea, SteepSeaError
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("precision")
TOLERANCE = {"f64": 1e-9, "f32": 2e-5}  # m, m/s
UP = np.array([1.0, 1.0, -1.0])


@pytest.fixture
def tolerance(precision):
    return TOLERANCE[precision]


@pytest.fixture
def sea():
    """A steep, short-crested sea: sum ka about 0.8."""
    return Sea.from_config(SeaConfig(hs=1.2, tp=4.0, components=16, realisations=3), seed=5)


def _points(n=60, span=80.0, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-span, span, n), rng.uniform(-span, span, n), rng.uniform(0, 100, n)


def _reference_sea(folder, name):
    data = json.loads((folder / "waves" / f"{name}.json").read_text())
    parts = [np.array([[c[key] for c in data["components"]]]) for key in ("a", "k", "omega", "dir_rad", "phase")]
    return Sea(Components(*parts), data["depth_m"])


@pytest.mark.parametrize("name", ["sea6_deep", "sea8_depth6"])
def test_surface_agrees_with_an_independent_inversion(name, reference, columns, tolerance):
    sea, q = _reference_sea(reference, name), columns(f"waves/{name}_gerstner_queries.csv")
    s = sea.surface(q.x, q.y, q.t)
    velocity, normal = np.stack((q.vx, q.vy, q.vz), 1), np.stack((q.nx, q.ny, q.nz), 1)
    assert np.abs(s.elevation.numpy() - q.eta).max() < tolerance
    assert np.abs(s.label[:, 0].numpy() - q.X_label).max() < tolerance
    assert np.abs(s.velocity.numpy() * UP - velocity).max() < tolerance
    assert np.abs(s.normal.numpy() * UP - normal).max() < tolerance
    assert np.abs(s.jacobian.numpy() - q.detJ).max() < tolerance


@pytest.mark.parametrize("name", ["sea6_deep", "sea8_depth6"])
def test_linear_water_agrees_with_the_closed_form(name, reference, columns, tolerance):
    sea, q = _reference_sea(reference, name), columns(f"waves/{name}_airy_velocity_pressure.csv")
    velocity, pressure = sea.airy(q.x, q.y, -q.z, q.t)
    assert np.abs(velocity.numpy() * UP - np.stack((q.vx, q.vy, q.vz), 1)).max() < tolerance
    assert np.abs(pressure.numpy() - q.p_dyn_Pa).max() < tolerance * 1025 * GRAVITY


def test_label_of_a_point_maps_back_to_it(sea, tolerance):
    """x = X - sum b sin(k X - omega t + phase), evaluated in NumPy at our label."""
    x, y, t = _points()
    label = sea.surface(x, y, t).label.double().numpy()
    c = sea.components
    kx, ky = c.k[0] * np.cos(c.direction[0]), c.k[0] * np.sin(c.direction[0])
    theta = label[:, :1] * kx + label[:, 1:] * ky - t[:, None] * c.omega[0] + c.phase[0]
    b = c.amplitude[0] * np.sin(theta)
    back = label - np.stack(((b * np.cos(c.direction[0])).sum(1), (b * np.sin(c.direction[0])).sum(1)), 1)
    # f32 rounds k and omega of the table itself; over 80 m and 100 s that moves a phase by 1e-5
    assert np.abs(back - np.stack((x, y), 1)).max() < 2 * tolerance


@pytest.mark.parametrize("ka", [0.1, 0.5, 0.9])
def test_single_wave_crest_trough_and_mean_level(ka, single_wave, tolerance):
    """Crest a, trough -a, mean -k a^2 / 2 (Lamb 1932, art. 251), steepest slope ka / sqrt(1 - (ka)^2)."""
    wavelength = 20.0
    k = 2 * np.pi / wavelength
    sea = single_wave(wavelength, ka / k)
    x = wavelength * np.arange(4096) / 4096
    surface = sea.surface(x, 0.0, 0.0)
    zeta, normal = surface.elevation.double().numpy(), surface.normal.double().numpy()
    assert zeta.max() == pytest.approx(ka / k, abs=tolerance)
    assert zeta.min() == pytest.approx(-ka / k, abs=tolerance)
    assert zeta.mean() == pytest.approx(-(ka**2) / k / 2, abs=tolerance)
    assert sea.mean_level() == pytest.approx(-(ka**2) / k / 2)
    assert np.abs(normal[:, 0] / normal[:, 2]).max() == pytest.approx(ka / np.sqrt(1 - ka**2), rel=1e-3)


def test_crest_travels_at_the_phase_speed_in_its_direction(single_wave):
    """c = sqrt(g / k) toward the wave's direction, so the crest at the origin is at c t later."""
    wavelength, direction = 30.0, 0.7
    sea = single_wave(wavelength, 0.5, direction)
    c, t = np.sqrt(GRAVITY * wavelength / (2 * np.pi)), 3.0
    crest = sea.elevation(c * t * np.cos(direction), c * t * np.sin(direction), t)
    assert float(crest) == pytest.approx(0.5, abs=1e-6)


def test_velocity_and_acceleration_are_the_rates_of_a_particle(sea, precision):
    """Follow particles: central differences of where they are, and of the velocity the sea gives there."""
    step = 1e-3 if precision == "f64" else 5e-2
    x, y, t = _points(20)
    here = sea.surface(x, y, t)
    label = here.label.double().numpy()
    c = sea.components
    kx, ky = c.k[0] * np.cos(c.direction[0]), c.k[0] * np.sin(c.direction[0])

    def follow(time):
        theta = label[:, :1] * kx + label[:, 1:] * ky - time[:, None] * c.omega[0] + c.phase[0]
        b = c.amplitude[0] * np.sin(theta)
        px = label[:, 0] - (b * np.cos(c.direction[0])).sum(1)
        py = label[:, 1] - (b * np.sin(c.direction[0])).sum(1)
        surface = sea.surface(px, py, time)
        position = np.stack((px, py, -surface.elevation.double().numpy()), 1)
        return position, surface.velocity.double().numpy()

    (x0, v0), (x1, v1) = follow(t - step), follow(t + step)
    limit = 1e-5 if precision == "f64" else 2e-2
    assert np.abs(here.velocity.double().numpy() - (x1 - x0) / (2 * step)).max() < limit
    assert np.abs(here.acceleration.double().numpy() - (v1 - v0) / (2 * step)).max() < limit


def test_the_column_meets_the_surface(sea, tolerance):
    """At the instantaneous surface: no pressure, and the water moves as the surface particle does."""
    x, y, t = _points()
    surface = sea.surface(x, y, t, sea=1)
    down = -surface.elevation
    head = sea.pressure(x, y, down, t, sea=1) / (RHO_SEA * GRAVITY)
    water = sea.kinematics(x, y, down, t, sea=1)
    assert head.abs().max() < tolerance
    assert (water.velocity - surface.velocity).abs().max() < tolerance
    assert (water.acceleration - surface.acceleration).abs().max() < 2 * tolerance  # m/s^2: omega^2 larger
    assert sea.pressure(x, y, down - 0.5, t, sea=1).max() == 0.0  # in the air


def test_pressure_following_gerstners_particles(columns, single_wave):
    """Gerstner's own pressure is constant along an orbit; ours is higher by up to rho g k a^2 / 2, far below.

    There it counts from still water, but the mean of Gerstner's surface is k a^2 / 2 lower. For k a = 0.16 that is at
    most 0.6 % of the pressure at any depth.
    """
    table = columns("hydrostatics/gerstner_exact_pressure_lambda20_a0.5.csv")
    a, k = 0.5, 2 * np.pi / 20.0
    sea, omega = single_wave(20.0, a), np.sqrt(GRAVITY * k)
    t = np.linspace(0, 2 * np.pi / omega, 40)
    for b, exact in zip(table.label_depth_b, table.gauge_pressure_Pa, strict=True):
        radius = a * np.exp(k * b)
        x, z = radius * np.sin(omega * t), b + radius * np.cos(omega * t)
        error = np.abs(sea.pressure(x, 0.0, -z, t).double().numpy() - exact).max()
        assert error < 0.5 * k * a**2 * RHO_SEA * GRAVITY
        assert error < 6e-3 * exact + 0.5  # Pa: rounding of f32 at the surface


def test_normal_is_orthogonal_to_the_surface(sea, precision):
    """Tangents by finite differences of the elevation."""
    step = 1e-4 if precision == "f64" else 2e-2
    x, y, t = _points()
    normal = sea.surface(x, y, t).normal.double().numpy()
    zero, two = np.zeros_like(x), np.full_like(x, 2 * step)
    dx = (sea.elevation(x + step, y, t) - sea.elevation(x - step, y, t)).double().numpy()
    dy = (sea.elevation(x, y + step, t) - sea.elevation(x, y - step, t)).double().numpy()
    for tangent in (np.stack((two, zero, -dx), 1), np.stack((zero, two, -dy), 1)):
        unit = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
        assert np.abs((unit * normal).sum(1)).max() < (1e-6 if precision == "f64" else 2e-3)
    assert np.allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-6)
    assert (normal[:, 2] < 0).all()


def test_phases_agree_with_numpy_after_long_times(sea, precision):
    """At 1e6 s the phases still belong to the table's frequencies, to rounding."""
    time = torch.tensor([1e6, 1e6 + 0.02, 3.3e5], dtype=torch.float64)
    phase = sea.phases(torch.tensor([0, 1, 2], dtype=torch.int32), time).double().numpy()
    omega = sea.table[:, 4].double().numpy()
    exact = sea.components.phase - omega * time.numpy()[:, None]
    error = np.abs(np.exp(1j * phase) - np.exp(1j * exact))
    assert error.max() < (2e-9 if precision == "f64" else 1e-6)
    assert phase.min() >= 0 and phase.max() <= 2 * np.pi + 1e-6


def test_grid_equals_points(sea):
    north, east = np.linspace(-20, 20, 9), np.linspace(-10, 30, 7)
    grid = sea.elevation_grid(north, east, time=12.0, sea=1)
    points = sea.elevation(north[:, None], east[None, :], 12.0, sea=1).numpy()
    assert grid.shape == (9, 7)
    assert np.abs(grid - points).max() < 1e-6


@pytest.mark.parametrize("config", [SeaConfig(hs=0.0, tp=4.0), SeaConfig(sea_state=0)])
def test_a_calm_sea_is_flat_and_still(config):
    """Elevation 0, hydrostatic pressure, no motion; finite everywhere."""
    sea = Sea.from_config(config, seed=1)
    surface = sea.surface([0.0, 7.0], 3.0, 5.0)
    assert not surface.elevation.any() and not surface.velocity.any() and not surface.acceleration.any()
    assert sea.pressure(1.0, 2.0, [-1.0, 2.0], 5.0).numpy() == pytest.approx([0.0, 2.0 * RHO_SEA * GRAVITY])


@pytest.mark.parametrize(
    "config",
    [
        SeaConfig(hs=3.0, tp=3.0),
        SeaConfig(hs=1.2, tp=4.0, swell=SwellConfig(hs=1.0, tp=4.0)),
        SeaConfig(hs=1.0, tp=10.0, depth=0.3),
    ],
    ids=["wind sea", "with swell", "shallow"],
)
def test_too_steep_a_sea_is_refused(config):
    with pytest.raises(SteepSeaError, match=r"sum of k a = \d.* in realisation \d+.*sea\.hs.*sea\.tp.*sea\.components"):
        Sea.from_config(config, seed=1)


@pytest.mark.parametrize("a", [0.95, 0.99])
def test_a_wave_that_is_almost_a_cusp_inverts_exactly(a, single_wave, tolerance):
    """x = X - a sin kX with k = 1 at 1000 points of one wave, the crest included."""
    sea = single_wave(2 * np.pi, a)
    X = np.linspace(-np.pi, np.pi, 1000)
    s = sea.surface(X - a * np.sin(X), 0.0, 0.0)
    assert np.abs(s.elevation.double().numpy() - a * np.cos(X)).max() < tolerance


def test_queries_of_a_realisation_out_of_range_are_refused(sea):
    with pytest.raises(IndexError, match="sea 3: there are 0 to 2"):
        sea.elevation(0.0, 0.0, 0.0, sea=3)
