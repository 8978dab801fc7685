"""`steered_ship`: a ship that follows an ordered course and speed, by its size alone; for traffic.

With L the length, U the speed through the water and the ordered course psi* and speed U*:

    psi' = sat((psi* - psi) / T),  |psi'| <= turn U / L,  T = lag L / U;    U' = (U* - U) / (stop L / U_top),
    U_top = froude sqrt(g L).

`turn` is the yaw rate of a turning circle over U / L, twice the length over the steady diameter. IMO MSC.137(76)
demands a tactical diameter below 5 L (0.4), and a track reach of a crash stop below 15 L. A speed that falls
exponentially reaches U stop L / U_top: `stop` lengths from top speed. `lag` is of the order of the time constant T'
of Nomoto's equation, 0.5 to 3 (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 6.4 and
7.2).

The ship moves with the water, level on its mean surface; waves and wind do not move it.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false, reportIndexIssue=false

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.config import Positive
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.abreast import put
from taichi_sim.kernels.conventions import GRAVITY, NORTH, QW, SURGE
from taichi_sim.kernels.packs import AroundPack, FleetPack, own_numbers
from taichi_sim.kernels.position import move
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, VELOCITY_N, rotation_matrix, store
from taichi_sim.models.usv.vessel_base import Length, Vessel
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits, VehicleParams


class SteeredShipParams(VehicleParams):
    """Parameters of a vehicle file with model = "steered_ship"."""

    length: Length
    slenderness: Annotated[Positive, Plausible(2.0, 12.0)] = 6.0  # length over beam
    depth: Annotated[Positive, Plausible(0.03, 0.5)] = 0.15  # height over length, for pictures
    froude: Annotated[Positive, Plausible(0.1, 1.5)] = 0.25  # of the top speed
    turn: Annotated[Positive, Plausible(0.1, 1.5)] = 0.5  # yaw rate over U / L, the most
    lag: Annotated[Positive, Plausible(0.1, 10.0)] = 1.0  # of the course, L / U
    stop: Annotated[Positive, Plausible(1.0, 30.0)] = 8.0  # track reach of a stop from top speed, L

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.length / self.slenderness, self.depth * self.length

    @property
    def collision_radius(self) -> float:
        """Half the diagonal, m."""
        return 0.5 * math.hypot(*self.size[:2])


class SteeredShipNumbers(NamedTuple):
    """Numbers of the kernel, SI."""

    length: Number
    beam: Number
    top_speed: Number
    turn: Number  # yaw rate over speed, 1/m
    lag: Number  # m
    stop: Number  # s


@ti.data_oriented
class SteeredShip(Vessel):
    """A ship on an ordered course, at an ordered speed; see the module.

    Actions: "course", over pi, in n; "speed", from -1 (stopped) to 1 (top speed).
    """

    Params = SteeredShipParams
    action_names = ("course", "speed")
    control_names = ("course", "speed")  # rad, m/s, ordered
    varying = ("length",)

    @property
    def limits(self) -> Limits:
        """Top speed."""
        return Limits((0.0, 0.0, float(self.constants.top_speed)))

    def own(self, values: Mapping[str, Number]) -> SteeredShipNumbers:
        """Compute the kernel's numbers."""
        p, L = self.params, values["length"]
        top = p.froude * (GRAVITY * L) ** 0.5
        return SteeredShipNumbers(L, L / p.slenderness, top, p.turn / L, p.lag * L, p.stop * L / top)

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance by one control step."""
        fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13]; wind and load have no effect."""
        p: Any = self.constants
        w, z = state[:, QW], state[:, QW + 3]
        c, s = w * w - z * z, 2 * w * z
        u = state[:, SURGE] - c * current[:, 0] - s * current[:, 1]
        off = torch.remainder(controls[:, 0] - torch.atan2(s, c) + math.pi, 2 * math.pi) - math.pi
        most = p.turn * u.abs()
        r = torch.minimum(torch.maximum(off * u.abs() / p.lag, -most), most)
        out = torch.zeros_like(state)
        out[:, 0], out[:, 1] = c * u + current[:, 0], s * u + current[:, 1]
        out[:, QW], out[:, QW + 3] = -0.5 * r * z, 0.5 * r * w
        u_c, v_c = c * current[:, 0] + s * current[:, 1], c * current[:, 1] - s * current[:, 0]
        out[:, SURGE], out[:, SURGE + 1] = (controls[:, 1] - u) / p.stop + r * v_c, -r * u_c
        return out

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            self.advance(own_numbers(self, build, fleet.numbers, e, i), fleet, around, e, i)

    @ti.func
    def advance(self, p: ti.template(), fleet: ti.template(), around: ti.template(), e, i):
        """Advance vehicle i of environment e by one control step."""
        flow, first = ti.Vector([around.current[e, 0], around.current[e, 1]]), ti.static(VELOCITY_N.start)
        psi = ti.atan2(fleet.derived[e, i, HEADING_SIN], fleet.derived[e, i, HEADING_COS])
        v = ti.Vector([fleet.derived[e, i, first], fleet.derived[e, i, first + 1]]) - flow
        u = ti.cos(psi) * v[0] + ti.sin(psi) * v[1]
        course = ti.static(math.pi) * fleet.action[e, i, 0]
        speed = 0.5 * (fleet.action[e, i, 1] + 1.0) * p.top_speed
        way, r, dt = flow * 0.0, u * 0.0, ti.static(self.dt)
        for _ in range(self.substeps):
            off = course - psi
            off -= ti.static(2 * math.pi) * ti.round(off / ti.static(2 * math.pi))
            most = p.turn * ti.abs(u)
            r = ti.min(ti.max(off * ti.abs(u) / p.lag, -most), most)
            change = dt * (speed - u) / p.stop
            middle = psi + 0.5 * dt * r
            way += dt * ((u + 0.5 * change) * ti.Vector([ti.cos(middle), ti.sin(middle)]) + flow)
            psi, u = psi + dt * r, u + change
        nothing = psi * 0.0
        q = ti.Vector([ti.cos(0.5 * psi), nothing, nothing, ti.sin(0.5 * psi)])
        R = rotation_matrix(q)
        v_n = ti.Vector([ti.cos(psi) * u + flow[0], ti.sin(psi) * u + flow[1], nothing])
        store(fleet.derived, e, i, R, v_n)
        v_b = R.transpose() @ v_n
        start = ti.Vector([fleet.state[e, i, NORTH], fleet.state[e, i, NORTH + 1]])
        move(fleet, e, i, start, way, [nothing, q[0], q[1], q[2], q[3]])
        put(fleet.state, e, i, SURGE, [v_b[0], v_b[1], nothing, nothing, nothing, r])

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """As placed: level, on the mean surface."""
        return state
