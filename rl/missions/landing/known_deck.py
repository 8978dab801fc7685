"""What each aircraft knows of its deck, by the marker, the boat's messages, and its own instruments between them.

The deck's place relative to the aircraft d, its velocity v and its acceleration a are the state of a Kalman filter
(Gelb 1974, ch. 4), the same for north, east and down. A deck swings about its mean velocity u (none down), with white
jerk; the own velocity v_own is noisy:

    d' = v - v_own + OWN_NOISE,    v' = a,    a' = -SWING^2 (v - u) + JERK.

Looks (marker.py) measure d. Messages (boats.py) measure v as it was when they were sent, u + (v - u) cos(SWING age) -
a sin(SWING age) / SWING. They measure d, too, while no look has found the marker for `BLIND`: then by satellite
navigation of both, whose errors are in it. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false, reportIndexIssue=false


import taichi as ti
import torch
from torch import Tensor

from rl.missions.landing.boats import Message
from rl.missions.landing.decks import DeckMotion
from rl.missions.landing.marker import Look
from rl.step import BEGINS, NOT_DUE, Due
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import put, taken
from taichi_sim.kernels.conventions import PITCH, ROLL
from taichi_sim.kernels.rotation import VELOCITY_N, torch_euler_from_rotation
from taichi_sim.kernels.runtime import array3, array4, whole1
from taichi_sim.state.memory import Remembers

BLIND = 1.0  # s after which a look no longer says where the deck is; assumed
JERK = 4.0  # m/s^3, of a decision; assumed
OWN_NOISE = 0.05  # m/s, of a decision; assumed
FROM_RADIO = 1.0  # m, standard deviation of d by messages alone; assumed
V_TOLD = 0.04  # m/s, of a message's velocity; assumed
BEGUN = 0.5  # m/s^2, of the acceleration as an episode begins; assumed
SWING = 1.4  # rad/s, of a small boat on waves; assumed
MEAN = 5.0  # s, over which the mean velocity is averaged; assumed
OLDEST = 3.0  # s: an older acceleration is not gone on with; assumed
LAGS = (5, 10, 20)  # decisions: how long ago vertical speeds were that are remembered
OLDEST_LAG = max(LAGS)

# Columns: d, v, a (3 each); roll, pitch, heading of the boat and its rates (3 each); mean velocity (3); own velocity a
# decision ago (3); the covariance of d, v, a (dd, dv, da, vv, va, aa); the deck's axis down (3), cosine and sine of the
# heading; height above the deck's plane; ages of the last look and message; vertical speeds, the latest first.
(TO, VELOCITY, ACCELERATION, ATTITUDE, RATES, AVERAGE, OWN, COVARIANCE, DOWN_AXIS, COS, SIN, ABOVE, SEEN, HEARD,
 PAST) = (
    0, 3, 6, 9, 12, 15, 18, 21, 27, 30, 31, 32, 33, 34, 35
)  # fmt: skip


@ti.func
def corrected(x: ti.template(), P: ti.template(), row, z, variance):
    """Correct x [3, 3], which holds d, v - u and a by rows, and its covariance P by a measurement z = row . x."""
    across = P @ row
    gain = across / (across.dot(row) + variance)
    x += gain.outer_product(z - x.transpose() @ row)
    P -= gain.outer_product(across)


@ti.func
def begun(known: ti.template(), e, i, by_radio, velocity, acceleration, own):
    """Know the deck as it was heard of."""
    put(known, e, i, TO, [by_radio[0], by_radio[1], by_radio[2], velocity[0], velocity[1], velocity[2]])
    put(known, e, i, ACCELERATION, [acceleration[0], acceleration[1], acceleration[2]])
    put(known, e, i, AVERAGE, [velocity[0], velocity[1], 0.0, own[0], own[1], own[2]])
    put(known, e, i, COVARIANCE, [FROM_RADIO**2, 0.0, 0.0, V_TOLD**2, 0.0, BEGUN**2])
    known[e, i, SEEN] = 2 * BLIND
    for k in range(OLDEST_LAG + 1):
        known[e, i, PAST + k] = velocity[2]


@ti.func
def gone_on(known: ti.template(), look: ti.template(), e, i, by_radio, told, age, own, interval: ti.template()):
    """Predict, and correct by what was heard and seen."""
    dt, w = ti.static(interval, SWING**2)
    F = ti.Matrix([[1.0, dt - w * dt**3 / 6, dt * dt / 2], [0.0, 1.0 - w * dt * dt / 2, dt], [0.0, -w * dt, 1.0]])
    jerk = ti.Vector([JERK * dt**3 / 6, JERK * dt * dt / 2, JERK * dt])
    before, mean, c = taken(known, e, i, 0, 9), taken(known, e, i, AVERAGE, 3), taken(known, e, i, COVARIANCE, 6)
    x = ti.Matrix(
        [
            [before[0], before[1], before[2]],
            [before[3] - mean[0], before[4] - mean[1], before[5] - mean[2]],
            [before[6], before[7], before[8]],
        ]
    )
    P = ti.Matrix([[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]])
    x = F @ x
    for k in ti.static(range(3)):
        x[0, k] += dt * (mean[k] - 0.5 * (known[e, i, OWN + k] + own[k]))
    P = F @ P @ F.transpose() + jerk.outer_product(jerk)
    P[0, 0] += (OWN_NOISE * dt) ** 2
    there = ti.Vector([1.0, 0.0, 0.0])
    if age < known[e, i, HEARD] + 0.5 * dt:
        row = ti.Vector([0.0, ti.cos(SWING * age), -ti.sin(SWING * age) / SWING])
        corrected(x, P, row, told - mean, V_TOLD**2 + (0.5 * JERK * age * age) ** 2)
        if known[e, i, SEEN] > BLIND:
            corrected(x, P, there, by_radio, FROM_RADIO**2)
    seen = taken(look, e, i, 0, Look.SIZE)
    known[e, i, SEEN] += dt
    if seen[Look.VARIANCE] > 0.0:
        corrected(x, P, there, ti.Vector([seen[0], seen[1], seen[2]]), seen[Look.VARIANCE])
        known[e, i, SEEN] = 0.0
    v = ti.Vector([x[1, k] + mean[k] for k in ti.static(range(3))])
    put(known, e, i, TO, [x[0, 0], x[0, 1], x[0, 2], v[0], v[1], v[2]])
    put(known, e, i, ACCELERATION, [x[2, 0], x[2, 1], x[2, 2]])
    for k in ti.static(range(2)):
        known[e, i, AVERAGE + k] = mean[k] + ti.static(dt / (MEAN + dt)) * (v[k] - mean[k])
    put(known, e, i, OWN, [own[0], own[1], own[2]])
    put(known, e, i, COVARIANCE, [P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2]])
    for back in range(OLDEST_LAG):
        k = PAST + OLDEST_LAG - back
        known[e, i, k] = known[e, i, k - 1]
    known[e, i, PAST] = v[2]


@ti.kernel
def _know(
    known: array3, look: array3, heard: array4, state: array3, derived: array3, which: whole1, boats: ti.template(),
    interval: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(known.shape[0], known.shape[1]):
        if which[e] != NOT_DUE:
            said = ti.Vector([heard[e, boats + i, i % boats, k] for k in ti.static(range(Message.SIZE + 1))])
            age = said[Message.SIZE]
            lead = ti.min(age, OLDEST)
            place, velocity, acceleration, angles, rates = ti.static(
                Message.PLACE, Message.VELOCITY, Message.ACCELERATION, Message.ATTITUDE, Message.RATES
            )
            own = taken(derived, e, i, ti.static(VELOCITY_N.start), 3)
            told = ti.Vector([said[velocity + k] for k in ti.static(range(3))])
            gains = ti.Vector([said[acceleration + k] for k in ti.static(range(3))])
            by_radio = ti.Vector([said[place + k] - state[e, i, k] for k in ti.static(range(3))])
            by_radio += lead * told + 0.5 * lead * lead * gains
            if which[e] == BEGINS:
                begun(known, e, i, by_radio, told + lead * gains, gains, own)
            else:
                gone_on(known, look, e, i, by_radio, told, age, own, interval)
            known[e, i, HEARD] = age
            # roll, pitch and heading, gone on with by their rates, for small roll and pitch
            p, q, r = said[rates], said[rates + 1], said[rates + 2]
            roll = said[angles] + lead * (p + r * said[angles + 1])
            pitch = said[angles + 1] + lead * (q - r * said[angles])
            heading = said[angles + 2] + lead * (r + q * said[angles])
            put(known, e, i, ATTITUDE, [roll, pitch, heading, p, q, r])
            c, s, ahead, aside = ti.cos(heading), ti.sin(heading), ti.cos(roll) * ti.sin(pitch), -ti.sin(roll)
            down = ti.cos(roll) * ti.cos(pitch)
            north, east = c * ahead - s * aside, s * ahead + c * aside
            above = known[e, i, TO] * north + known[e, i, TO + 1] * east + known[e, i, TO + 2] * down
            put(known, e, i, DOWN_AXIS, [north, east, down, c, s, above])


class KnownDeck(Remembers):
    """Each aircraft's knowledge of its deck, a Kalman filter (see the module); every tensor is [env, aircraft, ...].

    Attributes:
        table: [.., n] all of it, by columns; the others are views of it, which the next `measure` overwrites.
    """

    def __init__(self, like: Tensor, interval: float, boats: int):
        """Make filters for the aircraft of `like` [env, aircraft, n], updated every `interval` s.

        Aircraft i has the deck of boat i, modulo `boats`, and hears it as member `boats` + i of the radio.
        """
        self._interval, self._boats = interval, boats
        self.table = self.remember(like.new_zeros((*like.shape[:2], PAST + OLDEST_LAG + 1)))
        self._launch = runtime.Launcher(_know, few=runtime.MEDIUM)

    def measure(self, due: Due, own: Views, look: Tensor, heard: Tensor) -> None:
        """Update the filter in the environments that are `due`.

        own: the aircraft as it measures itself. look: [env, aircraft, Look.SIZE] (marker.py). heard: the messages of
        all, Radio.heard (boats.py).
        """
        self._launch(
            self.table, look, heard, own.state, own.derived, due.which, self._boats, self._interval, envs=due.count
        )

    def suppose(self, deck: DeckMotion, to: Tensor, acceleration: Tensor, rates: Tensor) -> None:
        """Know the `deck` exactly, `to` it, its acceleration, and the boat's rates (b), as if seen just now."""
        c, s = deck.heading
        for column, value in (
            (TO, to), (VELOCITY, deck.velocity), (ACCELERATION, acceleration), (RATES, rates), (DOWN_AXIS, deck.down),
            (ATTITUDE, torch_euler_from_rotation(deck.R)), (COS, torch.stack((c, s), dim=-1)),
            (ABOVE, (to * deck.down).sum(-1, keepdim=True)),
        ):  # fmt: skip
            self.table[..., column : column + value.shape[-1]] = value
        self.table[..., SEEN : HEARD + 1] = 0.0

    @property
    def to(self) -> Tensor:
        """From the aircraft to the deck's middle [.., 3], NED, m."""
        return self.table[..., TO : TO + 3]

    @property
    def velocity(self) -> Tensor:
        """Velocity of the deck's middle [.., 3], NED, m/s."""
        return self.table[..., VELOCITY : VELOCITY + 3]

    @property
    def acceleration(self) -> Tensor:
        """Acceleration of the deck's middle [.., 3], NED, m/s^2."""
        return self.table[..., ACCELERATION : ACCELERATION + 3]

    @property
    def mean(self) -> Tensor:
        """Mean velocity of the deck [.., 3], none down, NED, m/s."""
        return self.table[..., AVERAGE : AVERAGE + 3]

    @property
    def attitude(self) -> Tensor:
        """Roll, pitch and heading of the boat [.., 3] as last heard, gone on with, rad."""
        return self.table[..., ATTITUDE : ATTITUDE + 3]

    @property
    def rates(self) -> Tensor:
        """Rates of the boat [.., 3] as last heard, b, rad/s."""
        return self.table[..., RATES : RATES + 3]

    @property
    def heading(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine of the boat's heading."""
        return self.table[..., COS], self.table[..., SIN]

    @property
    def down(self) -> Tensor:
        """Normal of the known deck, into it, [.., 3], NED."""
        return self.table[..., DOWN_AXIS : DOWN_AXIS + 3]

    @property
    def above(self) -> Tensor:
        """Height of the aircraft above the plane of the known deck, m."""
        return self.table[..., ABOVE]

    @property
    def tilt(self) -> Tensor:
        """Angle between the deck's normal and the vertical, rad."""
        return torch.hypot(self.table[..., ATTITUDE + ROLL], self.table[..., ATTITUDE + PITCH])

    @property
    def seen(self) -> Tensor:
        """Age of the last look that found the marker, s."""
        return self.table[..., SEEN]

    @property
    def heard(self) -> Tensor:
        """Age of the last message, s."""
        return self.table[..., HEARD]

    @property
    def past(self) -> Tensor:
        """Vertical speed of the deck [.., n], n decisions back, m/s."""
        return self.table[..., PAST:]
