"""Fossen's vectorial equations of a rigid body in b: nu = [u v w p q r], six-vectors and 6 x 6 matrices.

With momentum p = M_11 v + M_12 omega and angular momentum h = M_21 v + M_22 omega of a symmetric M (Kirchhoff),

    C(nu) nu = [omega x p,  omega x h + v x p]

which is skew-symmetric: nu^T C(nu) nu = 0 (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control,
sec. 3.3 and 6.3). The same form serves rigid-body mass M_rb and added mass M_a.
"""

import numpy as np
import taichi as ti

from taichi_sim.maths.rotation import quaternion_product

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


def constant(matrix) -> Matrix6:
    """A 6 x 6 matrix as numbers that a kernel compiles in (`times`)."""
    return tuple(tuple(float(value) for value in row) for row in np.asarray(matrix))


@ti.func
def times(matrix: ti.template(), x):
    """matrix @ x of a constant 6 x 6 `matrix` (rigid_body.constant) and a six-vector; zeros cost nothing."""
    y = x * 0.0
    for i in ti.static(range(6)):
        for j in ti.static(range(6)):
            if ti.static(matrix[i][j] != 0.0):
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
    """C(nu) nu of the constant symmetric matrix M."""
    momentum = times(M, nu)
    p, h = linear(momentum), angular(momentum)
    v, omega = linear(nu), angular(nu)
    return six(cross(omega, p), cross(omega, h) + cross(v, p))


@ti.func
def quaternion_rate(q, omega_b):
    """dq/dt = q (0, omega_b) / 2."""
    return 0.5 * quaternion_product(q, ti.Vector([0.0, omega_b[0], omega_b[1], omega_b[2]]))
