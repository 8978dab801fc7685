"""Attitude: unit quaternions (w, x, y, z), body to world, and Euler angles in z-y-x order.

Functions named `torch_*` work on torch tensors [..., 4] or [..., 3], `numpy_*` on arrays; the others are Taichi
functions on values.
Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 2.

A vehicle's kernel writes what follows from the state once per step for all readers: `derived[env, vehicle, 14]` =
R_nb (9, by rows), velocity_n (3, m/s), cosine and sine of the heading (2).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import numpy as np
import taichi as ti
import taichi.math as tm
import torch

from taichi_sim.kernels import fast_maths, runtime
from taichi_sim.kernels.abreast import put, some, taken
from taichi_sim.kernels.conventions import (
    HEAVE,
    PITCH_RATE,
    QUATERNION,
    QW,
    QX,
    QY,
    QZ,
    ROLL_RATE,
    STATE_SIZE,
    SURGE,
    SWAY,
    YAW_RATE,
)
from taichi_sim.kernels.runtime import array3, whole1

DERIVED_SIZE = 14
ROTATION, DOWN = slice(0, 9), slice(6, 9)  # R_nb, and its third row: the world's down axis in b
WING_TILT, UPRIGHT = 7, 8  # R_nb[2, 1]: sine of the tilt of the wings; R_nb[2, 2]: cosine of the whole tilt
VELOCITY_N = slice(9, 12)
HEADING_COS, HEADING_SIN = 12, 13


@ti.func
def rotation_matrix(q):
    """R_nb of the unit quaternion q = (w, x, y, z): v_n = R_nb v_b."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ti.Matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@ti.func
def position_of(y):
    """Position (m) in n of state y (packed as in conventions.py)."""
    return ti.Vector([y[0], y[1], y[2]])


@ti.func
def quaternion_of(y):
    """Quaternion of state y."""
    return ti.Vector([y[QW], y[QX], y[QY], y[QZ]])


@ti.func
def attitude_of(y):
    """R_nb of state y."""
    return rotation_matrix(quaternion_of(y))


@ti.func
def velocity_of(y):
    """Velocity (m/s) in b of state y."""
    return ti.Vector([y[SURGE], y[SWAY], y[HEAVE]])


@ti.func
def rates_of(y):
    """Angular velocity (rad/s) in b of state y."""
    return ti.Vector([y[ROLL_RATE], y[PITCH_RATE], y[YAW_RATE]])


@ti.func
def quaternion_product(a, b):
    """Hamilton product a b."""
    return ti.Vector(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


@ti.func
def quaternion_advance(q, omega_b, dt):
    """Quaternion after a rotation from q at the constant body rate omega_b (rad/s) for dt (s), exact."""
    square = omega_b.dot(omega_b) * (dt * dt)
    # cos(angle/2) and sin(angle/2)/angle; below 0.3 rad per step by their series, which are exact to 1e-11 there
    h = 0.25 * square
    h2 = h * h
    c = (1 - 0.5 * h) + h2 * (1.0 / 24 - h * (1.0 / 720))
    k = (0.5 - h * (1.0 / 12)) + h2 * (1.0 / 240 - h * (1.0 / 10080))
    large = square > 0.09
    if some(large):
        angle = ti.sqrt(ti.max(square, 0.09))
        sine, cosine = fast_maths.sincos(0.5 * angle)
        c, k = ti.select(large, cosine, c), ti.select(large, sine / angle, k)
    # One Newton step towards 1/|q| suffices, because |q| - 1 is a rounding error. It does not wait for the rotation.
    scale = 1.5 - 0.5 * q.dot(q)
    c, k = c * scale, k * scale * dt
    return quaternion_product(q, ti.Vector([c, k * omega_b[0], k * omega_b[1], k * omega_b[2]]))


@ti.func
def quaternion_from_euler(phi, theta, psi):
    """Quaternion of roll phi, pitch theta and yaw psi (rad), z-y-x order."""
    sr, cr = fast_maths.sincos(0.5 * phi)
    sp, cp = fast_maths.sincos(0.5 * theta)
    sy, cy = fast_maths.sincos(0.5 * psi)
    return ti.Vector(
        [
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ]
    )


def torch_quaternion_from_euler(phi: torch.Tensor, theta: torch.Tensor, psi: torch.Tensor) -> torch.Tensor:
    """Quaternion [..., 4] of roll, pitch and yaw (rad, [...]), z-y-x order."""
    cr, sr = torch.cos(0.5 * phi), torch.sin(0.5 * phi)
    cp, sp = torch.cos(0.5 * theta), torch.sin(0.5 * theta)
    cy, sy = torch.cos(0.5 * psi), torch.sin(0.5 * psi)
    return torch.stack(
        (
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        ),
        dim=-1,
    )


def level_states(place: torch.Tensor, heading: torch.Tensor, surge: torch.Tensor | float = 0.0) -> torch.Tensor:
    """States [.., 13] (conventions.py) of vehicles that are level.

    Args:
        place: [.., 2 or 3] position, NED, m. heading: [..], rad. surge: speed ahead, [..] or one, m/s.
    """
    state = place.new_zeros((*place.shape[:-1], STATE_SIZE))
    state[..., : place.shape[-1]] = place
    level = torch.zeros_like(heading)
    state[..., QUATERNION] = torch_quaternion_from_euler(level, level, heading).to(state)
    state[..., SURGE] = surge
    return state


def torch_euler_from_quaternion(q: torch.Tensor) -> torch.Tensor:
    """Roll, pitch and yaw (rad) [..., 3] of quaternions [..., 4]; pitch is in [-pi/2, pi/2]."""
    w, x, y, z = q.unbind(-1)
    phi = torch.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    theta = torch.asin((2 * (w * y - z * x)).clamp(-1.0, 1.0))
    psi = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return torch.stack((phi, theta, psi), dim=-1)


def torch_heading(q: torch.Tensor) -> torch.Tensor:
    """Yaw (rad) [...] of quaternions [..., 4]."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def torch_to_body(v_n: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    """R_nb^T v_n of vectors [..., 3] and unit quaternions [..., 4]."""
    r = q[..., 1:]
    t = 2 * torch.linalg.cross(v_n, r, dim=-1)
    return v_n + q[..., :1] * t + torch.linalg.cross(t, r, dim=-1)


def torch_euler_from_rotation(R: torch.Tensor) -> torch.Tensor:
    """Roll, pitch and yaw (rad) [..., 3] of R_nb [..., 3, 3]; pitch is in [-pi/2, pi/2]."""
    roll, pitch = torch.atan2(R[..., 2, 1], R[..., 2, 2]), -R[..., 2, 0].clamp(-1.0, 1.0).asin()
    return torch.stack((roll, pitch, torch.atan2(R[..., 1, 0], R[..., 0, 0])), dim=-1)


def torch_rotation_matrix(q: torch.Tensor) -> torch.Tensor:
    """R_nb [..., 3, 3] of unit quaternions [..., 4]."""
    w, x, y, z = q.unbind(-1)
    rows = (
        torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), -1),
        torch.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), -1),
        torch.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), -1),
    )
    return torch.stack(rows, dim=-2)


def numpy_rotation_matrix(q: np.ndarray) -> np.ndarray:
    """R_nb [3, 3] of a unit quaternion [4]."""
    w, x, y, z = map(float, q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@ti.func
def wrap_pi(x):
    """The angle x (rad) wrapped to [-pi, pi)."""
    return x - 2.0 * tm.pi * ti.floor((x + tm.pi) / (2.0 * tm.pi))


@ti.func
def store(derived: ti.template(), e, i, R, v_n):
    """Write the derived quantities of vehicle i in environment e, from its attitude R = R_nb and velocity v_n."""
    # A bow that points straight up or down has no heading: the small term makes its cosine and sine 0 instead of NaN.
    inv = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + 1e-12)
    put(derived, e, i, 0, [R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]])
    put(derived, e, i, 9, [v_n[0], v_n[1], v_n[2], R[0, 0] * inv, R[1, 0] * inv])


@ti.func
def rotated(derived: ti.template(), e, i, v):
    """R_nb v of vehicle i in environment e, by its derived quantities."""
    out = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(3)):
        out[a] = derived[e, i, 3 * a] * v[0] + derived[e, i, 3 * a + 1] * v[1] + derived[e, i, 3 * a + 2] * v[2]
    return out


@ti.func
def rotated_back(derived: ti.template(), e, i, v):
    """R_nb^T v of that vehicle."""
    out = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(3)):
        out[a] = derived[e, i, a] * v[0] + derived[e, i, 3 + a] * v[1] + derived[e, i, 6 + a] * v[2]
    return out


@ti.kernel
def derive(derived: array3, state: array3, which: whole1):
    """Fill `derived` from `state` (columns as in conventions.py) in environments whose `which` [env] is not 0."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        if which[e] != 0:
            R = rotation_matrix(taken(state, e, i, QW, 4))
            store(derived, e, i, R, R @ taken(state, e, i, SURGE, 3))
