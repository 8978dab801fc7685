"""How a hull begins: afloat, moving with the water around it."""

import taichi as ti
import torch

from taichi_sim.conventions import ELEVATION, FREEBOARD, SURFACE_SIZE
from taichi_sim.maths.rotation import quaternion_product, rotation_matrix
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull.model import LABEL
from taichi_sim.usv.hull.motion import HullMotion, pack
from taichi_sim.usv.hull.water import heading

LABEL_STEPS = 4  # of Newton's method from no displacement, where there is no last step to predict from


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

    def settle(self, state: torch.Tensor, around: Surroundings) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Hulls afloat on the waves of `around`, so that their first step is calm.

        Args:
            state: [n, vehicle, 13] as placed on level, still water: heights are over it, velocities through it.
            around: of these n environments, at the time of the start.

        Returns:
            states [n, vehicle, 13]: raised and tilted with the mean surface plane under the hull, with the current and
            the orbital motion of the water averaged over the hull on top of their own velocity; auxiliary states
            [n, vehicle, k], propellers at rest; what the sea does to them [n, vehicle, 2], as in conventions.py.
        """
        state = state.contiguous()
        rows = state.shape[:2]
        out, surface = torch.empty_like(state), state.new_empty((*rows, SURFACE_SIZE))
        aux = state.new_zeros((*rows, self.aux_size))
        deck = self.tables(state.device, state.dtype)[-1]
        self._settle(
            out, aux, surface, state, around.sea, around.env_sea, around.phase, around.current, deck,
            around.sea.shape[2], around.depth > 0,
        )  # fmt: skip
        return out, aux, surface

    @ti.kernel
    def _settle(
        self,
        out: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        surface: ti.types.ndarray(ndim=3),
        state: ti.types.ndarray(ndim=3),
        sea: ti.types.ndarray(ndim=3),
        env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
        phase: ti.types.ndarray(ndim=2),
        current: ti.types.ndarray(ndim=2),
        deck: ti.types.ndarray(ndim=2),
        count: ti.template(),
        finite: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            y = ti.Vector([state[e, i, c] for c in range(13)])
            pos, q = ti.Vector([y[0], y[1], y[2]]), ti.Vector([y[3], y[4], y[5], y[6]])
            R, zero = rotation_matrix(q), pos[0] * 0.0
            D = ti.Vector([zero, zero])
            for _ in range(LABEL_STEPS):
                _water, L, _J = self.water(sea, phase, count, finite, env_sea[e], e, zero, pos, R, D)
                D = L - ti.Vector([pos[0], pos[1]])
            water, _L, _J = self.water(sea, phase, count, finite, env_sea[e], e, zero, pos, R, D)
            plane = self.plane_n(water, R)
            q = tilted(q, R, water[6], water[7])
            R = rotation_matrix(q)
            pos[2] -= plane[0]
            still = ti.Vector([zero, zero, zero])
            nu_c, _, nu_o, _ = self.flow(R, still, ti.Vector([current[e, 0], current[e, 1], 0.0]), water)
            nu = ti.Vector([y[7 + c] for c in range(6)]) + nu_c + nu_o
            y = pack(pos, q, nu)
            for c in ti.static(range(13)):
                out[e, i, c] = y[c]
            aux[e, i, LABEL], aux[e, i, LABEL + 1] = D[0], D[1]
            surface[e, i, ELEVATION] = plane[0]
            surface[e, i, FREEBOARD] = self.freeboard(deck, R, pos[2], plane)
