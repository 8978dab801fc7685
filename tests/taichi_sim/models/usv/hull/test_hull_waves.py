"""What waves do at a hull: pressure along its lines, its mean surface plane, the water's motion averaged over it."""

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.config.io import load_world
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.kernels.lanes import laned, laned1, laned2
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.usv.hull import water
from taichi_sim.models.usv.hull.geometry import Gauge, HullGeometry, wave_points
from taichi_sim.models.usv.hull.mesh import WigleyHull
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components, wavenumber

pytestmark = pytest.mark.usefixtures("f64")


def waves(amplitude, k, direction, phase, depth=None):
    """A sea of arrays [sea, component]."""
    amplitude, k, direction, phase = np.broadcast_arrays(amplitude, k, direction, phase)
    omega = np.sqrt(GRAVITY * k * (1.0 if depth is None else np.tanh(k * depth)))
    return Sea(Components(amplitude, k, omega, direction, phase), depth)


@pytest.fixture(scope="module")
def otter(make_model):
    """Steps of 10 microseconds: waves and hull stand still while the label under the hull converges."""
    return make_model("otter", 1e-5, 6)


def heads_at(team, euler, heave):
    """Hold hulls at attitudes [env, 3]: pressure heads (m) and their changes to starboard [env, point], and R_nb."""
    team.state[:, 0, 2] = torch.as_tensor(heave)
    team.state[:, 0, 3:7] = torch_quaternion_from_euler(*torch.as_tensor(euler).T)
    R = torch_rotation_matrix(team.state[:, 0, 3:7]).numpy()
    team.step([-1.0, 0.0])
    sizes, aux = team.model.pressure, team.aux[:, 0].numpy()
    heads = sizes.column(np.arange(sizes.groups * sizes.size))
    return aux[:, heads], aux[:, heads + sizes.size], R


@pytest.mark.slow
def test_heads_are_the_linear_pressure_averaged_over_a_step_of_the_line(otter, bench):
    """sum a exp(-k d) cos(k . x + phase), times sin(h)/h of half the turn h from point to point; tiny waves."""
    rng = np.random.default_rng(2)
    shape = (30, 3)
    a, k = rng.uniform(0.5, 1.0, shape) * 1e-6, rng.uniform(0.02, 4.0, shape)
    direction, phase = rng.uniform(-np.pi, np.pi, (2, *shape))
    euler = rng.uniform(-1, 1, (30, 3)) * [0.2, 0.1, 3.0]
    heave = 0.4  # m, deep enough that all points are wet
    head, slope, R = heads_at(bench(otter, waves(a, k, direction, phase), envs=30), euler, heave)
    points = otter.geometry.lines.position @ np.swapaxes(R, 1, 2) + [0.0, 0.0, heave]
    steps = np.repeat(otter.geometry.lines.step, otter.pressure.points, axis=0) @ np.swapaxes(R, 1, 2)
    assert points[..., 2].min() > 0
    wave = np.stack([k * np.cos(direction), k * np.sin(direction), 0 * k])  # [axis, env, component]
    theta = np.einsum("xec,epx->epc", wave, points) + phase[:, None]
    half = np.einsum("xec,epx->epc", wave, steps) / 2
    size = a[:, None] * np.exp(-k[:, None] * points[..., 2:]) * np.sinc(half / np.pi)
    across = np.einsum("xec,ex->ec", wave, R[:, :, 1])[:, None]
    limit = 5e-4 * a.max()  # short exponentials are polynomials
    assert head == pytest.approx(np.sum(size * np.cos(theta), axis=2), abs=limit)
    assert slope == pytest.approx(-np.sum(across * size * np.sin(theta), axis=2), abs=limit * k.max())


@pytest.mark.slow
def test_pressure_at_every_wet_wave_point_of_the_shipped_sea(otter, bench):
    """The whole pressure where each panel wants it, against the sea's own, which inverts labels there; random poses."""
    sea = Sea.from_config(load_world("paper").sea, seed=3)
    envs, rng = sea.num_seas, np.random.default_rng(4)
    index = np.arange(envs)
    team = bench(otter, sea, envs=envs)
    team.state[:, 0, :2] = torch.as_tensor(rng.uniform(-500, 500, (envs, 2)))
    surface = sea.elevation(team.state[:, 0, 0], team.state[:, 0, 1], 0.0, index)
    heads, slopes, R = heads_at(team, rng.uniform(-1, 1, (envs, 3)) * [0.1, 0.1, np.pi], -surface)
    geometry = otter.geometry
    wanted, node = wave_points(geometry.panels), geometry.lines.node
    aside = wanted[:, 1] - geometry.lines.position[node, 1]
    head = heads[:, node] + aside * slopes[:, node]
    points = team.state[:, 0, None, :3].numpy() + wanted @ np.swapaxes(R, 1, 2)
    exact = sea.pressure(*np.moveaxis(points, -1, 0), 0.0, index[:, None]).numpy() / (RHO_SEA * GRAVITY)
    wet = exact > 0.02  # m
    error = (head + points[..., 2] - exact)[wet]
    assert wet.mean() > 0.4
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(head[wet] ** 2))


@pytest.mark.parametrize(("vehicle", "abreast"), [("otter", 2), ("fpso", 1)])
def test_no_line_is_summed_twice_where_few_have_a_parallel(vehicle, abreast, make_model):
    """Lines come in pairs, or alone; then no two are the same."""
    lines = make_model(vehicle, 0.02, 1).geometry.lines
    assert lines.abreast == abreast
    assert len(np.unique(np.hstack([lines.start, lines.step]), axis=0)) == len(lines.start)


def centre_of(gauge, sea, finite=False, heading=0.0, tau=0.0):
    """water.at_centre [sea, 18] at the label (0, 0), all realisations at time 0."""
    count = sea.num_components
    cos_h, sin_h = float(np.cos(heading)), float(np.sin(heading))

    @ti.kernel
    def kernel(out: ti.types.ndarray(ndim=2), table: laned1, phase: laned2, t: ti.f64):
        for s in range(out.shape[0]):
            zero = t * 0.0
            r = water.at_centre(table, phase, count, gauge, finite, s, s, zero, zero, t, zero + cos_h, zero + sin_h)
            for c in ti.static(range(18)):
                out[s, c] = r[c]

    rows = torch.arange(sea.num_seas, dtype=torch.int32)
    phase = sea.phases(rows, torch.zeros(sea.num_seas, dtype=torch.float64))
    out = torch.empty((sea.num_seas, 18), dtype=runtime.current().torch_dtype)
    results = []
    for t in np.atleast_1d(tau):
        kernel(out, laned(sea.table).flatten(0, -2), laned(phase), float(t))
        results.append(out.numpy().copy())
    return results[0] if np.ndim(tau) == 0 else results


def rectangle(length, beam, depth=0.0, cells=8):
    """Gauge of a rectangle from its cells."""
    x = (np.arange(cells) + 0.5) / cells - 0.5
    point = np.stack(np.meshgrid(x * length, x * beam, indexing="ij"), axis=-1).reshape(-1, 2)
    half = np.full_like(point, 1.0) * [length / 2 / cells, beam / 2 / cells]
    return Gauge.of(point, np.ones(len(point)), half, depth)


def factors(gauge, k, direction):
    """Shares [wavenumber] of waves of k (rad/m) that are left in the mean plane: of their height, and of their slope
    along the hull (direction 0) or across it (pi / 2).
    """
    crest, flank = (centre_of(gauge, waves(1e-3, k[:, None], direction, phase)) for phase in (0.0, -np.pi / 2))
    return crest[:, 5] / 1e-3, flank[:, 7 if direction else 6] / (1e-3 * k)


def test_mean_and_slope_over_a_rectangle():
    """A wave's mean over length 2 h is sin x / x and its least-squares slope 3 (sin x - x cos x) / x^3, x = k h: from
    10 lengths down to 0.3. Waves shorter than a quarter of the length leave nothing.
    """
    gauge, x = rectangle(4.0, 1.0), np.pi / np.geomspace(0.3, 10.0, 40)
    mean, slope = np.sin(x) / x, 3 * (np.sin(x) - x * np.cos(x)) / x**3
    for half, direction in ((2.0, 0.0), (0.5, np.pi / 2)):
        ours = factors(gauge, x / half, direction)
        assert ours[0] == pytest.approx(mean, abs=0.004)
        assert ours[1] == pytest.approx(slope, abs=0.001)
        assert np.abs(factors(gauge, np.array([4.0, 6.0]) * np.pi / half, direction)).max() < 1e-9


def test_long_waves_leave_what_the_second_and_fourth_moment_say():
    """1 - m2 k^2/2 + m4 k^4/24 of the height and 1 - m4/(6 m2) k^2 of the slope, the next terms left out."""
    gauge, x = rectangle(4.0, 1.0), np.linspace(0.05, 0.3, 6)
    mean, slope = factors(gauge, x / 2.0, 0.0)
    assert np.abs(mean - (1 - x**2 / 6 + x**4 / 120)).max() < 0.3**6 / 5000
    assert np.abs(slope - (1 - x**2 / 10)).max() < 0.3**4 / 250


def test_mean_and_slope_over_two_thin_pontoons():
    """Between pontoons at +-y: mean cos(k y), slope sin(k y) / (k y), to waves of 0.3 of the beam."""
    y = 1.5
    point = np.array([[x, side * y] for x in (-1.0, 1.0) for side in (-1, 1)])
    gauge = Gauge.of(point, np.ones(4), np.array([[1.0, 1e-3]] * 4), 0.0)
    ky = np.linspace(0.1, 10.4, 60)
    mean, slope = factors(gauge, ky / y, np.pi / 2)
    assert mean == pytest.approx(np.cos(ky), abs=0.015)
    assert slope == pytest.approx(np.sin(ky) / ky, abs=0.004)


def direct(panels, axis, k):
    """Mean [k] of cos(k x), and of x sin(k x) / (k x^2), over the panels that face down, x along `axis` from their
    centre: sums over 60 x 60 pieces of each bilinear patch.
    """
    s, t = np.meshgrid(*[(np.arange(60) + 0.5) / 30 - 1] * 2)
    facing = panels.area[:, 2] > 0
    c, along, up, twist = (v[facing, None, None] for v in (panels.centre, panels.along, panels.up, panels.twist))
    s, t = s[..., None], t[..., None]
    point = c + s * along + t * up + s * t * twist
    weight = np.abs(np.cross(along + t * twist, up + s * twist)[..., 2]).ravel()
    x = point[..., axis].ravel()
    x = x - weight @ x / weight.sum()
    mean = np.array([weight @ np.cos(q * x) for q in k]) / weight.sum()
    return mean, np.array([weight @ (x * np.sin(q * x)) for q in k]) / (k * (weight @ x**2))


@pytest.mark.parametrize("name", ["otter", "wamv", "wigley"])
def test_mean_and_slope_over_the_hulls_own_waterplane(name, make_model):
    """Waves of 0.3 to 10 of its length along it, of its beam across it."""
    if name == "wigley":
        geometry = HullGeometry.of(WigleyHull(length=4.0, beam=0.8, draft=0.3, freeboard=0.3), 400.0, (0.0, 0.0, 0.0))
    else:
        geometry = make_model(name, 1e-5, 6).geometry
    corners = geometry.panels.deck
    for axis, direction in ((0, 0.0), (1, np.pi / 2)):
        k = 2 * np.pi / (np.geomspace(0.3, 10.0, 30) * np.ptp(corners[:, axis]))
        mean, slope = direct(geometry.panels, axis, k)
        ours = factors(geometry.gauge, k, direction)
        assert ours[0] == pytest.approx(mean, abs=0.015)
        assert ours[1] == pytest.approx(slope, abs=0.002)


def some_long_waves(depth=None):
    """Three systems at once, 100 to 400 m long, in 20 realisations."""
    rng = np.random.default_rng(6)
    k = 2 * np.pi / rng.uniform(100, 400, (20, 3))
    return waves(rng.uniform(5e-5, 1e-4, (20, 3)), k, *rng.uniform(-np.pi, np.pi, (2, 20, 3)), depth)


@pytest.mark.parametrize("depth", [None, 6.0])
def test_a_small_hull_in_long_waves_feels_the_sea_at_its_place(depth):
    """Elevation, slopes, orbital velocity and acceleration at the gauge's depth, as Sea gives them."""
    sea, heading, below = some_long_waves(depth), 0.9, 0.3
    r = centre_of(rectangle(0.2, 0.1, below), sea, depth is not None, heading)
    index = torch.arange(20)
    surface = sea.surface(0.0, 0.0, 0.0, index)
    label = surface.label.numpy()
    assert r[:, :2] == pytest.approx(label, abs=1e-3 * np.abs(label).max())
    assert r[:, 5] == pytest.approx(surface.elevation.numpy(), abs=1e-3 * 3e-4)
    normal = surface.normal.numpy()
    north, east = normal[:, 0] / normal[:, 2], normal[:, 1] / normal[:, 2]
    slope = np.hypot(north, east).max()
    assert r[:, 6] == pytest.approx(north * np.cos(heading) + east * np.sin(heading), abs=2e-3 * slope)
    assert r[:, 7] == pytest.approx(east * np.cos(heading) - north * np.sin(heading), abs=2e-3 * slope)
    water = sea.kinematics(0.0, 0.0, below, 0.0, index)
    for columns, exact in ((r[:, 8:11], water.velocity.numpy()), (r[:, 11:14], water.acceleration.numpy())):
        assert columns == pytest.approx(exact, abs=3e-3 * np.abs(exact).max())


def test_accelerations_are_rates_of_velocities_and_the_plane_turns_with_its_slopes():
    """Central differences in time at a fixed label; at the surface the plane's heave and turns are the water's."""
    sea, h = some_long_waves(), 1e-3
    for below in (0.0, 2.0):
        before, now, after = centre_of(rectangle(30.0, 12.0, below), sea, False, 0.9, (-h, 0.0, h))
        rate = (after - before) / (2 * h)
        scale = np.abs(now).max(axis=0)
        assert now[:, 11:14] == pytest.approx(rate[:, 8:11], abs=1e-5 * scale[11:14].max())
        assert now[:, 16:18] == pytest.approx(rate[:, 14:16], abs=1e-4 * scale[16:18].max())
        if below == 0.0:
            assert now[:, 10] == pytest.approx(-rate[:, 5], abs=1e-5 * scale[10])  # down is positive
            assert now[:, 14] == pytest.approx(-rate[:, 7], abs=1e-4 * scale[14])  # starboard rises: roll to port
            assert now[:, 15] == pytest.approx(rate[:, 6], abs=1e-4 * scale[15])  # the bow rises


def test_finite_depth_tends_to_deep_water():
    rng = np.random.default_rng(8)
    k = wavenumber(rng.uniform(1.0, 3.0, (10, 2)))
    others = rng.uniform(-np.pi, np.pi, (2, 10, 2))
    gauge = rectangle(4.0, 2.0, 0.5)
    deep, far = centre_of(gauge, waves(0.05, k, *others)), centre_of(gauge, waves(0.05, k, *others, 500.0), True)
    assert far == pytest.approx(deep, rel=1e-9, abs=1e-12)


def flow_at(R, omega, V_c, sums):
    """water.flow [moment, 4, 6] of hulls at attitudes R [moment, 3, 3] that turn with `omega` (rad/s, b)."""
    turn, current = ti.Vector(list(omega)), ti.Vector(list(V_c))

    @ti.kernel
    def kernel(out: ti.types.ndarray(ndim=3), R_nb: ti.types.ndarray(ndim=3), rows: ti.types.ndarray(ndim=2)):
        for n in range(out.shape[0]):
            attitude = ti.Matrix([[R_nb[n, i, j] for j in ti.static(range(3))] for i in ti.static(range(3))])
            r = ti.Vector([rows[n, c] for c in ti.static(range(water.SUMS))])
            parts = water.flow("body", attitude, turn, current, r)
            for k in ti.static(range(4)):
                for c in ti.static(range(6)):
                    out[n, k, c] = parts[k][c]

    out = np.empty((len(R), 4, 6))
    kernel(out, R, sums)
    return out


def test_a_turning_hull_sees_the_rates_of_the_water_that_it_sees():
    """Central differences in the frame of a hull that turns about all its axes, in water of constant acceleration."""
    rng, h, omega = np.random.default_rng(9), 1e-4, np.array([0.3, -0.2, 0.5])
    cross = torch.tensor([[0.0, -omega[2], omega[1]], [omega[2], 0.0, -omega[0]], [-omega[1], omega[0], 0.0]])
    begin = torch_rotation_matrix(torch_quaternion_from_euler(*torch.tensor([0.2, -0.1, 0.8], dtype=torch.float64)))
    R = torch.stack([begin @ torch.matrix_exp(cross * t) for t in (-h, 0.0, h)]).numpy()
    V, A, turns, turns_dot = rng.uniform(-1.0, 1.0, (4, 3))  # of the water, n; its turns are about level axes
    sums = np.zeros((3, water.SUMS))
    for row, attitude, t in zip(sums, R, (-h, 0.0, h), strict=True):
        cos_h, sin_h = attitude[:2, 0] / np.hypot(*attitude[:2, 0])
        level = np.array([[cos_h, sin_h], [-sin_h, cos_h]])
        row[[water.V_N, water.V_E, water.V_D]], row[[water.A_N, water.A_E, water.A_D]] = V + t * A, A
        row[[water.P, water.Q]] = level @ (turns + t * turns_dot)[:2]
        row[[water.P_DOT, water.Q_DOT]] = level @ turns_dot[:2]
    before, now, after = flow_at(R, omega, (0.4, -0.7, 0.0), sums)
    for seen, rate in ((0, 1), (2, 3)):  # the current, and the orbital motion
        assert now[rate] == pytest.approx((after - before)[seen] / (2 * h), abs=1e-6)
    assert np.abs(now[:2, :3]).max() > 0.1 and np.abs(now[2:]).min() > 0.01
