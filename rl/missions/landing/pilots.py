"""Classical pilots of the aircraft: what velocity over ground they want, NED (m/s), by what they know of the deck.

The horizontal part is the same for all pilots: the deck's velocity v_d, plus an approach as fast as the aircraft can
still brake,

    v = v_d + min(k r, sqrt(2 a r), approach) r / |r|.

It is slower while the aircraft leans far into the wind, because its airspeed is then near the maximum.

`descend` takes v_d as averaged over some seconds, as the integral of a PID does: it knows no motion of the deck.

    descend   holds its height above mean sea level while it approaches, hovers `hover` above the deck's mean height
              until it is near the deck's middle, then sinks at a constant speed over ground.
    glide     comes down in a cone as it approaches, matched to the deck's vertical velocity, and touches at `sink`;
              from `flare` above the deck on it lets go of the wind, to touch with all legs at once.
    forecast  waits at `wait` above the deck, matched to it, until the deck is predicted to be quiet for as long as it
              takes to touch; then as glide. Predicted by an autoregressive model (rl/guidance/forecast.py).
"""

import math
from typing import Any

import torch
from torch import Tensor

from rl.guidance.forecast import Autoregression
from rl.missions.landing.config import PilotConfig
from rl.missions.landing.known_deck import BLIND, KnownDeck
from rl.missions.landing.level_frame import out_of_level
from taichi_sim.fleet import Views
from taichi_sim.kernels.conventions import BELOW, DOWN, GRAVITY
from taichi_sim.models.uav.multirotor.controller import ControllerGains
from taichi_sim.state.memory import Remembers

MEAN = 8.0  # s, over which "descend" averages the deck's velocity and height; assumed
SAMPLED = 4  # decisions between two samples of the autoregressive model; assumed
ORDER = 8  # of it; assumed
MARGIN = 0.5  # s beyond the touch for which the deck is to be quiet; assumed
LEANS = 0.5  # s, over which the push of the wind is averaged; assumed
STEEPEST = math.radians(8.0)  # to the deck, at which it may touch; assumed
LIFT = 1.5  # m that it stays higher for each rad more; assumed
WAITED = 1.0  # s near the deck's middle before "descend" goes down; assumed
UPRIGHT = math.sin(math.radians(12.0))  # lean into the wind up to which it approaches at full speed; assumed
EASED, LEAST = math.sin(math.radians(22.0)), 0.2  # lean from which this share of the speed is left; assumed
SINK, STEEP = 0.35, 1.0  # m/s, and 1/s times the height: the fastest that a policy sinks over the deck; assumed
OVER, ABOVE = 0.2, 0.5  # m from the deck's middle where a policy may touch; height that it keeps beside it; assumed
HIGH = 2.5  # m above the deck, where a policy stays that has not seen the marker for BLIND; assumed


class Pilot(Remembers):
    """Flies the aircraft of a team (see the module); every tensor is [env, aircraft, ...].

    Attributes:
        height: mean of the deck's height, down, NED, m. velocity: mean of its velocity. ready: s near its middle.
        lean: the own down axis (NED) that holds against the wind. before: own velocity a decision ago, NED, m/s.
        down: whether it comes down. waiting: s over the deck.
        asked: int64 [env], the decision of the episode at which it was last asked.
        model, ahead: of the deck's vertical speed, and its forecast [.., n] (m/s); `forecast` alone.
    """

    def __init__(
        self, config: PilotConfig, own: Views, deck: KnownDeck, gains: ControllerGains, soles_below: float,
        steps: Tensor, interval: float,
    ):  # fmt: skip
        """Fly aircraft by `own`, as they measure themselves, and what they know of their `deck`, both live.

        `gains`: of the vehicle's controller. `soles_below`: of the soles below the aircraft's origin, m. `steps`: int64
        [env], decisions since the episode began, live; one takes `interval` s.
        """
        self.config, self.interval, like = config, interval, own.state
        self._own, self._deck, self._gains, self._soles_below, self._steps = own, deck, gains, soles_below, steps
        self.height, self.ready, self.waiting = (self.remember(like.new_zeros(like.shape[:2])) for _ in range(3))
        self.velocity, self.lean, self.before = (self.remember(torch.zeros_like(like[..., :3])) for _ in range(3))
        self.down = self.remember(torch.zeros_like(self.height, dtype=torch.bool))
        self.asked = self.remember(torch.full((len(like),), -1, dtype=torch.int64, device=like.device))
        self.model, self.ahead = self.remember(None), self.remember(None)
        if config.kind == "forecast":
            self.model = Autoregression(self.height, ORDER)
            takes = math.log(1 + config.steep * config.wait / config.sink) / config.steep  # s, to come down
            self._ahead = math.ceil((takes + MARGIN) / (SAMPLED * interval))
            self.ahead = like.new_zeros((*self.height.shape, self._ahead))

    def begin(self, envs: Tensor) -> None:
        """Clear the pilot's memory in environments `envs` [n], in which episodes begin."""
        for memory in (self.ready, self.waiting, self.down):
            memory[envs] = 0
        self.height[envs], self.asked[envs] = float("nan"), -1
        if self.model is not None and self.ahead is not None:
            self.model.begin(envs)
            self.ahead[envs] = 0.0

    def __call__(self, team: Any) -> Tensor:
        """Actions [env, aircraft, a] that fly the wanted velocity."""
        return team.flown(team.wanted)

    def wanted(self) -> Tensor:
        """Velocity [env, aircraft, 3] (NED, m/s) that the pilot wants now; its memory advances once a decision."""
        known, c = self._deck, self.config
        since = self.interval * (self._steps != self.asked).to(self.height).unsqueeze(-1)
        self.asked = self._steps.clone()
        self._average(known, self._own, since)
        lag, lead = c.lag, 1 / self._gains.velocity
        gaining, to, away = self._foreseen()
        r = to.norm(dim=-1)
        slow, most = c.position * r, (2 * c.braking * r).sqrt()
        fastest = c.approach * self._ease(-(self.lean[..., :2] * to).sum(-1) / r.clamp(min=1e-3))
        speed = torch.minimum(torch.minimum(slow, most), fastest)
        braked = torch.where(most < slow, c.braking, 0.0) * (speed < fastest)
        toward = ((speed - lead * braked) / r.clamp(min=1e-3)).unsqueeze(-1) * to
        if c.kind == "descend":
            level = self.velocity[..., :2] + toward
        else:
            level = known.velocity[..., :2] + lead * known.acceleration[..., :2] + lag * gaining + toward
            level = self._flared(level, away)
        fall = {"descend": self._descend, "glide": self._glide, "forecast": self._forecast}[c.kind](away, since)
        return torch.cat((level, fall.unsqueeze(-1)), dim=-1)

    @property
    def _height(self) -> Tensor:
        """Estimated height of the soles above the deck's plane, m."""
        return self._deck.above - self._soles_below

    def _foreseen(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the level parts of the deck's acceleration over the aircraft's own and of the way to the deck when a
        command has its effect, both [env, aircraft, 2] (m/s^2, m), and the longer of that way and the way now (m).
        """
        known, lag = self._deck, self.config.lag
        closing = (known.velocity - self._own.velocity_n)[..., :2]
        gaining = known.acceleration[..., :2] - GRAVITY * (self.lean - self._own.R_nb[..., BELOW])[..., :2]
        to = known.to[..., :2] + lag * closing + 0.5 * lag * lag * gaining
        return gaining, to, torch.maximum(to.norm(dim=-1), known.to[..., :2].norm(dim=-1))

    @staticmethod
    def _ease(lean: Tensor) -> Tensor:
        """Return the share of the speed over the deck that is flown while leaning that way by the sine `lean`: a large
        lean means an airspeed near the greatest.
        """
        return ((EASED - lean) / (EASED - UPRIGHT)).clamp(LEAST, 1.0)

    def limited(self, velocity: Tensor, fastest: float) -> Tensor:
        """Return a policy's velocity [env, aircraft, 3] (NED, m/s) within the pilot's limits.

        The lower the aircraft is, the slower it sinks. It stays above the height that its lean to the deck (`_lift`)
        and its way to the middle (OVER) allow, and high until it sees the marker (BLIND). Into the wind it flies over
        the deck at `fastest` (m/s), and slower while it leans far.
        """
        known, height = self._deck, self._height
        beside = self.config.cone * (self._foreseen()[2] - OVER)
        lift = torch.maximum(self._lift(), beside.clamp(0.0, ABOVE))
        lift = torch.where(known.seen > BLIND, lift.clamp(min=HIGH), lift)
        most = SINK + STEEP * height.clamp(min=0.0)
        most = torch.where(lift > 0, torch.minimum(most, self.config.position * (height - lift)), most)
        down = torch.minimum(velocity[..., DOWN], self._deck_falls() + most)
        lean = self.lean[..., :2].norm(dim=-1)
        wind = -self.lean[..., :2] / lean.clamp(min=1e-3).unsqueeze(-1)
        into = ((velocity - known.velocity)[..., :2] * wind).sum(-1)
        over = (into - fastest * self._ease(lean)).clamp(min=0.0)
        return torch.cat((velocity[..., :2] - over.unsqueeze(-1) * wind, down.unsqueeze(-1)), dim=-1)

    def _average(self, known: KnownDeck, own: Views, since: Tensor) -> None:
        """Update the averages of deck height, deck velocity and lean, `since` [env, 1] s after the last update."""
        height = known.to[..., DOWN] + own.position_n[..., DOWN]
        share = since / (MEAN + since)
        fresh = self.height.isnan()
        self.height = torch.where(fresh, height, self.height + share * (height - self.height))
        mean = self.velocity + share.unsqueeze(-1) * (known.velocity - self.velocity)
        self.velocity = torch.where(fresh.unsqueeze(-1), known.velocity, mean)
        gained = (own.velocity_n - self.before) / since.clamp(min=self.interval).unsqueeze(-1)
        against = own.R_nb[..., BELOW] + gained / GRAVITY
        lean = self.lean + (since / (LEANS + since)).unsqueeze(-1) * (against - self.lean)
        self.lean = torch.where(fresh.unsqueeze(-1), own.R_nb[..., BELOW], lean)
        self.before = own.velocity_n.clone()

    def _flared(self, level: Tensor, away: Tensor) -> Tensor:
        """Velocity [.., 2] (m/s): `level`, or close above the deck one that turns the thrust to the deck's normal.

        Until then the thrust leans against the wind. The velocity command exceeds the own velocity by as much as makes
        the velocity loop ask for that change of thrust.
        """
        push = GRAVITY * (self.lean - self._deck.down)[..., :2] / self._gains.velocity
        flares = (self._height < self.config.flare + self._lift()) & (away < 2 * self.config.near)
        return torch.where(flares.unsqueeze(-1), self._own.velocity_n[..., :2] + push, level)

    def _lift(self) -> Tensor:
        """Height (m) above the deck that the aircraft keeps until it is parallel to the deck."""
        upright = (self._own.R_nb[..., BELOW] * self._deck.down).sum(-1)
        return LIFT * (upright.clamp(-1.0, 1.0).acos() - STEEPEST).clamp(min=0.0)

    def _near(self, r: Tensor, since: Tensor) -> Tensor:
        self.ready = torch.where(r < 3 * self.config.near, self.ready + since, 0.0)
        return r < 2 * self.config.near

    def _descend(self, r: Tensor, since: Tensor) -> Tensor:
        """Velocity down (m/s) of the kind `descend`."""
        c = self.config
        self._near(r, since)
        self.down = self.down | (self.ready > WAITED)
        hover = self.height - c.hover - self._soles_below
        climb = c.position * (hover - self._own.position_n[..., DOWN])
        climb = torch.where(r > 5.0, climb.clamp(max=0.0), climb)  # it holds its height as it approaches
        return torch.where(self.down, torch.full_like(r, c.fall), climb.clamp(-2.0, 1.5))

    def _matched(self, least: Tensor) -> Tensor:
        """Velocity down (m/s), matched to the deck's, that leads to the height `least` (m) above the deck."""
        c = self.config
        least = torch.maximum(least, self._lift())
        height = self._height
        sink = c.sink + c.steep * height.clamp(min=0.0)
        sink = torch.where(least > 0, torch.minimum(sink, c.position * (height - least)), sink)
        return self._deck_falls() + sink

    def _deck_falls(self) -> Tensor:
        """Return the deck's velocity down (m/s) at the time when a command has its effect."""
        known, lead = self._deck, 1 / self._gains.climb + 0.5 * self.interval
        return known.velocity[..., DOWN] + lead * known.acceleration[..., DOWN]

    def _cone(self, r: Tensor) -> Tensor:
        """Height (m) above the deck that is kept at a distance r (m) from its middle."""
        c = self.config
        return torch.minimum(c.cone * (r - c.near).clamp(min=0.0), c.floor + c.slope * r)

    def _glide(self, r: Tensor, since: Tensor) -> Tensor:
        return self._matched(self._cone(r))

    def _forecast(self, r: Tensor, since: Tensor) -> Tensor:
        c, known, model = self.config, self._deck, self.model
        assert model is not None and self.ahead is not None
        due = (self._steps % SAMPLED == 0).unsqueeze(-1) & (since > 0)
        model.learn(known.velocity[..., DOWN], due)
        self.ahead = torch.where(due.unsqueeze(-1), model.predict(self._ahead), self.ahead)
        wider = 2.0 ** (self.waiting / c.patience).floor()
        quiet = (self.ahead.abs().amax(-1) < wider * c.quiet_heave) & model.ready
        quiet &= known.tilt < wider * math.radians(c.quiet_tilt_deg)
        near = self._near(r, since)
        waits = (self._height < c.wait + 0.5) & near
        self.waiting = torch.where(waits, self.waiting + since, self.waiting)
        self.down = (self.down & (r < 4 * c.near)) | (waits & quiet)
        cone = self._cone(r)
        least = torch.where(self.down, cone, cone.clamp(min=c.wait))
        return self._matched(least)


def corrected(wanted: Tensor, correction: Tensor, heading: tuple[Tensor, Tensor], level: float, down: float) -> Tensor:
    """Add a `correction` [.., 3] in [-1, 1] to the `wanted` velocity [.., 3] (NED, m/s).

    The correction is in the level frame of `heading`, at most `level` ahead and to starboard and `down` downwards
    (m/s).
    """
    return wanted + out_of_level(correction * correction.new_tensor((level, level, down)), heading)
