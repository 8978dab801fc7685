"""How a hull begins: afloat, moving with the water around it."""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.conventions import ELEVATION, FREEBOARD
from taichi_sim.maths.rotation import quaternion_product, rotation_matrix
from taichi_sim.packs import AroundPack
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull import waves as w
from taichi_sim.usv.hull.model import LABEL, TablesPack
from taichi_sim.usv.hull.motion import HullMotion, pack
from taichi_sim.usv.hull.water import heading


@ti.func
def tilted(q, R, along, across):
    """Attitude q, whose R_nb is R, turned with a surface that was level and now rises by `along` (m/m) ahead and by
    `across` to starboard.
    """
    cos_h, sin_h = heading(R)
    pitch = ti.atan2(along, 1.0)
    roll = -ti.atan2(across * ti.cos(pitch), 1.0)
    cp, sp, cr, sr = ti.cos(0.5 * pitch), ti.sin(0.5 * pitch), ti.cos(0.5 * roll), ti.sin(0.5 * roll)
    x, y = cp * sr, sp * cr
    turn = ti.Vector([cp * cr, x * cos_h - y * sin_h, x * sin_h + y * cos_h, -sp * sr])
    return quaternion_product(turn, q)


class HullStart(HullMotion):
    """How a hull is put on the water."""

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """States [n, vehicle, 13] of hulls afloat on the waves of `around`, so that their first step is calm.

        `state` is as placed on level, still water: heights are over it, velocities through it. The hulls are raised and
        tilted with the mean surface plane under them, with the current and the orbital motion of the water, averaged
        over the hull, on top of their own velocity. `surface` [n, vehicle, 2] is written.
        """
        state = state.contiguous()
        out = torch.empty_like(state)
        self._settle(out, surface, state, around.pack, self.tables(), self.water_build(around))
        return out

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Propellers at rest, and the label of the water under the hull."""
        aux.zero_()
        self._find_label(aux, state.contiguous(), around.pack, self.water_build(around))

    @ti.kernel
    def _settle(
        self,
        out: ti.types.ndarray(ndim=3),
        surface: ti.types.ndarray(ndim=3),
        state: ti.types.ndarray(ndim=3),
        around: AroundPack,
        tables: TablesPack,
        build: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            y = ti.Vector([state[e, i, c] for c in range(13)])
            pos, q = ti.Vector([y[0], y[1], y[2]]), ti.Vector([y[3], y[4], y[5], y[6]])
            R, now = rotation_matrix(q), pos[0] * 0.0
            water, _L, _J = self.water_at(build, around, e, now, pos, R, self.label(build, around, e, pos, R))
            plane = self.plane_n(water, R)
            q = tilted(q, R, water[w.ALONG], water[w.ACROSS])
            R = rotation_matrix(q)
            pos[2] -= plane[0]
            V_c, still = ti.Vector([around.current[e, 0], around.current[e, 1], 0.0]), ti.Vector([now, now, now])
            nu_c, _, nu_o, _ = self.flow(R, still, V_c, water)
            y = pack(pos, q, ti.Vector([y[7 + c] for c in range(6)]) + nu_c + nu_o)
            for c in ti.static(range(13)):
                out[e, i, c] = y[c]
            surface[e, i, ELEVATION] = plane[0]
            surface[e, i, FREEBOARD] = self.freeboard(tables.deck, R, pos[2], plane)

    @ti.kernel
    def _find_label(
        self,
        aux: ti.types.ndarray(ndim=3),
        state: ti.types.ndarray(ndim=3),
        around: AroundPack,
        build: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            R = rotation_matrix(ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]]))
            D = self.label(build, around, e, pos, R)
            aux[e, i, LABEL], aux[e, i, LABEL + 1] = D[0], D[1]
