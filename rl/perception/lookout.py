"""Lookouts of vessels, which see near objects on the sea by range and bearing.

The first object is seen within one range, the others within another, to their surface. A measurement fails with the
probability `dropout`. With `crests`, wave crests hide the first object: its line of sight, between two heights above
the water, is cut where the sea rises above it. The vessel's measured place and heading turn a measurement into a place.
Random numbers are counted (kernels/random.py): same seed, same bits. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from collections.abc import Callable
from typing import Annotated, NamedTuple

import taichi as ti
import torch
from pydantic import Field
from torch import Tensor

from rl.perception.camera import SEE, UNSEEN, VARIANCE_FLOOR
from rl.perception.columns import Object, Sighting
from rl.perception.instruments import InstrumentsConfig
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.conventions import EAST, NORTH
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import LOOKOUT, normal6, uniform4
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1

POINTS = 8  # of a line of sight at which the sea is looked at


class LookoutConfig(Strict):
    """`[TEAM.lookout]`; what is left out is assumed."""

    vessel_range: Positive = 60.0  # m, to its middle
    obstacle_range: Positive = 25.0  # m, to its surface
    range_noise: NonNegative = 0.2  # standard deviation, m
    bearing_noise_deg: NonNegative = 0.5
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.1  # share of measurements that fail
    crests: bool = False  # whether wave crests hide the vessel
    eye_height: Positive = 1.0  # m above the water, of the sensor, for that
    vessel_height: Positive = 1.0  # m above the water, of what is looked for


class LookoutNumbers(NamedTuple):
    """Parameters of the kernel, SI."""

    vessel_range: float
    obstacle_range: float
    range_noise: float
    bearing_noise: float
    dropout: float
    heading: float
    place: float


SightingsPack = ti.types.argpack(sightings=array4, objects=array3, hidden=array2, numbers=array1)
TruePack = ti.types.argpack(true_state=array3, true_derived=array3)
OwnPack = ti.types.argpack(state=array3, derived=array3)


class LookoutForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    vehicles: int  # number of the first vehicle among the random numbers
    serial: bool = False  # run on the calling thread


@ti.kernel
def _see(
    out: SightingsPack, true: TruePack, own: OwnPack, which: whole1, count: whole1, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(own.state.shape[0], own.state.shape[1]):
        if which[e] != 0:
            g = values_at(kind, out.numbers)
            c0, s0 = true.true_derived[e, i, HEADING_COS], true.true_derived[e, i, HEADING_SIN]
            c1, s1 = own.derived[e, i, HEADING_COS], own.derived[e, i, HEADING_SIN]
            cos, sin = c0 * c1 + s0 * s1, c0 * s1 - s0 * c1  # of the error of the heading
            for k in range(out.objects.shape[1]):
                out.sightings[e, i, k, Sighting.VARIANCE] = UNSEEN
                x = out.objects[e, k, Object.NORTH] - true.true_state[e, i, NORTH]
                y = out.objects[e, k, Object.EAST] - true.true_state[e, i, EAST]
                far = ti.sqrt(x * x + y * y)
                near = far - out.objects[e, k, Object.RADIUS] < g.obstacle_range
                if k == 0:
                    near = far < g.vessel_range and out.hidden[e, i] == 0
                if near:
                    number = ti.static(form.vehicles) + i + 4096 * k
                    u = uniform4(count[1], LOOKOUT, count[2 + e], number, count[0])
                    if u[0] >= g.dropout:
                        z = normal6(count[1], LOOKOUT + 1, count[2 + e], number, count[0])
                        away, turned = 1.0 + g.range_noise * z[0] / ti.max(far, 1.0), g.bearing_noise * z[1]
                        c, s = cos - turned * sin, sin + turned * cos
                        out.sightings[e, i, k, Sighting.NORTH] = own.state[e, i, NORTH] + away * (c * x - s * y)
                        out.sightings[e, i, k, Sighting.EAST] = own.state[e, i, EAST] + away * (s * x + c * y)
                        side = far * far * (g.bearing_noise * g.bearing_noise + g.heading * g.heading)
                        variance = 0.5 * (g.range_noise * g.range_noise + side) + g.place * g.place
                        out.sightings[e, i, k, Sighting.VARIANCE] = variance + VARIANCE_FLOOR


class Lookout:
    """The lookouts of one team of vessels."""

    STATE = ("_hidden",)

    def __init__(
        self, config: LookoutConfig, instruments: InstrumentsConfig, sightings: Tensor, objects: Tensor, true: Views,
        own: Views, elevation: Callable[[Tensor], Tensor], *, vehicles: int = 0,
    ):  # fmt: skip
        """Make lookouts of vessels whose true state is `true` and whose measured state is `own`.

        Args:
            sightings: [env, observer, object, 3], written for the first observers: place (m) and variance (m^2; below
                0: not seen). objects: [env, object, 6] place, NED, velocity, north and east, radius, SI.
            elevation: of the sea (m, up) at points [env, n, 2]. vehicles: of other teams before them, among the
                random numbers.
        """
        state, n = own.state, instruments.numbers
        self.config, self._elevation, self._true_state, self._objects = config, elevation, true.state, objects
        self._numbers = LookoutNumbers(
            config.vessel_range, config.obstacle_range, config.range_noise, math.radians(config.bearing_noise_deg),
            config.dropout, math.hypot(n.heading, n.heading_bias), math.hypot(n.place, n.walk),
        )  # fmt: skip
        self._hidden, self._rows = state.new_zeros(state.shape[:2]), state.shape[1] * objects.shape[1]
        self._share = torch.linspace(0.0, 1.0, POINTS + 2, device=state.device, dtype=state.dtype)[1:-1].view(-1, 1)
        self._sightings = runtime.Packed(
            SightingsPack,
            sightings=sightings,
            objects=objects,
            hidden=self._hidden,
            numbers=state.new_tensor(self._numbers),
        )
        self._true = runtime.Packed(TruePack, true_state=true.state, true_derived=true.derived)
        self._at = runtime.Packed(OwnPack, state=state, derived=own.derived)
        self._form, self._launch = LookoutForm(vehicles), runtime.Launcher(_see)

    def see(self, which: Tensor, rows: int, count: Tensor) -> None:
        """Look in environments [env] int32 that are not 0, `rows` of them; `count` int32 [2 + env] counts the random
        numbers (taichi_sim/kernels/random.py).
        """
        if self.config.crests:
            self._hidden.copy_(self.behind_crests())
        kind = struct_of(LookoutNumbers._fields, runtime.current().precision)
        form = self._form._replace(serial=runtime.few(rows * self._rows, SEE))
        self._launch(self._sightings(), self._true(), self._at(), which, count, kind, form)

    def behind_crests(self) -> Tensor:
        """Whether the sea is above the line from each vessel's eye to the first object [env, vessel]."""
        envs, vessels = self._true_state.shape[:2]
        here, there = self._true_state[..., :2], self._objects[:, :1, :2].expand(-1, vessels, -1)
        both = self._elevation(torch.cat((here, there[:, :1]), dim=1))
        eye = (both[:, :vessels] + self.config.eye_height).unsqueeze(-1)
        top = (both[:, vessels:] + self.config.vessel_height).unsqueeze(-1)
        points = here.unsqueeze(2) + self._share * (there - here).unsqueeze(2)
        sea = self._elevation(points.view(envs, vessels * POINTS, 2)).view(envs, vessels, POINTS)
        return (sea > eye + self._share.view(-1) * (top - eye)).any(-1)
