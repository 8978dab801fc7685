"""Loads from outside on a hull: they give it energy and momentum, and nothing where they are zero."""

import numpy as np
import pytest
import torch

from taichi_sim.kernels.conventions import QUATERNION
from taichi_sim.kernels.rotation import torch_euler_from_quaternion

pytestmark = pytest.mark.usefixtures("f64")
NONE = (0.0,) * 6
DT, SUBSTEPS = 0.005, 4  # s
TIME = 4.0  # s, a heave period and a half


@pytest.fixture(scope="module")
def free(f64, constant_model):
    """The barge without damping, added mass, propellers and windage: a body on springs of water."""
    water = {"linear": NONE, "quadratic": NONE, "added_mass": NONE}
    return constant_model("barge", DT, SUBSTEPS, hydrodynamics=water, thrusters=None)


def pushed(model, bench, loads, nu=NONE):
    """A bench of hulls at rest in calm water but for nu, under loads [env, 6] (N, N m, b)."""
    team = bench(model, envs=len(loads))
    team.state[:, 0, 7:] = torch.tensor(nu, dtype=torch.float64)
    team.fleet.load[:, 0] = torch.tensor(loads, dtype=torch.float64)
    return team


def energy_of(model, team):
    """Of motion, water and weight, J [env]."""
    state, hydrostatics = team.state[:, 0], model.geometry.hydrostatics
    nu, angles = state[:, 7:].numpy(), torch_euler_from_quaternion(state[:, QUATERNION]).numpy()
    way = np.column_stack((state[:, 2].numpy(), angles[:, :2]))
    node, weight = np.polynomial.legendre.leggauss(16)
    on_the_way = hydrostatics.energy_gradient((node[:, None, None] + 1) / 2 * way)
    potential = np.einsum("s,sei,ei->e", weight / 2, on_the_way, way)
    return 0.5 * np.einsum("ei,ij,ej->e", nu, model.params.M_rb, nu) + potential


def test_work_of_a_load_is_energy(free, bench):
    """Undamped, in calm water: the energy gained is the work done, to 2 in a thousand of it: the integrator's error."""
    loads = np.array([[0, 0, 4000.0, 0, 0, 0], [0, 0, 0, 1500.0, 0, 0], [500.0, -300, 2000, 900, -1500, 800]])
    team = pushed(free, bench, loads, (0.3, 0.1, 0.0, 0.0, 0.0, 0.1))
    energy, power = [energy_of(free, team)], [np.sum(loads * team.state[:, 0, 7:].numpy(), axis=1)]
    for _ in range(round(TIME / (DT * SUBSTEPS))):
        team.step([0.0, 0.0])
        energy.append(energy_of(free, team))
        power.append(np.sum(loads * team.state[:, 0, 7:].numpy(), axis=1))
    gained, power = np.array(energy)[1:] - energy[0], np.array(power)
    work = DT * SUBSTEPS * np.cumsum(power[1:] + power[:-1], axis=0) / 2
    most = np.abs(work).max(axis=0)
    assert (np.abs(gained - work) < 2e-3 * most).all()
    assert (most > [100.0, 100.0, 1000.0]).all()  # J


def test_a_force_through_the_centre_of_gravity_is_its_momentum(free, bench):
    """m u = F t ahead, without heel or trim, and I_z r = N t about the CG above the origin; and both go on for ever."""
    body, F, N = free.params.rigid_body, 400.0, 250.0
    through_cg = [F, 0, 0, 0, body.cg[2] * F, 0]
    team = pushed(free, bench, [through_cg, [0, 0, 0, 0, 0, N]])
    team.step([0.0, 0.0], 200)
    time = 200 * DT * SUBSTEPS
    nu = team.state[:, 0, 7:].numpy()
    I_z = body.mass * body.gyration[2] ** 2
    assert nu == pytest.approx(np.array([[F * time / body.mass, 0, 0, 0, 0, 0], [0] * 5 + [N * time / I_z]]), abs=1e-9)


@pytest.mark.slow
def test_a_load_of_zero_is_no_load(free, bench):
    without, zero = bench(free), pushed(free, bench, [NONE])
    for team in (without, zero):
        team.put((0.0, 0.0, 0.1), (0.1, 0.05, 0.3), (0.5, 0.1, 0.0)).step([0.0, 0.0], 50)
    assert zero.state[0, 0].numpy() == pytest.approx(without.state[0, 0].numpy(), abs=1e-12)
