"""Damping and cross-flow drag: the load (N, N m, about CO, b) due to the velocity nu_r relative to the water.

    X_i = -(d_i + d_ii |nu_r,i|) nu_r,i        diagonal, linear and quadratic (Fossen 2021, sec. 6.4)

The cross-flow drag is an integral over strips of width dx at x along the hull,

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx,

with Hoerner's (1965) section coefficient C_d (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.usv.hull.numbers import vector


@ti.func
def load(h: ti.template(), p: ti.template(), nu_r):
    """Total of damping and cross-flow drag. `h` is the Hydrodynamics section, `p` the kernel's numbers (numbers.py)."""
    tau = diagonal_damping(ti.static(vector(p, "linear", 6)), ti.static(vector(p, "quadratic", 6)), nu_r)
    if ti.static(h.cross_flow_length > 0):
        YN = cross_flow(h, nu_r[1], nu_r[5])
        tau[1] += YN[0]
        tau[5] += YN[1]
    return tau


@ti.func
def diagonal_damping(linear: ti.template(), quadratic: ti.template(), nu_r):
    """-D nu_r with diagonal linear and quadratic coefficients, six numbers each."""
    tau = nu_r * 0.0
    for i in ti.static(range(6)):
        tau[i] = -(linear[i] + quadratic[i] * ti.abs(nu_r[i])) * nu_r[i]
    return tau


@ti.func
def cross_flow(h: ti.template(), v, r):
    """Sway force and yaw moment (Y, N) of the strip integral."""
    Y, N = v * 0.0, v * 0.0
    strips = ti.static(h.cross_flow_strips)
    dx = ti.static(h.cross_flow_length / (h.cross_flow_strips - 1))
    for i in range(strips):
        x = i * dx - ti.static(0.5 * h.cross_flow_length)
        w = v + x * r
        drag = ti.abs(w) * w
        Y -= drag
        N -= x * drag
    scale = ti.static(0.5 * h.cross_flow_density * h.cross_flow_draft * h.cross_flow_coefficient) * dx
    return ti.Vector([Y * scale, N * scale])
