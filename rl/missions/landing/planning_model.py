"""The model in which an honest planner (rl/planning/planner.py) tries plans of the aircraft: what they know.

The model has nominal aircraft at the states that they measure, a steady wind, exact instruments, and decks that move as
foreseen (foresight.py), whatever stands on them. A deck is where the aircraft knows it to be (known_deck.py). There are
no waves: the model is `RAISED`, and an aircraft has met the water where it is below its boat's waterline. Plans keep
the pilot's limits (pilots.py), as policies do. What is not known needs room: a landing in the model must be softer and
more level than `[landing]` says (`MARGIN`), on a deck that is smaller (`INSIDE`).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from rl.mission import Mission
from rl.missions.landing.aircraft import Aircraft, LandingHost
from rl.missions.landing.config import LandingScenario
from rl.missions.landing.decks import Decks
from rl.missions.landing.foresight import Foresight
from rl.perception.radio import RadioConfig
from rl.perception.tracked_objects import SensorsConfig
from rl.step import Due
from taichi_sim.config import SeaConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, BELOW, DOWN, POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.contact.between_teams import Contacts, soles_in_deck
from taichi_sim.state.memory import Remembers
from taichi_sim.state.snapshot import transfer
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import Script, World

RAISED = 100.0  # m, by which the model is higher than the world: out of reach of the sea and of its ground effect
MARGIN = 0.6  # limits of a touchdown in the model over those of the world; assumed
INSIDE = 0.1  # m, by which the deck's edges are nearer to its middle in the model; assumed
ABOVE = 1e-3  # m, of the lowest sole above a deck in which it would be otherwise


def imagined_scenario(config: LandingScenario, components: int) -> LandingScenario:
    """The scenario of the model, with a calm sea of as many `components`.

    Air and sea are of the same kinds as in `config`, so that the kernels of its aircraft serve the model, too.
    """
    parts = {
        name: section.model_copy(update={"vary": {}, "sensors": SensorsConfig()})
        for name, section in config.parts.items()
    }
    landing = config.landing
    softer = {"hard_speed": MARGIN * landing.hard_speed, "hard_tilt_deg": MARGIN * landing.hard_tilt_deg}
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


class Ways(Remembers):
    """The ways of all boats as they are foreseen.

    Attributes:
        table: [env, boat, k, 16] states of the boats k decisions after what is known was written, and the acceleration
            of their decks (NED, m/s^2). since: int64 [env], decisions of the episode then.
    """

    def __init__(self, state: Tensor, steps: Tensor, interval: float, ahead: int):
        """Hold `ahead` decisions, every `interval` s, of the boats of `state` [env, boat, 13].

        `steps` int64 [env] are the decisions since the episode began.
        """
        self._steps, self.interval, self.ahead = steps, interval, ahead
        self.table = self.remember(state.new_zeros((*state.shape[:2], ahead, STATE_SIZE + 3)))
        self.since = self.remember(torch.zeros_like(steps))

    def foreseen(self, ahead: int) -> Tensor:
        """The row [env, boat, 16] that is `ahead` decisions from now."""
        k = self._steps - self.since + ahead
        within = k.clamp(max=self.ahead - 1)
        row = self.table[torch.arange(len(k), device=k.device), :, within]
        beyond = (k - within).to(row) * self.interval
        if bool((k > within).any()):
            R = torch_rotation_matrix(row[..., QUATERNION])
            gone = (R @ row[..., VELOCITY].unsqueeze(-1)).squeeze(-1) * beyond.view(-1, 1, 1)
            row = torch.cat((row[..., POSITION] + gone, row[..., 3:]), dim=-1)
        return row


class Foreseen(Vehicle):
    """A vessel that moves as foreseen; no load moves it."""

    def __init__(self, like: Vehicle, ways: Ways):
        """Replace the model `like`: keep its actions, without effect, and make its deck smaller (`INSIDE`)."""
        super().__init__(like.params, like.dt, like.substeps)
        self.action_names, self._ways = like.action_names, ways
        assert like.deck is not None
        x, y = (max(length - 2 * INSIDE, 0.5 * length) for length in like.deck.size)
        self.deck = like.deck.model_copy(update={"size": (x, y)})

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Put the vessels where they are foreseen to be at the end of the step."""
        fleet.state.copy_(self._ways.foreseen(1)[..., :STATE_SIZE])
        fleet.update()

    def mobility(self, fleet: Fleet) -> Tensor:
        """Mobility 0: no load moves the vessel."""
        return torch.zeros((1, 1, 6, 6), dtype=torch.float64, device=fleet.state.device)


class Adrift(Script):
    """Script that commands nothing; the boats move as foreseen."""

    def __call__(self, world: World) -> Tensor:
        """Actions of 0, which have no effect."""
        return torch.zeros_like(world.teams[self.name].action)


class ImaginedAircraft(Aircraft):
    """Aircraft that know their decks exactly."""

    def __init__(self, mission: LandingHost, name: str, decks: Decks, ways: Ways):
        """Prepare team `name`, which lands on `decks` that move along `ways`."""
        super().__init__(mission, name, decks)
        self._ways = ways

    def endings(self) -> dict[str, Tensor]:
        """Add `submerged`: soles are below the waterline of its boat."""
        waterline = self.decks.fleet.position_n[..., DOWN]
        return super().endings() | {"submerged": self.fleet.position_n[..., DOWN] + self.soles_below > waterline}

    def conclude(self, due: Due) -> None:
        """Set the aircraft's knowledge of the deck to the predicted motion."""
        super().conclude(due)
        known, deck = self.known_deck, self.deck
        rows = self._ways.foreseen(0)
        to = deck.place - self.fleet.position_n
        known.suppose(deck, to, rows[..., STATE_SIZE:], rows[..., ANGULAR_VELOCITY])

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Actions for the pilot's command plus a `correction`, always within the pilot's limits (Aircraft.planned)."""
        return super().planned(correction, self)

    def go_on_from(self, team: Aircraft) -> None:
        """Continue the episode of `team`."""
        transfer(team.pilot, self.pilot)
        self.pilot.height -= RAISED
        self.touched, self.settled = team.touches | team.touched, team.settled.clone()
        self.time, self.aborts = team.time.clone(), team.aborts.clone()


class ImaginedLanding(Mission[LandingScenario, ImaginedAircraft]):
    """The model; see the module.

    Attributes:
        ways: of the boats. boats: their decks. aircraft: the team. foresight: of decks and wind. hs: [env], 0.
    """

    Config = LandingScenario

    def make_teams(self, names: Sequence[str]) -> dict[str, ImaginedAircraft]:
        """Replace the boats that sail by boats that move as foreseen, then make the aircraft."""
        parts, dt, fleet = (
            self.config.landing,
            self.config.decision_interval,
            self.world.teams[self.config.landing.boats],
        )
        self.foresight = Foresight(Decks(fleet).centre, dt)
        self.ways = self.remember(Ways(fleet.state, self.steps, dt, self.foresight.steps))
        fleet.model = Foreseen(fleet.model, self.ways)
        self.world.contacts = Contacts(self.world.teams, dt)
        self.world.scripts[parts.boats] = Adrift(self.world, parts.boats)
        self.boats, self.hs = self.remember(Decks(fleet)), fleet.state.new_zeros(self.num_envs)
        self.aircraft = ImaginedAircraft(self, parts.aircraft, self.boats, self.ways)
        return {parts.aircraft: self.aircraft}

    def _alike(self, num_envs: int) -> "ImaginedLanding":
        """Make another model of the same scenario, with the same model of the aircraft, whose kernels are compiled."""
        other = type(self)(self.config, num_envs, seed=self.seed, teams=tuple(self.world.teams), source=self.source)
        other.aircraft.fleet.model = self.aircraft.fleet.model
        return other

    def begin(self, envs: Tensor) -> None:
        """No episode begins in the model: `believe` writes where all is."""

    def truth(self, due: Due) -> None:
        """Put the decks where they are foreseen; then measure the aircraft."""
        self.boats.follow()
        super().truth(due)

    def notice(self, team: Aircraft) -> None:
        """Learn from what `team` knows of decks and wind; call once a decision."""
        self.foresight.notice(team)

    def believe(self, team: Aircraft) -> None:
        """Write aircraft as `team` measures them, and decks as it foresees them, into the model."""
        own, steps, fleet, everywhere = team.own, team.steps, self.aircraft.fleet, self._all
        up = own.position_n.new_tensor((0.0, 0.0, -RAISED))
        self.steps.copy_(steps)
        self.ways.since.copy_(steps)
        fleet.state.copy_(own.state)
        fleet.state[..., POSITION] += up
        fleet.aux.copy_(own.aux)
        fleet.update()
        assert fleet.touch is not None
        fleet.touch.forget(everywhere)
        assert self.world.contacts.placed is not None
        self.world.contacts.placed.zero_()  # nobody begins inside a deck: `_clear`
        wind = self.foresight.wind.mean(1) / self.world.wind.speed_factor(RAISED)  # one for an environment's aircraft
        self.world.wind.set_mean(everywhere, wind)
        ways = self.foresight.ways(team, own.position_n + up + team.known_deck.to)
        self.ways.table.copy_(ways)
        self._clear()
        self.measure_anew()
        self.aircraft.go_on_from(team)

    def _clear(self) -> None:
        """Lower decks in which aircraft would begin by an error of what is known, until all soles are above them."""
        fleet, way = self.boats.fleet, self.ways.table
        fleet.state.copy_(way[:, :, 0, :STATE_SIZE])
        depth = soles_in_deck(self.aircraft.fleet, self.world.contacts.carriers[0], self._all).to(way)
        deep = depth.amax(1)  # [env, boat]
        down = torch_rotation_matrix(fleet.state[..., QUATERNION])[..., BELOW]
        shift = torch.where(deep > 0, deep + ABOVE, 0.0).unsqueeze(-1) * down
        way[..., POSITION] += shift.unsqueeze(2)
        fleet.state[..., POSITION] += shift
        fleet.update()
