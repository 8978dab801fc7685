"""Equations of motion of a hull (hull_6dof.py), and the two methods to integrate them.

    M nu_dot = M nu_c_dot + tau + radiation.orbital_load - C_rb (nu - nu_c) - C_a(nu_r) nu_r - D(nu_r) nu_r

Hulls on panels use a splitting method. A step drifts by half its time, evaluates waves and pressure once, changes the
velocity by the midpoint rule, and drifts by half again. The velocity in the middle is predicted with nu_dot of the last
step. The method is of second order and, apart from damping, symmetric in time (Strang 1968): still water creates no
energy. Hulls with linear restoring use the classical fourth-order Runge-Kutta method. `hull` is the Hull6Dof, `p` holds
the kernel's numbers (numbers.py), `sums` come from water.at.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import SURGE
from taichi_sim.kernels.rigid_body import angular, coriolis, linear, quaternion_rate, times
from taichi_sim.kernels.rotation import position_of, quaternion_advance, quaternion_of, rotation_matrix
from taichi_sim.usv.hull import loads, mmg_drive, water
from taichi_sim.usv.hull.numbers import diagonal, symmetric


@ti.func
def pack(pos, q, nu):
    """State of 13 numbers (conventions.py) from its parts."""
    return ti.Vector([pos[0], pos[1], pos[2], q[0], q[1], q[2], q[3], nu[0], nu[1], nu[2], nu[3], nu[4], nu[5]])


@ti.func
def unpack(y):
    """Position, attitude and nu from a state of 13 numbers (conventions.py)."""
    return position_of(y), quaternion_of(y), ti.Vector([y[SURGE + c] for c in range(6)])


@ti.func
def through_water(hull: ti.template(), nu, R, V_c, sums):
    """Velocity nu_r relative to the water."""
    nu_c, _, nu_o, _ = water.flow(hull.params.current_frame, R, angular(nu), V_c, sums)
    return nu - nu_c - nu_o


@ti.func
def acceleration(hull: ti.template(), p: ti.template(), nu, R, tau, controls, V_c, sums):
    """nu_dot under tau (N, N m), which holds all loads that do not depend on the velocity relative to the water; those
    of propellers and rudders that do follow from `controls`.
    """
    M_rb, M_a, M_inverse = ti.static(symmetric(p, "M_rb"), diagonal(p, "added"), symmetric(p, "inverse"))
    nu_c, nu_c_dot, nu_o, nu_o_dot = water.flow(hull.params.current_frame, R, angular(nu), V_c, sums)
    nu_r = nu - nu_c - nu_o
    load = tau + loads.damping_load(hull.params.hydrodynamics, p, nu_r)
    if ti.static(hull.thrusters.in_flow):
        load += mmg_drive.load_in_flow(hull.thrusters, p, controls, nu_r)
    load += hull.radiation.orbital_load(M_a, nu_o_dot)
    load = load - coriolis(M_rb, nu - nu_c) - coriolis(M_a, nu_r)
    return nu_c_dot + times(M_inverse, load)


@ti.func
def drift(dt: ti.template(), pos, q, nu, turn):
    """Position, attitude and R_nb in the middle of a step, after a turn for `turn` s and half a step's translation."""
    q = quaternion_advance(q, angular(nu), turn)
    R = rotation_matrix(q)
    return pos + ti.static(0.5 * dt) * (R @ linear(nu)), q, R


@ti.func
def kick(hull: ti.template(), p: ti.template(), pos, nu, nu_dot, R, tau, controls, V_c, sums):
    """Position at the end of a step, nu there, and nu_dot, under load tau and `controls` in the middle of the step.

    For damping and Coriolis, the velocity in the middle is predicted with the last step's nu_dot.
    """
    nu_dot = acceleration(hull, p, nu + ti.static(0.5 * hull.dt) * nu_dot, R, tau, controls, V_c, sums)
    nu = nu + ti.static(hull.dt) * nu_dot
    return pos + ti.static(0.5 * hull.dt) * (R @ linear(nu)), nu, nu_dot


@ti.func
def derivative(hull: ti.template(), p: ti.template(), y, R, tau, controls, V_c, sums):
    """dy/dt at attitude R = R_nb under tau and `controls` (see `acceleration`)."""
    _, q, nu = unpack(y)
    return pack(R @ linear(nu), quaternion_rate(q, angular(nu)), acceleration(hull, p, nu, R, tau, controls, V_c, sums))


@ti.func
def runge_kutta(hull: ti.template(), p: ti.template(), y, controls, command, load, V_c, sums):
    """Position, attitude and nu of a hull with linear restoring, one step after y.

    The water is constant during the step, and so is `load`, which holds all loads but restoring and thrust.
    """
    total, slope = y * 0.0, y * 0.0
    for stage in range(4):
        ahead = 0.5 * ((stage + 1) // 2)  # 0, 1/2, 1/2, 1 of the step
        now = hull.drive.lagged(hull.thrusters, p, controls, command, ahead)
        y_s = y + (ahead * ti.static(hull.dt)) * slope
        R = rotation_matrix(ti.Vector([y_s[3], y_s[4], y_s[5], y_s[6]]))
        tau = load + loads.linear_load(hull.params.linear, p, y_s[2], R, sums)
        tau += hull.drive.load(hull.thrusters, p, now)
        slope = derivative(hull, p, y_s, R, tau, now, V_c, sums)
        total += ti.select(stage % 3 == 0, 1.0, 2.0) * slope
    pos, q, nu = unpack(y + ti.static(hull.dt / 6) * total)
    return pos, q / q.norm(), nu
