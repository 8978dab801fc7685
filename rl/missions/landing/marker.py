"""Cameras of aircraft that see a marker in the middle of a deck.

A camera is kept level by its gimbal. The marker is found where it lies in the field of view and in range, from above at
no more than `steepest_deg` from the deck's normal, and not lost to a share `loss` + `spray` Hs of all looks. Then its
direction has an error of a pixel each way, and its distance, by the size s of its picture,

    sigma_r = r^2 sigma_pixel / s,

r being the distance (the error of a length of r sigma_pixel, seen at the scale s / r; first order). What is seen in the
camera's frame becomes a place by the aircraft's measured attitude, whose error is in it. Random numbers are counted
(kernels/random.py): same seed, same bits. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false, reportIndexIssue=false, reportOptionalCall=false

import math
from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.missions.landing.config import MarkerConfig
from rl.missions.landing.decks import Decks
from rl.step import NOT_DUE, Due
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import put, taken
from taichi_sim.kernels.conventions import BELOW
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CAMERA, CLOCK, KEY, SEED, normal6, uniform4
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, rotated, rotated_back
from taichi_sim.kernels.runtime import array1, array3, whole1
from taichi_sim.state.memory import Remembers

NEAREST = 1e-3  # m, least distance that the formulas take
LEAST_VARIANCE = 1e-6  # m^2, so that an exact look has one, too
ALONG = 0.33  # share of the variance of the distance that each component of a place has; assumed


class Look:
    """Columns of a look: place of the marker from the aircraft (NED as the aircraft has it, m); variance of each
    component (m^2), 0 where the marker was not found.
    """

    PLACE, VARIANCE, SIZE = 0, 3, 4


class Camera(NamedTuple):
    """A camera and its marker."""

    axis_cos: float  # of the angle from straight down to its axis
    axis_sin: float
    half_cos: float  # of half the field of view
    steep_cos: float  # of the steepest line of sight, from the deck's normal
    nearest: float  # m
    range: float  # m
    loss: float
    spray: float  # 1/m
    pixel: float  # rad
    size: float  # m
    tilt: float  # rad, standard deviation of measured roll and pitch


@ti.kernel
def _look(
    seen: array3, state: array3, derived: array3, measured: array3, place: array3, boats: array3, hs: array1,
    which: whole1, draws: whole1, camera: array1, kind: ti.template(), vehicles: ti.template()
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(seen.shape[0], seen.shape[1]):
        if which[e] != NOT_DUE:
            c, b = values_at(kind, camera), i % place.shape[1]
            u = uniform4(draws[SEED], CAMERA, draws[KEY + e], vehicles + i, draws[CLOCK])
            z = normal6(draws[SEED], CAMERA + 1, draws[KEY + e], vehicles + i, draws[CLOCK])
            to = taken(place, e, b, 0, 3) - taken(state, e, i, 0, 3)
            down = ti.Vector([boats[e, b, 3 * k + BELOW] for k in ti.static(range(3))])
            r = ti.max(to.norm(), NEAREST)
            line = to / r
            ahead = derived[e, i, HEADING_COS] * line[0] + derived[e, i, HEADING_SIN] * line[1]
            in_view = c.axis_cos * line[2] + c.axis_sin * ahead >= c.half_cos and line.dot(down) >= c.steep_cos
            kept = u[0] >= ti.min(c.loss + c.spray * hs[e], 1.0)
            across, along = r * c.pixel, r * r * c.pixel / c.size
            error = across * ti.Vector([z[0], z[1], z[2]]) + along * z[3] * line
            found = rotated(measured, e, i, rotated_back(derived, e, i, to + error))
            variance = across * across + (r * c.tilt) ** 2 + ALONG * along * along + LEAST_VARIANCE
            if not (in_view and kept and c.nearest <= r <= c.range):
                variance = 0.0
            put(seen, e, i, 0, [found[0], found[1], found[2], variance])


class Marker(Remembers):
    """The cameras of one team.

    Attributes:
        seen: [env, aircraft, Look.SIZE] the last look.
    """

    def __init__(self, config: MarkerConfig, own: Views, tilt_noise: float, vehicles: int):
        """Make the cameras of aircraft whose measured state is `own`.

        `tilt_noise` (rad) is the standard deviation of measured roll and pitch. `vehicles` numbers the first aircraft
        among the random numbers.
        """
        axis, rad = math.radians(config.axis_deg), math.radians
        camera = Camera(
            math.cos(axis), math.sin(axis), config.cos_half, math.cos(rad(config.steepest_deg)), config.nearest,
            config.range, config.loss, config.spray, rad(config.pixel_deg), config.size, tilt_noise,
        )  # fmt: skip
        self._own, self._vehicles, self._camera = own, vehicles, own.state.new_tensor(camera)
        self.seen = self.remember(own.state.new_zeros((*own.state.shape[:2], Look.SIZE)))
        self._launch = runtime.Launcher(_look)

    def look(self, true: Views, decks: Decks, hs: Tensor, due: Due) -> None:
        """Look from aircraft with the `true` state at the middle of their decks, in the environments that are `due`.

        Aircraft i has the deck of boat i, modulo their number. hs: [env] significant wave height, m.
        """
        kind = struct_of(Camera._fields, runtime.current().precision)
        self._launch.once(
            self.seen, true.state, true.derived, self._own.derived, decks.deck.place, decks.fleet.derived, hs,
            due.which, due.draws, self._camera, kind, self._vehicles, envs=due.count,
        )  # fmt: skip
