"""What an honest planner (rl/planning/honest.py) tries plans of the aircraft in: a world built from what they know.

The model has nominal aircraft at the states that they measure, a steady wind, exact instruments, and decks that move as
foreseen, whatever stands on them. A deck is where the aircraft knows it to be (known.py). How it goes on moving is
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
from rl.missions.landing.mission import Landing
from rl.perception.contacts import SensorsConfig
from rl.perception.radio import RadioConfig
from taichi_sim.config import SeaConfig
from taichi_sim.contact.contacts import Contacts, soles_in_deck
from taichi_sim.conventions import POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.forecast import Autoregression
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.script import Script
from taichi_sim.state import transfer
from taichi_sim.uav.aircraft import TrimError
from taichi_sim.uav.multirotor.trim import trim
from taichi_sim.vehicle import Vehicle

RAISED = 100.0  # m, by which the model is higher than the world: out of reach of the sea and of its ground effect
FORESEEN = 8.0  # s ahead for which a deck's motion is foreseen; beyond, it keeps its velocity; assumed
SAMPLED = 4  # decisions between two samples of the autoregressive models; assumed
ORDER = 8  # of them; assumed
BLOWN = 2.0  # s, over which the wind is averaged; assumed
JOINED, ALONE = 0.5, 1.2  # s, tau with a model that is ready, and without; assumed
ABOVE = 1e-3  # m, of the lowest sole above a deck in which it would be otherwise
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
    """A vessel that moves as `ImaginedLanding.way` says; no load moves it."""

    def __init__(self, like: Vehicle, mission: "ImaginedLanding"):
        """With a deck inside that of `like`, and its actions, which have no effect."""
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
        """Nothing moves it."""
        return torch.zeros((1, 1, 6, 6), dtype=torch.float64, device=fleet.state.device)


class Adrift(Script):
    """Asks nothing of the boats, which move by themselves."""

    def __init__(self, boats: Boats):
        """Of these."""
        self.name, self._boats = boats.name, boats

    def __call__(self, world: Any) -> Tensor:
        """Actions without effect."""
        return torch.zeros_like(self._boats.fleet.action)


class ImaginedAircraft(Aircraft):
    """Aircraft that know their decks exactly."""

    def conclude(self, which: Tensor, count: int, heard: Tensor | None = None) -> None:
        """What is foreseen is what is known."""
        known, deck, R = self.known_deck, self.deck, self.deck.R
        rows = self.mission.foreseen(0)[:, self.boat_of]
        known.to, known.velocity = deck.place - self.fleet.position_n, deck.velocity
        known.acceleration, known.rates = rows[..., STATE_SIZE:], rows[..., 10:STATE_SIZE]
        angles = torch.atan2(R[..., 2, 1], R[..., 2, 2]), -R[..., 2, 0].clamp(-1.0, 1.0).asin()
        known.attitude = torch.stack((*angles, torch.atan2(R[..., 1, 0], R[..., 0, 0])), dim=-1)
        known.seen, known.heard = torch.zeros_like(known.seen), torch.zeros_like(known.heard)

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Within the pilot's limits."""
        return super().planned(correction, self)


class ImaginedLanding(Landing):
    """The model; see the module.

    Attributes:
        way: [env, boat, k, 16] states of the boats k decisions after what is known was written, and the acceleration of
            their decks (NED, m/s^2). since: int64 [env], decisions of the episode then.
    """

    STATE = ("way", "since")

    @staticmethod
    def Team(mission: Any, name: str) -> Any:  # noqa: N802
        """A team by its part."""
        return (Boats if name == mission.config.landing.boats else ImaginedAircraft)(mission, name)

    def prepare(self) -> None:
        """Boats that move as foreseen take the place of those that sail."""
        self._ahead = round(FORESEEN / self.config.decision_interval) + 1
        super().prepare()
        fleet = self.boats.fleet
        self.way = fleet.state.new_zeros((self.num_envs, fleet.count, self._ahead, STATE_SIZE + 3))
        self.since = torch.zeros_like(self.steps)
        self._memory: Autoregression | None = None
        self._wind: Tensor | None = None
        fleet.model = Foreseen(fleet.model, self)
        self.world.contacts = Contacts(self.world.teams, self.config.decision_interval)
        self.world.scripts[fleet.name] = Adrift(self.boats)

    @property
    def _models_shared(self) -> tuple[str, ...]:
        """Not the boats', each of which is of one mission."""
        return tuple(self.teams)

    def foreseen(self, ahead: int) -> Tensor:
        """The row [env, boat, 16] of `way` that is `ahead` decisions from now."""
        k = self.steps - self.since + ahead
        within = k.clamp(max=self._ahead - 1)
        rows = torch.arange(self.num_envs, device=k.device)
        row = self.way[rows, :, within]
        beyond = (k - within).to(row) * self.config.decision_interval
        if bool((k > within).any()):
            R = torch_rotation_matrix(row[..., QUATERNION])
            gone = (R @ row[..., VELOCITY].unsqueeze(-1)).squeeze(-1) * beyond.view(-1, 1, 1)
            row = torch.cat((row[..., POSITION] + gone, row[..., 3:]), dim=-1)
        return row

    def _look(self, rows: int) -> None:
        self.boats._look()
        assert self.aircraft is not None
        self.aircraft.measure(self._which, rows)
        self.aircraft.conclude(self._which, rows)  # pyright: ignore[reportCallIssue]

    def begin(self, envs: Tensor) -> None:
        """Episodes do not begin here; boats are to be somewhere, nevertheless."""
        super().begin(envs)
        self.way[envs] = 0.0
        self.way[envs, :, :, :STATE_SIZE] = self.boats.fleet.state[envs].unsqueeze(2)
        self.since[envs] = 0

    def endings(self, team: Any) -> dict[str, Tensor]:
        """Also `submerged`: below the waterline of its boat."""
        waterline = self.boats.fleet.position_n[:, team.boat_of, 2]
        low = team.fleet.position_n[..., 2] + team.soles_below > waterline
        return super().endings(team) | {"submerged": low}

    # -- what is known ---------------------------------------------------------------------------------------------

    def notice(self, team: Aircraft) -> None:
        """Learn how decks move, as `team` knows them; once a decision."""
        x, steps = _moves(team), team.mission.steps
        if self._memory is None:
            self._memory = Autoregression(x, ORDER)
            self._wind = self._wind_of(team)
        begins = steps == 0
        self._memory.begin(begins.nonzero().flatten())
        self._memory.learn(x, (steps % SAMPLED == 0).view(-1, 1, 1))
        assert self._wind is not None
        now, dt = self._wind_of(team), self.config.decision_interval
        share = torch.where(begins.view(-1, 1, 1), 1.0, dt / (BLOWN + dt))
        share = torch.where(team.touches.unsqueeze(-1), 0.0, share)
        self._wind = self._wind + share * (now - self._wind)

    def believe(self, team: Aircraft) -> None:
        """Aircraft as `team` measures them, decks as it foresees them."""
        mine, own, steps = self.teams[team.name], team.own, team.mission.steps
        assert isinstance(mine, ImaginedAircraft)
        up = own.position_n.new_tensor((0.0, 0.0, -RAISED))
        self.steps.copy_(steps)
        self.since.copy_(steps)
        everywhere = self._all
        fleet = mine.fleet
        fleet.state.copy_(own.state)
        fleet.state[..., POSITION] += up
        fleet.aux.copy_(own.aux)
        fleet.update()
        assert fleet.touch is not None
        fleet.touch.forget(everywhere)
        assert self.world.contacts.placed is not None
        self.world.contacts.placed.zero_()  # nobody begins inside a deck: `_clear`
        wind = self._wind_of(team) if self._wind is None else self._wind
        wind = wind.mean(1) / self.world.wind.speed_factor(RAISED)  # one for the aircraft of an environment
        self.world.wind.set_mean(everywhere, wind)
        self._foresee(team, own.position_n + up + team.known_deck.to)
        transfer(team.pilot, mine.pilot)
        mine.pilot.height -= RAISED
        self._which.fill_(2)
        self._look(self.num_envs)
        mine.touched, mine.settled = team.touches | team.touched, team.settled.clone()
        for name in ("time", "aborts", "turns", "landed", "over", "bearing"):
            setattr(mine, name, getattr(team, name).clone())

    def _wind_of(self, team: Aircraft) -> Tensor:
        """Velocity of the air [env, aircraft, 3] in which the aircraft would have to lean as they do."""
        pilot, own = team.pilot, team.own
        lean = torch.where(pilot.height.isnan().unsqueeze(-1), own.R_nb[..., 2], pilot.lean)[..., :2]
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
        if not hasattr(self, "_table"):
            model, sines = team.fleet.model, [0.0]
            step = model.limits.speeds[2] / SPEEDS
            for k in range(1, SPEEDS + 1):
                try:
                    found = trim(model.plan, (k * step, 0.0, 0.0))  # pyright: ignore[reportAttributeAccessIssue]
                except TrimError:
                    break
                sines.append(max(float(torch.tensor(found.tilt).sin()), sines[-1] + 1e-6))
            self._table = own = team.fleet.state.new_tensor(sines), step
            return own
        return self._table

    def _foresee(self, team: Aircraft, place: Tensor) -> None:
        """Write `way`, for decks that are at `place` [env, aircraft, 3] now."""
        known, dt, K = team.known_deck, self.config.decision_interval, self._ahead
        x, slope = _moves(team), torch.cat((known.acceleration, known.rates[..., :2]), dim=-1)
        t = dt * torch.arange(K, device=x.device, dtype=x.dtype)
        told, ready = self._told(x, team.mission.steps)
        e = x - told[..., 0]
        e_rate = slope - (told[..., 1] - told[..., 0]) / dt
        tau = torch.where(ready, JOINED, ALONE)
        dies = (e.unsqueeze(-1) + (e_rate + e / tau).unsqueeze(-1) * t) * (-t / tau.unsqueeze(-1)).exp()
        path = (told + dies).transpose(-1, -2)  # [env, aircraft, k, 5]
        velocity = path[..., :3] + known.mean.unsqueeze(-2)
        moved = torch.zeros_like(velocity)
        moved[..., 1:, :] = (0.5 * dt * (velocity[..., 1:, :] + velocity[..., :-1, :])).cumsum(-2)
        faster = torch.gradient(velocity, spacing=dt, dim=-2)[0]
        roll, pitch = path[..., 3], path[..., 4]
        heading = known.attitude[..., 2:].expand_as(roll)
        q = torch_quaternion_from_euler(roll, pitch, heading)
        R = torch_rotation_matrix(q)
        turns = torch.gradient(path[..., 3:], spacing=dt, dim=-2)[0]
        rates = torch.stack((turns[..., 0], roll.cos() * turns[..., 1], -roll.sin() * turns[..., 1]), dim=-1)
        centre = self.boats.centre.to(x)
        arm = torch.linalg.cross(rates, centre.expand_as(rates), dim=-1)
        v_b = (R.mT @ velocity.unsqueeze(-1)).squeeze(-1) - arm
        at = place.unsqueeze(-2) + moved - R @ centre
        chosen = team.turn  # of each boat, the aircraft that foresees its motion
        rows = torch.arange(self.num_envs, device=x.device).unsqueeze(1)
        self.way.copy_(torch.cat((at, q, v_b, rates, faster), dim=-1)[rows, chosen])
        self._clear(team)

    def _told(self, x: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        """What the autoregressive models foresee [env, aircraft, 5, k], zero without one; which are ready."""
        K = self._ahead
        if self._memory is None:
            return x.new_zeros((*x.shape, K)), torch.zeros_like(x, dtype=torch.bool)
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

    def _clear(self, team: Aircraft) -> None:
        """Lower decks in which aircraft would begin by an error of what is known, until all soles are above them."""
        mine, fleet = self.teams[team.name].fleet, self.boats.fleet
        fleet.state.copy_(self.way[:, :, 0, :STATE_SIZE])
        depth = soles_in_deck(mine, self.world.contacts.carriers[0], self._all).to(self.way)
        deep = depth.amax(1)  # [env, boat]
        down = torch_rotation_matrix(fleet.state[..., QUATERNION])[..., 2]
        shift = torch.where(deep > 0, deep + ABOVE, 0.0).unsqueeze(-1) * down
        self.way[..., POSITION] += shift.unsqueeze(2)
        fleet.state[..., POSITION] += shift
        fleet.update()


def _moves(team: Aircraft) -> Tensor:
    """[env, aircraft, 5]: velocity of each deck over its mean (NED, m/s), its roll and pitch (rad), as known."""
    known = team.known_deck
    return torch.cat((known.velocity - known.mean, known.attitude[..., :2]), dim=-1)
