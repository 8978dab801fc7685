"""What aircraft foresee of their decks, and their estimate of the wind, for the model of planning_model.py.

How a deck goes on moving is foreseen from its past by autoregressive models (rl/guidance/forecast.py) of its velocity
over its mean velocity, of roll and of pitch. What they foresee is joined to what is known now (known_deck.py) by an
error that dies away, critically damped:

    x(t) = AR(t) + (e + (e' + e / tau) t) exp(-t / tau),    e, e' at t = 0: x and x' as known, less those of AR.

Until a model is ready, AR is zero. The wind is that in which the aircraft would have to lean as it does to hold its
velocity, averaged.
"""

import torch
from torch import Tensor

from rl.guidance.forecast import Autoregression
from rl.missions.landing.aircraft import Aircraft
from taichi_sim.kernels.conventions import BELOW, HEADING
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.uav.aircraft import TrimError
from taichi_sim.models.uav.multirotor.trim import trim

FORESEEN = 8.0  # s ahead for which a deck's motion is foreseen; beyond, it keeps its velocity; assumed
SAMPLED = 4  # decisions between two samples of the autoregressive models; assumed
ORDER = 8  # of them; assumed
BLOWN = 2.0  # s, over which the wind is averaged; assumed
JOINED, ALONE = 0.5, 1.2  # s, tau with a model that is ready, and without; assumed
SPEEDS = 24  # airspeeds of the table of leans


class Foresight:
    """Predictions that aircraft make of their decks, and their estimate of the wind.

    Attributes:
        wind: [env, aircraft, 3] velocity of the air (NED, m/s). interval: of decisions, s. steps: decisions foreseen.
    """

    wind: Tensor

    def __init__(self, centre: Tensor, interval: float):
        """Predict decks whose middle is at `centre` [3] (m, b), for decisions every `interval` s."""
        self._centre, self.interval, self.steps = centre, interval, round(FORESEEN / interval) + 1
        self._memory: Autoregression | None = None
        self._table: tuple[Tensor, float] | None = None

    def notice(self, team: Aircraft) -> None:
        """Learn how decks move, as `team` knows them; once a decision."""
        x, steps = _moves(team), team.steps
        now = self._wind_of(team)
        if self._memory is None:
            self._memory, self.wind = Autoregression(x, ORDER), now
        begins = steps == 0
        self._memory.begin(begins.nonzero().flatten())
        self._memory.learn(x, (steps % SAMPLED == 0).view(-1, 1, 1))
        dt = self.interval
        share = torch.where(begins.view(-1, 1, 1), 1.0, dt / (BLOWN + dt))
        share = torch.where(team.touches.unsqueeze(-1), 0.0, share)
        self.wind = self.wind + share * (now - self.wind)

    def _wind_of(self, team: Aircraft) -> Tensor:
        """Estimate the wind [env, aircraft, 3] (NED, m/s) by the airspeed at which an aircraft leans that far."""
        pilot, own = team.pilot, team.own
        lean = torch.where(pilot.height.isnan().unsqueeze(-1), own.R_nb[..., BELOW], pilot.lean)[..., :2]
        size = lean.norm(dim=-1)
        leans, step = self._leans(team)
        size = size.clamp(max=float(leans[-1])).contiguous()
        at = torch.searchsorted(leans, size, right=True).clamp(1, len(leans) - 1)
        low, high = leans[at - 1], leans[at]
        airspeed = step * ((at - 1).to(size) + (size - low) / (high - low))
        through = -airspeed.unsqueeze(-1) * lean / size.clamp(min=1e-6).unsqueeze(-1)
        return torch.nn.functional.pad(own.velocity_n[..., :2] - through, (0, 1))

    def _leans(self, team: Aircraft) -> tuple[Tensor, float]:
        """Sines of the leans [n] of a nominal aircraft in level flight at airspeeds 0, step, 2 step ... (m/s)."""
        if self._table is None:
            model, sines = team.model, [0.0]
            step = model.limits.speeds[2] / SPEEDS
            for k in range(1, SPEEDS + 1):
                try:
                    found = trim(model.plan, (k * step, 0.0, 0.0))
                except TrimError:
                    break
                sines.append(max(float(torch.tensor(found.tilt).sin()), sines[-1] + 1e-6))
            self._table = team.fleet.state.new_tensor(sines), step
        return self._table

    def ways(self, team: Aircraft, place: Tensor) -> Tensor:
        """Predict the boat of each aircraft at every decision from now on, [env, aircraft, steps, 16].

        The columns are the boat's state and the acceleration of its deck (NED, m/s^2). The middle of the deck is now at
        `place` [env, aircraft, 3] (NED, m).
        """
        known, dt, K = team.known_deck, self.interval, self.steps
        x, slope = _moves(team), torch.cat((known.acceleration, known.rates[..., :2]), dim=-1)
        t = dt * torch.arange(K, device=x.device, dtype=x.dtype)
        told, ready = self._told(x, team.steps)
        now, soon = told[..., :2].unbind(-1)
        e, e_rate = x - now, slope - (soon - now) / dt
        tau = torch.where(ready, JOINED, ALONE)
        dies = (e.unsqueeze(-1) + (e_rate + e / tau).unsqueeze(-1) * t) * (-t / tau.unsqueeze(-1)).exp()
        path = (told + dies).transpose(-1, -2)  # [env, aircraft, k, 5]
        velocity = path[..., :3] + known.mean.unsqueeze(-2)
        moved = torch.zeros_like(velocity)
        moved[..., 1:, :] = (0.5 * dt * (velocity[..., 1:, :] + velocity[..., :-1, :])).cumsum(-2)
        faster = torch.gradient(velocity, spacing=dt, dim=-2)[0]
        roll, pitch = path[..., 3:].unbind(-1)
        heading = known.attitude[..., HEADING, None].expand_as(roll)
        q = torch_quaternion_from_euler(roll, pitch, heading)
        R = torch_rotation_matrix(q)
        roll_rate, pitch_rate = torch.gradient(path[..., 3:], spacing=dt, dim=-2)[0].unbind(-1)
        rates = torch.stack((roll_rate, roll.cos() * pitch_rate, -roll.sin() * pitch_rate), dim=-1)
        centre = self._centre.to(x)
        arm = torch.linalg.cross(rates, centre.expand_as(rates), dim=-1)
        v_b = (R.mT @ velocity.unsqueeze(-1)).squeeze(-1) - arm
        at = place.unsqueeze(-2) + moved - R @ centre
        return torch.cat((at, q, v_b, rates, faster), dim=-1)

    def _told(self, x: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        """Return predictions [env, aircraft, 5, k] of the models, 0 where a model is not ready, and which are ready."""
        K = self.steps
        assert self._memory is not None
        count = (K + SAMPLED) // SAMPLED + 2
        nodes = torch.cat((self._memory.past[..., :2].flip(-1), self._memory.predict(count)), dim=-1)
        late = (steps % SAMPLED).view(-1, 1)  # decisions since the last sample, which is node 1
        where = 1 + (late + torch.arange(K, device=x.device)) / SAMPLED
        first = where.floor().long()
        s = (where - first).view(len(x), 1, 1, K).to(x)
        first = first.view(len(x), 1, 1, K).expand(*x.shape, K)
        a, b, c, d = (nodes.gather(-1, (first + k).clamp(max=nodes.shape[-1] - 1)) for k in (-1, 0, 1, 2))
        # a cubic through b and c with the slopes of the chords over them (Catmull-Rom)
        found = b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))
        ready = self._memory.ready
        return torch.where(ready.unsqueeze(-1), found, 0.0), ready


def _moves(team: Aircraft) -> Tensor:
    """Known motion of each deck [env, aircraft, 5]: velocity relative to its mean (NED, m/s), roll and pitch (rad)."""
    known = team.known_deck
    return torch.cat((known.velocity - known.mean, known.attitude[..., :2]), dim=-1)
