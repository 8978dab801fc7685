"""What each aircraft knows of its deck, by the marker, the boat's messages, and its own instruments between them.

The deck's place relative to the aircraft d, its velocity v and its acceleration a are the state of a Kalman filter
(Gelb 1974, ch. 4), the same for north, east and down. A deck swings about its mean velocity u (none down), with white
jerk; the own velocity v_own is noisy:

    d' = v - v_own + OWN_NOISE,    v' = a,    a' = -SWING^2 (v - u) + JERK.

Looks (marker.py) measure d. Messages (boats.py) measure v as it was when they were sent, u + (v - u) cos(SWING age) -
a sin(SWING age) / SWING. They measure d, too, while no look has found the marker for `BLIND`: then by satellite
navigation of both, whose errors are in it. Frame: NED.
"""

import torch
from torch import Tensor

from rl.missions.landing.marker import Look
from rl.perception.due import Due
from taichi_sim.fleet import Views
from taichi_sim.kernels.conventions import HEADING, PITCH, ROLL
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


class KnownDeck(Remembers):
    """Each aircraft's knowledge of its deck, a Kalman filter (see the module); every tensor is [env, aircraft, ...].

    Attributes:
        to: [.., 3] from the aircraft to the deck's middle, m. velocity, acceleration: [.., 3] of the deck.
        attitude: [.., 3] roll, pitch, heading of the boat as last heard, gone on with. rates: [.., 3] of it, b.
        heading: cosine and sine of the boat's heading. seen, heard: ages of the last look and message, s.
        past: [.., n] vertical speed of the deck, n decisions back. mean: [.., 3] mean velocity of the deck, none down.
    """

    def __init__(self, like: Tensor, interval: float):
        """Make filters for the aircraft of `like` [env, aircraft, n], updated every `interval` s."""
        self.interval = interval
        self.to, self.velocity, self.acceleration, self.attitude, self.rates = (
            self.remember(like[..., :3] * 0.0) for _ in range(5)
        )
        self.seen, self.heard = (self.remember(like.new_zeros(like.shape[:2])) for _ in range(2))
        self.past = self.remember(like.new_zeros((*like.shape[:2], max(LAGS) + 1)))
        dt, w = interval, SWING**2
        # of the deck; own, a decision ago; m/s
        self.mean, self._own = (self.remember(like[..., :3] * 0.0) for _ in range(2))
        self._level = like.new_tensor((1.0, 1.0, 0.0))
        step = ((1.0, dt - w * dt**3 / 6, dt * dt / 2), (0.0, 1.0 - w * dt * dt / 2, dt), (0.0, -w * dt, 1.0))
        self._step = like.new_tensor(step).expand(*like.shape[:2], 3, 3)  # one each: else rounding depends on how many
        jerk = JERK * like.new_tensor((dt**3 / 6, dt * dt / 2, dt))
        noise = torch.outer(jerk, jerk)
        noise[0, 0] += (OWN_NOISE * dt) ** 2
        self._noise = noise
        self._begun = like.new_tensor((FROM_RADIO, V_TOLD, BEGUN)).square().diag()
        self._covariance = self.remember(self._begun.expand(*like.shape[:2], 3, 3).clone())  # of d, v and a

    def measure(self, due: Due, own: Views, look: Look, heard: Tensor) -> None:
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
