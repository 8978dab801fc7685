"""Fossen's vectorial equations of a rigid body in b: nu = [u v w p q r], six-vectors and 6 x 6 matrices.

A symmetric M has the momentum p = M_11 v + M_12 omega and the angular momentum h = M_21 v + M_22 omega (Kirchhoff).
Then

    C(nu) nu = [omega x p,  omega x h + v x p]

is skew-symmetric: nu^T C(nu) nu = 0 (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, sec. 3.3
and 6.3). The same form serves the rigid-body mass M_rb and the added mass M_a.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from collections.abc import Sequence

import numpy as np
import taichi as ti
from torch import Tensor

from taichi_sim.kernels.rotation import quaternion_product

Number = float | Tensor
"""A number of a vehicle file (float), or one for each vehicle (tensor)."""


def skew(r) -> np.ndarray:
    """S(r) [3, 3], so that S(r) a = r x a."""
    x, y, z = r
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rigid_body_mass(mass: float, cg, inertia_cg) -> np.ndarray:
    """M_rb [6, 6] about CO of a body of `mass` (kg) with its CG at `cg` [3] (m, b) (Fossen 2021, eq. 3.49).

    `inertia_cg` [3, 3] (kg m^2) is about the CG.
    """
    S = skew(cg)
    M = np.zeros((6, 6))
    M[:3, :3] = mass * np.eye(3)
    M[:3, 3:], M[3:, :3] = -mass * S, mass * S
    M[3:, 3:] = np.asarray(inertia_cg) - mass * S @ S
    return M


def changed_mass(M_rb, mass: float, cg, new_mass: Number, new_cg: Sequence[Number]) -> list[list[Number]]:
    """M_rb (rows) of a body after a change of its mass and CG; its radii of gyration about the CG stay the same.

    R(m, r, I_g) is `rigid_body_mass`, and I_g = M_22 + m S(r)^2 is the inertia about the CG in M_rb. The result is

        M_rb + R(m', r', I_g m'/m) - R(m, r, I_g).

    It keeps what a published matrix has beside the inertia of a rigid body. Without a change it is M_rb to the bit.

    Args:
        M_rb: [6, 6] about CO.
        mass, cg: mass (kg) and CG [3] (m, b) of that body.
        new_mass, new_cg: mass (kg) and CG [3] (m, b) after the change. Tensors broadcast, also in the result's entries.
    """
    M = np.array(M_rb, dtype=np.float64)
    I_g = M[3:, 3:] + mass * skew(cg) @ skew(cg)
    S, new_S = skew(cg), _skew_rows(new_cg)
    for_cg, new_for_cg = _about_origin(mass, cg), _about_origin(new_mass, new_cg)
    rows: list[list[Number]] = [[float(value) for value in row] for row in M]
    for i in range(3):
        rows[i][i] += new_mass - mass
        for j in range(3):
            turned = mass * float(S[i, j]) - new_mass * new_S[i][j]
            rows[i][3 + j] += turned
            rows[3 + j][i] += turned
            rows[3 + i][3 + j] += float(I_g[i, j]) * (new_mass / mass - 1) + (new_for_cg[i][j] - for_cg[i][j])
    return rows


def _skew_rows(r: Sequence[Number]) -> list[list[Number]]:
    """`skew` of three floats or tensors."""
    x, y, z = r
    return [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]


def _about_origin(mass: Number, r: Sequence[Number]) -> list[list[Number]]:
    """-m S(r)^2: inertia (kg m^2) about the origin of a point mass at r."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    return [[mass * ((square if i == j else 0.0) - r[i] * r[j]) for j in range(3)] for i in range(3)]


def is_nothing(number: object) -> bool:
    """Whether a number is known to be zero when the kernel is compiled; read inside `ti.static`."""
    return isinstance(number, float) and number == 0.0


@ti.func
def times(matrix: ti.template(), x):
    """Product of a 6 x 6 `matrix` (rows) and a six-vector.

    The entries are either run-time numbers or numbers that are compiled in (`constant`). Zeros that are compiled in
    cost nothing.
    """
    y = x * 0.0
    for i in ti.static(range(6)):
        for j in ti.static(range(6)):
            if ti.static(not is_nothing(matrix[i][j])):
                y[i] += matrix[i][j] * x[j]
    return y


@ti.func
def cross(a, b):
    """a x b of three-vectors."""
    return ti.Vector([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@ti.func
def six(force, moment):
    """Six-vector of two three-vectors."""
    return ti.Vector([force[0], force[1], force[2], moment[0], moment[1], moment[2]])


@ti.func
def linear(nu):
    """First three entries of a six-vector."""
    return ti.Vector([nu[0], nu[1], nu[2]])


@ti.func
def angular(nu):
    """Last three entries of a six-vector."""
    return ti.Vector([nu[3], nu[4], nu[5]])


@ti.func
def coriolis(M: ti.template(), nu):
    """C(nu) nu of the symmetric matrix M (rows, as in `times`)."""
    momentum = times(M, nu)
    p, h = linear(momentum), angular(momentum)
    v, omega = linear(nu), angular(nu)
    return six(cross(omega, p), cross(omega, h) + cross(v, p))


@ti.func
def quaternion_rate(q, omega_b):
    """dq/dt = q (0, omega_b) / 2."""
    return 0.5 * quaternion_product(q, ti.Vector([0.0, omega_b[0], omega_b[1], omega_b[2]]))
