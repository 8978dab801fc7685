"""Branch-free sine and cosine that LLVM can vectorise inside an innermost loop.

Range reduction subtracts the nearest multiple of 2 pi with `floor` (two-term Cody-Waite constant), then
polynomials in r^2 on [-pi, pi]: least-squares fits at Chebyshev nodes, absolute error below 1e-6 in f32
(tests/test_maths.py measures it). libm's scalar sine is about 17 times slower per wave component.
In f64 the library functions are used: precision matters there, speed does not.
"""

import taichi as ti

from taichi_sim import runtime

TWO_PI_HI = 6.28125  # exact in 11 bits: n * TWO_PI_HI is exact in f32 for |n| < 8192
TWO_PI_LO = 1.9353071795864769e-3
INV_TWO_PI = 0.15915494309189535


@ti.func
def wrap_two_pi(x):
    """The angle x (rad) minus the nearest multiple of 2 pi: in [-pi, pi]."""
    n = ti.floor(x * INV_TWO_PI + 0.5)
    # The bound never binds; without it fast math would merge the two terms into one rounded constant.
    return ti.max(x - n * TWO_PI_HI, -1e6) - n * TWO_PI_LO


@ti.func
def sin_reduced(r):
    """sin(r) for r in [-pi, pi]; Estrin's scheme: what a call costs is its longest chain, not its operations."""
    s = r * r
    s2 = s * s
    low = (9.9999993782e-01 - 1.6666621108e-01 * s) + (8.3327915028e-03 - 1.9817630988e-04 * s) * s2
    return r * (low + (2.7088311591e-06 - 2.0698134663e-08 * s) * (s2 * s2))


@ti.func
def cos_reduced(r):
    """cos(r) for r in [-pi, pi]."""
    s = r * r
    s2 = s * s
    low = (9.9999998906e-01 - 4.9999989101e-01 * s) + (4.1666489217e-02 - 1.3887803598e-03 * s) * s2
    return low + ((2.4769883558e-05 - 2.7079030826e-07 * s) + 1.7245091764e-09 * s2) * (s2 * s2)


@ti.func
def sin(x):
    """sin(x), x in rad."""
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.sin(x)
    else:
        y = sin_reduced(wrap_two_pi(x))
    return y


@ti.func
def cos(x):
    """cos(x), x in rad."""
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.cos(x)
    else:
        y = cos_reduced(wrap_two_pi(x))
    return y


@ti.func
def sincos(x):
    """(sin x, cos x), x in rad."""
    s, c = x, x
    if ti.static(runtime.is_f64()):
        s, c = ti.sin(x), ti.cos(x)
    else:
        r = wrap_two_pi(x)
        s, c = sin_reduced(r), cos_reduced(r)
    return s, c
