"""What waves do at a hull, as Taichi functions on values: its mean surface, the water's motion, the pressure.

Components of waves.py are summed at the label of the hull's centre and, for the pressure, along lines of points
(wave_lines.py). Means over the hull come from a three-point rule per direction, matched to second and fourth
moment of the waterplane (`Gauge`): a component of wavenumber k along it counts

    1 - q + q cos(k l)  in a mean,      sin(k l) / (k l)  in a slope,

exact to the sixth order for a rectangle (Gauss-Legendre, l = sqrt(3/5) L/2, q = 5/9), and for two thin pontoons.

Decay with depth counts from the hull's mean surface plane (Wheeler 1970, OTC 1256, whose stretching counts from the
elevation at the point: here that of the plane, so that one exponential serves a line). Hulls lie near the surface, so
in finite depth the decay of the pressure is exp(-omega^2/g d), that of vertical motion exp(-g k^2/omega^2 d): equal to
exp(-k d) in deep water, and equal to the exact factors to first order in k d.
"""

from typing import NamedTuple

import numpy as np
import taichi as ti

from taichi_sim.conventions import AMPLITUDE, BX, BY, GRAVITY, KX, KY, OMEGA, K
from taichi_sim.maths import fast

CENTRE_SIZE = 18
HALF_TURN = 3.14159265  # the rule's angles stop here: shorter waves cancel over the hull anyway


class Gauge(NamedTuple):
    """The three-point rule of a hull's waterplane along and across it; see the module."""

    along: float  # l, m
    along_share: float  # q
    across: float
    across_share: float
    depth: float  # m, where the water's motion is taken: the draft

    @classmethod
    def of(cls, point: np.ndarray, weight: np.ndarray, half_size: np.ndarray, depth: float) -> "Gauge":
        """From waterplane elements at `point` [n, 2], of area `weight` [n], each 2 half_size [n, 2] long and wide."""
        share = weight / weight.sum()
        x = point - share @ point
        second = share @ (x**2 + half_size**2 / 3)
        fourth = share @ (x**4 + 2 * x**2 * half_size**2 + half_size**4 / 5)
        arm = np.sqrt(fourth / second)
        q = second / arm**2
        return cls(float(arm[0]), float(q[0]), float(arm[1]), float(q[1]), depth)


@ti.func
def at_centre(
    sea: ti.template(), phase: ti.template(), count: ti.template(), gauge: ti.template(), finite: ti.template(),
    s, row, X, Y, tau, cos_h, sin_h
):  # fmt: skip
    """Sums at the label (X, Y) of the hull's centre; (cos_h, sin_h) is its heading.

    Returns 18 numbers: displacement x, y (0, 1) and Jacobian xx, xy, yy (2-4) of the label; elevation (5, m, up) and
    slopes along and across the heading (6, 7) of the mean plane; the water's motion averaged over the hull at
    gauge.depth: north, east, down velocity (8-10, m/s) and acceleration (11-13), roll and pitch rate about the heading
    axes (14, 15, rad/s) and their accelerations (16, 17).
    """
    r = ti.Vector([X * 0.0 for _ in range(CENTRE_SIZE)])
    for c in range(count):
        a, kx, ky, k, omega = sea[s, AMPLITUDE, c], sea[s, KX, c], sea[s, KY, c], sea[s, K, c], sea[s, OMEGA, c]
        bx, by = sea[s, BX, c], sea[s, BY, c]
        sine, cosine = fast.sincos(kx * X + ky * Y + phase[row, c] - omega * tau)
        r[0] += bx * sine
        r[1] += by * sine
        r[2] += bx * kx * cosine
        r[3] += bx * ky * cosine
        r[4] += by * ky * cosine
        k_along, k_across = kx * cos_h + ky * sin_h, ky * cos_h - kx * sin_h
        u = fast.at_most(ti.abs(k_along * gauge.along), HALF_TURN)
        v = fast.at_most(ti.abs(k_across * gauge.across), HALF_TURN)
        mean_u = 1 - gauge.along_share + gauge.along_share * fast.cos_reduced(u)
        mean_v = 1 - gauge.across_share + gauge.across_share * fast.cos_reduced(v)
        slope_u = k_along * mean_v * fast.sinc_reduced(u)
        slope_v = k_across * mean_u * fast.sinc_reduced(v)
        mean = mean_u * mean_v
        r[5] += mean * a * cosine
        r[6] -= slope_u * a * sine
        r[7] -= slope_v * a * sine
        decay = fast.exp_decay(k * gauge.depth)
        decay_h = decay
        if ti.static(finite):
            decay_h = fast.exp_decay(omega * omega * ti.static(gauge.depth / GRAVITY))
            decay = fast.exp_decay(k * k * ti.static(gauge.depth * GRAVITY) / (omega * omega))
        speed_h = mean * decay_h * omega
        r[8] += speed_h * bx * cosine
        r[9] += speed_h * by * cosine
        r[11] += speed_h * omega * bx * sine
        r[12] += speed_h * omega * by * sine
        speed = a * decay * omega
        r[10] -= mean * speed * sine
        r[13] += mean * speed * omega * cosine
        r[14] -= slope_v * speed * cosine
        r[15] += slope_u * speed * cosine
        r[16] -= slope_v * speed * omega * sine
        r[17] += slope_u * speed * omega * sine
    r[2], r[3], r[4] = 1 - r[2], -r[3], 1 - r[4]
    return r


@ti.func
def along_line(
    sea: ti.template(), phase: ti.template(), count: ti.template(), points: ti.template(), finite: ti.template(),
    s, row, X, Y, d, dX, dY, dd, across_x, across_y, tau
):  # fmt: skip
    """Dynamic pressure head p / (rho g) (m) at `points` points from the label (X, Y) and depth d (m) below the mean
    plane, by steps of dX, dY, dd, and its change (m/m) in the direction (across_x, across_y) of labels.

    Each is a mean over one step's length around the point, so that a row of panels adds up to the integral along it.
    """
    head, slope = ti.Vector([X * 0.0 for _ in range(points)]), ti.Vector([X * 0.0 for _ in range(points)])
    for c in range(count):
        kx, ky, k, omega = sea[s, KX, c], sea[s, KY, c], sea[s, K, c], sea[s, OMEGA, c]
        rate = k
        if ti.static(finite):
            rate = omega * omega * ti.static(1 / GRAVITY)
        sine, cosine = fast.sincos(kx * X + ky * Y + phase[row, c] - omega * tau)
        # of half a turn, so that the mean over a step's length, its sinc, comes along; waves shorter than that cancel
        turn, k_across = kx * dX + ky * dY, kx * across_x + ky * across_y
        half = fast.at_most(ti.abs(0.5 * turn), HALF_TURN)
        sinc, half_cosine = fast.sinc_reduced(half), fast.cos_reduced(half)
        half_sine = half * sinc
        a = sea[s, AMPLITUDE, c] * fast.exp_decay(rate * d) * sinc
        real, imaginary = a * cosine, a * sine
        m = 2 * fast.exp_near_one(rate * dd)
        step_real = 0.5 * m - m * half_sine * half_sine
        step_imaginary = ti.select(turn < 0, -m, m) * half_sine * half_cosine
        for i in ti.static(range(points)):
            head[i] += real
            slope[i] -= k_across * imaginary
            if ti.static(i < points - 1):
                t = real * step_real - imaginary * step_imaginary
                imaginary = real * step_imaginary + imaginary * step_real
                real = t
    return head, slope
