"""Propellers and rudders of the MMG method on a hull in six degrees of freedom, and its manoeuvring polynomial.

The forces are those of usv/mmg.py (Yasukawa & Yoshimura 2015, J. Mar. Sci. Technol. 20, 37-52) for the velocity
[u v r] of CO relative to the water. Each has a point of attack (x, y, z), so that a rudder heels the ship:

    K = -z Y,   M = z X,   N as in the plane, less y X.

- Two propellers, y to starboard and to port, have their own revolutions, and meet the water at u - y r in the place of
  u (assumed). Two rudders turn together. A rudder stands behind its own propeller; where the numbers differ, it stands
  behind one propeller with the mean thrust.
- The polynomial, where there is one, holds all loads of the hull in surge, sway and yaw, also the Munk moment. So the
  moment -(Y_vdot - X_udot) u v of the added mass (motion.py) is taken away.

Propeller and rudder follow their commands by lag and rate, as in usv/mmg.py. `p` holds the kernel's numbers
(params.py). All loops over propellers and rudders are unrolled.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false

import math
from collections.abc import Mapping

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import AHEAD
from taichi_sim.models.usv.hull.thruster_set import Arrow
from taichi_sim.models.usv.hull.thruster_set import controls_at as controls_at
from taichi_sim.models.usv.hull.thrusters import Thruster
from taichi_sim.models.usv.mmg import followed, hull_load, rudder_load, thrust
from taichi_sim.models.usv.mmg_params import MmgSection


class MmgDrive:
    """Compile-time tables of propellers and rudders, and their names. It takes the place of a ThrusterSet.

    Attributes:
        action_names, control_names: propellers, then the rudder; controls are revolutions (1/s) and an angle (rad).
        columns: names of the columns in the auxiliary state, controls first.
        first, first_thrust, first_rudder: first column of the controls, of the thrusts (N), and of the rudders' X and
            Y (N, b).
        propellers, rudders: y of each, m.
        stands_behind: whether each rudder has a propeller of its own.
        signals: plots of a recording (`Vehicle.signals`).
    """

    in_flow = True  # whether loads depend on the velocity through the water
    thrusters: tuple[Thruster, ...] = ()
    allocation = None

    def __init__(self, section: MmgSection, first: int):
        """Take the section [mmg]; the columns in the auxiliary state begin at `first`."""
        self.section, self.first = section, first
        self.polynomial = section.hull is not None
        self.z_H = section.hull.z if section.hull is not None else 0.0
        self.z_P, self.z_R = section.propeller.z, section.rudder.z
        self.propellers, self.rudders = (_places(p.count, p.y) for p in (section.propeller, section.rudder))
        self.stands_behind = len(self.propellers) == len(self.rudders)
        one = len(self.propellers) == 1
        names = ("propeller",) if one else ("propeller_left", "propeller_right")
        thrusts = ("thrust",) if one else ("thrust_left", "thrust_right")
        self.action_names = self.control_names = (*names, "rudder")
        self.columns = (*self.control_names, *thrusts, "rudder_x", "rudder_y")
        self.first_thrust = first + len(self.control_names)
        self.first_rudder = self.first_thrust + len(thrusts)
        self.backs = section.propeller.n_astern > 0
        self.helm_max = math.radians(section.rudder.angle_max_deg)
        self.signals = {"revolutions": ("1/s", names), "rudder": ("rad", ("rudder",)), "thrust": ("N", thrusts)}

    def __len__(self) -> int:
        """Number of propellers."""
        return len(self.propellers)

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64]:
        """Return the actions of a helmsman (`Vessel.steer`); the propellers turn alike."""
        ahead, helm = np.broadcast_arrays(np.asarray(ahead, dtype=np.float64), helm)
        return np.stack((*(ahead for _ in self.propellers), helm), axis=-1)

    @property
    def arrows(self) -> Mapping[str, Arrow]:
        """Load arrows of a recording (`Vehicle.forces`)."""
        L, p, r = self.section.length, self.section.propeller, self.section.rudder
        found: dict[str, Arrow] = {"rudder": ((r.x * L, 0.0, r.z), ("rudder_x", "rudder_y", None))}
        for name, y in zip(self.signals["thrust"][1], self.propellers, strict=True):
            found[name] = ((p.x * L, y, p.z), (name, None, None))
        return found

    def power(self, fleet: Fleet) -> Tensor:
        """Thrusts times the speed ahead, [env, vehicle], W."""
        thrusts = fleet.aux[..., self.first_thrust : self.first_thrust + len(self)]
        return thrusts.sum(-1) * fleet.velocity_b[..., AHEAD]


def _places(count: int, y: float) -> tuple[float, ...]:
    return (0.0,) if count == 1 else (-y, y)


@ti.func
def commanded(drive: ti.template(), p: ti.template(), action: ti.template(), e, i, controls):
    """Command for an action; -1 and 1 are full astern and ahead, and hard to port and starboard."""
    command = controls * 0.0
    for k in ti.static(range(len(drive.propellers))):
        share = action[e, i, k]
        command[k] = share * ti.select(share > 0, p.n_ahead, p.n_astern)
    command[ti.static(len(drive.propellers))] = action[e, i, ti.static(len(drive.propellers))] * p.angle_max
    return command


@ti.func
def lagged(drive: ti.template(), p: ti.template(), controls, command, ahead):
    """Controls after `ahead` (0, 1/2 or 1) of a step towards the command."""
    found, last = controls, ti.static(len(drive.propellers))
    close_n = ti.select(ahead > 0.5, p.lag_n, ti.select(ahead > 0, p.lag_half_n, 0.0))
    close_delta = ti.select(ahead > 0.5, p.lag_delta, ti.select(ahead > 0, p.lag_half_delta, 0.0))
    for k in ti.static(range(len(drive.propellers))):
        now, asked = ti.Vector([controls[k], controls[last]]), ti.Vector([command[k], command[last]])
        new = followed(p, now, asked, close_n, close_delta, ahead)
        found[k], found[last] = new[0], new[1]
    return found


@ti.func
def load(drive: ti.template(), p: ti.template(), controls):
    """Load that does not depend on the velocity: none."""
    return ti.Vector([controls[0] * 0.0 for _ in range(6)])


@ti.func
def parts(drive: ti.template(), p: ti.template(), controls, nu_r):
    """Load (N, N m, about CO, b) of propellers and rudders, thrusts (N), and the rudders' X and Y (N)."""
    tau, blades = nu_r * 0.0, ti.Vector([0.0 * nu_r[0], 0.0 * nu_r[0]])
    thrusts = ti.Vector([0.0 * nu_r[0] for _ in ti.static(range(len(drive.propellers)))])
    v, r, delta = nu_r[1], nu_r[5], controls[ti.static(len(drive.propellers))]
    for k in ti.static(range(len(drive.propellers))):
        y = ti.static(drive.propellers[k])
        thrusts[k] = thrust(p, nu_r[0] - y * r, v, r, controls[k])
        X = p.push * thrusts[k]
        tau[0] += X
        tau[4] += drive.z_P * X
        tau[5] -= y * X
    for k in ti.static(range(len(drive.rudders))):
        y = ti.static(drive.rudders[k])
        T = thrusts.sum() * ti.static(1.0 / len(drive.propellers))
        if ti.static(drive.stands_behind):
            T = thrusts[k]
        f = rudder_load(p, nu_r[0] - y * r, v, r, T, delta)
        tau += ti.Vector([f[0], f[1], 0.0, -drive.z_R * f[1], drive.z_R * f[0], f[2] - y * f[0]])
        blades += ti.Vector([f[0], f[1]])
    return tau, thrusts, blades


@ti.func
def load_in_flow(drive: ti.template(), p: ti.template(), controls, nu_r):
    """Load (N, N m, about CO, b) of propellers, rudders and polynomial at the velocity nu_r through the water."""
    tau, _thrusts, _blades = parts(drive, p, controls, nu_r)
    if ti.static(drive.polynomial):
        f = hull_load(p, nu_r[0], nu_r[1], nu_r[5])
        munk = (p.added_1 - p.added_0) * nu_r[0] * nu_r[1]
        tau += ti.Vector([f[0], f[1], 0.0, -drive.z_H * f[1], drive.z_H * f[0], f[2] + munk])
    return tau


@ti.func
def note(drive: ti.template(), p: ti.template(), aux: ti.template(), e, i, controls, nu_r):
    """Write controls, thrusts and the rudders' forces at the end of the step to the auxiliary state."""
    _tau, thrusts, blades = parts(drive, p, controls, nu_r)
    for c in ti.static(range(len(drive.control_names))):
        aux[e, i, ti.static(drive.first) + c] = controls[c]
    for k in ti.static(range(len(drive.propellers))):
        aux[e, i, ti.static(drive.first_thrust) + k] = thrusts[k]
    for c in ti.static(range(2)):
        aux[e, i, ti.static(drive.first_rudder) + c] = blades[c]
