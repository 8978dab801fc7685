"""The exponential function in f32 without a call of libm."""

import taichi as ti

from taichi_sim.kernels import runtime

LOG2_E, LN2 = 1.4426950408889634, 0.6931471805599453
LOWEST, HIGHEST = -87.0, 88.0  # exp of every argument between them is a normal f32


@ti.func
def exp(x):
    """Return e^x with a relative error of 1e-7 (1 + |x|); in f32, x is clamped to [-87, 88].

    Range reduction is x = n ln 2 + r with |r| <= ln 2 / 2. The polynomial in r is that of expf in Moshier's Cephes
    library. In f64 this is the library's function.
    """
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.exp(x)
    else:
        bounded = ti.min(ti.max(x, LOWEST), HIGHEST)
        n = ti.floor(bounded * LOG2_E + 0.5)
        r = bounded - n * LN2
        p = x * 0.0 + 1.9875691500e-4
        for c in ti.static((1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1)):
            p = p * r + c
        y = (p * r * r + r + 1.0) * ti.bit_cast((ti.cast(n, ti.i32) + 127) << 23, ti.f32)
    return y
