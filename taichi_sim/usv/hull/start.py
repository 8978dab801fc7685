"""Start of a hull: afloat, moving with the water around it."""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import EAST, ELEVATION, FREEBOARD, NORTH
from taichi_sim.kernels.packs import AroundPack
from taichi_sim.kernels.rotation import quaternion_product, rotation_matrix
from taichi_sim.kernels.runtime import array2, array3
from taichi_sim.usv.hull import water
from taichi_sim.usv.hull.instruments import LABEL
from taichi_sim.usv.hull.motion import pack, unpack


@ti.func
def tilted(q, R, along, across):
    """Attitude on a sloping surface of a hull that has attitude q (and R_nb = R) on a level one.

    The surface rises by `along` (m/m) ahead and by `across` (m/m) to starboard.
    """
    cos_h, sin_h = water.heading(R)
    pitch = ti.atan2(along, 1.0)
    roll = -ti.atan2(across * ti.cos(pitch), 1.0)
    cp, sp, cr, sr = ti.cos(0.5 * pitch), ti.sin(0.5 * pitch), ti.cos(0.5 * roll), ti.sin(0.5 * roll)
    x, y = cp * sr, sp * cr
    turn = ti.Vector([cp * cr, x * cos_h - y * sin_h, x * sin_h + y * cos_h, -sp * sr])
    return quaternion_product(turn, q)


@ti.kernel
def float_on_waves(
    hull: ti.template(), out: array3, surface: array3, state: array3, deck: array2, around: AroundPack,
    build: ti.template(),
):  # fmt: skip
    """Write the result of `Hull6Dof.settle` for `state` to `out`."""
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        pos, q, nu = unpack(ti.Vector([state[e, i, c] for c in range(13)]))
        R, now = rotation_matrix(q), pos[0] * 0.0
        D = water.displacement(hull.gauge, build, around, e, pos, R)
        sums, _L, _J = water.at(hull.gauge, build, around, e, now, pos, R, D)
        plane = water.mean_plane(sums, R)
        q = tilted(q, R, sums[water.ALONG], sums[water.ACROSS])
        R = rotation_matrix(q)
        pos[2] -= plane[0]
        V_c, still = ti.Vector([around.current[e, NORTH], around.current[e, EAST], 0.0]), ti.Vector([now, now, now])
        nu_c, _, nu_o, _ = water.flow(hull.params.current_frame, R, still, V_c, sums)
        y = pack(pos, q, nu + nu_c + nu_o)
        for c in ti.static(range(13)):
            out[e, i, c] = y[c]
        surface[e, i, ELEVATION] = plane[0]
        surface[e, i, FREEBOARD] = water.freeboard(deck, R, pos[2], plane)


@ti.kernel
def find_label(hull: ti.template(), aux: array3, state: array3, around: AroundPack, build: ti.template()):
    """Write the displacement of the water's label under the hull to the auxiliary state."""
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        pos, q, _nu = unpack(ti.Vector([state[e, i, c] for c in range(13)]))
        D = water.displacement(hull.gauge, build, around, e, pos, rotation_matrix(q))
        aux[e, i, LABEL], aux[e, i, LABEL + 1] = D[0], D[1]
