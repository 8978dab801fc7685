"""Positions that lose no increment, however far from the origin a vehicle is and however short its steps are.

In f32 a position 1,000 km from the origin is a multiple of 6 cm, so a step that is shorter would not move a vehicle at
all. A fleet therefore keeps the remainder of each position (`Fleet.remainder`, m), which `state` cannot hold, and a
kernel adds up its way from the place where the control step began:

    start, way = position_of(y), v * 0.0
    ...                                   # in every substep: way += dt v; what needs the place uses start + way
    move(fleet, e, i, start, way, then)   # position + remainder = start + remainder + way

Sum and remainder are those of two floats, without rounding (Dekker 1971, A floating-point technique for extending the
available precision, Numerische Mathematik 18, 224-242). In f64, where a position of 1,000 km is exact to 0.1 nm, the
remainder stays 0.

A position that is written by hand may meet an older remainder. If it is more than half of the position's last digit, it
counts as 0 (`belongs`).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import bit_cast, put
from taichi_sim.kernels.conventions import NORTH
from taichi_sim.kernels.lanes import WIDTH, is_laned

HALF_DIGIT = 2.0**-24  # largest remainder of an f32, as a share of it
ONE_EXPONENT = 1 << 23  # added to the bits of an f32, it doubles the number


@ti.func
def move(fleet: ti.template(), e, i, start, way, then: ti.template()):
    """Write the first positions (n, m) of vehicle i in environment e, and their remainders: `start`, as they are in the
    state, plus `way`; vectors of two or three numbers. The list `then` holds the columns of the state that follow.

    The vehicles of a group (abreast.py) lie one after another, so that their remainders are whole vectors.
    """
    if ti.static(runtime.is_f64()):
        put(fleet.state, e, i, NORTH, [start[k] + way[k] for k in ti.static(range(way.n))] + then)
    else:
        there = start
        for k in ti.static(range(way.n)):
            if ti.static(is_laned(e)):
                g = (e[0] * fleet.state.shape[1] + i[0]) // WIDTH
                there[k], fleet.rests[k, g] = added(start[k], way[k] + belongs(fleet.rests[k, g], start[k]))
            else:
                row = e * fleet.state.shape[1] + i
                there[k], fleet.remainder[k, row] = added(start[k], way[k] + belongs(fleet.remainder[k, row], start[k]))
        put(fleet.state, e, i, NORTH, [there[k] for k in ti.static(range(way.n))] + then)


@ti.func
def belongs(rest, p):
    """The remainder of position p; 0 if it is that of another one."""
    return ti.select(rest * rest <= p * p * ti.static(HALF_DIGIT**2), rest, 0.0 * p)


@ti.func
def added(a, b):
    """a + b as rounded, and exactly what rounding has left."""
    first = a * a >= b * b
    large, small = ti.select(first, a, b), ti.select(first, b, a)
    s = large + small
    return s, small - opaque(opaque(s) - large)


@ti.func
def opaque(x):
    """x, whose origin the compiler does not see; otherwise fast math would cancel the terms of `added`."""
    return 0.5 * bit_cast(bit_cast(x, ti.i32) + ONE_EXPONENT, ti.f32)


@ti.func
def with_position(y, place):
    """State y with its position replaced by `place` (n, m)."""
    new = y
    for k in ti.static(range(3)):
        new[NORTH + k] = place[k]
    return new
