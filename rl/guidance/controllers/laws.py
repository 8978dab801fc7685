"""Functions of the kernels in which controllers follow a velocity command."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti
import taichi.math as tm

from taichi_sim.kernels.conventions import EAST, GRAVITY, NORTH


@ti.func
def limited(x, least, most):
    """`x` between two bounds."""
    return ti.min(ti.max(x, least), most)


@ti.func
def wrapped(angle):
    """`angle` (rad) in [-pi, pi)."""
    return angle - 2 * tm.pi * ti.floor((angle + tm.pi) / (2 * tm.pi))


@ti.func
def swung(v, rate):
    """Rate of change of a vector that turns with the target's course at `rate` (rad/s)."""
    change = v * 0.0
    change[NORTH], change[EAST] = -rate * v[EAST], rate * v[NORTH]
    return change


@ti.func
def cross(a, b):
    """Cross product of the level parts: above 0 where b is to starboard of a."""
    return a[NORTH] * b[EAST] - a[EAST] * b[NORTH]


@ti.func
def turn_to(nose, force):
    """Angle (rad) from the level part of the `nose` to that of `force`, to starboard."""
    return ti.atan2(cross(nose, force), nose[NORTH] * force[NORTH] + nose[EAST] * force[EAST])


@ti.func
def approach(error, gain, acceleration):
    """Rate towards a zero of `error` that can still be stopped: min(gain |e|, sqrt(2 acceleration |e|))."""
    size = ti.abs(error)
    rate = ti.min(gain * size, ti.sqrt(2.0 * acceleration * size))
    return ti.select(error < 0, -rate, rate)


@ti.func
def push_of_waves(R, omega, ahead):
    """Acceleration of a floating hull down the water's slope, `ahead` s from now, and its rate: m/s^2, m/s^3, NED.

    `R` is R_nb by rows, `omega` the body rates (rad/s).
    """
    rate = -GRAVITY * ti.Vector([R[3 * a] * omega[1] - R[3 * a + 1] * omega[0] for a in ti.static(range(2))])
    return -GRAVITY * ti.Vector([R[2], R[5]]) + ahead * rate, rate


@ti.func
def yaw_rate(R, omega):
    """Rate of turn about the vertical (rad/s)."""
    return R[6] * omega[0] + R[7] * omega[1] + R[8] * omega[2]
