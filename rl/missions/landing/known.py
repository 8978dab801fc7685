"""What an aircraft knows of its deck: by the marker, by the boat's messages, and by its own instruments between them.

The place of the deck relative to the aircraft, d, and the deck's velocity v are kept by a filter of one gain a step,

    d' = v - v_own,  v' = a,   P grows by q^2 dt^2 each step, where q is how well v is known,

d is corrected by looks (marker.py) with the gain K = P / (P + R), and v by K_v = GAIN_V K^2 / dt times the same error
(an alpha-beta filter). Messages, as old as they are, give v and a: v + a age. They give d, too, while no look has found
the marker for `BLIND`: then by satellite navigation of both, whose errors are in it.
Frame: NED.
"""

from typing import Any

import torch
from torch import Tensor

from rl.missions.landing.marker import Look

BLIND = 1.0  # s after which a look no longer says where the deck is; assumed
WALK = 0.3  # m/s, q; assumed
GAIN_V = 0.05  # share of the alpha-beta filter's velocity gain that a message leaves to looks; assumed
FROM_RADIO = 1.0  # m, standard deviation of d by messages alone; assumed
BY_RADIO = 0.6  # of a message's velocity that counts at once; assumed
OLDEST = 3.0  # s: an older acceleration is not gone on with; assumed
LAGS = (5, 10, 20)  # decisions: how long ago vertical speeds were that are remembered


class KnownDeck:
    """Everything is [env, aircraft, ...].

    Attributes:
        to: [.., 3] from the aircraft to the deck's middle, m. velocity, acceleration: [.., 3] of the deck.
        attitude: [.., 3] roll, pitch, heading of the boat as last heard, gone on with. rates: [.., 3] of it, b.
        heading: cosine and sine of the boat's heading. seen, heard: ages of the last look and message, s.
        past: [.., n] vertical speed of the deck, n decisions back.
    """

    STATE = ("to", "velocity", "acceleration", "attitude", "rates", "seen", "heard", "past", "_variance", "_started")

    def __init__(self, like: Tensor, interval: float):
        """`like` is a tensor [env, aircraft, n]; decisions are every `interval` s."""
        self.interval = interval
        self.to, self.velocity, self.acceleration, self.attitude, self.rates = (like[..., :3] * 0.0 for _ in range(5))
        self.seen, self.heard, self._variance = (like[..., 0] * 0.0 for _ in range(3))
        self.past = like.new_zeros((*like.shape[:2], max(LAGS) + 1))
        self._started = torch.zeros_like(self.seen, dtype=torch.bool)

    def measure(self, which: Tensor, own: Any, look: Look, heard: Tensor) -> None:
        """In environments `which` [env] int32 (0 not at all, 1 after a step, 2 as an episode begins).

        own: the aircraft as it measures itself. heard: [env, aircraft, MESSAGE + 1] its boat's last message (boats.py),
        and its age.
        """
        dt, age = self.interval, heard[..., -1]
        place, velocity, acceleration = heard[..., :3], heard[..., 3:6], heard[..., 6:9]
        lead = age.clamp(max=OLDEST).unsqueeze(-1)
        by_radio = place + lead * velocity + 0.5 * lead.square() * acceleration - own.position_n
        v_radio = velocity + lead * acceleration
        on, fresh = (which == 1).unsqueeze(-1), (which == 2).unsqueeze(-1)
        # predicted
        to = self.to + dt * (self.velocity - own.velocity_n) + 0.5 * dt * dt * self.acceleration
        v = self.velocity + dt * self.acceleration
        variance = self._variance + (WALK * dt) ** 2
        # by radio
        new = age < self.heard + 0.5 * dt
        a = torch.where(new.unsqueeze(-1), acceleration, self.acceleration)
        v = torch.where(new.unsqueeze(-1), v + BY_RADIO * (v_radio - v), v)
        blind = self.seen > BLIND
        share = torch.where(blind & new, variance / (variance + FROM_RADIO**2), 0.0)
        to = to + share.unsqueeze(-1) * (by_radio - to)
        variance = variance * (1 - share)
        # by the marker
        gain = torch.where(look.found, variance / (variance + look.variance + 1e-6), 0.0)
        error = gain.unsqueeze(-1) * (look.place - to)
        to, v = to + error, v + (GAIN_V / dt) * gain.unsqueeze(-1) * error
        variance = variance * (1 - gain)
        seen = torch.where(look.found, 0.0, self.seen + dt)
        # at the beginning: as heard
        attitude = heard[..., 9:12] + lead * self._euler_rates(heard)

        def kept(now: Tensor, begun: Tensor, before: Tensor) -> Tensor:
            wide = (slice(None), slice(None), *(None,) * (now.dim() - 2))
            return torch.where(on[wide], now, torch.where(fresh[wide], begun, before))

        self.to = kept(to, by_radio, self.to)
        self.velocity = kept(v, v_radio, self.velocity)
        self.acceleration = kept(a, acceleration, self.acceleration)
        self.attitude = kept(attitude, attitude, self.attitude)
        self.rates = kept(heard[..., 12:15], heard[..., 12:15], self.rates)
        self._variance = kept(variance, torch.full_like(variance, FROM_RADIO**2), self._variance)
        self.seen = kept(seen, torch.full_like(seen, 2 * BLIND), self.seen)
        self.heard = kept(age, age, self.heard)
        down = self.velocity[..., 2:3]
        past = torch.cat((down, self.past[..., :-1]), dim=-1)
        self.past = kept(past, down.expand_as(self.past), self.past)

    @staticmethod
    def _euler_rates(heard: Tensor) -> Tensor:
        """Rates of roll, pitch and heading for small roll and pitch (rad/s)."""
        roll, pitch = heard[..., 9], heard[..., 10]
        p, q, r = heard[..., 12], heard[..., 13], heard[..., 14]
        return torch.stack((p + r * pitch, q - r * roll, r + q * roll), dim=-1)

    @property
    def heading(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine of the boat's heading."""
        return self.attitude[..., 2].cos(), self.attitude[..., 2].sin()

    @property
    def down(self) -> Tensor:
        """[.., 3] the deck's normal, into it, NED."""
        (c, s), roll, pitch = self.heading, self.attitude[..., 0], self.attitude[..., 1]
        x, y = roll.cos() * pitch.sin(), -roll.sin()
        return torch.stack((c * x - s * y, s * x + c * y, roll.cos() * pitch.cos()), dim=-1)

    @property
    def tilt(self) -> Tensor:
        """Of the deck's normal to the vertical, rad."""
        return torch.hypot(self.attitude[..., 0], self.attitude[..., 1])
