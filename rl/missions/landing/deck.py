"""Decks: how the middle of each boat's deck moves, what an aircraft sees of the marker there, and what it knows of it.

A camera is kept level by its gimbal. The marker is found where it lies in the field of view and in range, from above at
no more than `steepest_deg` from the deck's normal, and not lost to a share `loss` + `spray` Hs of all looks. Then its
direction has an error of a pixel each way, and its distance, by the size s of its picture,

    sigma_r = r^2 sigma_pixel / s,

r being the distance (the error of a length of r sigma_pixel, seen at the scale s / r; first order). What is seen in the
camera's frame becomes a place by the aircraft's measured attitude, whose error is in it. Random numbers are counted
(kernels/random.py): same seed, same bits.

An aircraft knows its deck by the marker, by the boat's messages, and by its own instruments between them. The deck's
place relative to the aircraft d, its velocity v and its acceleration a are the state of a Kalman filter (Gelb 1974, ch.
4), the same for north, east and down. A deck swings about its mean velocity u (none down), with white jerk; the own
velocity v_own is noisy:

    d' = v - v_own + OWN_NOISE,    v' = a,    a' = -SWING^2 (v - u) + JERK.

Looks measure d. Messages measure v as it was when they were sent, u + (v - u) cos(SWING age) - a sin(SWING age) /
SWING. They measure d, too, while no look has found the marker for `BLIND`: then by satellite navigation of both, whose
errors are in it. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Any, NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.missions.landing.config import MarkerConfig
from rl.perception.due import NOT_DUE, Due
from taichi_sim.conventions import BELOW, HEADING, PITCH, ROLL
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import CAMERA, normal6, uniform4
from taichi_sim.kernels.runtime import array3, whole1

DRAWN = 7  # numbers of a look: whether it is lost (uniform), six normal ones
DRAW = 30.0  # ns of one aircraft, about
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


class DeckMotion(NamedTuple):
    """Motion of the middle of each deck."""

    place: Tensor  # [env, boat, 3] NED, m
    velocity: Tensor  # [env, boat, 3] NED, m/s
    R: Tensor  # [env, boat, 3, 3] R_nb
    tilt: Tensor  # [env, boat] rad, of its normal to the vertical
    heading: tuple[Tensor, Tensor]  # cosine and sine [env, boat]

    @property
    def down(self) -> Tensor:
        """Normal of each deck, into it, [env, boat, 3] (NED)."""
        return self.R[..., BELOW]

    def of(self, boats: Tensor) -> "DeckMotion":
        """Return the motion of the decks of `boats` [n], in that order."""
        place, velocity, R, tilt = (x[:, boats] for x in self[:4])
        return DeckMotion(place, velocity, R, tilt, (self.heading[0][:, boats], self.heading[1][:, boats]))


def deck_motion(boats: Views, centre: Tensor) -> DeckMotion:
    """Return the motion of the decks of `boats`; `centre` [3] (m, b) is the middle of a deck."""
    R = boats.R_nb
    arm = torch.linalg.cross(boats.angular_velocity_b, centre.expand_as(boats.angular_velocity_b), dim=-1)
    place = boats.position_n + R @ centre
    velocity = boats.velocity_n + (R @ arm.unsqueeze(-1)).squeeze(-1)
    return DeckMotion(place, velocity, R, R[..., 2, 2].clamp(-1.0, 1.0).acos(), boats.heading)


def into_level(vector: Tensor, heading: tuple[Tensor, Tensor]) -> Tensor:
    """Rotate vectors [.., 3] from NED into the level frame (ahead, starboard, down) of a `heading` (cosine, sine)."""
    c, s = heading
    x, y, z = vector.unbind(-1)
    return torch.stack((c * x + s * y, c * y - s * x, z), dim=-1)


def out_of_level(vector: Tensor, heading: tuple[Tensor, Tensor]) -> Tensor:
    """Rotate vectors [.., 3] from the level frame of a `heading` into NED; the inverse of `into_level`."""
    c, s = heading
    x, y, z = vector.unbind(-1)
    return torch.stack((c * x - s * y, s * x + c * y, z), dim=-1)


@ti.kernel
def _draw(out: array3, which: whole1, draws: whole1, vehicles: ti.template(), serial: ti.template()):
    ti.loop_config(serialize=serial)
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        if which[e] != NOT_DUE:
            u = uniform4(draws[1], CAMERA, draws[2 + e], vehicles + i, draws[0])
            z = normal6(draws[1], CAMERA + 1, draws[2 + e], vehicles + i, draws[0])
            out[e, i, 0] = u[0]
            for k in ti.static(range(6)):
                out[e, i, 1 + k] = z[k]


class Look(NamedTuple):
    """What the cameras see of their markers in one step, each [env, aircraft, ...]."""

    found: Tensor  # bool
    place: Tensor  # [.., 3] of the marker from the aircraft, NED as the aircraft has it, m
    variance: Tensor  # of each component, m^2


class Marker:
    """The cameras of one team."""

    def __init__(self, config: MarkerConfig, own: Views, tilt_noise: float, vehicles: int):
        """Make the cameras of aircraft whose measured state is `own`.

        `tilt_noise` (rad) is the standard deviation of measured roll and pitch. `vehicles` numbers the first aircraft
        among the random numbers.
        """
        self.config, self._own, self._vehicles, self._tilt = config, own, vehicles, tilt_noise
        self._drawn = own.state.new_zeros((*own.state.shape[:2], DRAWN))
        self._launch = runtime.Launcher(_draw)

    def look(self, true: Views, to: Tensor, down: Tensor, hs: Tensor, due: Due) -> Look:
        """Look from aircraft with the `true` state at markers `to` [env, aircraft, 3] (m, NED) away.

        down: [env, aircraft, 3] normals of the decks, into them. hs: [env] significant wave height, m.
        """
        c = self.config
        self._launch(self._drawn, due.which, due.draws, self._vehicles, runtime.few(due.count * to.shape[1], DRAW))
        chance, across_error, along_error, _ = self._drawn.split((1, 3, 1, 2), dim=-1)
        r = to.norm(dim=-1).clamp(min=1e-3)
        line = to / r.unsqueeze(-1)
        (cos, sin), axis, (north, east, below) = true.heading, math.radians(c.axis_deg), line.unbind(-1)
        bore = below * math.cos(axis) + math.sin(axis) * (cos * north + sin * east)
        square = (line * down).sum(-1) >= math.cos(math.radians(c.steepest_deg))
        lost = chance.squeeze(-1) < (c.loss + c.spray * hs).clamp(max=1.0).unsqueeze(-1)
        found = (bore >= c.cos_half) & square & (r <= c.range) & (r >= c.nearest) & ~lost
        pixel = math.radians(c.pixel_deg)
        across, along = r * pixel, r * r * (pixel / c.size)
        error = across.unsqueeze(-1) * across_error + along.unsqueeze(-1) * along_error * line
        in_b = (true.R_nb.mT @ (to + error).unsqueeze(-1)).squeeze(-1)
        place = (self._own.R_nb @ in_b.unsqueeze(-1)).squeeze(-1)
        variance = across.square() + (r * self._tilt).square() + 0.33 * along.square()
        return Look(found, place, variance)


class KnownDeck:
    """Each aircraft's knowledge of its deck, a Kalman filter (see the module); every tensor is [env, aircraft, ...].

    Attributes:
        to: [.., 3] from the aircraft to the deck's middle, m. velocity, acceleration: [.., 3] of the deck.
        attitude: [.., 3] roll, pitch, heading of the boat as last heard, gone on with. rates: [.., 3] of it, b.
        heading: cosine and sine of the boat's heading. seen, heard: ages of the last look and message, s.
        past: [.., n] vertical speed of the deck, n decisions back. mean: [.., 3] mean velocity of the deck, none down.
    """

    STATE = (
        "to", "velocity", "acceleration", "attitude", "rates", "seen", "heard", "past", "mean", "_own", "_covariance",
    )  # fmt: skip

    def __init__(self, like: Tensor, interval: float):
        """Make filters for the aircraft of `like` [env, aircraft, n], updated every `interval` s."""
        self.interval = interval
        self.to, self.velocity, self.acceleration, self.attitude, self.rates = (like[..., :3] * 0.0 for _ in range(5))
        self.seen, self.heard = (like.new_zeros(like.shape[:2]) for _ in range(2))
        self.past = like.new_zeros((*like.shape[:2], max(LAGS) + 1))
        dt, w = interval, SWING**2
        self.mean, self._own = like[..., :3] * 0.0, like[..., :3] * 0.0  # of the deck; own, a decision ago; m/s
        self._level = like.new_tensor((1.0, 1.0, 0.0))
        step = ((1.0, dt - w * dt**3 / 6, dt * dt / 2), (0.0, 1.0 - w * dt * dt / 2, dt), (0.0, -w * dt, 1.0))
        self._step = like.new_tensor(step).expand(*like.shape[:2], 3, 3)  # one each: else rounding depends on how many
        jerk = JERK * like.new_tensor((dt**3 / 6, dt * dt / 2, dt))
        self._noise = torch.outer(jerk, jerk)
        self._noise[0, 0] += (OWN_NOISE * dt) ** 2
        self._begun = like.new_tensor((FROM_RADIO, V_TOLD, BEGUN)).square().diag()
        self._covariance = self._begun.expand(*like.shape[:2], 3, 3).clone()  # of d, v and a

    def measure(self, due: Due, own: Any, look: Look, heard: Tensor) -> None:
        """Update the filter in the environments that are `due`.

        own: the aircraft as it measures itself. heard: [env, aircraft, MESSAGE + 1] its boat's last message (boats.py),
        and its age.
        """
        dt = self.interval
        place, velocity, acceleration, angles, rates, age = heard.split(3, dim=-1)
        age = age.squeeze(-1)
        lead = age.clamp(max=OLDEST).unsqueeze(-1)
        by_radio = place + lead * velocity + 0.5 * lead.square() * acceleration - own.position_n
        v_radio = velocity + lead * acceleration
        on, fresh = due.goes_on.unsqueeze(-1), due.begins.unsqueeze(-1)
        # predicted
        mean = self.mean
        x = self._step @ torch.stack((self.to, self.velocity - mean, self.acceleration), dim=-2)
        x[..., 0, :] += dt * (mean - 0.5 * (self._own + own.velocity_n))
        P = self._step @ self._covariance @ self._step.mT + self._noise
        # by radio
        new, blind = age < self.heard + 0.5 * dt, self.seen > BLIND
        zero, one = torch.zeros_like(age), torch.ones_like(age)
        told = V_TOLD**2 + (0.5 * JERK * age.square()).square()
        row = torch.stack((zero, (SWING * age).cos(), -(SWING * age).sin() / SWING), -1)
        x, P = _corrected(x, P, row, velocity - mean, told, new)
        there = torch.stack((one, zero, zero), -1)
        x, P = _corrected(x, P, there, by_radio, FROM_RADIO**2 * one, new & blind)
        # by the marker
        x, P = _corrected(x, P, there, look.place, look.variance + 1e-6, look.found)
        to, v, a = x.unbind(-2)
        v = v + mean
        mean = mean + dt / (MEAN + dt) * self._level * (v - mean)
        seen = torch.where(look.found, 0.0, self.seen + dt)
        # at the beginning: as heard
        attitude = angles + lead * self._euler_rates(angles, rates)

        def kept(now: Tensor, begun: Tensor, before: Tensor) -> Tensor:
            wide = (slice(None), slice(None), *(None,) * (now.dim() - 2))
            return torch.where(on[wide], now, torch.where(fresh[wide], begun, before))

        self.to = kept(to, by_radio, self.to)
        self.velocity = kept(v, v_radio, self.velocity)
        self.acceleration = kept(a, acceleration, self.acceleration)
        self.attitude = kept(attitude, attitude, self.attitude)
        self.rates = kept(rates, rates, self.rates)
        self.mean = kept(mean, self._level * v_radio, self.mean)
        self._own = kept(own.velocity_n, own.velocity_n, self._own)
        self._covariance = kept(P, self._begun.expand_as(P), self._covariance)
        self.seen = kept(seen, torch.full_like(seen, 2 * BLIND), self.seen)
        self.heard = kept(age, age, self.heard)
        down = self.velocity[..., 2:3]
        past = torch.cat((down, self.past[..., :-1]), dim=-1)
        self.past = kept(past, down.expand_as(self.past), self.past)

    @staticmethod
    def _euler_rates(angles: Tensor, rates: Tensor) -> Tensor:
        """Rates of roll, pitch and heading for small roll and pitch (rad/s)."""
        (roll, pitch, _), (p, q, r) = angles.unbind(-1), rates.unbind(-1)
        return torch.stack((p + r * pitch, q - r * roll, r + q * roll), dim=-1)

    @property
    def heading(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine of the boat's heading."""
        return self.attitude[..., HEADING].cos(), self.attitude[..., HEADING].sin()

    @property
    def down(self) -> Tensor:
        """Normal of the known deck, into it, [env, aircraft, 3] (NED)."""
        (c, s), (roll, pitch, _) = self.heading, self.attitude.unbind(-1)
        x, y = roll.cos() * pitch.sin(), -roll.sin()
        return torch.stack((c * x - s * y, s * x + c * y, roll.cos() * pitch.cos()), dim=-1)

    @property
    def tilt(self) -> Tensor:
        """Angle between the deck's normal and the vertical, rad."""
        return torch.hypot(self.attitude[..., ROLL], self.attitude[..., PITCH])


def _corrected(x: Tensor, P: Tensor, row: Tensor, z: Tensor, variance: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
    """Correct states and covariance by a measurement z [.., 3] = row . x of a given `variance`.

    x [.., 3, 3] holds d, v - u and a of each direction; P [.., 3, 3] is their covariance. Nothing changes
    except `where` (bool) there is a measurement.
    """
    across = (P @ row.unsqueeze(-1)).squeeze(-1)
    gain = across / ((across * row).sum(-1) + variance).unsqueeze(-1)
    gain = torch.where(where.unsqueeze(-1), gain, 0.0)
    x = x + gain.unsqueeze(-1) * (z - (row.unsqueeze(-1) * x).sum(-2)).unsqueeze(-2)
    return x, P - gain.unsqueeze(-1) * across.unsqueeze(-2)
