"""Motion of a hull (hull_6dof.py): loads, auxiliary state, equations, methods to integrate them, start on the waves.

    M nu_dot = M nu_c_dot + tau + radiation.orbital_load - C_rb (nu - nu_c) - C_a(nu_r) nu_r - D(nu_r) nu_r

The loads here are those besides pressure, radiation and thrust, in N and N m, about CO, in b.

Restoring: the weight m g acts at the centre of gravity. With `restoring = "linear"` there are no panels (water.py),
and the load is

    -G eta,   eta = (heave, roll, pitch) relative to the mean surface plane (water.py),

with G of the source (Fossen 2021, sec. 4.2), plus the weight's component down the slope of that plane. It also has the
payload's weight if the source adds it (PythonVehicleSimulator's otter).

Damping, due to the velocity nu_r relative to the water:

    X_i = -(d_i + d_ii |nu_r,i|) nu_r,i        diagonal, linear and quadratic (Fossen 2021, sec. 6.4)

or, with `damping_relative_to = "current"`, due to nu - nu_c, as in codes that compute RAOs.

The cross-flow drag is an integral over strips of width dx at x along the hull,

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx,

with Hoerner's (1965) section coefficient C_d (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92). Lift is linear
in v and r (params.Lift).

Hulls on panels use a splitting method. A step drifts by half its time, evaluates waves and pressure once, changes the
velocity by the midpoint rule, and drifts by half again. The velocity in the middle is predicted with nu_dot of the last
step. The method is of second order and, apart from damping, symmetric in time (Strang 1968): still water creates no
energy. Hulls with linear restoring use the classical fourth-order Runge-Kutta method. `hull` is the Hull6Dof, `p` holds
the kernel's numbers (params.py), `sums` come from water.at.

The largest stable step follows from the eigenvalues of the linear motion about rest, of the state (heave, roll, pitch,
nu): position and heading do not affect stability. Damping is the linear one, plus the quadratic one at top speed.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import EAST, ELEVATION, FREEBOARD, GRAVITY, NORTH, SURGE
from taichi_sim.kernels.packs import AroundPack
from taichi_sim.kernels.rigid_body import angular, coriolis, cross, is_nothing, linear, quaternion_rate, six, times
from taichi_sim.kernels.rotation import (
    position_of,
    quaternion_advance,
    quaternion_of,
    quaternion_product,
    rotation_matrix,
)
from taichi_sim.kernels.runtime import array2, array3
from taichi_sim.models.usv.hull import mmg_drive, water
from taichi_sim.models.usv.hull.params import added_mass, symmetric, vector
from taichi_sim.models.usv.hull.radiation_memory import Modes
from taichi_sim.models.usv.vessel_base import wind_forces
from taichi_sim.vehicle import edge

Array = NDArray[np.float64]
LARGEST, HALVINGS = 10.0, 40  # s, largest step considered; halvings of the bisection
AUX = (
    "label_north", "label_east", "label_change_north", "label_change_east",
    "pressure_x", "pressure_y", "pressure_z", "drag_x", "drag_y", "drag_z",
    "wind_x", "wind_y", "wind_z",
    "u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot",
)  # fmt: skip
"""Displacement of the label under the hull (water.py) and its change in a step (m), forces in the last step (N, b), and
nu_dot in that step (m/s^2, rad/s^2). The columns of the thrusters (thruster_set.py), of the pressure heads
(water.py) and of the radiation's memory (radiation.py) follow."""
LABEL, LABEL_CHANGE, PRESSURE, DRAG, WIND_FORCE, NU_DOT = map(
    AUX.index, ("label_north", "label_change_north", "pressure_x", "drag_x", "wind_x", "u_dot")
)
CONTROLS = len(AUX)
"""First column of each group."""


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
    along, across = sums[water.SLOPE_ALONG], sums[water.SLOPE_ACROSS]
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
def damping_load(h: ti.template(), p: ti.template(), nu_r, nu_m):
    """Total of damping, cross-flow drag and lift at velocities relative to the water (nu_r) and to the current (nu_m).

    `h` is the Hydrodynamics section, `p` the kernel's numbers.
    """
    damped = nu_m if ti.static(h.damping_relative_to == "current") else nu_r
    tau = diagonal_damping(ti.static(vector(p, "linear", 6)), ti.static(vector(p, "quadratic", 6)), damped)
    if ti.static(h.has_cross_flow):
        YN = cross_flow(h, nu_r[1], nu_r[5]) * (p.cross_flow * ti.static(1.0 / h.cross_flow_coefficient))
        tau[1] += YN[0]
        tau[5] += YN[1]
    if ti.static(h.lift.Y_uv < 0):
        u, v, r = nu_r[0], nu_r[1], nu_r[5]
        tau[1] += p.Y_uv * ti.abs(u) * v + p.Y_ur * u * r
        tau[5] += p.N_uv * u * v + p.N_ur * ti.abs(u) * r
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


@ti.func
def note(aux: ti.template(), e, i, D, change, nu_dot, up, drag, wind):
    """Write the label's displacement D and its change, nu_dot, and the forces (N, b): pressure minus weight, drag,
    wind.
    """
    for c in ti.static(range(2)):
        aux[e, i, LABEL + c], aux[e, i, LABEL_CHANGE + c] = D[c], change[c]
    for c in ti.static(range(6)):
        aux[e, i, NU_DOT + c] = nu_dot[c]
    for c in ti.static(range(3)):
        aux[e, i, PRESSURE + c], aux[e, i, DRAG + c], aux[e, i, WIND_FORCE + c] = up[c], drag[c], wind[c]


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
    """Velocity relative to the water, nu_r, and to the current alone, nu - nu_c."""
    nu_c, _, nu_o, _ = water.flow(hull.params.current_frame, R, angular(nu), V_c, sums)
    return nu - nu_c - nu_o, nu - nu_c


@ti.func
def acceleration(hull: ti.template(), p: ti.template(), nu, R, tau, controls, V_c, sums):
    """nu_dot under tau (N, N m), which holds all loads that do not depend on the velocity relative to the water; those
    of propellers and rudders that do follow from `controls`.
    """
    M_rb, M_a, M_inverse = ti.static(
        symmetric(p, "M_rb"), added_mass(p, hull.params.hydrodynamics), symmetric(p, "inverse")
    )
    nu_c, nu_c_dot, nu_o, nu_o_dot = water.flow(hull.params.current_frame, R, angular(nu), V_c, sums)
    nu_r = nu - nu_c - nu_o
    load = tau + damping_load(hull.params.hydrodynamics, p, nu_r, nu - nu_c)
    if ti.static(hull.thrusters.in_flow):
        load += mmg_drive.load_in_flow(hull.thrusters, p, controls, nu_r)
    load += hull.radiation.orbital_load(M_a, nu_o_dot)
    load = load - coriolis(M_rb, nu - nu_c) - coriolis(M_a, nu_r)
    return nu_c_dot + times(M_inverse, load)


@ti.func
def drift(dt: ti.template(), way, q, nu, turn):
    """Way, attitude and R_nb in the middle of a step, after a turn for `turn` s and half a step's translation."""
    q = quaternion_advance(q, angular(nu), turn)
    R = rotation_matrix(q)
    return way + 0.5 * dt * (R @ linear(nu)), q, R


@ti.func
def kick(hull: ti.template(), p: ti.template(), way, nu, nu_dot, R, tau, controls, V_c, sums):
    """Way at the end of a step, nu there, and nu_dot, under load tau and `controls` in the middle of the step.

    For damping and Coriolis, the velocity in the middle is predicted with the last step's nu_dot.
    """
    nu_dot = acceleration(hull, p, nu + 0.5 * p.dt * nu_dot, R, tau, controls, V_c, sums)
    nu = nu + p.dt * nu_dot
    return way + 0.5 * p.dt * (R @ linear(nu)), nu, nu_dot


@ti.func
def derivative(hull: ti.template(), p: ti.template(), y, R, tau, controls, V_c, sums):
    """dy/dt at attitude R = R_nb under tau and `controls` (see `acceleration`)."""
    _, q, nu = unpack(y)
    return pack(R @ linear(nu), quaternion_rate(q, angular(nu)), acceleration(hull, p, nu, R, tau, controls, V_c, sums))


@ti.func
def runge_kutta(hull: ti.template(), p: ti.template(), z, y, controls, command, load, V_c, sums):
    """Way, attitude and nu of a hull with linear restoring, one step after y, which holds the way from the depth z (m).

    The water is constant during the step, and so is `load`, which holds all loads but restoring and thrust.
    """
    total, slope = y * 0.0, y * 0.0
    for stage in range(4):
        ahead = 0.5 * ((stage + 1) // 2)  # 0, 1/2, 1/2, 1 of the step
        now = hull.drive.lagged(hull.thrusters, p, controls, command, ahead)
        y_s = y + (ahead * p.dt) * slope
        R = rotation_matrix(ti.Vector([y_s[3], y_s[4], y_s[5], y_s[6]]))
        tau = load + linear_load(hull.params.linear, p, z + y_s[2], R, sums)
        tau += hull.drive.load(hull.thrusters, p, now)
        slope = derivative(hull, p, y_s, R, tau, now, V_c, sums)
        total += ti.select(stage % 3 == 0, 1.0, 2.0) * slope
    pos, q, nu = unpack(y + p.dt / 6 * total)
    return pos, q / q.norm(), nu


def linear_motion(M: Array, D: Array, G: Array) -> Array:
    """A [9, 9] of d/dt (z, phi, theta, nu) = A (z, phi, theta, nu); M, D [6, 6] and G [3, 3]."""
    A = np.zeros((9, 9))
    A[:3, 5:8] = np.eye(3)
    inverse = np.linalg.inv(M)
    A[3:, 3:] = -inverse @ D
    A[3:, :3] = -inverse[:, 2:5] @ G
    return A


def runge_kutta_step(A: Array, dt: float) -> Array:
    """Matrix by which the classical Runge-Kutta method advances y' = A y."""
    x, step, term = A * dt, np.eye(len(A)), np.eye(len(A))
    for n in range(1, 5):
        term = term @ x / n
        step = step + term
    return step


def strang_step(A: Array, dt: float, modes: Modes, inverse: Array) -> Array:
    """Matrix of one step of drift, midpoint rule and drift of a hull with the inverse mass `inverse` [6, 6].

    Its state is (pose, nu, last change of nu), and the real and imaginary parts of the memory's filters
    (radiation_memory.py).
    """
    filters = len(modes.pole)
    drift, kick = np.eye(15 + 2 * filters), np.eye(15 + 2 * filters)
    drift[:3, 3:9] = A[:3, 3:] * dt / 2
    middle = np.hstack([np.zeros((6, 3)), np.eye(6), np.eye(6) / 2])  # velocity, predicted with the last change
    change = np.zeros((6, len(kick)))
    change[:, :15] = A[3:, 3:] @ middle
    change[:, :3] = A[3:, :3]
    gain, x = 1 / (1 - modes.pole * dt / 2), np.zeros((filters, len(kick)), dtype=np.complex128)
    x[:, 15::2], x[:, 16::2] = np.eye(filters), 1j * np.eye(filters)
    x_middle = gain[:, None] * x
    x_middle[:, :15] += (gain * dt / 2)[:, None] * modes.enters @ middle
    change -= inverse @ (modes.leaves.T @ x_middle).real
    after = 2 * x_middle - x
    kick[15::2], kick[16::2] = after.real, after.imag
    kick[3:9] += dt * change
    kick[9:15] = dt * change
    return drift @ kick @ drift


def largest_stable_dt(A: Array, step) -> float:
    """Largest dt (s) at which no motion grows under `step(A, dt)`."""

    def stable(dt: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(step(A, dt))).max() <= 1 + 1e-9)

    return edge(0.0, LARGEST, stable, HALVINGS)


@ti.func
def tilted(q, R, along, across):
    """Attitude on a sloping surface of a hull that has attitude q (and R_nb = R) on a level one.

    The surface rises by `along` (m/m) ahead and by `across` (m/m) to starboard.
    """
    cos_h, sin_h = water.heading(R)
    pitch = ti.atan2(along, 1.0)
    roll = -ti.atan2(across * ti.cos(pitch), 1.0)
    cp, sp, cr, sr = ti.cos(0.5 * pitch), ti.sin(0.5 * pitch), ti.cos(0.5 * roll), ti.sin(0.5 * roll)
    x, y = cp * sr, sp * cr
    turn = ti.Vector([cp * cr, x * cos_h - y * sin_h, x * sin_h + y * cos_h, -sp * sr])
    return quaternion_product(turn, q)


@ti.kernel
def float_on_waves(
    hull: ti.template(), out: array3, surface: array3, state: array3, deck: array2, around: AroundPack,
    build: ti.template(),
):  # fmt: skip
    """Write the result of `Hull6Dof.settle` for `state` to `out`."""
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        pos, q, nu = unpack(ti.Vector([state[e, i, c] for c in range(13)]))
        R, now = rotation_matrix(q), pos[0] * 0.0
        D = water.displacement(hull.gauge, build, around, e, pos, R)
        sums, _L, _J = water.at(hull.gauge, build, around, e, now, pos, R, D)
        plane = water.mean_plane(sums, R)
        q = tilted(q, R, sums[water.SLOPE_ALONG], sums[water.SLOPE_ACROSS])
        R = rotation_matrix(q)
        pos[2] -= plane[0]
        V_c, still = ti.Vector([around.current[e, NORTH], around.current[e, EAST], 0.0]), ti.Vector([now, now, now])
        nu_c, _, nu_o, _ = water.flow(hull.params.current_frame, R, still, V_c, sums)
        y = pack(pos, q, nu + nu_c + nu_o)
        for c in ti.static(range(13)):
            out[e, i, c] = y[c]
        surface[e, i, ELEVATION] = plane[0]
        surface[e, i, FREEBOARD] = water.freeboard(deck, R, pos[2], plane)


@ti.kernel
def find_label(hull: ti.template(), aux: array3, state: array3, around: AroundPack, build: ti.template()):
    """Write the displacement of the water's label under the hull to the auxiliary state."""
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        pos, q, _nu = unpack(ti.Vector([state[e, i, c] for c in range(13)]))
        D = water.displacement(hull.gauge, build, around, e, pos, rotation_matrix(q))
        aux[e, i, LABEL], aux[e, i, LABEL + 1] = D[0], D[1]
