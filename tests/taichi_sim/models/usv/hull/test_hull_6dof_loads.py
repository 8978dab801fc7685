"""Water's load on a held `hull_6dof`: hydrostatics and Froude-Krylov against closed forms and NumPy."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.usv.hull.water import STRIPS
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("precision")

GM, BM = 19 / 60, 2 / 3  # m, metacentric height and radius of the barge


def held(team, pose, heading=0.0):
    """Hold vehicles at poses [env, 3] = heave (m), roll, pitch (rad)."""
    heave, roll, pitch = torch.as_tensor(np.array(pose, dtype=np.float64), dtype=team.state.dtype).T
    team.state[:, 0, 2] = heave
    team.state[:, 0, 3:7] = torch_quaternion_from_euler(roll, pitch, torch.full_like(roll, heading))
    return team


def pressure_of(team):
    """Load of the water [env, 6], N and N m, in b."""
    return team.model.pressure_load(team.state, team.around)[:, 0].double().numpy()


@pytest.fixture(scope="module")
def barge(precision, constant_model):
    return constant_model("barge")


@pytest.mark.parametrize("name", ["otter", *(pytest.param(x, marks=pytest.mark.slow) for x in ("wamv", "barge"))])
def test_the_kernel_sums_the_pressure_as_numpy_does(name, precision, constant_model, bench):
    """Random poses, awash and capsized ones too; the NumPy sum is proven against closed forms in test_hydrostatics.

    While keel and deck do not cross the water, the kernel does not take back the strips' errors.
    """
    model = constant_model(name)
    poses = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * [0.3, 3.1, 1.4]
    load = pressure_of(held(bench(model, envs=400), poses, heading=0.6))
    expected = replace(model.geometry.hydrostatics, strips=STRIPS).buoyancy(poses)
    strips = replace(model.geometry.hydrostatics, strips=STRIPS).strip_load(poses)
    limit = model.params.weight * (1e-9 if precision == "f64" else 1e-5)
    error = np.minimum(np.abs(load - expected).max(axis=1), np.abs(load - strips).max(axis=1))
    assert error.max() < limit
    assert np.abs(expected).max() > model.params.weight  # some are deep


def test_heeled_box_has_the_wall_sided_righting_arm(barge, bench):
    """GZ = sin phi (GM + BM tan^2 phi / 2) of pressure and weight about CO, where they balance."""
    heel = np.deg2rad(np.arange(5.0, 21.0, 5.0))
    # CO stays in the surface: what one side gains the other loses
    load = pressure_of(held(bench(barge, envs=4), np.stack([0 * heel, heel, 0 * heel], axis=1)))
    weight = barge.params.weight
    down = load[:, 1] * np.sin(heel) + load[:, 2] * np.cos(heel)
    assert down == pytest.approx(-weight * np.ones(4), rel=1e-5)
    cg = barge.params.rigid_body.cg[2]
    moment = load[:, 3] - weight * cg * np.sin(heel)
    wall_sided = np.sin(heel) * (GM + BM * np.tan(heel) ** 2 / 2)
    assert -moment / weight == pytest.approx(wall_sided, rel=1e-4)


def in_world(team):
    """Force and moment of the water [env, 3] about CO, in n."""
    R = torch_rotation_matrix(team.state[:, 0, 3:7].double())
    return ((R @ part[..., None])[..., 0] for part in torch.as_tensor(pressure_of(team)).split(3, dim=1))


TILTED = (  # heave over the draft, roll and pitch (deg) from rest
    (0.3, 10.0, 5.0),  # the keel and the deck of an Otter cross the water
    (0.3, 20.0, 10.0),
    (1.0, 178.0, 80.0),  # awash and capsized
)


@pytest.mark.parametrize("name", ["otter", "wamv", "barge", pytest.param("kvlcc2_6dof", marks=pytest.mark.slow)])
def test_still_water_only_pushes_upwards(name, precision, constant_model, bench):
    """Archimedes: the pressure on a closed surface has no force along the water, and no moment about the vertical."""
    model = constant_model(name)
    rest, rng = model.geometry.hydrostatics.equilibrium, np.random.default_rng(1)
    reach = np.array(TILTED) * [model.draft, *np.deg2rad([1.0, 1.0])]
    poses = np.concatenate([rest + rng.uniform(-1, 1, (200, 3)) * most for most in reach])
    force, moment = in_world(held(bench(model, envs=len(poses)), poses, heading=0.6))
    assert force[:, :2].abs().max() < 2e-5 * model.params.weight
    assert moment[:, 2].abs().max() < 2e-5 * model.params.weight * model.params.length
    # the strips alone miss it by more (kernels and NumPy add them up alike, above)
    strips = replace(model.geometry.hydrostatics, strips=STRIPS).strip_load(poses)
    assert np.abs(strips - model.geometry.hydrostatics.buoyancy(poses)).max() > 1e-3 * model.params.weight


def regular_waves(omega, amplitude, direction):
    """Deep water, one wave a realisation: arrays [sea]; a crest at the origin at time 0."""
    k = np.square(omega) / GRAVITY
    rows = (amplitude * np.ones_like(k), k, omega, direction * np.ones_like(k), np.zeros_like(k))
    return Sea(Components(*(np.asarray(r, dtype=np.float64)[:, None] for r in rows)))


@pytest.fixture(scope="module")
def fine(precision, constant_model):
    return constant_model("barge", hull={"panels_along": 24, "panels_across": 8, "panels_up": 3})


@pytest.mark.slow
def test_a_long_wave_pushes_a_tilted_hull_down_its_slope(fine, bench):
    """The pressure's gradient is the same all over a hull in a long wave: rho g V along the surface's normal, at any
    tilt relative to the surface; the undisturbed wave's force is the part towards the trough.

    The wave is 100 hulls long and has a slope of 3 %. Panels sample it with an error of 5 %, however it is clipped.
    """
    length = 100 * fine.params.length
    omega, slope = np.sqrt(GRAVITY * 2 * np.pi / length), 0.03
    sea = regular_waves(np.array([omega]), slope * length / (2 * np.pi), 0.0)
    rest = fine.geometry.hydrostatics.equilibrium
    poses = rest + np.random.default_rng(2).uniform(-1, 1, (100, 3)) * [0.1, *np.deg2rad([20.0, 10.0])]
    team = held(bench(fine, sea, envs=100), poses, heading=0.6)
    team.time[:] = torch.full((100,), np.pi / 2 / omega, dtype=torch.float64)  # the steepest place, at mean level
    team.refresh()
    force, _ = in_world(team)
    north, east = (force[:, :2] / force[:, 2:]).T.numpy()
    assert np.hypot(np.abs(north) - slope, east).max() < 0.06 * slope


@pytest.mark.parametrize("precision", ["f64", pytest.param("f32", marks=pytest.mark.slow)], scope="module")
@pytest.mark.parametrize("heading_to", [0.0, 180.0])
def test_froude_krylov_load_on_a_box_of_fine_panels(heading_to, fine, columns, bench):
    """Surge, heave and pitch of the closed form, in and out of phase; heave is zero at L / lambda = 1.

    The closed form is linear: crest minus trough of a wave of 2 mm, per metre. Its frame is z up, time as exp(-i w t).
    """
    table = columns("hydrostatics/froude_krylov_box.csv")
    chosen = (table.beta_deg == heading_to) & (table.depth == -1) & (table.L_over_lambda < 1.4)
    omega = table.omega[chosen]
    amplitude = 2e-3
    team = bench(fine, regular_waves(omega, amplitude, np.deg2rad(heading_to)), envs=len(omega))
    loads = []
    for quarter in range(4):
        team.time[:] = torch.as_tensor(quarter * np.pi / 2 / omega)
        team.refresh()
        loads.append(pressure_of(team))
    real, imaginary = (loads[0] - loads[2]) / (2 * amplitude), (loads[1] - loads[3]) / (2 * amplitude)
    for row, sign, name, tolerance in ((0, 1, "F1", 0.01), (2, -1, "F3", 0.01), (4, -1, "F5", 0.02)):
        re, im = getattr(table, f"{name}_re")[chosen], getattr(table, f"{name}_im")[chosen]
        size = np.hypot(re, im).max()
        assert sign * real[:, row] == pytest.approx(re, rel=tolerance, abs=tolerance * size)
        assert sign * imaginary[:, row] == pytest.approx(im, rel=tolerance, abs=tolerance * size)
