"""Motion of a deck during a control step, and the reaction of a contact on the vehicle that carries the deck.

A carrier makes its control step first. In it, a constant load stands for the vehicles that press on its decks: their
mean load over the previous step. The states at both ends of the step are then known. Between them the carrier follows
the cubic with the positions and velocities of both ends; its rotation vector does likewise. The vehicle with legs
then makes its own control step against the deck

    x_D = x + dx,   R_D = exp(S(dtheta)) R,   (dx, dtheta)'' = W (tau - tau_before).

This deck answers at once to the wrench tau on it, less the wrench tau_before that the carrier has already had. W is the
carrier's mobility: the acceleration per unit load (`Vehicle.mobility`). Afterwards the carrier is moved by dx and
dtheta, and receives exactly the impulse that it has not had yet. Linear and angular momentum of both vehicles are
therefore conserved to rounding, and a vehicle at rest on a deck presses on the carrier as a steady load.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportOptionalCall=false, reportGeneralTypeIssues=false

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import NORTH, QW, ROLL_RATE, SURGE
from taichi_sim.kernels.rigid_body import cross
from taichi_sim.kernels.rotation import quaternion_advance, quaternion_product, rotation_matrix, store
from taichi_sim.kernels.runtime import array3

# Columns of a carrier's table: the deck's centre and half size in b (m), its friction, the mobility W and the inverse
# of W (by rows)
CENTRE, HALF, FRICTION, MOBILITY, MASS, TABLE_SIZE = 0, 3, 5, 6, 42, 78
# Columns of a way, that is, the motion of one deck during one control step:
# - WHICH deck (0: none, else 1 + its number), and its DISTANCE (m);
# - at the beginning: the carrier's position n (m), quaternion, velocity n (m/s) and rates b (rad/s);
# - from the beginning to the end: displacement n (m) and rotation vector b (rad);
# - at the end: velocity n (m/s) and rate of the rotation vector (rad/s);
# - the load that the carrier has already had (N, N m, b), and the carrier's table;
# - what the vehicle with legs does to the carrier: displacement and rotation vector n (m, rad), impulse and angular
#   impulse about the position at the beginning, n (N s, N m s).
(WHICH, DISTANCE, PLACE, TURN, VELOCITY, RATES, STEP, ROTATION, LAST_VELOCITY, LAST_RATES, HAD, TABLE) = (
    0, 1, 2, 5, 9, 12, 15, 18, 21, 24, 27, 33,
)  # fmt: skip
SHIFT, IMPULSE = TABLE + TABLE_SIZE, TABLE + TABLE_SIZE + 6
WAY_SIZE = IMPULSE + 6
# columns of pressing: 1 + number of the deck (0: none), mean wrench on its carrier in the last step, b (N, N m)
PRESSED, WRENCH, PRESSING_SIZE = 0, 1, 7
SMALL_ANGLE = 1e-4  # rad; a smaller rotation vector is twice the vector part of the quaternion


@ti.func
def turned(v):
    """Quaternion of the rotation vector v (rad)."""
    return quaternion_advance(ti.Vector([v[0] * 0.0 + 1.0, v[0] * 0.0, v[0] * 0.0, v[0] * 0.0]), v, 1.0)


@ti.func
def rotation_vector(q, r):
    """Rotation vector (rad) from attitude q to attitude r, in the axes of q."""
    d = quaternion_product(ti.Vector([q[0], -q[1], -q[2], -q[3]]), r)
    d *= ti.select(d[0] < 0.0, -1.0, 1.0)
    v = ti.Vector([d[1], d[2], d[3]])
    size = ti.sqrt(v.dot(v))
    angle = 2.0 * ti.atan2(size, d[0])
    return v * ti.select(angle > SMALL_ANGLE, angle / ti.max(size, 0.1 * SMALL_ANGLE), 2.0)


@ti.func
def cubic(along, first, last, t, T: ti.template()):
    """Value and rate at t (s) of the cubic from 0 to `along` at T (s), with the rates `first` at 0 and `last` at T."""
    s = t * ti.static(1.0 / T)
    value = T * s * (1 - s) * (1 - s) * first + s * s * (3 - 2 * s) * along + T * s * s * (s - 1) * last
    rate = (1 - s) * (1 - 3 * s) * first + 6 * s * (1 - s) * ti.static(1.0 / T) * along + s * (3 * s - 2) * last
    return value, rate


@ti.func
def carried(way: ti.template(), e, i, t, T: ti.template()):
    """Displacement of the carrier from PLACE (m), R_nb, velocity, rates at t (s) of a control step T (s), all in n."""
    x, v = cubic(taken(way, e, i, STEP, 3), taken(way, e, i, VELOCITY, 3), taken(way, e, i, LAST_VELOCITY, 3), t, T)
    turn, rate = cubic(taken(way, e, i, ROTATION, 3), taken(way, e, i, RATES, 3), taken(way, e, i, LAST_RATES, 3), t, T)
    R = rotation_matrix(quaternion_advance(taken(way, e, i, TURN, 4), turn, 1.0))
    bent = cross(turn, rate)
    return x, R, v, R @ (rate - 0.5 * bent + cross(turn, bent) * (1.0 / 6.0))


@ti.func
def answer(way: ti.template(), e, i, R, force, moment):
    """Linear and angular acceleration (m/s^2, rad/s^2) of a carrier of attitude R under a force (N) and a moment (N m).

    All vectors are in n; the moment is about the carrier's origin.
    """
    F, M = R.transpose() @ force, R.transpose() @ moment
    a, alpha = F * 0.0, F * 0.0
    for r in ti.static(range(3)):
        for c in ti.static(range(3)):
            w = ti.static(TABLE + MOBILITY)
            a[r] += way[e, i, w + 6 * r + c] * F[c] + way[e, i, w + 6 * r + 3 + c] * M[c]
            alpha[r] += way[e, i, w + 6 * (3 + r) + c] * F[c] + way[e, i, w + 6 * (3 + r) + 3 + c] * M[c]
    return R @ a, R @ alpha


@ti.kernel
def press(load: array3, pressing: array3, base: ti.template()):
    """Add the loads of vehicles on decks (`pressing` [env, vehicle, 7]) to their carriers' `load` [env, carrier, 6].

    `base` is the number of the first carrier's deck.
    """
    ti.loop_config(serialize=runtime.loop.serial)
    for e, j in ti.ndrange(load.shape[0], load.shape[1]):
        for i in range(pressing.shape[1]):
            if int(pressing[e, i, PRESSED]) == 1 + base + j:
                for c in ti.static(range(6)):
                    load[e, j, c] += pressing[e, i, WRENCH + c]


@ti.kernel
def meet(
    state: array3, pressing: array3, way: array3, before: array3, after: array3, table: array3,
    base: ti.template(), reach: ti.template(), T: ti.template()
):  # fmt: skip
    """Find the nearest deck within reach of each vehicle with legs, and write its motion to `way` [env, vehicle,
    WAY_SIZE].

    A deck is within reach if the vehicle can come within `reach` (m) of its rectangle in a control step T (s). A
    vehicle that pressed on a deck in the last step stays with that deck.

    state: states [env, vehicle, 13] of the vehicles with legs. before, after: states [env, carrier, 13] of the carriers
    at both ends of the step. table: [env or 1, carrier or 1, TABLE_SIZE]. base: number of the first carrier's deck.
    """
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        if ti.static(base == 0):
            way[e, i, WHICH], way[e, i, DISTANCE] = 0.0, 0.0
        position = taken(state, e, i, NORTH, 3)
        v = rotation_matrix(taken(state, e, i, QW, 4)) @ taken(state, e, i, SURGE, 3)
        pressed = int(pressing[e, i, PRESSED])
        for j in range(before.shape[1]):
            te, tj = e % table.shape[0], j % table.shape[1]
            R = rotation_matrix(taken(before, e, j, QW, 4))
            r = R.transpose() @ (position - taken(before, e, j, NORTH, 3)) - taken(table, te, tj, CENTRE, 3)
            beside = ti.max(ti.abs(r[0]) - table[te, tj, HALF], 0.0)
            beside = ti.max(beside, ti.abs(r[1]) - table[te, tj, HALF + 1])
            distance = ti.max(beside, ti.abs(r[2]))
            # velocity of the deck's centre, not of the carrier's origin: the carrier's rates count, too
            swing = cross(taken(before, e, j, ROLL_RATE, 3), taken(table, te, tj, CENTRE, 3))
            own = R @ (taken(before, e, j, SURGE, 3) + swing)
            near = distance < reach + T * (v - own).norm()
            mine = pressed == 1 + base + j
            better = way[e, i, WHICH] == 0.0 or distance < way[e, i, DISTANCE]
            if mine or (pressed == 0 and near and better):
                way[e, i, WHICH], way[e, i, DISTANCE] = float(1 + base + j), distance
                write_way(way, e, i, before, after, j)
                for c in range(TABLE_SIZE):
                    way[e, i, TABLE + c] = table[te, tj, c]
                for c in ti.static(range(6)):
                    way[e, i, HAD + c] = ti.select(mine, pressing[e, i, WRENCH + c], 0.0)
                    way[e, i, SHIFT + c], way[e, i, IMPULSE + c] = 0.0, 0.0


@ti.func
def write_way(way: ti.template(), e, i, before: ti.template(), after: ti.template(), j):
    """Write the states of carrier j at both ends of the step to `way`."""
    q, last = taken(before, e, j, QW, 4), taken(after, e, j, QW, 4)
    v = rotation_matrix(q) @ taken(before, e, j, SURGE, 3)
    v_last = rotation_matrix(last) @ taken(after, e, j, SURGE, 3)
    turn, rates = rotation_vector(q, last), taken(after, e, j, ROLL_RATE, 3)
    bent = cross(turn, rates)
    bent_rates = rates + 0.5 * bent + cross(turn, bent) * (1.0 / 12.0)
    for c in ti.static(range(3)):
        way[e, i, PLACE + c] = before[e, j, c]
        way[e, i, VELOCITY + c], way[e, i, LAST_VELOCITY + c] = v[c], v_last[c]
        way[e, i, RATES + c], way[e, i, LAST_RATES + c] = before[e, j, ROLL_RATE + c], bent_rates[c]
        way[e, i, STEP + c], way[e, i, ROTATION + c] = after[e, j, c] - before[e, j, c], turn[c]
    for c in ti.static(range(4)):
        way[e, i, TURN + c] = q[c]


@ti.kernel
def react(
    state: array3, derived: array3, before: array3, table: array3, way: array3, base: ti.template(),
):  # fmt: skip
    """Move the carriers `state` [env, carrier, 13] by the reactions of vehicles with legs that loads did not include.

    `way` [env, vehicle, WAY_SIZE] holds the displacements and impulses; they are added in the order of the vehicles.
    `before` holds the carriers at the beginning of the step.
    """
    ti.loop_config(serialize=runtime.loop.serial)
    for e, j in ti.ndrange(state.shape[0], state.shape[1]):
        zero = state[e, j, 0] * 0.0
        shift = ti.Vector([zero, zero, zero])
        turn, impulse, angular, met = shift, shift, shift, 0
        for i in range(way.shape[1]):
            if int(way[e, i, WHICH]) == 1 + base + j:
                shift += taken(way, e, i, SHIFT, 3)
                turn += taken(way, e, i, SHIFT + 3, 3)
                impulse += taken(way, e, i, IMPULSE, 3)
                angular += taken(way, e, i, IMPULSE + 3, 3)
                met = 1
        te, tj = e % table.shape[0], j % table.shape[1]
        if met == 1 and table[te, tj, MASS] > 0.0:
            R = rotation_matrix(taken(state, e, j, QW, 4))
            P, H = momentum(state, table, e, j, te, tj)
            along = taken(state, e, j, NORTH, 3) - taken(before, e, j, NORTH, 3)
            P_n = R @ P + impulse
            H_n = R @ H + angular - cross(along, impulse) - cross(shift, P_n)
            q = quaternion_product(turned(turn), taken(state, e, j, QW, 4))
            q *= 1.5 - 0.5 * q.dot(q)
            R = rotation_matrix(q)
            P, H = R.transpose() @ P_n - P, R.transpose() @ H_n - H
            for r in ti.static(range(6)):
                for c in ti.static(range(3)):
                    state[e, j, SURGE + r] += table[te, tj, MOBILITY + 6 * r + c] * P[c]
                    state[e, j, SURGE + r] += table[te, tj, MOBILITY + 6 * r + 3 + c] * H[c]
            for c in ti.static(range(3)):
                state[e, j, c] += shift[c]
            for c in ti.static(range(4)):
                state[e, j, QW + c] = q[c]
            store(derived, e, j, R, R @ taken(state, e, j, SURGE, 3))


@ti.func
def momentum(state: ti.template(), table: ti.template(), e, j, te, tj):
    """Linear and angular momentum (kg m/s, kg m^2/s, b) of carrier j about its origin, by its inverse mobility."""
    zero = state[e, j, 0] * 0.0
    P = ti.Vector([zero, zero, zero])
    H = P
    for r in ti.static(range(3)):
        for c in ti.static(range(6)):
            P[r] += table[te, tj, MASS + 6 * r + c] * state[e, j, SURGE + c]
            H[r] += table[te, tj, MASS + 6 * (3 + r) + c] * state[e, j, SURGE + c]
    return P, H
