"""Fossen's vectorial equations of a rigid body in b: nu = [u v w p q r], six-vectors and 6 x 6 matrices.

With momentum p = M_11 v + M_12 omega and angular momentum h = M_21 v + M_22 omega of a symmetric M (Kirchhoff),

    C(nu) nu = [omega x p,  omega x h + v x p]

which is skew-symmetric: nu^T C(nu) nu = 0 (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control,
sec. 3.3 and 6.3). The same form serves rigid-body mass M_rb and added mass M_a.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from taichi_sim.kernels.rotation import quaternion_product

Matrix6 = tuple[tuple[float, ...], ...]


def skew(r) -> np.ndarray:
    """S(r) [3, 3]: S(r) a = r x a."""
    x, y, z = r
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rigid_body_mass(mass: float, cg, inertia_cg) -> np.ndarray:
    """M_rb [6, 6] about CO of a body of `mass` (kg) whose CG is at `cg` [3] (m, b).

    `inertia_cg` [3, 3] (kg m^2) is about the CG (Fossen 2021, eq. 3.49).
    """
    S = skew(cg)
    M = np.zeros((6, 6))
    M[:3, :3] = mass * np.eye(3)
    M[:3, 3:], M[3:, :3] = -mass * S, mass * S
    M[3:, 3:] = np.asarray(inertia_cg) - mass * S @ S
    return M


def changed_mass(M_rb, mass: float, cg, new_mass: Any, new_cg: Sequence[Any]) -> list[list[Any]]:
    """M_rb (rows) of a body whose mass and CG have become others; its radii of gyration about the CG stay.

    With R(m, r, I_g) of `rigid_body_mass` and I_g = M_22 + m S(r)^2, the inertia about the CG in M_rb,

        M_rb + R(m', r', I_g m'/m) - R(m, r, I_g),

    so that what a published matrix has beside the inertia of a rigid body stays; and without a change it is M_rb, to
    the bit.

    Args:
        M_rb: [6, 6] about CO of a body of `mass` (kg) whose CG is at `cg` [3] (m, b). new_mass: kg, and new_cg: [3], m,
            b; floats, or tensors that broadcast, as the entries of the result then are.
    """
    M = np.array(M_rb, dtype=np.float64)
    I_g = M[3:, 3:] + mass * skew(cg) @ skew(cg)
    S, new_S = skew(cg), _skew_rows(new_cg)
    for_cg, new_for_cg = _about_origin(mass, cg), _about_origin(new_mass, new_cg)
    rows: list[list[Any]] = [[float(value) for value in row] for row in M]
    for i in range(3):
        rows[i][i] += new_mass - mass
        for j in range(3):
            turned = mass * float(S[i, j]) - new_mass * new_S[i][j]
            rows[i][3 + j] += turned
            rows[3 + j][i] += turned
            rows[3 + i][3 + j] += float(I_g[i, j]) * (new_mass / mass - 1) + (new_for_cg[i][j] - for_cg[i][j])
    return rows


def _skew_rows(r: Sequence[Any]) -> list[list[Any]]:
    """`skew` of three numbers of any kind."""
    x, y, z = r
    return [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]


def _about_origin(mass: Any, r: Sequence[Any]) -> list[list[Any]]:
    """-m S(r)^2 of numbers of any kind: inertia (kg m^2) about the origin of a point mass at r."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    return [[mass * ((square if i == j else 0.0) - r[i] * r[j]) for j in range(3)] for i in range(3)]


def constant(matrix) -> Matrix6:
    """A 6 x 6 matrix as numbers that a kernel compiles in (`times`)."""
    return tuple(tuple(float(value) for value in row) for row in np.asarray(matrix))


def is_nothing(number: Any) -> bool:
    """Whether a number is zero and known to be when the kernel is compiled; read inside `ti.static`."""
    return isinstance(number, float) and number == 0.0


@ti.func
def times(matrix: ti.template(), x):
    """matrix @ x of a 6 x 6 `matrix` (rows) and a six-vector; its entries are numbers that are compiled in
    (rigid_body.constant), of which zeros cost nothing, or run-time numbers.
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
    """A six-vector of two three-vectors."""
    return ti.Vector([force[0], force[1], force[2], moment[0], moment[1], moment[2]])


@ti.func
def linear(nu):
    """First half of a six-vector."""
    return ti.Vector([nu[0], nu[1], nu[2]])


@ti.func
def angular(nu):
    """Second half of a six-vector."""
    return ti.Vector([nu[3], nu[4], nu[5]])


@ti.func
def coriolis(M: ti.template(), nu):
    """C(nu) nu of the symmetric matrix M (rows, as `times` takes them)."""
    momentum = times(M, nu)
    p, h = linear(momentum), angular(momentum)
    v, omega = linear(nu), angular(nu)
    return six(cross(omega, p), cross(omega, h) + cross(v, p))


@ti.func
def quaternion_rate(q, omega_b):
    """dq/dt = q (0, omega_b) / 2."""
    return 0.5 * quaternion_product(q, ti.Vector([0.0, omega_b[0], omega_b[1], omega_b[2]]))
