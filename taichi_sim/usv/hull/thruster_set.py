"""What a hull's thrusters do, as methods that kernels inline: commands, lags, turning, thrusts, load.

`setting` is a vector: the speed of each unit, then the angle (rad) of each that turns. `p` is what the kernel works
with (numbers.py). All is unrolled over the units.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math

import taichi as ti

from taichi_sim.usv.hull import pressure
from taichi_sim.usv.hull.model import SHAFT
from taichi_sim.usv.hull.numbers import vector
from taichi_sim.usv.hull.water import HullWater

IDLE = 1e-3  # of its greatest thrust: for less, a unit does not turn; assumed (rounding has no direction)
NONE = 1e-12  # of its greatest thrust; keeps the direction of no thrust finite


@ti.func
def within_half_turn(angle):
    """The angle (rad) in [-pi, pi) of the same direction."""
    return angle - ti.static(2 * math.pi) * ti.floor((angle + ti.static(math.pi)) * ti.static(0.5 / math.pi))


class HullActuators(HullWater):
    """How a hull is driven."""

    @ti.func
    def settings_of(self, table: ti.template(), e, i, first: ti.template()):
        """The settings that begin at the column `first` of a row of a table."""
        return ti.Vector([table[e, i, first + c] for c in ti.static(range(self.settings))])

    # -- commands --------------------------------------------------------------------------------------------------

    @ti.func
    def command(self, action: ti.template(), e, i, setting):
        """Commanded settings of an action; see step."""
        wanted = setting * 0.0
        if ti.static(self.propelled):
            if ti.static(self.params.actions == "wrench"):
                tau = ti.Vector([action[e, i, 0], action[e, i, 1], action[e, i, 2]])
                for c in ti.static(range(3)):
                    most, least = ti.static(self.wrench_max[c], self.wrench_min[c])
                    tau[c] *= ti.select(tau[c] > 0, most, -least)
                wanted = self.allocated(tau, setting)
            elif ti.static(self.params.actions == "surge_yaw"):
                low, high = ti.static(self.units[0].thrust_min), ti.static(self.units[0].thrust_max)
                surge = 0.5 * (action[e, i, 0] + 1.0) * high
                yaw = 0.5 * action[e, i, 1] * (high - low)
                wanted[0] = pressure.shaft_speed(self.units[0], ti.max(ti.min(surge + yaw, high), low))
                wanted[1] = pressure.shaft_speed(self.units[1], ti.max(ti.min(surge - yaw, high), low))
            else:
                for k in ti.static(range(self.settings)):
                    share = action[e, i, k]
                    if ti.static(k < len(self.units)):
                        n_max, n_min = ti.static(self.units[k].n_max, self.units[k].n_min)
                        wanted[k] = ti.select(share > 0, share * n_max, -share * n_min)
                    else:
                        low, high = ti.static(self.turning[k - len(self.units)].span)
                        wanted[k] = low + 0.5 * (share + 1.0) * (high - low)
        return wanted

    @ti.func
    def allocated(self, tau, setting):
        """Settings that make tau (X, Y, N), or as much of it as all units can make in its direction (allocation.py).

        A unit that turns is told where to push, and meanwhile pushes with what of that its present angle has.
        """
        wanted, push, share = setting, setting * 0.0, tau[0] * 0.0 + 1.0
        ahead, right = setting * 0.0, setting * 0.0  # of the units, as they are unturned
        for k in ti.static(range(len(self.units))):
            u, first = ti.static(self.units[k], self.first_component[k])
            limit = tau[0] * 0.0
            for axis in ti.static(range(3)):
                ahead[k] += ti.static(self.shares[first][axis]) * tau[axis]
            if ti.static(u.azimuth):
                c, s = ti.static(u.direction)
                x, y = ahead[k], tau[0] * 0.0
                for axis in ti.static(range(3)):
                    y += ti.static(self.shares[first + 1][axis]) * tau[axis]
                ahead[k], right[k] = c * x + s * y, c * y - s * x
                angle, at = ti.atan2(right[k], ahead[k]), ti.static(self.angle_of[k])
                push[k], limit = 1.0, ti.static(u.thrust_max)
                if ti.static(not u.all_round):  # out of its range it pushes the other way
                    low, high = ti.static(u.turns)
                    if angle < low or angle > high:
                        push[k], limit = -1.0, ti.static(-u.thrust_min)
                        angle += ti.select(angle > 0, ti.static(-math.pi), ti.static(math.pi))
                wanted[at] = angle
            else:
                limit = ti.select(ahead[k] > 0, ti.static(u.thrust_max), ti.static(-u.thrust_min))
            size = ti.sqrt(ahead[k] * ahead[k] + right[k] * right[k])
            share = ti.min(share, limit / ti.max(size, ti.static(NONE * u.thrust_max)))
        for k in ti.static(range(len(self.units))):
            u = ti.static(self.units[k])
            thrust = share * ahead[k]
            if ti.static(u.azimuth):
                at = ti.static(self.angle_of[k])
                if share * ti.sqrt(ahead[k] * ahead[k] + right[k] * right[k]) < ti.static(IDLE * u.thrust_max):
                    wanted[at] = setting[at]
                thrust = share * (ahead[k] * ti.cos(setting[at]) + right[k] * ti.sin(setting[at]))
                thrust = ti.select(push[k] > 0, ti.max(thrust, 0.0), ti.min(thrust, 0.0))
            wanted[k] = pressure.shaft_speed(u, thrust)
        return wanted

    # -- what follows ----------------------------------------------------------------------------------------------

    @ti.func
    def lagged(self, p: ti.template(), setting, command, ahead):
        """Settings on the way to the command, `ahead` of a step later: 0, 1/2 or 1.

        Without a lag a command acts at once.
        """
        found = setting
        if ti.static(self.propelled):
            halves, wholes = ti.static(vector(p, "keep_half", len(self.units)), vector(p, "keep", len(self.units)))
            for k in ti.static(range(len(self.units))):
                begin = ti.select(wholes[k] > 0, 1.0, 0.0)
                keep = ti.select(ahead > 0.5, wholes[k], ti.select(ahead > 0, halves[k], begin))
                found[k] = command[k] + (setting[k] - command[k]) * keep
            for a in ti.static(range(len(self.turning))):
                u, at = ti.static(self.turning[a], len(self.units) + a)
                most = ahead * ti.static(u.turn_rate * self.dt)
                if ti.static(u.all_round):  # the shorter way round
                    way = within_half_turn(command[at] - setting[at])
                    found[at] = within_half_turn(setting[at] + ti.max(ti.min(way, most), -most))
                else:
                    found[at] = setting[at] + ti.max(ti.min(command[at] - setting[at], most), -most)
        return found

    @ti.func
    def thrusts(self, p: ti.template(), setting):
        """Thrusts (N) of the units, and what they push ahead and to starboard: three vectors."""
        size = ti.static(max(len(self.units), 1))
        thrust = ti.Vector([setting[0] * 0.0 for _ in range(size)])
        ahead, right = thrust, thrust
        if ti.static(self.propelled):
            gains = ti.static(vector(p, "gain", len(self.units)))
            for k in ti.static(range(len(self.units))):
                u = ti.static(self.units[k])
                thrust[k] = gains[k] * pressure.thrust(u, setting[k])
                c, s = ti.static(u.direction)
                if ti.static(u.azimuth):
                    at = ti.static(self.angle_of[k])
                    turned_c, turned_s = ti.cos(setting[at]), ti.sin(setting[at])
                    ahead[k] = (c * turned_c - s * turned_s) * thrust[k]
                    right[k] = (s * turned_c + c * turned_s) * thrust[k]
                else:
                    ahead[k], right[k] = c * thrust[k], s * thrust[k]
        return thrust, ahead, right

    @ti.func
    def thrust_load(self, p: ti.template(), setting):
        """Load of the thrusters."""
        load = ti.Vector([setting[0] * 0.0 for _ in range(6)])
        if ti.static(self.propelled):
            thrust, ahead, right = self.thrusts(p, setting)
            for k in ti.static(range(len(self.units))):
                u = ti.static(self.units[k])
                for c in ti.static(range(6)):
                    if ti.static(u.azimuth):
                        load[c] += ti.static(u.arm[0][c]) * ahead[k] + ti.static(u.arm[1][c]) * right[k]
                    elif ti.static(u.wrench[c] != 0):
                        load[c] += ti.static(u.wrench[c]) * thrust[k]
        return load

    @ti.func
    def note_thrusts(self, p: ti.template(), aux: ti.template(), e, i, setting):
        """Write settings and thrusts at the end of the step to aux, as propulsion.py has them."""
        for c in ti.static(range(self.settings)):
            aux[e, i, SHAFT + c] = setting[c]
        if ti.static(self.propelled):
            thrust, ahead, right = self.thrusts(p, setting)
            for k in ti.static(range(len(self.units))):
                aux[e, i, ti.static(self.first_thrust + k)] = thrust[k]
                if ti.static(self.push_of[k] >= 0):
                    aux[e, i, ti.static(self.push_of[k])] = ahead[k]
                    aux[e, i, ti.static(self.push_of[k] + 1)] = right[k]
