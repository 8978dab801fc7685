"""Branch-free sine, cosine and decay that LLVM can vectorise inside an innermost loop.

Range reduction subtracts the nearest multiple of 2 pi with `floor` (two-term Cody-Waite constant), then
polynomials in r^2 on [-pi, pi]: least-squares fits at Chebyshev nodes, absolute error below 1e-6 in f32
(tests/test_maths.py measures it). libm's scalar sine is about 17 times slower per wave component.
In f64 the library functions are used: precision matters there, speed does not.
"""

import taichi as ti

from taichi_sim.kernels import runtime

TWO_PI_HI = 6.28125  # exact in 11 bits: n * TWO_PI_HI is exact in f32 for |n| < 8192
TWO_PI_LO = 1.9353071795864769e-3
TWO_PI = 6.283185307179586
INV_TWO_PI = 0.15915494309189535
DECAYED = 12.0  # exp(-x) stays at 6e-6 from here on


@ti.func
def wrap_two_pi(x):
    """The angle x (rad) minus the nearest multiple of 2 pi: in [-pi, pi]."""
    n = ti.floor(x * INV_TWO_PI + 0.5)
    # The bound never binds; without it fast math would merge the two terms into one rounded constant.
    return ti.max(x - n * TWO_PI_HI, -1e6) - n * TWO_PI_LO


@ti.func
def sinc_reduced(r):
    """sin(r) / r for r in [-pi, pi]; Estrin's scheme: what a call costs is its longest chain, not its operations."""
    s = r * r
    s2 = s * s
    low = (9.9999993782e-01 - 1.6666621108e-01 * s) + (8.3327915028e-03 - 1.9817630988e-04 * s) * s2
    return low + (2.7088311591e-06 - 2.0698134663e-08 * s) * (s2 * s2)


@ti.func
def sin_reduced(r):
    """sin(r) for r in [-pi, pi]."""
    return r * sinc_reduced(r)


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


@ti.func
def sinc_short(r):
    """sin(r) / r for r in [-pi, pi] to 4e-6."""
    s = r * r
    s2 = s * s
    return (9.9999615200e-01 - 1.6664703189e-01 * s) + (
        (8.3172454379e-03 - 1.9376590195e-04 * s) + 2.1981251567e-06 * s2
    ) * s2


@ti.func
def cos_short(r):
    """cos(r) for r in [-pi, pi] to 5e-5."""
    s = r * r
    s2 = s * s
    return (9.9995902084e-01 - 4.9979060875e-01 * s) + (
        (4.1494742104e-02 - 1.3390584762e-03 * s) + 1.8781329857e-05 * s2
    ) * s2


@ti.func
def sincos_short(x):
    """(sin x, cos x), x in rad: in f32 to 5e-5 and twice the rounding of x, for two thirds of the price of sincos."""
    s, c = x, x
    if ti.static(runtime.is_f64()):
        s, c = ti.sin(x), ti.cos(x)
    else:
        r = x - ti.floor(x * INV_TWO_PI + 0.5) * TWO_PI
        s, c = r * sinc_short(r), cos_short(r)
    return s, c


@ti.func
def at_most(x, limit):
    """min(x, limit) in one instruction: ti.min takes two more to say what it does with NaN."""
    return ti.select(x < limit, x, limit)


@ti.func
def at_least(x, limit):
    """max(x, limit), see `at_most`."""
    return ti.select(x > limit, x, limit)


@ti.func
def exp_decay(x):
    """exp(-x): in f32 the eighth power of a quartic, to 5e-4 of the value for x in [-2, 8] and to 8e-6 above."""
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.exp(-x)
    else:
        a = 0.125 * at_most(x, DECAYED)
        a2 = a * a
        b = (1.00002562 - 1.00043207 * a) + (0.49960771 - 0.15938701 * a + 0.02808227 * a2) * a2
        b = b * b
        b = b * b
        y = b * b
    return y


@ti.func
def exp_near_one(x):
    """exp(-x) for |x| below 1, to 1.3e-2 in f32 (3e-4 below 0.3), and positive everywhere: a power of a quadratic."""
    y = x
    if ti.static(runtime.is_f64()):
        y = ti.exp(-x)
    else:
        b = 1 - 0.25 * x + 0.03125 * (x * x)
        b = b * b
        y = b * b
    return y
