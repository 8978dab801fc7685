"""The model in which an honest planner (rl/planning/planner.py) tries plans of the aircraft: what they know.

The model has nominal aircraft at the states that they measure, a steady wind, exact instruments, and decks that move as
foreseen, whatever stands on them. A deck is where the aircraft knows it to be (known_deck.py). How it goes on moving is
foreseen from its past by autoregressive models (taichi_sim/forecast.py) of its velocity over its mean velocity, of roll
and of pitch. What they foresee is joined to what is known now by an error that dies away, critically damped:

    x(t) = AR(t) + (e + (e' + e / tau) t) exp(-t / tau),    e, e' at t = 0: x and x' as known, less those of AR.

Until a model is ready, AR is zero. The wind is that in which the aircraft would have to lean as it does to hold its
velocity, averaged. There are no waves: the model is `RAISED`, and an aircraft has met the water where it is below its
boat's waterline. Plans keep the pilot's limits (pilots.py), as policies do. What is not known needs room: a landing in
the model must be softer and more level than `[landing]` says (`MARGIN`), on a deck that is smaller (`INSIDE`).
"""

from typing import Any

import torch
from torch import Tensor

from rl.missions.landing.aircraft import Aircraft
from rl.missions.landing.boats import Boats
from rl.missions.landing.config import LandingScenario
from rl.perception.contacts import SensorsConfig
from rl.perception.due import Due
from rl.perception.radio import RadioConfig
from taichi_sim.config import SeaConfig
from taichi_sim.conventions import ANGULAR_VELOCITY, BELOW, DOWN, HEADING, STATE_SIZE
from taichi_sim.forecast import Autoregression
from taichi_sim.kernels.rotation import torch_euler_from_rotation, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.script import Script
from taichi_sim.uav.aircraft import TrimError
from taichi_sim.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.uav.multirotor.trim import trim
from taichi_sim.vehicle import Vehicle

RAISED = 100.0  # m, by which the model is higher than the world: out of reach of the sea and of its ground effect
FORESEEN = 8.0  # s ahead for which a deck's motion is foreseen; beyond, it keeps its velocity; assumed
SAMPLED = 4  # decisions between two samples of the autoregressive models; assumed
ORDER = 8  # of them; assumed
BLOWN = 2.0  # s, over which the wind is averaged; assumed
JOINED, ALONE = 0.5, 1.2  # s, tau with a model that is ready, and without; assumed
MARGIN = 0.6  # limits of a touchdown in the model over those of the world; assumed
INSIDE = 0.1  # m, by which the deck's edges are nearer to its middle in the model; assumed
SPEEDS = 24  # airspeeds of the table of leans


def imagined_scenario(config: LandingScenario, components: int) -> LandingScenario:
    """The scenario of the model, with a calm sea of as many `components`.

    Air and sea are of the same kinds as in `config`, so that the kernels of its aircraft serve the model, too.
    """
    parts = {
        name: section.model_copy(update={"vary": {}, "sensors": SensorsConfig()})
        for name, section in config.parts.items()
    }
    landing = config.landing
    softer = {key: MARGIN * getattr(landing, key) for key in ("hard_speed", "hard_tilt_deg")}
    steady = {"speed": 0.0, "beaufort": None, "series": None, "std": 0.0, "turbulence_w20": 0.0, "gust": None}
    return config.model_copy(
        update={
            "sea": SeaConfig(hs=0.0, tp=4.0, components=components, realisations=1),
            "air": None if config.air is None else config.air.model_copy(update=steady),
            "vary": {key: of for key, of in config.vary.items() if key == "air.turbulence"},
            "radio": RadioConfig(),
            "landing": landing.model_copy(update=softer),
            **parts,
        }
    )


class Foreseen(Vehicle):
    """A vessel that moves as `ImaginedLanding.way` (mission.py) says; no load moves it."""

    def __init__(self, like: Vehicle, mission: Any):
        """Replace the model `like`: keep its actions, without effect, and make its deck smaller (`INSIDE`)."""
        super().__init__(like.params, like.dt, like.substeps)
        self.action_names, self._mission = like.action_names, mission
        assert like.deck is not None
        x, y = (max(length - 2 * INSIDE, 0.5 * length) for length in like.deck.size)
        self.deck = like.deck.model_copy(update={"size": (x, y)})

    def step(self, fleet: Any, around: Any) -> None:
        """Put the vessels where they are foreseen to be at the end of the step."""
        fleet.state.copy_(self._mission.foreseen(1)[..., :STATE_SIZE])
        fleet.update()

    def mobility(self, fleet: Any) -> Tensor:
        """Mobility 0: no load moves the vessel."""
        return torch.zeros((1, 1, 6, 6), dtype=torch.float64, device=fleet.state.device)


class Adrift(Script):
    """Script that commands nothing; the boats move as foreseen."""

    def __init__(self, boats: Boats):
        """Command `boats`."""
        self.name, self._boats = boats.name, boats

    def __call__(self, world: Any) -> Tensor:
        """Actions of 0, which have no effect."""
        return torch.zeros_like(self._boats.fleet.action)


class ImaginedAircraft(Aircraft):
    """Aircraft that know their decks exactly."""

    def endings(self) -> dict[str, Tensor]:
        """Add `submerged`: soles are below the waterline of its boat."""
        waterline = self.mission.boats.fleet.position_n[:, self.boat_of, DOWN]
        return super().endings() | {"submerged": self.fleet.position_n[..., DOWN] + self.soles_below > waterline}

    def sense(self, due: Due) -> None:
        """Read the instruments."""
        self.own.read(due)

    def conclude(self, due: Due) -> None:
        """Set the aircraft's knowledge of the deck to the predicted motion."""
        self._wanted = None
        known, deck = self.known_deck, self.deck
        rows = self.mission.foreseen(0)[:, self.boat_of]
        known.to, known.velocity = deck.place - self.fleet.position_n, deck.velocity
        known.acceleration, known.rates = rows[..., STATE_SIZE:], rows[..., ANGULAR_VELOCITY]
        known.attitude = torch_euler_from_rotation(deck.R)
        known.seen, known.heard = torch.zeros_like(known.seen), torch.zeros_like(known.heard)

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Actions for the pilot's command plus a `correction`, always within the pilot's limits (Aircraft.planned)."""
        return super().planned(correction, self)


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
        x, steps = _moves(team), team.mission.steps
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
            model, sines = team.fleet.model, [0.0]
            assert isinstance(model, Multirotor6DOF)
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
        told, ready = self._told(x, team.mission.steps)
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
