"""Quantities that follow from the state; a vehicle's kernel writes them once per step for all readers.

`derived[env, vehicle, 14]` = R_nb (9, by rows), velocity_n (3, m/s), cosine and sine of the heading (2).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rotation import rotation_matrix

DERIVED_SIZE = 14
ROTATION, DOWN = slice(0, 9), slice(6, 9)  # R_nb, and its third row: the world's down axis in b
WING_TILT, UPRIGHT = 7, 8  # R_nb[2, 1]: sine of the tilt of the wings; R_nb[2, 2]: cosine of the whole tilt
VELOCITY_N = slice(9, 12)
HEADING_COS, HEADING_SIN = 12, 13


@ti.func
def store(derived: ti.template(), e, i, R, v_n):
    """Write the derived quantities of vehicle i in environment e, from its attitude R = R_nb and velocity v_n."""
    for a in ti.static(range(3)):
        for b in ti.static(range(3)):
            derived[e, i, 3 * a + b] = R[a, b]
        derived[e, i, 9 + a] = v_n[a]
    # A bow that points straight up or down has no heading: the small term makes its cosine and sine 0 instead of NaN.
    inv = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + 1e-12)
    derived[e, i, 12], derived[e, i, 13] = R[0, 0] * inv, R[1, 0] * inv


@ti.kernel
def derive(
    derived: ti.types.ndarray(ndim=3),
    state: ti.types.ndarray(ndim=3),
    which: ti.types.ndarray(dtype=ti.i32, ndim=1),
    serial: ti.template(),
):
    """Fill `derived` from `state` (columns as in conventions.py) in environments whose `which` [env] is not 0."""
    ti.loop_config(serialize=serial)
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        if which[e] != 0:
            R = rotation_matrix(ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]]))
            store(derived, e, i, R, R @ ti.Vector([state[e, i, 7], state[e, i, 8], state[e, i, 9]]))
