"""Rigid-body inertia and Coriolis forces against a cloud of point masses, and Kirchhoff's invariants."""

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels.rigid_body import changed_mass, coriolis, quaternion_rate, rigid_body_mass
from taichi_sim.kernels.rotation import torch_rotation_matrix

pytestmark = pytest.mark.usefixtures("f64")

RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-1.0, 1.0, (7, 3)) * [2.0, 1.0, 0.4] + [0.3, -0.1, 0.2]  # m, b: no plane of symmetry
MASSES = RNG.uniform(1.0, 9.0, 7)  # kg
CG = MASSES @ POINTS / MASSES.sum()
NU = RNG.uniform(-2.0, 2.0, (40, 6))
NU_DOT = RNG.uniform(-3.0, 3.0, (40, 6))


def inertia(about):
    """Inertia matrix of the point masses about a point, from its definition."""
    r = POINTS - about
    return sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(MASSES, r, strict=True))


@pytest.fixture(scope="module")
def mass():
    return rigid_body_mass(MASSES.sum(), CG, inertia(CG))


@pytest.fixture(scope="module")
def apply():
    """coriolis(M, nu) of rows nu [n, 6] for two matrices: the masses' own, and a full symmetric one."""
    full = RNG.uniform(-1.0, 1.0, (6, 6))
    full = full + full.T
    rigid, general = (
        tuple(map(tuple, np.asarray(m).tolist())) for m in (rigid_body_mass(MASSES.sum(), CG, inertia(CG)), full)
    )

    @ti.kernel
    def kernel(out: ti.types.ndarray(ndim=2), rows: ti.types.ndarray(ndim=2), which: ti.i32):
        for i in range(rows.shape[0]):
            nu = ti.Vector([rows[i, c] for c in range(6)])
            a, b = coriolis(rigid, nu), coriolis(general, nu)
            for c in ti.static(range(6)):
                out[i, c] = ti.select(which == 0, a[c], b[c])

    def run(nu, which=0):
        rows = torch.from_numpy(np.ascontiguousarray(nu))
        out = torch.empty_like(rows)
        kernel(out, rows, which)
        return out.numpy(), full

    return run


def test_mass_matrix_moves_every_point_mass(mass):
    """M nu is the momentum and angular momentum about CO of the points moving with v + omega x r."""
    velocity = NU[:, None, :3] + np.cross(NU[:, None, 3:], POINTS)
    momentum = MASSES[:, None] * velocity
    expected = np.concatenate([momentum.sum(1), np.cross(POINTS, momentum).sum(1)], axis=1)
    assert pytest.approx(expected, rel=1e-12, abs=1e-10) == NU @ mass.T
    assert mass == pytest.approx(mass.T, abs=1e-12)
    assert mass[3:, 3:] == pytest.approx(inertia(np.zeros(3)), abs=1e-10)
    assert np.linalg.eigvalsh(mass).min() > 0


@pytest.mark.parametrize("kind", [float, lambda x: torch.tensor(x, dtype=torch.float64)])
def test_changed_mass_is_that_of_the_points_made_heavier_and_moved(mass, kind):
    """All points 1.3 times as heavy and moved together; what a published matrix has beside them stays."""
    new_cg, beside = CG + [0.2, -0.1, 0.15], RNG.uniform(-1, 1, (6, 6))
    beside[3:, 3:] = 0.0  # a share of the inertia is taken for one
    beside += beside.T
    heavier = rigid_body_mass(1.3 * MASSES.sum(), new_cg, 1.3 * inertia(CG)) + beside
    new_mass, *new = (kind(x) for x in (1.3 * MASSES.sum(), *new_cg))
    assert np.array(changed_mass(mass + beside, MASSES.sum(), CG, new_mass, new)) == pytest.approx(heavier, abs=1e-11)
    same_mass, *same = (kind(x) for x in (MASSES.sum(), *CG))
    assert np.array_equal(changed_mass(mass, MASSES.sum(), CG, same_mass, same), mass)


def test_mass_and_coriolis_give_newtons_second_law_for_every_point_mass(mass, apply):
    """M nu_dot + C(nu) nu is the sum of m a, and of r x m a, with a the acceleration of each point in space."""
    v, w, v_dot, w_dot = NU[:, None, :3], NU[:, None, 3:], NU_DOT[:, None, :3], NU_DOT[:, None, 3:]
    acceleration = v_dot + np.cross(w, v) + np.cross(w_dot, POINTS) + np.cross(w, np.cross(w, POINTS))
    force = MASSES[:, None] * acceleration
    expected = np.concatenate([force.sum(1), np.cross(POINTS, force).sum(1)], axis=1)
    assert NU_DOT @ mass.T + apply(NU)[0] == pytest.approx(expected, rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("which", [0, 1])
def test_coriolis_does_no_work(which, apply):
    force, _ = apply(NU, which)
    assert np.abs(np.sum(NU * force, axis=1)).max() < 1e-11 * np.abs(force).max()


def test_coriolis_keeps_kirchhoffs_momentum_in_space(apply):
    """Left alone, p and h = r x p + h_b of any symmetric M stay constant in space: their rates are those of b alone."""
    force, M = apply(NU, 1)
    p, h = np.split(NU @ M.T, 2, axis=1)
    p_dot, h_dot = np.split(-force, 2, axis=1)  # in b, where M nu_dot = -C nu
    v, w = NU[:, :3], NU[:, 3:]
    assert p_dot + np.cross(w, p) == pytest.approx(np.zeros_like(p), abs=1e-11)
    assert h_dot + np.cross(w, h) + np.cross(v, p) == pytest.approx(np.zeros_like(h), abs=1e-11)


def test_quaternion_rate_turns_vectors_at_omega():
    """R(q + q_dot h) a - R(q) a = h R (omega x a): the rate is that of a rotating frame."""

    @ti.kernel
    def kernel(out: ti.types.ndarray(ndim=1), x: ti.types.ndarray(ndim=1)):
        for _ in range(1):
            rate = quaternion_rate(ti.Vector([x[0], x[1], x[2], x[3]]), ti.Vector([x[4], x[5], x[6]]))
            for c in ti.static(range(4)):
                out[c] = rate[c]

    q = np.array([0.6, -0.3, 0.5, 0.2])
    q, omega, a = q / np.linalg.norm(q), np.array([0.7, -1.1, 0.4]), np.array([0.3, 2.0, -0.5])
    rate = torch.empty(4, dtype=torch.float64)
    kernel(rate, torch.from_numpy(np.concatenate([q, omega])))
    h = 1e-5
    ahead, behind = (torch_rotation_matrix(torch.from_numpy(q) + s * h * rate).numpy() @ a for s in (1, -1))
    here = torch_rotation_matrix(torch.from_numpy(q)).numpy()
    assert (ahead - behind) / (2 * h) == pytest.approx(here @ np.cross(omega, a), abs=1e-8)
