"""A free `hull_6dof` in still water: it keeps its energy, knows no absolute rest, and oscillates at its eigenvalues."""

import numpy as np
import pytest
import torch

from taichi_sim.kernels.rotation import (
    torch_euler_from_quaternion,
    torch_quaternion_from_euler,
    torch_rotation_matrix,
)

pytestmark = pytest.mark.usefixtures("f64")

NONE = (0.0,) * 6
UNDAMPED = {"linear": NONE, "quadratic": NONE}
CALM = {"frontal_area": 0.0, "lateral_area": 0.0}


@pytest.fixture(scope="module")
def otter(constant_model):
    return constant_model("otter")


@pytest.fixture(scope="module")
def barge(constant_model):
    return constant_model("barge")


def place(team, pose, nu=NONE, heading=0.0):
    """Put vehicles at poses [env, 3] = heave (m), roll, pitch (rad), with velocities [env, 6] in b."""
    pose = torch.as_tensor(pose, dtype=torch.float64)
    team.state[:, 0] = 0.0
    team.state[:, 0, 2] = pose[:, 0]
    team.state[:, 0, 3:7] = torch_quaternion_from_euler(pose[:, 1], pose[:, 2], torch.full_like(pose[:, 0], heading))
    team.state[:, 0, 7:] = torch.as_tensor(nu, dtype=torch.float64)
    return team


def pose_of(team):
    """Heave, roll, pitch [env, 3] and nu [env, 6]."""
    state = team.state[:, 0]
    angle = torch_euler_from_quaternion(state[:, 3:7])
    return torch.cat((state[:, 2:3], angle[:, :2]), dim=1).numpy(), state[:, 7:].numpy().copy()


def record(team, steps):
    """Poses [step + 1, env, 3] and velocities [step + 1, env, 6] of a run without thrust."""
    rows = [pose_of(team)]
    for _ in range(steps):
        rows.append(pose_of(team.step([-1.0, 0.0])))
    return (np.stack(column) for column in zip(*rows, strict=True))


def potential_energy(hydrostatics, pose):
    """Work [...] done against water and weight on the straight way from equilibrium to `pose` [..., 3], J."""
    node, weight = np.polynomial.legendre.leggauss(16)
    start = hydrostatics.equilibrium
    way = pose - start
    return sum(
        w / 2 * np.sum(hydrostatics.energy_gradient(start + (s + 1) / 2 * way) * way, axis=-1)
        for s, w in zip(node, weight, strict=True)
    )


BARGE_FREELY = pytest.param("barge", 0.02, (0.2, 0.25, 0.1), marks=pytest.mark.slow)


@pytest.mark.parametrize(("vehicle", "dt", "reach"), [BARGE_FREELY, ("otter", 0.01, (0.05, 0.15, 0.08))])
def test_an_undamped_hull_keeps_its_energy(constant_model, bench, vehicle, dt, reach):
    """Sixty seconds of heave, roll and pitch together, with some speed: bounded error of the step, no drift."""
    free = UNDAMPED | {"cross_flow_length": 0.0}
    model = constant_model(vehicle, dt, round(0.1 / dt), hydrodynamics=free, thrusters=None, windage=CALM)
    share = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.4, 0.5], [0.5, 0.6, 0.5]])
    nu = np.zeros((5, 6))
    nu[4] = [0.8, 0.2, 0.0, 0.0, 0.0, 0.3]
    team = place(bench(model, envs=5), model.geometry.hydrostatics.equilibrium + share * reach, nu)
    pose, nu = record(team, 600)
    M = model.params.M_rb + model.params.M_a
    kinetic = 0.5 * np.einsum("tei,ij,tej->te", nu, M, nu)
    energy = kinetic + potential_energy(model.geometry.hydrostatics, pose)
    assert energy / energy[0] == pytest.approx(np.ones_like(energy), abs=3e-3)  # a quarter at half dt
    assert energy[-150:].mean(0) / energy[:150].mean(0) == pytest.approx(np.ones(5), abs=1e-3)
    # not for want of motion: energy goes to and fro between its two forms
    assert (kinetic[:, :3].max(0) > 0.95 * energy[0, :3]).all()


def test_an_undamped_linear_hull_keeps_its_energy(constant_model, bench):
    model = constant_model(
        "otter", 0.01, 10, restoring="linear", linear={"payload_mass": 0.0}, thrusters=None, windage=CALM,
        hydrodynamics=UNDAMPED | {"cross_flow_length": 0.0},
    )  # fmt: skip
    team = place(bench(model, envs=3), 1e-5 * np.eye(3))  # small: -G eta is no gradient at finite angles
    pose, nu = record(team, 600)
    g = model.params.linear
    G = np.array([[g.G33, 0, g.G35], [0, g.G44, 0], [g.G35, 0, g.G55]])
    M = model.params.M_rb + model.params.M_a
    energy = 0.5 * (np.einsum("tei,ij,tej->te", nu, M, nu) + np.einsum("tei,ij,tej->te", pose, G, pose))
    assert energy / energy[0] == pytest.approx(np.ones_like(energy), abs=2e-3)


def motion_matrix(model):
    """A [9, 9] of d/dt (heave, roll, pitch, nu), from stiffness, inertia and linear damping."""
    hydrostatics = model.geometry.hydrostatics
    D = np.diag(model.params.hydrodynamics.linear)
    M = model.params.M_rb + model.params.M_a
    A = np.zeros((9, 9))
    A[0, 5] = A[1, 6] = A[2, 7] = 1.0
    A[3:, 3:] = -np.linalg.solve(M, D)
    A[3:, :3] = -np.linalg.solve(M, np.eye(6)[:, 2:5] @ hydrostatics.stiffness(hydrostatics.equilibrium))
    return A


@pytest.mark.parametrize("name", ["otter", pytest.param("barge", marks=pytest.mark.slow)])
def test_heave_roll_and_pitch_decay_at_their_eigenvalues(name, bench, request):
    """Each coupled damped mode, started alone at up to 3 cm or 3 degrees: its period, and all of its motion."""
    model = request.getfixturevalue(name)
    value, vector = np.linalg.eig(motion_matrix(model))
    modes = np.flatnonzero(value.imag > 1e-6)
    assert len(modes) == 3
    start = vector[:, modes] / np.abs(vector[:3, modes] / np.array([[0.03], [0.05], [0.05]])).max(axis=0)
    rest = model.geometry.hydrostatics.equilibrium
    team = place(bench(model, envs=3), rest + start[:3].real.T, start[3:].real.T)
    longest = 2 * np.pi / value[modes].imag.min()
    pose, nu = record(team, round(1.6 * longest / model.dt))
    motion = np.concatenate([pose - rest, nu], axis=2)
    time = model.dt * np.arange(len(motion))
    for env, mode in enumerate(modes):
        lead = np.argmax(np.abs(vector[:3, mode] / np.array([0.03, 0.05, 0.05])))
        x = motion[:, env, lead]
        expected = (np.exp(value[mode] * time) * start[lead, env]).real
        crossing = np.flatnonzero(x[1:] * x[:-1] < 0)[:3]
        when = time[crossing] - x[crossing] * model.dt / (x[crossing + 1] - x[crossing])
        period = 2 * (when[-1] - when[0]) / (len(when) - 1)
        assert period == pytest.approx(2 * np.pi / value[mode].imag, rel=0.02)
        assert x == pytest.approx(expected, abs=0.05 * np.abs(expected).max())


@pytest.mark.parametrize("restoring", ["panels", "linear"])
def test_a_steady_current_carries_the_hull_along(restoring, otter, constant_model, bench):
    """Galileo: with the current's velocity added to hull, water and air, track and turns are those of still water.

    Envs 0, 1 drift from a list, a trim and a turn; envs 2, 3 steam in a circle. 1 and 3 are in the current.
    """
    model = otter if restoring == "panels" else constant_model("otter", 0.01, restoring=restoring, windage=CALM)
    V_c = torch.tensor([0.5, -0.3, 0.0], dtype=torch.float64)
    team = place(bench(model, envs=4), [[0.02, 0.1, -0.05]] * 4, [0.5, 0.1, 0.0, 0.1, 0.0, 0.3], 0.7)
    for env in (1, 3):
        team.state[env, 0, 7:10] += torch_rotation_matrix(team.state[env, 0, 3:7]).T @ V_c
        team.current[env], team.wind[env] = V_c[:2], V_c
    action = [[[-1.0, 0.0]], [[-1.0, 0.0]], [[0.3, 0.4]], [[0.3, 0.4]]]
    worst = torch.zeros(2, dtype=torch.float64)
    for _ in range(round(20 / model.dt)):
        team.step(action)
        state = team.state[:, 0]
        gap = torch.cat((state[1::2, :3] - state[::2, :3] - V_c * team.time[0], state[1::2, 3:7] - state[::2, 3:7]), 1)
        worst = torch.maximum(worst, gap.abs().amax(1))
    assert (state[2, :2]).norm() > 5.0 and state[2, 12] > 0.2
    # A turning frame is stepped to second order: 4 mm at dt = 0.02 (a quarter at half the step); Runge-Kutta shows
    # that the equations themselves are invariant.
    assert worst.tolist() < ([5e-4, 6e-3] if restoring == "panels" else [1e-6, 1e-6])
