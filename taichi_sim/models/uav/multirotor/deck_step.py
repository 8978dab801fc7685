"""A multirotor's physics step on a deck, divided into contact steps of about a millisecond with rotors and air.

A contact step is half a drift, a kick, and half a drift (Strang 1968). It integrates position, velocity, attitude and
angular momentum, all in n, so kicks conserve linear and angular momentum to rounding. A kick uses the forces at its
midpoint: the soles' forces (contact/leg_contact.py) are computed from velocities predicted half a kick ahead. The deck
moves and responds to contact as contact/deck_motion.py describes. Rotor speeds follow their exact solution. The air's
velocity is constant over the physics step.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import taichi as ti

from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rigid_body import cross, is_nothing
from taichi_sim.kernels.rotation import (
    attitude_of,
    position_of,
    quaternion_advance,
    quaternion_of,
    rates_of,
    rotation_matrix,
    velocity_of,
)
from taichi_sim.models.contact import deck_motion
from taichi_sim.models.contact.leg_contact import DOWN, FREE, SOLE_SIZE, UNDER, sole_force
from taichi_sim.models.uav.multirotor import ground, rotors
from taichi_sim.models.uav.multirotor.airframe import inertia_times, inverse_inertia_times, loads
from taichi_sim.models.uav.multirotor.rotors import arm

BODY_SIZE = 24
"""What the deck's answer is at, numbers of a vector: displacement, rotation vector, velocity, rates of the deck beyond
the carrier's way (n; m, rad, m/s, rad/s); impulse and angular impulse beyond the carrier's load (as
deck_motion.IMPULSE); impulse and angular impulse of all about the carrier's origin, in its b (N s, N m s).
"""
STRUCK_BELOW = 2.0  # radii: a rotor up to this far below the deck's plane has struck it; one farther down is under it
EDGE = 2.0  # width over which the ground effect fades at a deck's edge, in radii; assumed
NEARING = 2.0  # a touch is expected from a distance of this many times the motion in a physics step


@ti.func
def part(body, first: ti.template()):
    """Three numbers of `body`, from column `first`."""
    return ti.Vector([body[first], body[first + 1], body[first + 2]])


@ti.func
def deck_now(way: ti.template(), e, i, t, T: ti.template(), body):
    """The deck's carrier at t (s), with its response to contact: position from deck_motion.PLACE, R_nb, velocity and
    rates (n).

    Then the same position and attitude without the response.
    """
    x, R, v, w = deck_motion.carried(way, e, i, t, T)
    R_D = rotation_matrix(deck_motion.turned(part(body, 3))) @ R
    return x + part(body, 0), R_D, v + part(body, 6), w + part(body, 9), x, R


@ti.func
def ahead_of(y, v_n, dt):
    """State y dt (s) later, if it goes on to move over ground with v_n (n, m/s) and to turn with its body rates."""
    new, q = y, quaternion_advance(quaternion_of(y), rates_of(y), dt)
    for c in ti.static(range(3)):
        new[c] += dt * v_n[c]
    for c in ti.static(range(4)):
        new[3 + c] = q[c]
    return new


@ti.func
def sole_arm(craft: ti.template(), p: ti.template(), k: ti.template()):
    """Sole of leg k (m, b), from the centre of gravity."""
    x, y, z = ti.static(craft.legs.points[k])
    return ti.Vector([x - p.cg_0, y - p.cg_1, z - p.cg_2])


@ti.func
def rotors_over(craft: ti.template(), p: ti.template(), way: ti.template(), e, i, y, t, T: ti.template(), body):
    """Height (m) of each hub over the deck's plane, and how far it is inside the edge (m), [rotor] each, at t (s).

    Also returns whether a rotor has touched the deck.
    """
    x_D, R_D, _v, _w, _x, _R = deck_now(way, e, i, t, T, body)
    R = attitude_of(y)
    x = position_of(y) - taken(way, e, i, deck_motion.PLACE, 3)
    centre = taken(way, e, i, deck_motion.TABLE + deck_motion.CENTRE, 3)
    axis = R_D.transpose() @ ti.Vector([R[0, 2], R[1, 2], R[2, 2]])
    droop = ti.static(craft.rotor.radius) * ti.sqrt(ti.max(1.0 - axis[2] * axis[2], 0.0))
    height = ti.Vector([x[0] * 0.0 for _ in ti.static(range(len(craft.rotors)))])
    inside, met = height, 0
    for k in ti.static(range(len(craft.rotors))):
        d = R_D.transpose() @ (x + R @ arm(craft, p, k) - x_D) - centre
        height[k] = -d[2]
        half = ti.static(deck_motion.TABLE + deck_motion.HALF)
        inside[k] = ti.min(way[e, i, half] - ti.abs(d[0]), way[e, i, half + 1] - ti.abs(d[1]))
        low = height[k] - droop
        if low < 0.0 and low > ti.static(-STRUCK_BELOW * craft.rotor.radius):
            if inside[k] > ti.static(-craft.rotor.radius):
                met = 1
    return height, inside, met


@ti.func
def deck_ground(craft: ti.template(), p: ti.template(), height, inside, omega, speed2):
    """Weight [rotor] of the sea beside a deck, and upwash [rotor] of the rotors' images in the deck over their induced
    velocity.

    speed2 is the square of the airspeed across the axes (m^2/s^2).
    """
    weight = height * 0.0
    for k in ti.static(range(len(craft.rotors))):
        over = ground.edge_weight(inside[k], ti.static(EDGE * craft.rotor.radius))
        weight[k] = ti.select(height[k] > 0.0, over, 0.0)
    ratio = ground.thrust_ratios(craft, p, height, weight, omega, speed2)
    return 1.0 - weight, 1.0 - 1.0 / ratio


@ti.func
def touches_soon(craft: ti.template(), p: ti.template(), way: ti.template(), e, i, y, v_n, t, T: ti.template(), body,
                 dt: ti.template()):  # fmt: skip
    """Whether a sole is below the deck's plane, or may be within a physics step dt (s) from t (s)."""
    x_D, R_D, v_D, w_D, _x, _R = deck_now(way, e, i, t, T, body)
    R = attitude_of(y)
    x = position_of(y) - taken(way, e, i, deck_motion.PLACE, 3)
    w = R @ rates_of(y)
    top = way[e, i, deck_motion.TABLE + deck_motion.CENTRE + 2]
    soon = 0
    for k in ti.static(range(len(craft.legs.points))):
        r = R @ sole_arm(craft, p, k)
        away = x + r - x_D
        depth = (R_D.transpose() @ away)[2] - top
        v = v_n + cross(w, r) - v_D - cross(w_D, away)
        if depth + ti.static(NEARING * dt) * (v.norm() + ti.static(dt * GRAVITY)) > 0.0:
            soon = 1
    return soon


@ti.func
def soles_on(craft: ti.template(), p: ti.template(), way: ti.template(), e, i, x, R, v, w, x_D, R_D, v_D, w_D, soles):
    """Loads of all soles, in n: force on the aircraft (N), its moment about the centre of gravity (N m), and the moment
    of the opposite force about the carrier's origin (N m).

    Also returns the soles' memory after it, and the largest speed (m/s) along the normal of soles that come down.
    Positions are from deck_motion.PLACE.
    """
    centre = taken(way, e, i, deck_motion.TABLE + deck_motion.CENTRE, 3)
    friction = way[e, i, deck_motion.TABLE + deck_motion.FRICTION]
    long, wide = way[e, i, deck_motion.TABLE + deck_motion.HALF], way[e, i, deck_motion.TABLE + deck_motion.HALF + 1]
    force, moment, on_deck, new, blow = x * 0.0, x * 0.0, x * 0.0, soles, x[0] * 0.0
    for k in ti.static(range(len(craft.legs.points))):
        r = R @ sole_arm(craft, p, k)
        away = x + r - x_D
        d = R_D.transpose() @ away - centre
        u = R_D.transpose() @ (v + cross(w, r) - v_D - cross(w_D, away))
        a = ti.static(SOLE_SIZE * k)
        mark = soles[a + 2]
        if d[2] <= 0.0:
            mark = FREE
        elif ti.abs(d[0]) > long or ti.abs(d[1]) > wide:
            mark = UNDER
        elif mark > ti.static(0.5 * (UNDER + FREE)):
            here = ti.Vector([d[0], d[1]])
            stood = mark > ti.static(0.5 * (FREE + DOWN))
            down = ti.select(stood, ti.Vector([soles[a], soles[a + 1]]), here)
            blow = ti.max(blow, ti.select(stood, 0.0, u[2]))
            N, f, bent = sole_force(
                d[2], u[2], here - down, ti.Vector([u[0], u[1]]), p.leg_stiffness, p.leg_damping, friction
            )
            F = R_D @ ti.Vector([f[0], f[1], -N])
            force += F
            moment += cross(r, F)
            on_deck -= cross(away, F)
            mark = DOWN
            new[a], new[a + 1] = here[0] - bent[0], here[1] - bent[1]
        new[a + 2] = mark
    return force, moment, on_deck, new, blow


@ti.func
def land(
    craft: ti.template(), p: ti.template(), steps: ti.template(), dt: ti.template(), T: ti.template(),
    way: ti.template(), e, i, y, met, omega, command, tau, ratio, soles, body, begun, blow,
):  # fmt: skip
    """State y with its way in place of its position, rotor speeds omega [rotor] (rad/s), the soles' memory, `body` and
    the blow (m/s, contact/leg_contact.py) after a physics step.

    The step dt (s) begins `begun` s after the control step T (s), and consists of `steps` contact steps. Velocities in
    y are relative to the air, which moves with `met` (n, m/s); positions are over ground. command [rotor] (rad/s) and
    the load tau (6, b) are held; ratio [rotor] is that of the ground effect.
    """
    h = ti.static(dt / steps)
    place = taken(way, e, i, deck_motion.PLACE, 3)
    start, moved, q = position_of(y) - place, met * 0.0, quaternion_of(y)
    x = start
    R = rotation_matrix(q)
    v = R @ velocity_of(y) + met
    H = R @ inertia_times(p, rates_of(y))
    away, left, t = omega - command, omega, begun
    for k in ti.static(range(len(craft.rotors))):
        left[k] = ti.exp(-0.5 * h * ti.select(command[k] >= omega[k], p.per_tau_up, p.per_tau_down))
    F_had = taken(way, e, i, deck_motion.HAD, 3)
    M_had = taken(way, e, i, deck_motion.HAD + 3, 3)
    for n in range(ti.static(2 * steps)):
        # half a drift, with the rates in its middle
        w_b = inverse_inertia_times(p, R.transpose() @ H)
        R_m = rotation_matrix(quaternion_advance(q, w_b, ti.static(0.25 * h)))
        q = quaternion_advance(q, inverse_inertia_times(p, R_m.transpose() @ H), ti.static(0.5 * h))
        R = rotation_matrix(q)
        moved += ti.static(0.5 * h) * v
        x = start + moved
        for c in ti.static(range(6)):
            body[c] += ti.static(0.5 * h) * body[6 + c]
        t += ti.static(0.5 * h)
        away *= left
        if n % 2 == 0:
            w_b = inverse_inertia_times(p, R.transpose() @ H)
            w, speed = R @ w_b, command + away
            force_b, moment_b = loads(craft, p, R.transpose() @ (v - met), w_b, speed, ratio)
            if ti.static(not is_nothing(p.J_r)):
                moment_b += rotors.spin_moment(craft, p, w_b, speed, rotors.acceleration(craft, p, speed, command))
            force = R @ (force_b + ti.Vector([tau[0], tau[1], tau[2]]))
            force[2] += GRAVITY / p.inverse_mass
            moment = R @ (moment_b + ti.Vector([tau[3], tau[4], tau[5]]))
            x_D, R_D, v_D, w_D, x_C, R_C = deck_now(way, e, i, t, T, body)
            F_C, M_C = R_C @ F_had, R_C @ M_had
            F, M, M_D, new, hit = force * 0.0, force * 0.0, force * 0.0, soles, t * 0.0
            dv, dw, dv_D, dw_D = force * 0.0, force * 0.0, force * 0.0, force * 0.0
            for stage in range(2):
                F, M, M_D, new, hit = soles_on(
                    craft, p, way, e, i, x, R, v + dv, w + dw, x_D, R_D, v_D + dv_D, w_D + dw_D, soles
                )
                if stage == 0:
                    a, alpha = deck_motion.answer(way, e, i, R_D, -F - F_C, M_D - M_C)
                    dv, dv_D, dw_D = 0.5 * h * p.inverse_mass * (force + F), 0.5 * h * a, 0.5 * h * alpha
                    turn = R.transpose() @ (moment + M - cross(w, H))
                    dw = 0.5 * h * (R @ inverse_inertia_times(p, turn))
            soles, blow = new, ti.max(blow, hit)
            v += h * p.inverse_mass * (force + F)
            H += h * (moment + M)
            a, alpha = deck_motion.answer(way, e, i, R_D, -F - F_C, M_D - M_C)
            extra = M_D - cross(x_D, F) - cross(x_C, F_C) - M_C
            F_b, M_b = R_D.transpose() @ F, R_D.transpose() @ M_D
            for c in ti.static(range(3)):
                body[6 + c] += h * a[c]
                body[9 + c] += h * alpha[c]
                body[12 + c] -= h * (F[c] + F_C[c])
                body[15 + c] += h * extra[c]
                body[18 + c] -= h * F_b[c]
                body[21 + c] += h * M_b[c]
    w_b, v_r = inverse_inertia_times(p, R.transpose() @ H), R.transpose() @ (v - met)
    after = y
    for c in ti.static(range(3)):
        after[c], after[7 + c], after[10 + c] = moved[c], v_r[c], w_b[c]
    for c in ti.static(range(4)):
        after[3 + c] = q[c]
    return after, command + away, soles, body, blow


@ti.func
def soles_down(soles, legs: ti.template()):
    """Number of soles on a deck."""
    down = 0
    for k in ti.static(range(legs)):
        if soles[SOLE_SIZE * k + 2] > ti.static(0.5 * (FREE + DOWN)):
            down += 1
    return down


@ti.func
def remember(touch: ti.template(), T: ti.template(), e, i, soles, body, met):
    """Store the soles' memory, and what the aircraft does to the deck's carrier in a control step of T (s).

    `body` is the deck's answer (BODY_SIZE). A `met` other than 0 means that a rotor has struck the deck.
    """
    for c in ti.static(range(soles.n)):
        touch.soles[e, i, c] = soles[c]
    if met != 0:
        touch.struck[e, i, 0] = 1.0
    for c in ti.static(range(6)):
        touch.way[e, i, deck_motion.SHIFT + c] = body[c]
        touch.way[e, i, deck_motion.IMPULSE + c] = body[12 + c]
    pressing = 0.0
    for c in ti.static(range(6)):
        mean = ti.static(1.0 / T) * body[18 + c]
        touch.pressing[e, i, deck_motion.WRENCH + c] = mean
        pressing += ti.abs(mean)
    touch.pressing[e, i, deck_motion.PRESSED] = ti.select(pressing > 0.0, touch.way[e, i, deck_motion.WHICH], 0.0)
