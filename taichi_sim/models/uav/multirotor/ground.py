"""Ground effect: rotors near a surface give more thrust at the same speed.

Cheeseman & Bennett (1955, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021) put a source
of the flux of the rotor's flow, pi R^2 v, in the rotor, and its image below the ground: the image's upwash
(R^2 / 4) v / (2 h)^2 makes thrust at constant power 1 / (1 - (R / 4 h)^2) times that in free air. With several rotors
each one feels the images of all (Sanchez-Cuevas, Heredia & Ollero 2017, Int. J. Aerospace Eng., 1823056; their fountain
term with a fitted K_b is left out). The image of rotor j is at the distance rho_ij from rotor i, and h_i + h_j below
it:

    T_i / T_free = 1 / (1 - sum_j w_j (R^2 / 4) (h_i + h_j) / rho_ij^3),   rho_ij^2 = |r_i - r_j|^2 + 4 h_i h_j.

In flight the upwash is swept behind: Cheeseman & Bennett divide it by 1 + (V / v)^2, with V the airspeed across the
axis and v the rotor's induced velocity in hover. The formula is not valid below h = R / 2, so h is held there.

A ground is given by a height above it and a weight for each rotor. The weight w_j is 1 over an infinite plane. Over a
finite one, such as a deck, `edge_weight` reduces it to 0 across the edge, so that a rotor beyond the edge has no image.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import math

import taichi as ti

from taichi_sim.kernels.abreast import some
from taichi_sim.models.uav.multirotor.params import gains
from taichi_sim.models.uav.multirotor.rotors import arm

NOTHING, SEA, DECK = False, True, 2
"""What may be below; `below` of a kernel's functions is nothing, the height over the sea (m), or `beneath`."""
LOWEST = 0.5  # height over the radius, below which the formula is not valid
REACH = 16.0  # height over the radius above which there is no effect; four rotors have 0.1 % left there
FADE = 0.75  # fraction of the reach from which the effect fades to zero
LARGEST = 0.5  # largest upwash over the induced velocity: many rotors close to the ground would exceed 1
STILL = 1e-6  # m^2/s^2, added to squares of induced velocities: keeps 0 / 0 out of a rotor that stands still


@ti.func
def beneath(height, sea, upwash):
    """`below` of a DECK, held over a step.

    Args:
        height: height of the centre of gravity over the sea, m.
        sea: weight of the sea [rotor].
        upwash: upwash of the rotors' images in the deck over their induced velocity [rotor].
    """
    below = ti.Vector([height for _ in ti.static(range(1 + 2 * sea.n))])
    for k in ti.static(range(sea.n)):
        below[1 + k], below[1 + sea.n + k] = sea[k], upwash[k]
    return below


@ti.func
def lowered(kind: ti.template(), below, by):
    """Return `below` (what is under the rotors; see `beneath`) for a centre of gravity `by` m higher."""
    new = below
    if ti.static(kind == DECK):
        new[0] += by
    else:
        new += by
    return new


@ti.func
def edge_weight(inside, width):
    """Weight (0 to 1, smooth) of a ground `inside` its edge (m; negative: outside); it fades over `width` (m)."""
    x = ti.max(ti.min(inside / width + 0.5, 1.0), 0.0)
    return x * x * (3.0 - 2.0 * x)


@ti.func
def heights_over(craft: ti.template(), p: ti.template(), down_b, height):
    """Height [rotor] (m) of each hub over a level plane that is `height` m below the centre of gravity.

    down_b is the world's down direction in b.
    """
    h = ti.Vector([height for _ in ti.static(range(len(craft.rotors)))])
    for k in ti.static(range(len(craft.rotors))):
        h[k] -= down_b.dot(arm(craft, p, k))
    return h


@ti.func
def thrust_ratios(craft: ti.template(), p: ti.template(), heights, weights, omega, speed2):
    """T / T_free [rotor] at speeds omega [rotor] (rad/s) over a ground with `heights` (m) and `weights` [rotor].

    speed2 is the square of the airspeed across the axes (m^2/s^2).
    """
    N = ti.static(len(craft.rotors))
    R = ti.static(craft.rotor.radius)
    ratio = ti.Vector([heights[0] * 0.0 + 1.0 for _ in ti.static(range(N))])
    lowest = heights[0]
    for k in ti.static(range(1, N)):
        lowest = ti.min(lowest, heights[k])
    if some(lowest < ti.static(REACH * R)):
        gain = ti.static(gains(p, N))
        fade = 1.0 - edge_weight(
            lowest - ti.static(0.5 * (1.0 + FADE) * REACH * R), ti.static((1.0 - FADE) * REACH * R)
        )
        h, upwash = heights, ratio * 0.0
        for k in ti.static(range(N)):
            h[k] = ti.max(heights[k], ti.static(LOWEST * R))
        for i in ti.static(range(N)):
            for j in ti.static(range(N)):
                apart = ti.static(math.dist(craft.rotors[i].position, craft.rotors[j].position) ** 2)
                rho2 = apart + 4.0 * h[i] * h[j]
                upwash[i] += weights[j] * ti.static(0.25 * R * R) * (h[i] + h[j]) / (rho2 * ti.sqrt(rho2))
            induced2 = p.k_f * gain[i] * omega[i] * omega[i] * ti.static(0.5 / (craft.physical.rho * math.pi * R * R))
            swept = (induced2 + STILL) / (induced2 + STILL + speed2)
            ratio[i] = 1.0 / (1.0 - ti.min(fade * swept * upwash[i], LARGEST))
    return ratio
