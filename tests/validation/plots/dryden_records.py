"""Records of turbulence as a flight has it: the kernels' own steps and random numbers, height and airspeed held."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from functools import cache

import numpy as np
import taichi as ti
import torch

from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import TURBULENCE, normal6
from taichi_sim.surroundings.air.turbulence import dryden_advance, dryden_filter, dryden_output, dryden_sigma


@cache
def _kernel():
    @ti.kernel
    def kernel(V: float, h: float, W20: float, dt: float, seed: int, out: ti.types.ndarray(ndim=3)):
        for i in range(out.shape[0]):
            f, sigma = dryden_filter(V, h, dt), dryden_sigma(h, W20)
            z = normal6(seed, TURBULENCE, i, 1, 0)
            x = ti.Vector([z[0], z[1], z[2], z[3], z[4]])
            for n in range(out.shape[2]):
                gust = dryden_output(x, sigma)
                for k in ti.static(range(3)):
                    out[i, k, n] = gust[k]
                x = dryden_advance(x, f, normal6(seed, TURBULENCE, i, 0, n))

    return kernel


def records(V: float, h: float, W20: float, dt: float, time: float, count: int, seed: int) -> np.ndarray:
    """Gusts u, v, w (m/s) [record, 3, sample], every dt (s) for `time` (s).

    At airspeed V (m/s), height h (m), wind W20 (m/s) at 20 ft.
    """
    run = runtime.current()
    out = torch.zeros((count, 3, round(time / dt)), dtype=run.torch_dtype, device=run.device)
    _kernel()(V, h, W20, dt, seed, out)
    return out.double().cpu().numpy()
