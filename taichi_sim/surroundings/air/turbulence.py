"""Continuous turbulence: the Dryden model of MIL-F-8785C (1980, sec. 3.7.1.2) at low altitude (3.7.3.4).

h is the height in feet, clamped to 10..1000 ft. W20 is the mean wind at 20 ft. Lengths and intensities are

    L_w = h,          L_u = L_v = h / (0.177 + 0.000823 h)^1.2
    sigma_w = 0.1 W20,  sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4

An aircraft of airspeed V meets gusts with these one-sided spectra (per rad/s), with T = L / V:

    Phi_u = sigma^2 2 T / pi / (1 + (T omega)^2),
    Phi_v, Phi_w = sigma^2 T / pi (1 + 3 (T omega)^2) / (1 + (T omega)^2)^2.

Axes: u points along the aircraft's horizontal velocity through the air, v to its right, w down. (MIL-F-8785C takes the
horizontal relative mean wind at low altitude.) A positive gust is air that moves along the axis. `gust_n` converts to
NED.

State: u / sigma is an Ornstein-Uhlenbeck process x0. v / sigma = cos 15 deg x1 + sin 15 deg x2. With s = t / T and
white noise dW,

    dx1 = -x1 ds + sqrt 2 dW,   dx2 = -(2 x1 + x2) ds + sqrt 2 dW.

These are Laguerre's functions: their covariance is the identity for any V, L and sigma. x3 and x4 do the same for w.
The five states are therefore independent standard normal numbers at any time, and a reset draws them so. A change of
airspeed or height changes only how fast they evolve. A gust jumps only where sigma(h, W20) jumps.

A step is exact for any dt while V and h are constant. With tau = dt / T, a = e^-tau and z standard normal, x1 and x2
become F x + N z, where

    F = a [[1, 0], [-2 tau, 1]],   N N^T = 1 - F F^T,   N lower triangular.

`dryden_filter` and `dryden_sigma` are most of the cost, and their results change slowly. A kernel of many substeps
calls them once, then `dryden_advance` and `dryden_output` in each substep. The rotary gusts (p, q, r) of MIL-F-8785C
are not modelled.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import math

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.fast_maths import exp
from taichi_sim.kernels.lanes import is_laned

STATES = 5  # per vehicle: one of u, two of v, two of w

FOOT = 0.3048  # m
LOWEST, HIGHEST = 10 * FOOT, 1000 * FOOT  # m, ends of the low-altitude model
RATIO_0, RATIO_1 = 0.177, 0.000823 / FOOT  # y = RATIO_0 + RATIO_1 h, h in m
INTENSITY = 0.1  # sigma_w / W20

# Polynomial of y^-0.4 on [0.185, 1], a least-squares fit at Chebyshev nodes with a relative error of 7e-4. One Newton
# step for r^-5 = y^2 reduces the error to 1.3e-6, two steps to 5e-12.
SEED = (3.36590721, -12.67740378, 38.17499484, -70.05698598, 75.17589619, -43.32291445, 10.34080659)
NEWTON_STEPS = {"f32": 2, "f64": 3}

OUT_1, OUT_2 = math.cos(math.pi / 12), math.sin(math.pi / 12)  # v / sigma = OUT_1 x1 + OUT_2 x2

SERIES_END = 0.5  # below this tau, N comes from the series of (sinh tau - tau) / tau^3; a difference would lose digits
SERIES = tuple(1 / math.factorial(2 * k + 3) for k in range(7))
SERIES_TERMS = {"f32": 4, "f64": 7}

AT_REST = 0.01  # m/s; below this horizontal airspeed the gust's axes are north and east


@ti.func
def dryden_ratio(h):
    """Return (h clamped to the model's range (m), y = 0.177 + 0.000823 h_ft, y^-0.4 = sigma_u / sigma_w)."""
    held = ti.min(ti.max(h, LOWEST), HIGHEST)
    y = RATIO_0 + RATIO_1 * held
    r = y * 0.0 + SEED[6]
    for k in ti.static(range(6)):
        r = r * y + SEED[5 - k]
    for _ in ti.static(range(NEWTON_STEPS[runtime.current().precision])):
        square = y * r * r
        r *= 1.2 - 0.2 * (square * square * r)
    return held, y, r


@ti.func
def filter_step(tau):
    """Return (a, 2 tau a, N11, N21, N22) for a step of tau >= 0 time constants."""
    a = exp(-tau)
    n = ti.Vector([a, a, a])
    if ti.static(is_laned(tau)):
        n = ti.select(tau < SERIES_END, noise_of_short_step(tau, a), noise_of_long_step(ti.max(tau, SERIES_END), a))
    elif tau < SERIES_END:
        n = noise_of_short_step(tau, a)
    else:
        n = noise_of_long_step(tau, a)
    return ti.Vector([a, 2.0 * tau * a, n[0], n[1], n[2]])


@ti.func
def noise_of_short_step(tau, a):
    """(N11, N21, N22) for tau < SERIES_END, a = exp(-tau)."""
    square = tau * tau
    terms = ti.static(SERIES_TERMS[runtime.current().precision])
    c = tau * 0.0 + SERIES[terms - 1]
    for k in ti.static(range(1, terms)):
        c = c * square + SERIES[terms - 1 - k]
    sinhc = 1.0 + square * c
    n11 = ti.sqrt(2.0 * a * tau * sinhc)
    return ti.Vector([n11, a * n11 / sinhc, n11 / sinhc * tau * ti.sqrt(c * (1.0 + sinhc))])


@ti.func
def noise_of_long_step(tau, a):
    """(N11, N21, N22) for tau >= SERIES_END, a = exp(-tau)."""
    variance = 1.0 - a * a
    n11 = ti.sqrt(variance)
    m = 2.0 * tau * a / n11
    return ti.Vector([n11, a * m, ti.sqrt(variance - m * m)])


@ti.func
def dryden_filter(V, h, dt):
    """Coefficients (10) of a step dt (s) at airspeed V (m/s, >= 0) and height h (m): `filter_step` of u and v, of w."""
    held, y, r = dryden_ratio(h)
    tau_w = V * dt / held
    f, g = filter_step(tau_w * (y * r) * (y * r)), filter_step(tau_w)  # y^1.2 = y^2 (y^-0.4)^2
    return ti.Vector([f[0], f[1], f[2], f[3], f[4], g[0], g[1], g[2], g[3], g[4]])


@ti.func
def dryden_advance(x, f, z):
    """State (5) after one step with the coefficients f (10) and five standard normal numbers z."""
    return ti.Vector(
        [
            f[0] * x[0] + f[2] * z[0],
            f[0] * x[1] + f[2] * z[1],
            f[0] * x[2] - f[1] * x[1] + f[3] * z[1] + f[4] * z[2],
            f[5] * x[3] + f[7] * z[3],
            f[5] * x[4] - f[6] * x[3] + f[8] * z[3] + f[9] * z[4],
        ]
    )


@ti.func
def dryden_sigma(h, W20):
    """Intensities (sigma_u = sigma_v, sigma_w; m/s) at height h (m) in a wind of W20 (m/s) at 20 ft."""
    _, _, r = dryden_ratio(h)
    return ti.Vector([INTENSITY * W20 * r, INTENSITY * W20])


@ti.func
def dryden_output(x, sigma):
    """Gust (u, v, w; m/s) in the turbulence axes from the state x (5) and the intensities of `dryden_sigma`."""
    v, w = OUT_1 * x[1] + OUT_2 * x[2], OUT_1 * x[3] + OUT_2 * x[4]
    return ti.Vector([sigma[0] * x[0], sigma[0] * v, sigma[1] * w])


@ti.func
def gust_n(gust, v_air_n):
    """Convert a gust (u, v, w) to NED for an aircraft with velocity v_air_n (NED, m/s) relative to the mean wind."""
    square = v_air_n[0] * v_air_n[0] + v_air_n[1] * v_air_n[1]
    moves = square > AT_REST * AT_REST
    scale = 1.0 / ti.sqrt(ti.max(square, AT_REST * AT_REST))
    c, s = ti.select(moves, v_air_n[0] * scale, 1.0), ti.select(moves, v_air_n[1] * scale, 0.0)
    return ti.Vector([c * gust[0] - s * gust[1], s * gust[0] + c * gust[1], gust[2]])
