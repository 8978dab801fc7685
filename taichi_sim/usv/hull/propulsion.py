"""What a hull's thrusters make of its model: actions, controls, columns of the auxiliary state, top speed, power."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor

from taichi_sim.usv.hull import allocation
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.hull.thrusters import Unit
from taichi_sim.usv.vessel import Vessel, steady_speed
from taichi_sim.vehicle import Limits

ACTION_NAMES = {"surge_yaw": ("acceleration", "yaw"), "wrench": ("surge", "sway", "yaw")}  # of others: the units'
Arrow = tuple[tuple[float, float, float], tuple[str | None, str | None, str | None]]


class Propelled(Vessel):
    """A hull's thrusters, which are `units`; without any it has the columns of two propellers, at rest.

    Attributes:
        settings: number of actuator settings: a speed of each unit, then an angle of each that turns. turning: those.
        first_thrust: column of the auxiliary state where thrusts begin. push_of: of each unit, the column of its push
            ahead, its push to starboard being the next; -1 where its thrust says it. angle_of: of each unit, the
            setting that is its angle; -1 of one that does not turn.
        shares: pseudo-inverse (allocation.py), rows of components; first_component: of each unit. wrench_max,
            wrench_min: X, Y, N (N, N m) of the actions 1 and -1. All of `actions = "wrench"` alone.
    """

    def fit_out(self, params: Hull6DofParams, first: int) -> int:
        """Lay out the thrusters' columns from `first` on; return the column after them."""
        self.units: tuple[Unit, ...] = params.units
        self.turning = tuple(unit for unit in self.units if unit.azimuth)
        self.propelled = bool(self.units)
        names = tuple(unit.name for unit in self.units) or ("left", "right")
        angles = tuple(f"angle_{unit.name}" for unit in self.turning)
        self.control_names = (*(f"shaft_{name}" for name in names), *angles)
        self.action_names = ACTION_NAMES.get(params.actions, (*names, *(f"{unit.name}_angle" for unit in self.turning)))
        self.settings, self.first_thrust = len(self.control_names), first + len(self.control_names)
        columns, push_of = [*self.control_names, *(f"thrust_{name}" for name in names)], []
        for unit in self.units:
            plain = not unit.azimuth and 1.0 in unit.direction
            push_of.append(-1 if plain else first + len(columns))
            columns += [] if plain else [f"ahead_{unit.name}", f"starboard_{unit.name}"]
        self.push_of, self.thruster_columns = tuple(push_of), tuple(columns)
        self.angle_of = tuple(len(names) + self.turning.index(unit) if unit.azimuth else -1 for unit in self.units)
        self._prepare(params)
        rated = params.thrusters is not None or all(one.n_max is not None for one in params.actuators.values())
        self.signals = {
            "shaft speed": ("rad/s" if rated else "", self.control_names[: len(names)]),
            "thrust": ("N", tuple(f"thrust_{name}" for name in names)),
            **({"thruster angle": ("rad", angles)} if angles else {}),
        }
        return first + len(columns)

    def _prepare(self, params: Hull6DofParams) -> None:
        """Numbers of the allocation, where it is asked for."""
        if params.actions != "wrench":
            return
        found = allocation.components(self.units)
        self.first_component = tuple(found.index((k, 0)) for k in range(len(self.units)))
        self.shares = tuple(tuple(float(x) for x in row) for row in allocation.pseudo_inverse(self.units))
        self.wrench_max, self.wrench_min = (tuple(float(x) for x in row) for row in allocation.largest(self.units))

    @property
    def limits(self) -> Limits:
        """Its top speed is where damping takes all the thrust, if it has thrusters."""
        h = self.params.hydrodynamics
        if not self.propelled:
            return Limits()
        return Limits((0.0, 0.0, steady_speed(sum(unit.ahead for unit in self.units), h.linear[0], h.quadratic[0])))

    @property
    def push_ahead(self) -> float:
        """The most that its thrusters push ahead, fouled or damaged as they are, N."""
        return sum(gain * unit.ahead for gain, unit in zip(self.params.gains, self.units, strict=True))

    @property
    def thrust_arrows(self) -> Mapping[str, Arrow]:
        """Load arrows of a recording (`Vehicle.forces`)."""
        found: dict[str, Arrow] = {}
        for unit, push in zip(self.units, self.push_of, strict=True):
            along, name = unit.direction, f"thrust_{unit.name}"
            if push >= 0:
                columns = f"ahead_{unit.name}", f"starboard_{unit.name}", None
            else:
                columns = (name, None, None) if along[0] == 1.0 else (None, name, None)
            found[name] = (unit.position, columns)
        return found

    def power(self, fleet: Any) -> Tensor | None:
        """Thrust times the speed of the hull along it, of all units [env, vehicle], W; None without thrusters."""
        if not self.propelled:
            return None
        first, count = self.first_thrust, len(self.units)
        if all(unit.direction[0] == 1.0 and not unit.azimuth for unit in self.units):
            return fleet.aux[..., first : first + count].sum(-1) * fleet.velocity_b[..., 0]
        total = fleet.velocity_b[..., 0] * 0.0
        for _, columns in self.thrust_arrows.values():
            for axis, column in enumerate(columns):
                if column is not None:
                    total += fleet.reading(column) * fleet.velocity_b[..., axis]
        return total
