"""Sightings of objects on the sea, by cameras of aircraft and by lookouts of vessels.

A camera is on a gimbal, or fixed to the airframe. An object is in view if the line to it is within half the field of
view of the camera's axis. A fixed camera turns with the attitude of its aircraft. A camera on a gimbal points at the
place where its aircraft believes the vessel to be. One look at an object in view finds it with the probability

    p = 1 - 2^(-(R / s)^3),   R = reach / (1 + Hs / rough),

s being the slant range: the inverse cube law of Koopman (1956, The theory of search II, Operations Research 4(5)), with
reach, the range at which every second look finds it in calm water, and its loss with the significant wave height Hs
assumed. The sighting is the point where the line to the object, with a pixel's error, meets mean sea level, computed
from the aircraft's measured place and attitude (instruments.py): it contains their errors. Its variance follows from
the instruments' standard deviations.

A lookout sees near objects by range and bearing: the first object within one range, the others within another, to their
surface. A measurement fails with the probability `dropout`. With `crests`, wave crests hide the first object: its line
of sight, between two heights above the water, is cut where the sea rises above it. The vessel's measured place and
heading turn a measurement into a place.

Random numbers are counted (kernels/random.py): same seed, same bits. Frames: NED,
b.
"""


# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false
# pyright: reportInvalidTypeForm=false

import math
from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple

import taichi as ti
import torch
from pydantic import Field
from torch import Tensor

from rl.perception.instruments import InstrumentsConfig
from rl.step import NOT_DUE, Due
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN, EAST, NORTH
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CAMERA, CLOCK, KEY, LOOKOUT, SEED, normal6, uniform4
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, rotated, rotated_back
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1
from taichi_sim.state.memory import Remembers

UNSEEN = -1.0  # variance of a sighting that has not been made
VARIANCE_FLOOR = 1e-4  # m^2, of exact measurements
LEAST_SLOPE = 0.02  # of a line of sight: a flatter one meets the sea too far away
POINTS = 8  # of a lookout's line of sight at which the sea is looked at


class Object:
    """An object that observers can see: place, velocity, radius; the truth."""

    NORTH, EAST, DOWN, V_NORTH, V_EAST, RADIUS, SIZE = range(7)


class Sighting:
    """A sighting of an object: measured place and variance (m^2, each way); a variance below 0: not seen."""

    NORTH, EAST, VARIANCE, SIZE = range(4)


class CameraConfig(Strict):
    """`[TEAM.camera]`"""

    mount: Literal["gimbal", "fixed"] = "gimbal"
    field_of_view_deg: Annotated[float, Field(gt=1, lt=179)] = 60.0  # full angle of a cone about the axis
    azimuth_deg: Annotated[float, Field(ge=-180, le=180)] = 90.0  # of a fixed camera's axis, from the nose to starboard
    depression_deg: Annotated[float, Field(ge=0, le=90)] = 30.0  # of a fixed camera's axis, below the wings' plane
    # m: range at which every second look finds a vessel in calm water; assumed
    reach: Annotated[Positive, Plausible(5.0, 5e4, "m")] = 500.0
    # significant wave height that halves this range; assumed
    rough: Annotated[Positive, Plausible(0.05, 20.0, "m")] = 2.0
    # standard deviation of a line of sight, each way; assumed
    noise_deg: Annotated[NonNegative, Plausible(1e-3, 20.0, "deg")] = 0.1
    surface: Literal["mean", "waves"] = "mean"  # objects float at mean sea level, or on the waves

    @property
    def axis_b(self) -> tuple[float, float, float]:
        """Axis of a fixed camera, b."""
        a, d = math.radians(self.azimuth_deg), math.radians(self.depression_deg)
        return math.cos(d) * math.cos(a), math.cos(d) * math.sin(a), math.sin(d)

    @property
    def cos_half(self) -> float:
        """Cosine of half the field of view."""
        return math.cos(math.radians(self.field_of_view_deg / 2))


class CameraNumbers(NamedTuple):
    """Parameters of the kernel, SI."""

    cos_half: float
    reach: float
    rough: float
    pixel: float
    tilt: float  # standard deviations of the instruments, by configuration
    heading: float
    place: float


CameraPack = ti.types.argpack(sightings=array4, objects=array3, axis=array3, hs=array1, numbers=array1)
TruePack = ti.types.argpack(true_state=array3, true_derived=array3)
OwnPack = ti.types.argpack(state=array3, derived=array3)


class ObserverForm(NamedTuple):
    """Compile-time parameters of the kernels."""

    first: int  # number of the first among all observers
    vehicles: int  # number of the first vehicle among the random numbers


class LookoutConfig(Strict):
    """`[TEAM.lookout]`; what is left out is assumed."""

    vessel_range: Annotated[Positive, Plausible(1.0, 5e4, "m")] = 60.0  # to its middle
    obstacle_range: Annotated[Positive, Plausible(1.0, 2e4, "m")] = 25.0  # to its surface
    range_noise: Annotated[NonNegative, Plausible(2e-3, 100.0, "m")] = 0.2  # standard deviation
    bearing_noise_deg: Annotated[NonNegative, Plausible(5e-3, 30.0, "deg")] = 0.5
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.1  # share of measurements that fail
    crests: bool = False  # whether wave crests hide the vessel
    eye_height: Annotated[Positive, Plausible(0.05, 100.0, "m")] = 1.0  # m above the water, of the sensor, for that
    vessel_height: Annotated[Positive, Plausible(0.05, 100.0, "m")] = 1.0  # m above the water, of what is looked for


class LookoutNumbers(NamedTuple):
    """Parameters of the kernel, SI."""

    vessel_range: float
    obstacle_range: float
    range_noise: float
    bearing_noise: float
    dropout: float
    heading: float
    place: float


LookoutPack = ti.types.argpack(sightings=array4, objects=array3, hidden=array2, numbers=array1)


@ti.kernel
def _see(
    out: CameraPack, true: TruePack, own: OwnPack, which: whole1, draws: whole1, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(own.state.shape[0], own.state.shape[1]):
        if which[e] != NOT_DUE:
            g, node = values_at(kind, out.numbers), i + form.first
            there = ti.Vector([true.true_state[e, i, a] for a in ti.static(range(3))])
            bore = rotated(true.true_derived, e, i, ti.Vector([out.axis[e, i, a] for a in ti.static(range(3))]))
            reach = g.reach / (1.0 + out.hs[e] / g.rough)
            for k in range(out.objects.shape[1]):
                out.sightings[e, node, k, Sighting.VARIANCE] = UNSEEN
                line = ti.Vector([out.objects[e, k, a] for a in ti.static(range(3))]) - there
                slant = ti.max(line.norm(), 1e-3)
                line = line / slant
                if line.dot(bore) >= g.cos_half:
                    number = ti.static(form.vehicles) + i
                    u = uniform4(draws[SEED], CAMERA, draws[KEY + e], number + 4096 * k, draws[CLOCK])
                    r = reach / slant
                    if u[0] >= ti.pow(2.0, -r * r * r):
                        z = normal6(draws[SEED], CAMERA + 1, draws[KEY + e], number + 4096 * k, draws[CLOCK])
                        line_b = rotated_back(true.true_derived, e, i, line)
                        error = ti.Vector([g.pixel * z[a] for a in ti.static(range(3))])
                        ray = rotated(own.derived, e, i, line_b + error)
                        if ray[2] > LEAST_SLOPE:
                            far = -own.state[e, i, DOWN] / ray[2]
                            out.sightings[e, node, k, Sighting.NORTH] = own.state[e, i, NORTH] + far * ray[0]
                            out.sightings[e, node, k, Sighting.EAST] = own.state[e, i, EAST] + far * ray[1]
                            tilted = (g.pixel * g.pixel + g.tilt * g.tilt) / (ray[2] * ray[2])
                            turned = g.pixel * g.pixel + g.heading * g.heading
                            out.sightings[e, node, k, Sighting.VARIANCE] = (
                                0.5 * far * far * (tilted + turned) + g.place * g.place + VARIANCE_FLOOR
                            )


@ti.kernel
def _look_out(
    out: LookoutPack, true: TruePack, own: OwnPack, which: whole1, draws: whole1, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(own.state.shape[0], own.state.shape[1]):
        if which[e] != NOT_DUE:
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
                    u = uniform4(draws[SEED], LOOKOUT, draws[KEY + e], number, draws[CLOCK])
                    if u[0] >= g.dropout:
                        z = normal6(draws[SEED], LOOKOUT + 1, draws[KEY + e], number, draws[CLOCK])
                        away, turned = 1.0 + g.range_noise * z[0] / ti.max(far, 1.0), g.bearing_noise * z[1]
                        c, s = cos - turned * sin, sin + turned * cos
                        out.sightings[e, i, k, Sighting.NORTH] = own.state[e, i, NORTH] + away * (c * x - s * y)
                        out.sightings[e, i, k, Sighting.EAST] = own.state[e, i, EAST] + away * (s * x + c * y)
                        side = far * far * (g.bearing_noise * g.bearing_noise + g.heading * g.heading)
                        variance = 0.5 * (g.range_noise * g.range_noise + side) + g.place * g.place
                        out.sightings[e, i, k, Sighting.VARIANCE] = variance + VARIANCE_FLOOR


class Observers(Remembers):
    """Observers of one team, aircraft or vessels, that look at objects by a kernel."""

    def __init__(
        self, kernel: Callable[..., object], pack: runtime.Packed, numbers: NamedTuple, form: ObserverForm,
        true: Views, own: Views, objects: Tensor,
    ):  # fmt: skip
        """Let observers, whose true and measured states are `true` and `own`, look at `objects` [env, object, n]."""
        self._fields, self._form = numbers._fields, form
        self._pack, self._launch = pack, runtime.Launcher(kernel, few=runtime.MEDIUM)
        self._true = runtime.Packed(TruePack, true_state=true.state, true_derived=true.derived)
        self._at = runtime.Packed(OwnPack, state=own.state, derived=own.derived)

    def see(self, due: Due) -> None:
        """Look in the environments that are `due`."""
        kind = struct_of(self._fields, runtime.current().precision)
        self._launch(self._pack(), self._true(), self._at(), due.which, due.draws, kind, self._form, envs=due.count)


class Camera(Observers):
    """The cameras of one team.

    Attributes:
        axis: [env, aircraft, 3] of each camera now, b; kept by `aim`. true: the aircraft as they are.
    """

    def __init__(
        self, config: CameraConfig, instruments: InstrumentsConfig, sightings: Tensor, objects: Tensor, hs: Tensor,
        true: Views, own: Views, *, first: int, vehicles: int = 0,
    ):  # fmt: skip
        """Make cameras of aircraft whose true state is `true` and whose measured state is `own`.

        Args:
            sightings: [env, observer, object, 3], written for observers from `first` on: place (m) and variance (m^2;
                below 0: not seen). objects: [env, object, 3 or more] place, NED, m. hs: [env] significant wave height,
                m.
            vehicles: number of the first aircraft among the random numbers.
        """
        self.config, state = config, own.state
        n = instruments.numbers
        numbers = CameraNumbers(
            config.cos_half, config.reach, config.rough, math.radians(config.noise_deg), n.tilt,
            math.hypot(n.heading, n.heading_bias), math.hypot(n.place, n.walk, n.common, n.height_bias),
        )  # fmt: skip
        self.axis = self.remember(state.new_tensor(config.axis_b).expand(*state.shape[:2], 3).contiguous())
        self.true, self._own = true, own
        pack = runtime.Packed(
            CameraPack, sightings=sightings, objects=objects, axis=self.axis, hs=hs, numbers=state.new_tensor(numbers)
        )
        super().__init__(_see, pack, numbers, ObserverForm(first, vehicles), true, own, objects)

    def aim(self, place: Tensor) -> None:
        """Point cameras on gimbals at `place` [env, aircraft, 2] (north, east, m)."""
        if self.config.mount == "gimbal":
            line = torch.cat((place, torch.zeros_like(place[..., :1])), dim=-1) - self._own.position_n
            line = line / line.norm(dim=-1, keepdim=True).clamp(min=1e-3)
            self.axis.copy_((line.unsqueeze(-2) @ self._own.R_nb).squeeze(-2))


class Lookout(Observers):
    """The lookouts of one team of vessels."""

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
        numbers = LookoutNumbers(
            config.vessel_range, config.obstacle_range, config.range_noise, math.radians(config.bearing_noise_deg),
            config.dropout, math.hypot(n.heading, n.heading_bias), math.hypot(n.place, n.walk),
        )  # fmt: skip
        self._hidden = self.remember(state.new_zeros(state.shape[:2]))
        self._share = torch.linspace(0.0, 1.0, POINTS + 2, device=state.device, dtype=state.dtype)[1:-1].view(-1, 1)
        pack = runtime.Packed(
            LookoutPack, sightings=sightings, objects=objects, hidden=self._hidden, numbers=state.new_tensor(numbers)
        )
        super().__init__(_look_out, pack, numbers, ObserverForm(0, vehicles), true, own, objects)

    def see(self, due: Due) -> None:
        """Look as other observers do, where wave crests do not hide the first object."""
        if self.config.crests:
            self._hidden.copy_(self.behind_crests())
        super().see(due)

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
