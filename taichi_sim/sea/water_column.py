"""Water between the surface and the bottom: pressure, velocity and acceleration.

Linear theory holds below still water. Extended into a crest, its pressure is not zero at the surface, and exp(k z)
grows without bound for short waves on long ones. The water is therefore stretched (Wheeler 1970, J. Petroleum
Technology 22, 359): the decay counts from the instantaneous surface,

    z' = (z - zeta) / (1 + zeta / depth),

which is z - zeta in deep water, 0 at the surface and -depth at the bottom. theta_c is that of the surface particle
straight above (label X, Y), so that zeta = sum a cos theta exactly. Then

    p / (rho g) = -z + sum a cosh k(z' + depth) / cosh k depth  cos theta         (0 at z = zeta, exactly)
    u_n = sum b_n omega cosh k(z' + depth) / cosh k depth  cos theta              (b = a coth k depth, as in waves.py)
    w   = sum a omega sinh k(z' + depth) / sinh k depth  sin theta                (up; 0 at the bottom)

The acceleration is the rate of u and w at a fixed label and z'. At the surface the motion is that of the Gerstner
particle; far below, it decays as in linear theory. In deep water the pressure grows with depth everywhere, because
sum k a < 1.

The pressure differs from Gerstner's exact one by second order in k a. Each component makes it higher by rho g k a^2 (1
- exp k z')^2 / 2, because it counts from still water, and the mean of Gerstner's surface is lower (`Sea.mean_level`).
For one wave of k a = 0.16 the difference is at most 0.6 % at any depth (tests/physics/test_waves.py).

The exponentials of -2k(depth + z') and -2k depth give deep and finite water one form without overflow; depth < 0 means
deep water.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import AMPLITUDE, BX, BY, KX, KY, OMEGA, K
from taichi_sim.kernels import fast


@ti.func
def stretched(z, zeta, depth):
    """Height z' <= 0 (m) below the instantaneous surface zeta at which linear theory is evaluated, for the height z (m,
    up).

    It is 0 above the surface and -depth below the bottom.
    """
    below = ti.min(z - zeta, 0.0)
    if depth > 0:
        below = ti.max(below / (1 + zeta / depth), -depth)
    return below


@ti.func
def column_at_label(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, below, depth, tau):
    """(eta, velocity 3, acceleration 3) at the stretched height `below` (m, <= 0) under the surface particle (X, Y).

    eta (m) is the dynamic pressure over rho g. Velocity (m/s) and acceleration (m/s^2) are north, east, up.
    """
    eta = X * 0.0
    vx, vy, vz = eta, eta, eta
    ax, ay, az = eta, eta, eta
    for c in range(count):
        k, omega = sea[s, K, c], sea[s, OMEGA, c]
        sine, cosine = fast.sincos(sea[s, KX, c] * X + sea[s, KY, c] * Y + phase[row, c] - omega * tau)
        level = ti.exp(k * below)  # cosh k(z' + depth) / cosh k depth
        upright = level  # sinh k(z' + depth) / sinh k depth
        if depth > 0:
            up, down = ti.exp(-2 * k * (depth + below)), ti.exp(-2 * k * depth)
            upright = level * (1 - up) / (1 - down)
            level = level * (1 + up) / (1 + down)
        a, bx, by = sea[s, AMPLITUDE, c] * upright, sea[s, BX, c] * level, sea[s, BY, c] * level
        eta += sea[s, AMPLITUDE, c] * level * cosine
        vx += bx * omega * cosine
        vy += by * omega * cosine
        vz += a * omega * sine
        ax += bx * omega * omega * sine
        ay += by * omega * omega * sine
        az -= a * omega * omega * cosine
    return ti.Vector([eta, vx, vy, vz, ax, ay, az])
