"""Rotors: speed, force and moment.

Speed follows its command by a first-order lag, omega' = (omega_c - omega) / tau, tau_up where it rises and tau_down
where it falls. A held command is never passed, so one tau holds through a step, and

    omega(t) = omega_c + (omega - omega_c) e^(-t / tau)

is exact: the equations of motion get these values at the stages of their Runge-Kutta step.

Force and moment of rotor i at r_i, with v_i = v + omega_b x r_i relative to the air, s_i = +1 for one that turns
counter-clockwise seen from above (all in b, forward-right-down):

    F_i = -omega diag(k_d, k_d, k_z) v_i - (0, 0, k_f omega^2 + k_h (v_ix^2 + v_iy^2))
    M_i = r_i x F_i + (0, 0, s_i k_m omega^2) + k_flap omega (v_iy, -v_ix, 0)

(drag of rotors: Martin & Salaun 2010, The true role of accelerometer feedback in quadrotor control, ICRA; lift and
flapping: Hoffmann et al. 2007, AIAA 2007-6461; the form is that of Folk et al. 2023, RotorPy, arXiv:2306.04485). With a
rotor's inertia J_r there is its angular momentum h = -s_i J_r omega about z, and the moment -omega_b x h - dh/dt.

A battery limits the rotors: its voltage falls with charge and load, and the rotors' speed falls with it. The
open-circuit voltage V_0 is linear in the charge, behind a resistance R. The power P is the rotors' shaft power over
their efficiency, plus that of the avionics. The terminal voltage is the larger root of V (V_0 - V) / R = P; where there
is none, the battery gives its largest power, at V_0 / 2. The largest rotor speed of the vehicle file holds at the
nominal voltage and is proportional to the voltage, like the no-load speed of a motor.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rigid_body import cross, is_nothing
from taichi_sim.models.uav.multirotor.params import gains


@ti.func
def clipped(craft: ti.template(), command, most):
    """Commands [rotor] (rad/s) limited to the rotors' range; `most` is their largest speed now (rad/s)."""
    held = command
    for k in ti.static(range(len(craft.rotors))):
        held[k] = ti.max(ti.min(command[k], most), craft.rotor.omega_min)
    return held


@ti.func
def lag_left(craft: ti.template(), p: ti.template(), omega, command):
    """Fraction [rotor] of the change to the command left after half a step; its square: after a whole one."""
    left = omega
    for k in ti.static(range(len(craft.rotors))):
        left[k] = ti.select(command[k] >= omega[k], p.left_up, p.left_down)
    return left


@ti.func
def acceleration(craft: ti.template(), p: ti.template(), omega, command):
    """Rates omega' [rotor] (rad/s^2) of rotors that follow `command`."""
    rate = omega
    for k in ti.static(range(len(craft.rotors))):
        rate[k] = (command[k] - omega[k]) * ti.select(command[k] >= omega[k], p.per_tau_up, p.per_tau_down)
    return rate


@ti.func
def arm(craft: ti.template(), p: ti.template(), k: ti.template()):
    """Hub of rotor k (m, b), from the centre of gravity."""
    x, y, z = ti.static(craft.rotors[k].position)
    return ti.Vector([x - p.cg_0, y - p.cg_1, z - p.cg_2])


@ti.func
def rotor_loads(craft: ti.template(), p: ti.template(), v_r, omega_b, omega, ratio):
    """Force (N) and moment (N m) in b of all rotors at speeds omega [rotor] (rad/s).

    v_r is the velocity (m/s) of the centre of gravity through the air, omega_b the body rates (rad/s), and `ratio`
    [rotor] the factor of the ground effect on the thrusts.
    """
    zero = v_r[0] * 0.0
    force, moment = ti.Vector([zero, zero, zero]), ti.Vector([zero, zero, zero])
    gain = ti.static(gains(p, len(craft.rotors)))
    for k in ti.static(range(len(craft.rotors))):
        r = arm(craft, p, k)
        v = v_r + cross(omega_b, r)
        square = gain[k] * omega[k] * omega[k]
        side, along = p.k_d * omega[k], p.k_z * omega[k]
        lift = p.k_f * square * ratio[k]
        if ti.static(not is_nothing(p.k_h)):
            lift += p.k_h * (v[0] * v[0] + v[1] * v[1])
        F = ti.Vector([-side * v[0], -side * v[1], -along * v[2] - lift])
        force += F
        moment += cross(r, F)
        moment[2] += ti.static(craft.rotors[k].yaw) * p.k_m * square
        if ti.static(not is_nothing(p.k_flap)):
            flap = p.k_flap * omega[k]
            moment[0] += flap * v[1]
            moment[1] -= flap * v[0]
    return force, moment


@ti.func
def spin_moment(craft: ti.template(), p: ti.template(), omega_b, omega, rate):
    """Moment (N m, b) of the rotors' angular momentum on the airframe: -omega_b x h - dh/dt, rate = omega' [rotor]."""
    h, h_dot = omega_b[0] * 0.0, omega_b[0] * 0.0
    for k in ti.static(range(len(craft.rotors))):
        h -= ti.static(craft.rotors[k].yaw) * omega[k]
        h_dot -= ti.static(craft.rotors[k].yaw) * rate[k]
    h *= p.J_r
    return ti.Vector([-omega_b[1] * h, omega_b[0] * h, -p.J_r * h_dot])


@ti.func
def shaft_power(craft: ti.template(), p: ti.template(), omega):
    """Power (W) that the air takes from the rotors' shafts: torque times speed."""
    power = omega[0] * 0.0
    gain = ti.static(gains(p, len(craft.rotors)))
    for k in ti.static(range(len(craft.rotors))):
        power += gain[k] * p.k_m * omega[k] * omega[k] * omega[k]
    return power


@ti.func
def battery_terminal(b: ti.template(), charge, shaft):
    """(voltage, V; current, A) of a Battery with `charge` (0 to 1) left, at the rotors' shaft power `shaft` (W)."""
    V_0 = b.empty + ti.static(b.full - b.empty) * ti.max(charge, 0.0)
    P = shaft * ti.static(1.0 / b.efficiency) + b.avionics
    V = 0.5 * (V_0 + ti.sqrt(ti.max(V_0 * V_0 - ti.static(4.0 * b.resistance) * P, 0.0)))
    return V, P / V
