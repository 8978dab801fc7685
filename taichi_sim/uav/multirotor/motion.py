"""One step of a multirotor's equations of motion: classical Runge-Kutta, in the frame of the air, rotors exact.

The rotors' speeds at the stages come from their exact solution for the held command (rotors.py). A lag as short as half
a step costs neither accuracy nor stability.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rotation import rotation_matrix
from taichi_sim.uav.multirotor import ground, rotors
from taichi_sim.uav.multirotor.airframe import derivative


@ti.func
def rk4(craft: ti.template(), p: ti.template(), kind: ti.template(), y, omega, command, below, tau, dt: ti.template()):
    """State and rotor speeds [rotor] (rad/s) in still air after a step dt (s), with the load tau and the command held.

    kind, below: what is below the centre of gravity at the beginning of the step (ground.py).
    """
    left = rotors.lag_left(craft, p, omega, command)
    away, start = omega - command, y
    k, new, speed = 0.0 * y, y, omega
    for stage in range(4):  # a loop, not four copies: compiled in a quarter of the time
        ahead = ti.select(stage == 0, 0.0, ti.select(stage == 3, dt, ti.static(0.5 * dt)))
        weight = ti.select(stage == 0 or stage == 3, ti.static(dt / 6.0), ti.static(dt / 3.0))
        if stage == 1 or stage == 3:
            away *= left
        speed = command + away
        at = start + ahead * k
        R = rotation_matrix(ti.Vector([at[3], at[4], at[5], at[6]]))
        rate = rotors.acceleration(craft, p, speed, command)
        v_r = ti.Vector([at[7], at[8], at[9]])
        there = ground.lowered(kind, below, start[2] - at[2])
        k = derivative(craft, p, kind, at, R, v_r, speed, rate, there, tau)
        new += weight * k
    # one Newton step of 1/|q| suffices: |q| - 1 is as small as the method's error per step
    norm2 = new[3] * new[3] + new[4] * new[4] + new[5] * new[5] + new[6] * new[6]
    for c in ti.static(range(3, 7)):
        new[c] *= 1.5 - 0.5 * norm2
    return new, speed
