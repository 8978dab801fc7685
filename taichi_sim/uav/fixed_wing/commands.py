"""From actions to commanded deflections, through the autopilot or directly.

`m` is the model: its `gains`, `autopilot_limits`, `actions`, `protected`, `neutral` are compiled in.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rotation import rates_of, velocity_of
from taichi_sim.uav.fixed_wing import autopilot


@ti.func
def demands(m: ti.template(), action, Va):
    """`autopilot.demands` of the actions [action]; zeros if the actions are deflections."""
    asked = ti.Vector([Va * 0.0] * 9)
    if ti.static(m.actions != "surfaces"):
        turn, boost = action[1], action[2]
        asked = autopilot.demands(m.gains, m.autopilot_limits, m.protected, turn, boost, Va)
    return asked


@ti.func
def commands(m: ti.template(), action, asked, R, y, met, pilot):
    """Commanded deflections (4), and the autopilot's state (integral of the throttle, height that is held).

    R is the attitude; y the state relative to the air, which moves with `met` (NED, m/s); asked = demands(..); pilot
    the autopilot's state before.
    """
    v_air, omega = velocity_of(y), rates_of(y)
    zero = 0.0 * y[0]
    command, state = ti.Vector([zero, zero, zero, zero]), pilot
    air = autopilot.flight(m.gains, R, v_air)
    if ti.static(m.actions == "surfaces"):
        command = deflections(m, action)
    else:
        sin_gamma = action[0] * m.autopilot_limits.sin_pitch
        if ti.static(m.actions == "altitude"):
            climb = action[0] * m.autopilot_limits.climb
            state[1] += m.dt * climb
            climb += m.gains.height * (state[1] + y[2])
            rising = -(R[2, 0] * v_air[0] + R[2, 1] * v_air[1] + R[2, 2] * v_air[2] + met[2])
            sin_gamma = autopilot.climb_to_fly(m.gains, m.autopilot_limits, climb, rising) * air[1]
        sine = autopilot.sine_of_pitch(m.gains, m.autopilot_limits, m.protected, air[0], asked[4], sin_gamma)
        surfaces = autopilot.surfaces(m.gains, asked, air, R, omega, sine)
        engine = autopilot.throttle(m.gains, asked, air[0], sine - asked[4], pilot[0], m.dt)
        state[0] = engine[1]
        command = ti.Vector([surfaces[0], surfaces[1], surfaces[2], engine[0]])
    if ti.static(m.protected):
        alpha = v_air[2] * air[1]
        command[0] = autopilot.protected_elevator(
            m.gains, m.autopilot_limits, command[0], air[0], air[2], alpha, omega[1]
        )
    return command, state


@ti.func
def deflections(m: ti.template(), action):
    """Deflections that the actions command directly.

    Each goes from its lower limit at -1 through its value in cruise at 0 to its upper limit at 1, linear on either
    side.
    """
    command = ti.Vector([action[0], action[1], action[2], action[3]])
    for k in ti.static(range(4)):
        neutral, lower, upper = ti.static(m.neutral[k], m.p.actuators.lower[k], m.p.actuators.upper[k])
        up, down = ti.max(command[k], 0.0), ti.min(command[k], 0.0)
        command[k] = neutral + up * ti.static(upper - neutral) + down * ti.static(neutral - lower)
    return command
