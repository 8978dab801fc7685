"""Names and columns of a hull's auxiliary state: its instruments, and what it carries from step to step."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

AUX = (
    "label_north", "label_east", "label_change_north", "label_change_east",
    "pressure_x", "pressure_y", "pressure_z", "drag_x", "drag_y", "drag_z",
    "wind_x", "wind_y", "wind_z",
    "u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot",
)  # fmt: skip
"""Displacement of the label under the hull (water.py) and its change in a step (m), forces in the last step (N, b), and
nu_dot in that step (m/s^2, rad/s^2). The columns of the thrusters (thruster_set.py), of the pressure heads
(pressure.py) and of the radiation's memory (radiation.py) follow."""

LABEL, LABEL_CHANGE, PRESSURE, DRAG, WIND_FORCE, NU_DOT = map(
    AUX.index, ("label_north", "label_change_north", "pressure_x", "drag_x", "wind_x", "u_dot")
)
CONTROLS = len(AUX)
"""First column of each group."""


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
