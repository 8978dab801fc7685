"""Loads on a hull besides those of pressure, radiation and thrust: restoring, damping, wind. N, N m, about CO, in b.

Restoring: the weight m g acts at the centre of gravity. With `restoring = "linear"` there are no panels (pressure.py),
and the load is

    -G eta,   eta = (heave, roll, pitch) relative to the mean surface plane (water.py),

with G of the source (Fossen 2021, sec. 4.2), plus the weight's component down the slope of that plane. It also has the
payload's weight if the source adds it (PythonVehicleSimulator's otter).

Damping, due to the velocity nu_r relative to the water:

    X_i = -(d_i + d_ii |nu_r,i|) nu_r,i        diagonal, linear and quadratic (Fossen 2021, sec. 6.4)

The cross-flow drag is an integral over strips of width dx at x along the hull,

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx,

with Hoerner's (1965) section coefficient C_d (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import GRAVITY
from taichi_sim.kernels.rigid_body import cross, is_nothing, linear, six
from taichi_sim.usv.hull import water
from taichi_sim.usv.hull.numbers import vector
from taichi_sim.usv.vessel import wind_forces


@ti.func
def down(R):
    """Unit vector downwards, in b."""
    return ti.Vector([R[2, 0], R[2, 1], R[2, 2]])


@ti.func
def weight_load(weight: ti.template(), position: ti.template(), k):
    """Load of a weight (N) at `position` (three numbers, m, b); k is the unit vector downwards in b."""
    force = weight * k
    return six(force, cross(ti.Vector([position[0], position[1], position[2]]), force))


@ti.func
def linear_load(source: ti.template(), p: ti.template(), z, R, sums):
    """Load of linear restoring at the depth z (m) of CO.

    `source` is the LinearRestoring section, `sums` come from water.at.
    """
    along, across = sums[water.ALONG], sums[water.ACROSS]
    heave = z + sums[water.ELEVATION]
    roll = ti.atan2(R[2, 1], R[2, 2]) + across
    pitch = ti.asin(ti.max(ti.min(-R[2, 0], 1.0), -1.0)) - along
    Z = -source.G33 * heave - source.G35 * pitch
    M = -source.G55 * pitch - source.G35 * heave
    K = -source.G44 * roll
    load = ti.Vector([-p.weight * along, -p.weight * across, Z, K, M, 0.0])
    load += weight_load(ti.static(source.payload_mass * GRAVITY), source.payload_position, down(R))
    return load


@ti.func
def damping_load(h: ti.template(), p: ti.template(), nu_r):
    """Total of damping and cross-flow drag. `h` is the Hydrodynamics section, `p` the kernel's numbers (numbers.py)."""
    tau = diagonal_damping(ti.static(vector(p, "linear", 6)), ti.static(vector(p, "quadratic", 6)), nu_r)
    if ti.static(h.cross_flow_length > 0):
        YN = cross_flow(h, nu_r[1], nu_r[5])
        tau[1] += YN[0]
        tau[5] += YN[1]
    return tau


@ti.func
def diagonal_damping(d: ti.template(), d_d: ti.template(), nu_r):
    """-D nu_r with diagonal linear and quadratic coefficients, six numbers each."""
    tau = nu_r * 0.0
    for i in ti.static(range(6)):
        tau[i] = -(d[i] + d_d[i] * ti.abs(nu_r[i])) * nu_r[i]
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


@ti.func
def wind_load(height: ti.template(), p: ti.template(), R, nu, air):
    """Load of the wind `air` (m/s, n) on areas with their centre `height` (m) above CO; X and Y act there."""
    tau = nu * 0.0
    if ti.static(not (is_nothing(p.wind_x) and is_nothing(p.wind_y))):
        met = R.transpose() @ air - linear(nu)
        f = wind_forces(p, met[0], met[1])
        tau = ti.Vector([f[0], f[1], 0.0, height * f[1], -height * f[0], f[2]])
    return tau
