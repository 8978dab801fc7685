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
# pyright: reportInvalidTypeForm=false

import math
from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.missions.landing.config import MarkerConfig
from rl.perception.due import NOT_DUE, Due
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import CAMERA, normal6, uniform4
from taichi_sim.kernels.runtime import array3, whole1

DRAWN = 7  # numbers of a look: whether it is lost (uniform), six normal ones
DRAW = 30.0  # ns of one aircraft, about


@ti.kernel
def _draw(out: array3, which: whole1, draws: whole1, vehicles: ti.template(), serial: ti.template()):
    ti.loop_config(serialize=serial)
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        if which[e] != NOT_DUE:
            u = uniform4(draws[1], CAMERA, draws[2 + e], vehicles + i, draws[0])
            z = normal6(draws[1], CAMERA + 1, draws[2 + e], vehicles + i, draws[0])
            out[e, i, 0] = u[0]
            for k in ti.static(range(6)):
                out[e, i, 1 + k] = z[k]


class Look(NamedTuple):
    """What the cameras see of their markers in one step, each [env, aircraft, ...]."""

    found: Tensor  # bool
    place: Tensor  # [.., 3] of the marker from the aircraft, NED as the aircraft has it, m
    variance: Tensor  # of each component, m^2


class Marker:
    """The cameras of one team."""

    def __init__(self, config: MarkerConfig, own: Views, tilt_noise: float, vehicles: int):
        """Make the cameras of aircraft whose measured state is `own`.

        `tilt_noise` (rad) is the standard deviation of measured roll and pitch. `vehicles` numbers the first aircraft
        among the random numbers.
        """
        self.config, self._own, self._vehicles, self._tilt = config, own, vehicles, tilt_noise
        self._drawn = own.state.new_zeros((*own.state.shape[:2], DRAWN))
        self._launch = runtime.Launcher(_draw)

    def look(self, true: Views, to: Tensor, down: Tensor, hs: Tensor, due: Due) -> Look:
        """Look from aircraft with the `true` state at markers `to` [env, aircraft, 3] (m, NED) away.

        down: [env, aircraft, 3] normals of the decks, into them. hs: [env] significant wave height, m.
        """
        c = self.config
        self._launch(self._drawn, due.which, due.draws, self._vehicles, runtime.few(due.count * to.shape[1], DRAW))
        chance, across_error, along_error, _ = self._drawn.split((1, 3, 1, 2), dim=-1)
        r = to.norm(dim=-1).clamp(min=1e-3)
        line = to / r.unsqueeze(-1)
        (cos, sin), axis, (north, east, below) = true.heading, math.radians(c.axis_deg), line.unbind(-1)
        bore = below * math.cos(axis) + math.sin(axis) * (cos * north + sin * east)
        square = (line * down).sum(-1) >= math.cos(math.radians(c.steepest_deg))
        lost = chance.squeeze(-1) < (c.loss + c.spray * hs).clamp(max=1.0).unsqueeze(-1)
        found = (bore >= c.cos_half) & square & (r <= c.range) & (r >= c.nearest) & ~lost
        pixel = math.radians(c.pixel_deg)
        across, along = r * pixel, r * r * (pixel / c.size)
        error = across.unsqueeze(-1) * across_error + along.unsqueeze(-1) * along_error * line
        in_b = (true.R_nb.mT @ (to + error).unsqueeze(-1)).squeeze(-1)
        place = (self._own.R_nb @ in_b.unsqueeze(-1)).squeeze(-1)
        variance = across.square() + (r * self._tilt).square() + 0.33 * along.square()
        return Look(found, place, variance)
