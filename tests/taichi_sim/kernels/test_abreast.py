"""Groups of vehicles (kernels/abreast.py) have the numbers of single ones."""

# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false

import taichi as ti
import torch

from taichi_sim.kernels import abreast, fast_maths, lanes, random, runtime
from taichi_sim.kernels.abreast import group, put, some, taken, taken1

ENVS, COUNT = 7, 3  # 21 vehicles: the second group of 16 is not full
OUT = 12
_array3 = ti.types.ndarray(ndim=3)


@ti.func
def functions(z, x):
    """A vector of the group's type, with every operator that the module adds to Taichi."""
    R = ti.Matrix([[z[0], -z[1], 0.0], [z[1], z[0], 0.0], [0.0, 0.0, 1.0]])
    v = ti.Vector([z[2], z[3], z[4]])
    turned = R.transpose() @ v
    turned -= 0.5 * v
    turned[2] = -turned[2]
    if some(x > 0.0):
        turned[1] = ti.select(x > 0.0, turned[1] + 1.0, turned[1])
    return ti.Vector([turned[0], turned[1], turned[2], turned.norm(), ti.abs(x), v.dot(turned)])


@ti.kernel
def _step(x: _array3, keys: ti.types.ndarray(dtype=ti.i32, ndim=1), out: _array3, width: ti.template()):
    for g in range((x.shape[0] * x.shape[1] + width - 1) // width):
        e, i = group(width, g * width, x.shape[0], x.shape[1])
        z = random.normal6(123, random.TURBULENCE, taken1(keys, e, 2), i, 77)
        put(out, e, i, 0, [z[0], z[1], z[2], z[3], z[4], z[5]])
        u = taken(x, e, i, 0, 1)[0]
        s = functions(z, u)
        put(out, e, i, 6, [s[0], s[1], s[2], s[3] + s[4], s[5], fast_maths.exp(20.0 * u) + random.log(1.5 + ti.abs(u))])


def test_groups_and_single_vehicles_agree():
    """To rounding; the last group, which is not full, too."""
    run = runtime.current()
    x = torch.randn((ENVS, COUNT, 1), generator=torch.Generator().manual_seed(1)).to(run.torch_dtype)
    keys = torch.arange(2 + ENVS, dtype=torch.int32)
    keys[3] = -4
    alone, together = (torch.full((ENVS, COUNT, OUT), torch.nan, dtype=run.torch_dtype) for _ in range(2))
    _step(x, keys, alone, 1)
    with abreast.vectors():
        _step(x, keys, together, lanes.width())
    assert torch.allclose(alone, together, rtol=1e-6, atol=1e-6)
    assert alone[..., 0].unique().numel() == ENVS * COUNT
