"""Cameras of aircraft, on a gimbal or fixed to the airframe, which see objects on the sea.

An object is in view if the line to it is within half the field of view of the camera's axis. A fixed camera turns with
the attitude of its aircraft. A camera on a gimbal points at the place where its aircraft believes the vessel to be. One
look at an object in view finds it with the probability

    p = 1 - 2^(-(R / s)^3),   R = reach / (1 + Hs / rough),

s being the slant range: the inverse cube law of Koopman (1956, The theory of search II, Operations Research 4(5)), with
reach, the range at which every second look finds it in calm water, and its loss with the significant wave height Hs
assumed. The sighting is the point where the line to the object, with a pixel's error, meets mean sea level, computed
from the aircraft's measured place and attitude (instruments.py): it contains their errors. Its variance follows from
the instruments' standard deviations. Random numbers are counted (kernels/random.py): same seed, same bits. Frames: NED,
b.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false

import math
from typing import Annotated, Literal, NamedTuple

import taichi as ti
import torch
from pydantic import Field
from torch import Tensor

from rl.perception.columns import Sighting
from rl.perception.instruments import InstrumentsConfig
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.conventions import DOWN, EAST, NORTH
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CAMERA, normal6, uniform4
from taichi_sim.kernels.runtime import array1, array3, array4, whole1

UNSEEN = -1.0  # variance of a sighting that has not been made
VARIANCE_FLOOR = 1e-4  # m^2, of exact measurements
LEAST_SLOPE = 0.02  # of a line of sight: a flatter one meets the sea too far away
SEE = 40.0  # ns of one aircraft and object, about


class CameraConfig(Strict):
    """`[TEAM.camera]`"""

    mount: Literal["gimbal", "fixed"] = "gimbal"
    field_of_view_deg: Annotated[float, Field(gt=1, lt=179)] = 60.0  # full angle of a cone about the axis
    azimuth_deg: Annotated[float, Field(ge=-180, le=180)] = 90.0  # of a fixed camera's axis, from the nose to starboard
    depression_deg: Annotated[float, Field(ge=0, le=90)] = 30.0  # of a fixed camera's axis, below the wings' plane
    reach: Positive = 500.0  # m: range at which every second look finds a vessel in calm water; assumed
    rough: Positive = 2.0  # m, significant wave height that halves this range; assumed
    noise_deg: NonNegative = 0.1  # standard deviation of a line of sight, each way; assumed
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


SightingsPack = ti.types.argpack(sightings=array4, objects=array3, axis=array3, hs=array1, numbers=array1)
TruePack = ti.types.argpack(true_state=array3, true_derived=array3)
OwnPack = ti.types.argpack(state=array3, derived=array3)


class CameraForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    first: int  # number of the first aircraft among all observers
    vehicles: int  # number of the first vehicle among the random numbers
    serial: bool = False  # run on the calling thread


@ti.func
def rotated(derived: ti.template(), e, i, v):
    """R_nb v."""
    out = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(3)):
        out[a] = derived[e, i, 3 * a] * v[0] + derived[e, i, 3 * a + 1] * v[1] + derived[e, i, 3 * a + 2] * v[2]
    return out


@ti.func
def rotated_back(derived: ti.template(), e, i, v):
    """R_nb^T v."""
    out = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(3)):
        out[a] = derived[e, i, a] * v[0] + derived[e, i, 3 + a] * v[1] + derived[e, i, 6 + a] * v[2]
    return out


@ti.kernel
def _see(
    out: SightingsPack, true: TruePack, own: OwnPack, which: whole1, count: whole1, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(own.state.shape[0], own.state.shape[1]):
        if which[e] != 0:
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
                    u = uniform4(count[1], CAMERA, count[2 + e], number + 4096 * k, count[0])
                    r = reach / slant
                    if u[0] >= ti.pow(2.0, -r * r * r):
                        z = normal6(count[1], CAMERA + 1, count[2 + e], number + 4096 * k, count[0])
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


class Camera:
    """The cameras of one team.

    Attributes:
        axis: [env, aircraft, 3] of each camera now, b; kept by `aim`. true: the aircraft as they are.
    """

    STATE = ("axis",)

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
        self._numbers = CameraNumbers(
            config.cos_half, config.reach, config.rough, math.radians(config.noise_deg), n.tilt,
            math.hypot(n.heading, n.heading_bias), math.hypot(n.place, n.walk, n.common, n.height_bias),
        )  # fmt: skip
        self.axis = state.new_tensor(config.axis_b).expand(*state.shape[:2], 3).contiguous()
        self.true, self._own, self._rows = true, own, state.shape[1] * objects.shape[1]
        self._sightings = runtime.Packed(
            SightingsPack,
            sightings=sightings,
            objects=objects,
            axis=self.axis,
            hs=hs,
            numbers=state.new_tensor(self._numbers),
        )
        self._true = runtime.Packed(TruePack, true_state=true.state, true_derived=true.derived)
        self._at = runtime.Packed(OwnPack, state=state, derived=own.derived)
        self._form, self._launch = CameraForm(first, vehicles), runtime.Launcher(_see)

    def aim(self, place: Tensor) -> None:
        """Point cameras on gimbals at `place` [env, aircraft, 2] (north, east, m)."""
        if self.config.mount == "gimbal":
            line = torch.cat((place, torch.zeros_like(place[..., :1])), dim=-1) - self._own.position_n
            line = line / line.norm(dim=-1, keepdim=True).clamp(min=1e-3)
            self.axis.copy_((line.unsqueeze(-2) @ self._own.R_nb).squeeze(-2))

    def see(self, which: Tensor, rows: int, count: Tensor) -> None:
        """Look in environments [env] int32 that are not 0, `rows` of them; `count` int32 [2 + env] counts the random
        numbers (taichi_sim/kernels/random.py).
        """
        kind = struct_of(CameraNumbers._fields, runtime.current().precision)
        form = self._form._replace(serial=runtime.few(rows * self._rows, SEE))
        self._launch(self._sightings(), self._true(), self._at(), which, count, kind, form)
