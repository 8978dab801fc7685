"""Angles of the airflow and the blending function of the stall. In f32 they call no libm; in f64 they call the library.

The arctangent is a polynomial in t^2 on [0, 1]: least-squares fit at Chebyshev nodes, error below 3e-7 of the value
and of 1 rad (tests/physics/test_fixed_wing_loads.py measures it).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import some

HALF_PI = math.pi / 2
TINY = 1e-30  # keeps 0 / 0 out of atan2(0, 0)
ATTACHED, STALLED = -17.0, 17.0  # exponents beyond which the blend rounds to 0 and to 1 in f32
LARGEST = 300.0  # exp(300)^2 is still finite in f64
SQUARINGS = 6  # exp(x) = exp(x / 64)^64


@ti.func
def atan_unit(t):
    """atan(t) for t in [0, 1]; Estrin's scheme."""
    s = t * t
    s2 = s * s
    low = (9.9999982133e-01 - 3.3331495914e-01 * s) + (1.9963134872e-01 - 1.3984092215e-01 * s) * s2
    high = (9.8206141158e-02 - 5.8187920381e-02 * s) + (2.3348513941e-02 - 4.4439168300e-03 * s) * s2
    return t * (low + high * (s2 * s2))


@ti.func
def atan2(y, x):
    """Angle (rad, in [-pi, pi]) of the vector (x, y); 0 for (0, 0)."""
    angle = y
    if ti.static(runtime.is_f64()):
        angle = ti.atan2(y, x)
    else:
        ax, ay = ti.abs(x), ti.abs(y)
        small, large = ti.min(ax, ay), ti.max(ax, ay)
        angle = atan_unit(small / ti.max(large, TINY))
        angle = ti.select(ay > ax, HALF_PI - angle, angle)
        angle = ti.select(x < 0.0, math.pi - angle, angle)
        angle = ti.select(y < 0.0, -angle, angle)
    return angle


@ti.func
def exp_clamped(x):
    """exp(x) of x clamped to [ATTACHED, STALLED] (in f64: to LARGEST)."""
    result = x
    if ti.static(runtime.is_f64()):
        result = ti.exp(ti.min(x, LARGEST))
    else:
        z = ti.max(ti.min(x, STALLED), ATTACHED) * ti.static(0.5**SQUARINGS)
        series = 1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0 + z * (1.0 / 720.0 + z * (1.0 / 5040.0))))
        result = 1.0 + z * (1.0 + z * (0.5 + z * series))
        for _ in ti.static(range(SQUARINGS)):
            result *= result
    return result


@ti.func
def stall_blend(M: ti.template(), alpha0: ti.template(), alpha):
    """sigma(alpha) of Beard & McLain 2012, eq. 4.10: 0 in attached flow, 1 far beyond +-alpha0, sharpness M (1/rad).

    With c = exp(-M alpha0) their quotient of exponentials is x / (1 + x), x = c^2 + 2 c cosh(M alpha). This form needs
    one exponential and loses no digits to cancellation.
    """
    sigma = alpha * 0.0
    exponent = M * ti.abs(alpha) - ti.static(M * alpha0)
    # this branch is nearly always predicted; it keeps the exponential out of the longest chain of operations
    near = exponent > ti.static(-LARGEST if runtime.is_f64() else ATTACHED)
    if some(near):
        c2 = ti.static(math.exp(-2.0 * M * alpha0))
        growing = exp_clamped(exponent)
        x = growing * (growing + c2) + c2  # scaled by `growing`, which saves a division
        sigma = ti.select(near, x / (growing + x), 0.0)
    return sigma
