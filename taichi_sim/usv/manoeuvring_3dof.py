"""`manoeuvring_3dof`: a USV in surge, sway and yaw, eqs (1)-(4) of the seed paper, on waves and in a current.

    eta_dot = R(psi) nu,   M nu_dot = -C(nu) nu - D(nu) nu - g + tau,

with eta = [x, y, psi] in n, nu = [u, v, r] in b; M, C, D and the wave disturbance g are in manoeuvring_loads.py.

Current: the water moves with V_c, constant in n, so that nu_c = R^T V_c turns in b, nu_c_dot = -S(r) nu_c. Rigid-body
terms act on nu, hydrodynamic ones on nu_r = nu - nu_c and its derivative. As M_rb nu_c_dot + C_rb(nu) nu -
C_rb(nu_r) nu_r = 0, this is the same equation in nu_r (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion
Control, sec. 10.3), which is what is integrated: eta_dot = R nu_r + V_c.

Heave, roll and pitch follow the plane through the elevations under the four corners of the water plane.
"""

import math

import numpy as np
import taichi as ti
import torch

from taichi_sim import runtime
from taichi_sim.config import ConfigError
from taichi_sim.kinematics import store
from taichi_sim.maths import fast
from taichi_sim.maths.rotation import quaternion_product, rotation_matrix
from taichi_sim.sea import waves
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.manoeuvring_loads import Manoeuvring3dofParams, ManoeuvringLoads

ACTION_NAMES = {"acceleration_yaw": ("acceleration", "yaw"), "surge_sway_yaw": ("surge", "sway", "yaw")}


@ti.data_oriented
class Manoeuvring3dof(ManoeuvringLoads):
    """Steps a team of vessels in place: RK4 in (x, y, psi, u_r, v_r, r), waves and thrust held over a substep.

    Auxiliary state [env, vehicle, 10]: displacement of the surface particle at the hull's centre (north, east, m) and
    its change in the last substep (found as in unity_boat.py); wave load X, Y, N of the surface met at the end of the
    last substep (none before the first); forces X, Y, N of the actuators.
    """

    team = "usv"
    aux_size = 10
    capsize_cosine, deck_height = 0.0, math.inf  # it follows the surface: it cannot capsize or be swamped
    draft, wind_height = 0.0, 10.0  # m; it feels the current at the surface, and no wind
    Params = Manoeuvring3dofParams

    def __init__(self, params: Manoeuvring3dofParams, dt: float, substeps: int):
        """Bake the numbers of `params`, the step dt (s) and the substeps of a control step into the kernel.

        Raises:
            ConfigError: if dt is beyond the largest at which RK4 is stable.
        """
        super().__init__(params)
        if not dt <= params.largest_dt:
            raise ConfigError(f"dt = {dt} s is unstable for this vehicle: allowed are up to {params.largest_dt:.4g} s")
        self.params, self.dt, self.substeps = params, dt, substeps
        self.action_names = ACTION_NAMES[params.actions]
        # Actuators close in on a command by exp(-dt / T) per step; the mean over the step is what the hull feels.
        x = dt / params.time_constant if params.time_constant > 0 else np.inf
        self.lag_end, self.lag_mean = float(np.exp(-x)), float(-np.expm1(-x) / x)

    def step(self, team, action: torch.Tensor, around: Surroundings) -> None:
        """Advance one control step.

        `action` [env, vehicle, action] in [-1, 1]: acceleration maps to X in [0, surge_force_max], yaw to
        N = yaw_moment_max yaw; with actions = "surge_sway_yaw" all three are symmetric.
        """
        sea = around.sea
        self._step(
            team.state, team.derived, team.aux, team.surface, action, sea, around.env_sea, around.phase, around.current,
            sea.shape[2],
        )  # fmt: skip

    def reset_aux(self, aux: torch.Tensor, state: torch.Tensor) -> None:
        """Auxiliary state [.., 10] of vehicles put at `state` [.., 13]: no thrust, no wave load yet."""
        aux.zero_()

    def rhs(self, eta, nu, tau, current=(0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
        """The right-hand side alone, without waves.

        Args:
            eta: [row, 3] x, y (m), psi (rad). nu: [row, 3] u, v (m/s), r (rad/s), over ground. tau: [row, 3] X, Y
                (N), N (N m). current: [2] or [row, 2] north, east, m/s.

        Returns:
            eta_dot [row, 3] and nu_dot [row, 3], in b, over ground.
        """
        eta, nu, tau = (np.atleast_2d(np.asarray(a, dtype=np.float64)) for a in (eta, nu, tau))
        V_c = np.broadcast_to(np.asarray(current, dtype=np.float64), (eta.shape[0], 2))
        run = runtime.current()
        rows = torch.as_tensor(np.hstack((eta, nu, tau, V_c)), dtype=run.torch_dtype, device=run.device)
        out = rows.new_empty((eta.shape[0], 6))
        self._rhs(out, rows)
        result = out.double().cpu().numpy()
        return result[:, :3], result[:, 3:]

    @ti.kernel
    def _rhs(self, out: ti.types.ndarray(ndim=2), rows: ti.types.ndarray(ndim=2)):
        for i in range(rows.shape[0]):
            V_c = ti.Vector([rows[i, 9], rows[i, 10]])
            sine, cosine = fast.sincos(rows[i, 2])
            u_c, v_c = cosine * V_c[0] + sine * V_c[1], cosine * V_c[1] - sine * V_c[0]
            s = ti.Vector([rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] - u_c, rows[i, 4] - v_c, rows[i, 5]])
            rate = self.derivatives(s, ti.Vector([rows[i, 6], rows[i, 7], rows[i, 8]]), V_c)
            rate[3] += rows[i, 5] * v_c
            rate[4] -= rows[i, 5] * u_c
            for k in ti.static(range(6)):
                out[i, k] = rate[k]

    @ti.kernel
    def _step(
        self,
        state: ti.types.ndarray(ndim=3),
        derived: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        surface: ti.types.ndarray(ndim=3),
        action: ti.types.ndarray(ndim=3),
        sea: ti.types.ndarray(ndim=3),
        env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
        phase: ti.types.ndarray(ndim=2),
        current: ti.types.ndarray(ndim=2),
        count: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            V_c = ti.Vector([current[e, 0], current[e, 1]])
            s, plane = self.load(state, e, i, V_c)
            before = plane
            D = ti.Vector([aux[e, i, 0], aux[e, i, 1]])
            change = ti.Vector([aux[e, i, 2], aux[e, i, 3]])
            wave = ti.Vector([aux[e, i, 4], aux[e, i, 5], aux[e, i, 6]])
            drive = ti.Vector([aux[e, i, 7], aux[e, i, 8], aux[e, i, 9]])
            command = self.command(action, e, i)
            for n in range(self.substeps):
                excess = drive - command
                s = self.runge_kutta(s, command + self.lag_mean * excess + wave, V_c)
                drive = command + self.lag_end * excess
                D_next, heights = self.elevations(
                    sea, phase, count, env_sea[e], e, (n + 1) * ti.static(self.dt), s, D + change
                )
                change = D_next - D
                D = D_next
                before = plane
                plane = self.water_plane(heights)
                wave = self.wave_load(plane)
            q, omega = self.attitude(s[2], s[5], plane, (plane - before) / ti.static(self.dt))
            R_nb = rotation_matrix(q)
            c, sine = self.heading(R_nb)
            v_n = ti.Vector([c * s[3] - sine * s[4] + V_c[0], sine * s[3] + c * s[4] + V_c[1], 0.0])
            v_n[2] = (before[0] - plane[0]) / ti.static(self.dt)
            store(derived, e, i, R_nb, v_n)
            v_b = R_nb.transpose() @ v_n
            state[e, i, 0], state[e, i, 1], state[e, i, 2] = s[0], s[1], -plane[0]
            for k in ti.static(range(4)):
                state[e, i, 3 + k] = q[k]
            for k in ti.static(range(3)):
                state[e, i, 7 + k], state[e, i, 10 + k] = v_b[k], omega[k]
                aux[e, i, 4 + k], aux[e, i, 7 + k] = wave[k], drive[k]
            aux[e, i, 0], aux[e, i, 1], aux[e, i, 2], aux[e, i, 3] = D[0], D[1], change[0], change[1]
            surface[e, i, 0] = plane[0]

    @ti.func
    def command(self, action: ti.template(), e, i):
        """Forces X, Y (N) and moment N (N m) that the actions ask for."""
        X, Y, N = action[e, i, 0], action[e, i, 0] * 0.0, action[e, i, 1]
        if ti.static(self.p.actions == "surge_sway_yaw"):
            Y, N = action[e, i, 1], action[e, i, 2]
        else:
            X = 0.5 * (X + 1.0)
        return ti.Vector([self.p.surge_force_max * X, self.p.sway_force_max * Y, self.p.yaw_moment_max * N])

    @ti.func
    def derivatives(self, s, tau, V_c):
        """Rates of s = [x, y, psi, u_r, v_r, r] under tau = [X, Y, N], velocity relative to water that moves by V_c."""
        sine, cosine = fast.sincos(s[2])
        a = self.acceleration(s[3], s[4], s[5], tau)
        x_dot, y_dot = cosine * s[3] - sine * s[4] + V_c[0], sine * s[3] + cosine * s[4] + V_c[1]
        return ti.Vector([x_dot, y_dot, s[5], a[0], a[1], a[2]])

    @ti.func
    def runge_kutta(self, s, tau, V_c):
        """s after one step of the classical fourth-order method."""
        h = ti.static(self.dt)
        k1 = self.derivatives(s, tau, V_c)
        k2 = self.derivatives(s + (0.5 * h) * k1, tau, V_c)
        k3 = self.derivatives(s + (0.5 * h) * k2, tau, V_c)
        k4 = self.derivatives(s + h * k3, tau, V_c)
        return s + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)

    @ti.func
    def heading(self, R):
        """Cosine and sine of the heading of R = R_nb."""
        inv = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0])
        return R[0, 0] * inv, R[1, 0] * inv

    @ti.func
    def load(self, state: ti.template(), e, i, V_c):
        """s = [x, y, psi, u_r, v_r, r] and the water plane (water_plane; its twist is not kept) of a packed state."""
        R = rotation_matrix(ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]]))
        v = R @ ti.Vector([state[e, i, 7], state[e, i, 8], state[e, i, 9]])
        c, sine = self.heading(R)
        north, east = v[0] - V_c[0], v[1] - V_c[1]
        r = (R[2, 1] * state[e, i, 11] + R[2, 2] * state[e, i, 12]) / (R[2, 1] * R[2, 1] + R[2, 2] * R[2, 2])
        u_r, v_r = c * north + sine * east, c * east - sine * north
        slope_n, slope_e = R[0, 2] / R[2, 2], R[1, 2] / R[2, 2]
        ahead, right = c * slope_n + sine * slope_e, c * slope_e - sine * slope_n
        s = ti.Vector([state[e, i, 0], state[e, i, 1], ti.atan2(R[1, 0], R[0, 0]), u_r, v_r, r])
        return s, ti.Vector([-state[e, i, 2], ahead, right, ahead * 0.0])

    @ti.func
    def elevations(self, sea: ti.template(), phase: ti.template(), count: ti.template(), sea_index, e, tau, s, D):
        """Displacement (m) at the centre, from its prediction D, and elevations (m, up) at the four corners."""
        sine, cosine = fast.sincos(s[2])
        x, y = s[0] + D[0], s[1] + D[1]
        fx, fy = 0.5 * self.p.length * cosine, 0.5 * self.p.length * sine
        gx, gy = -0.5 * self.p.beam * sine, 0.5 * self.p.beam * cosine
        X = ti.Vector([x, x + fx - gx, x + fx + gx, x - fx - gx, x - fx + gx])
        Y = ti.Vector([y, y + fy - gy, y + fy + gy, y - fy - gy, y - fy + gy])
        h = waves.displacement_and_four_elevations(sea, phase, count, sea_index, e, X, Y, tau)
        return ti.Vector([h[0], h[1]]), ti.Vector([h[2], h[3], h[4], h[5]])

    @ti.func
    def attitude(self, psi, r, plane, rate):
        """Quaternion of heading psi on the water plane, and body rates (rad/s) as the plane changes by `rate`.

        tan theta = slope ahead, tan phi = -slope to starboard cos theta; half angles by square roots.
        """
        cos_t = 1.0 / ti.sqrt(1.0 + plane[1] * plane[1])
        sin_t = plane[1] * cos_t
        tan_p = -plane[2] * cos_t
        cos_p = 1.0 / ti.sqrt(1.0 + tan_p * tan_p)
        sin_p = tan_p * cos_p
        half_ct, half_cp = ti.sqrt(0.5 * (1.0 + cos_t)), ti.sqrt(0.5 * (1.0 + cos_p))
        half_st, half_sp = 0.5 * sin_t / half_ct, 0.5 * sin_p / half_cp
        tilt = ti.Vector([half_ct * half_cp, half_ct * half_sp, half_st * half_cp, -half_st * half_sp])
        # libm here: an error of the stored heading would grow from step to step
        yaw = ti.Vector([ti.cos(0.5 * psi), psi * 0.0, psi * 0.0, ti.sin(0.5 * psi)])
        theta_dot = rate[1] * cos_t * cos_t
        phi_dot = -(rate[2] * cos_t - plane[2] * sin_t * theta_dot) * cos_p * cos_p
        p = phi_dot - r * sin_t
        omega = ti.Vector([p, theta_dot * cos_p + r * cos_t * sin_p, r * cos_t * cos_p - theta_dot * sin_p])
        return quaternion_product(yaw, tilt), omega
