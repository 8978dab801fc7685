"""Branch-free sine, cosine and exponential that LLVM can vectorise inside an innermost loop.

Range reduction subtracts the nearest multiple of 2 pi with `floor` (a two-term Cody-Waite constant). Polynomials in r^2
on [-pi, pi] follow: least-squares fits at Chebyshev nodes with an absolute error below 1e-6 in f32 (measured by
test_maths.py). The scalar sine of libm is about 17 times slower per wave component. In f64 the library functions
are used, because precision matters there and speed does not.
"""

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import bit_cast
from taichi_sim.kernels.lanes import is_laned

TWO_PI_HI = 6.28125  # exact in 11 bits: n * TWO_PI_HI is exact in f32 for |n| < 8192
TWO_PI_LO = 1.9353071795864769e-3
TWO_PI = 6.283185307179586
INV_TWO_PI = 0.15915494309189535
LOG2_E, LN2 = 1.4426950408889634, 0.6931471805599453
LOWEST_EXPONENT, HIGHEST_EXPONENT = -87.0, 88.0  # exp of every argument between them is a normal f32
MIDDLE, MIDDLE_BITS = 1.5 * 2.0**23, 0x4B400000  # an f32 whose last digit is 1, and its bits
DECAYED = 12.0  # for larger x, exp(-x) stays at 6e-6


@ti.func
def wrap_two_pi(x):
    """Return the angle x (rad) minus the nearest multiple of 2 pi, in [-pi, pi]."""
    n = ti.floor(x * INV_TWO_PI + 0.5)
    # The bound is never reached. Without it, fast math would merge the two terms into one rounded constant.
    return at_least(x - n * TWO_PI_HI, -1e6) - n * TWO_PI_LO


@ti.func
def sinc_reduced(r):
    """sin(r) / r for r in [-pi, pi], by Estrin's scheme: the longest chain of operations sets the cost."""
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
    if ti.static(runtime.is_f64()):
        return ti.sin(x)
    else:
        return sin_reduced(wrap_two_pi(x))


@ti.func
def cos(x):
    """cos(x), x in rad."""
    if ti.static(runtime.is_f64()):
        return ti.cos(x)
    else:
        return cos_reduced(wrap_two_pi(x))


@ti.func
def sincos(x):
    """(sin x, cos x), x in rad."""
    if ti.static(runtime.is_f64()):
        return ti.sin(x), ti.cos(x)
    else:
        r = wrap_two_pi(x)
        return sin_reduced(r), cos_reduced(r)


@ti.func
def sin_turns(x):
    """Return the sine of an angle of x turns; the nearest turn is a whole number, so it costs two thirds of `sin`."""
    if ti.static(runtime.is_f64()):
        return ti.sin(TWO_PI * x)
    else:
        return sin_reduced(TWO_PI * (x - ti.floor(x + 0.5)))


@ti.func
def cos_turns(x):
    """Return the cosine of an angle of x turns (see `sin_turns`)."""
    if ti.static(runtime.is_f64()):
        return ti.cos(TWO_PI * x)
    else:
        return cos_reduced(TWO_PI * (x - ti.floor(x + 0.5)))


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
    """(sin x, cos x), x in rad. In f32 the error is 5e-5 plus twice the rounding of x; 2/3 of the cost of `sincos`."""
    if ti.static(runtime.is_f64()):
        return ti.sin(x), ti.cos(x)
    else:
        r = x - ti.floor(x * INV_TWO_PI + 0.5) * TWO_PI
        return r * sinc_short(r), cos_short(r)


@ti.func
def at_most(x, limit):
    """min(x, limit) in one instruction; ti.min takes two more to handle NaN."""
    return ti.select(x < limit, x, limit)


@ti.func
def at_least(x, limit):
    """max(x, limit) in one instruction (see `at_most`)."""
    return ti.select(x > limit, x, limit)


@ti.func
def exp_decay(x):
    """exp(-x). In f32 the eighth power of a quartic: relative error 5e-4 for x in [-2, 8], absolute 8e-6 above."""
    if ti.static(runtime.is_f64()):
        return ti.exp(-x)
    else:
        a = 0.125 * at_most(x, DECAYED)
        a2 = a * a
        b = (1.00002562 - 1.00043207 * a) + (0.49960771 - 0.15938701 * a + 0.02808227 * a2) * a2
        b = b * b
        b = b * b
        return b * b


@ti.func
def exp_near_one(x):
    """exp(-x) > 0 for |x| < 1. In f32 the fourth power of a quadratic: error 1.3e-2, and 3e-4 for |x| < 0.3."""
    if ti.static(runtime.is_f64()):
        return ti.exp(-x)
    else:
        b = 1 - 0.25 * x + 0.03125 * (x * x)
        b = b * b
        return b * b


@ti.func
def float_of(n):
    """f32 of an i32 with |n| < 2^22.

    LLVM would convert a group's numbers (abreast.py) one by one, so they are added to the digits of 1.5 x 2^23.
    """
    if ti.static(is_laned(n)):
        return at_least(bit_cast(n + MIDDLE_BITS, ti.f32) - MIDDLE, -MIDDLE)  # (the bound: see `wrap_two_pi`)
    else:
        return ti.cast(n, ti.f32)


@ti.func
def int_of(n):
    """i32 of a whole f32 with |n| < 2^22; the inverse of `float_of`."""
    if ti.static(is_laned(n)):
        return bit_cast(n + MIDDLE, ti.i32) - MIDDLE_BITS
    else:
        return ti.cast(n, ti.i32)


@ti.func
def exp(x):
    """Return e^x with a relative error of 1e-7 (1 + |x|); in f32, x is clamped to [-87, 88].

    Range reduction is x = n ln 2 + r with |r| <= ln 2 / 2. The polynomial in r is that of expf in Moshier's Cephes
    library. In f64 this is the library's function.
    """
    if ti.static(runtime.is_f64()):
        return ti.exp(x)
    else:
        bounded = ti.min(ti.max(x, LOWEST_EXPONENT), HIGHEST_EXPONENT)
        n = ti.floor(bounded * LOG2_E + 0.5)
        r = bounded - n * LN2
        p = x * 0.0 + 1.9875691500e-4
        for c in ti.static((1.3981999507e-3, 8.3334519073e-3, 4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1)):
            p = p * r + c
        return (p * r * r + r + 1.0) * bit_cast((int_of(n) + 127) << 23, ti.f32)
