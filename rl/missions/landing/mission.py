"""Landing: multirotors come in over boats in a seaway and land on their decks.

Aircraft i lands on boat i, modulo their number; several of one deck take turns (aircraft.py). An episode begins with
the boats under way, or still, on courses of their own, and each aircraft in hover 20 to 60 m from its deck, anywhere
around. An aircraft knows itself by its instruments, the deck by a camera that sees a marker on it from near and by what
the boat tells by radio (boats.py), late and at times lost (known_deck.py). It has landed when all its soles have been
on the deck for some seconds, and it came down softly (`[landing]`). Boats that take no part hold their course
(boats.Helm).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from rl.mission import Frame, Histories, Mission
from rl.missions.landing.aircraft import Aircraft
from rl.missions.landing.boats import MESSAGE, Boats, Helm
from rl.missions.landing.config import LandingConfig, LandingScenario
from rl.missions.landing.film import overlays_of
from rl.missions.landing.imagined import RAISED, Adrift, Foreseen, Foresight, ImaginedAircraft, imagined_scenario
from rl.missions.landing.judge import LandingJudge
from rl.perception.due import Due
from rl.perception.radio import Radio
from taichi_sim.config import ConfigError
from taichi_sim.contact.contacts import Contacts, soles_in_deck
from taichi_sim.conventions import BELOW, DOWN, EAST, NORTH, POSITION, QUATERNION, STATE_SIZE, SURGE, VELOCITY
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.recording.episode import Scene
from taichi_sim.state import transfer

TRIES = 50  # draws of places, until all aircraft are apart
SPACED = 4.0  # least distance between two aircraft as an episode begins, over their collision radius; assumed
SEEN_FROM_AFAR = 40.0  # m about the first boat, in recordings
ABOVE = 1e-3  # m, of the lowest sole above a deck in which it would be otherwise, in a model


def afloat(team: Any, config: LandingScenario, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Draw states [n, boat, 13], courses (rad) and speeds (m/s) of the boats of `n` environments.

    The boats of an environment are abreast, on one course, each at a speed of its own.
    """
    like, count = team.fleet.state, team.fleet.count
    draw = torch.rand((n, count + 1), generator=generator).to(like)
    course = (2 * math.pi * draw[:, :1]).expand(-1, count)
    low, high = config.course.speed
    speed = low + (high - low) * draw[:, 1:]
    state = like.new_zeros((n, count, STATE_SIZE))
    rank = (torch.arange(count, device=like.device) - (count - 1) / 2) * config.landing.apart
    state[..., NORTH], state[..., EAST] = -rank * course.sin(), rank * course.cos()
    state[..., QUATERNION] = torch_quaternion_from_euler(0 * course, 0 * course, course)
    state[..., SURGE] = speed
    return state, course, speed


def aloft(team: Any, over: Tensor, config: LandingConfig, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Draw aircraft in hover around places `over` [n, aircraft, 2] (m), with any heading.

    Returns their states [n, aircraft, 13], and unit vectors [n, aircraft, 2] from those places to them. Aircraft of one
    deck are evenly spaced around it, to within a quarter of their spacing.

    Raises:
        ConfigError: where two aircraft would begin in one place.
    """
    like, n = team.fleet.state, len(over)
    state = like.new_zeros((*over.shape[:2], STATE_SIZE))
    away = like.new_zeros((*over.shape[:2], 2))
    rows = torch.arange(n, device=like.device)
    for _ in range(TRIES):
        draw = torch.rand((len(rows), over.shape[1], 4), generator=generator).to(like)
        side, heading, apart, up = draw.unbind(-1)
        (near, far), (low, high) = config.distance, config.height
        if not team.alone:
            first, each = side[:, team.boat_of], 1 / (int(team.rank.max()) + 1)
            spaced = first + each * (team.rank + 0.5 * (side - 0.5))
            side = torch.where(team.rank == 0, first, spaced)
        bearing, heading, distance = 2 * math.pi * side, 2 * math.pi * heading, near + (far - near) * apart
        away[rows] = torch.stack((bearing.cos(), bearing.sin()), dim=-1)
        state[rows, :, :2] = over[rows] + distance.unsqueeze(-1) * away[rows]
        state[rows, :, DOWN] = -(low + (high - low) * up)
        state[rows, :, QUATERNION] = torch_quaternion_from_euler(0 * heading, 0 * heading, heading)
        apart = torch.cdist(state[..., :3], state[..., :3])
        apart.diagonal(dim1=1, dim2=2).fill_(math.inf)
        rows = (apart.flatten(1).amin(1) < SPACED * team.fleet.model.collision_radius).nonzero().flatten()
        if not len(rows):
            return state, away
    raise ConfigError(
        f"landing.distance = {list(config.distance)}, landing.height = {list(config.height)}, landing.apart = "
        f"{config.apart:g}: two aircraft would begin in one place, {float(apart.amin()):.3g} m from each other; "
        f"allowed are {SPACED * team.fleet.model.collision_radius:g} m or more"
    )


class Landing(Mission):
    """Boats with decks and aircraft that land on them; see the module.

    Attributes:
        boats: the team of boats (boats.py), whether it takes part or not. manned: whether it does. aircraft: the team
            of aircraft, or None.
        hs: [env] significant wave height, m. radio: between boats and aircraft, boats first.
    """

    STATE = ("boats", "hs", "radio")

    Config = LandingScenario
    Judge = LandingJudge
    config: LandingScenario

    @staticmethod
    def Team(mission: Any, name: str) -> Any:  # noqa: N802
        """Make team `name`: `Boats` or `Aircraft`, by its part."""
        return (Boats if name == mission.config.landing.boats else Aircraft)(mission, name)

    def __init__(
        self, config: Any, num_envs: int, *, seed: int, teams: Sequence[str] | None = None, source: Path | None = None
    ):
        """Build the mission (see `Mission`), with boats even if they are not among the `teams` that take part."""
        name = config.landing.boats
        self.manned = teams is None or name in teams
        there = None if teams is None else [team for team in config.teams if team in (*teams, name)]
        super().__init__(config, num_envs, seed=seed, teams=there, source=source)

    def _alike(self, num_envs: int) -> "Mission":
        """Make another mission of the same scenario, seed and teams.

        Both share the vehicle models, so that kernels are compiled once.
        """
        other = type(self)(self.config, num_envs, seed=self.seed, teams=tuple(self.teams), source=self.source)
        for name in self._models_shared:
            other.world.teams[name].model = self.world.teams[name].model
        return other

    @property
    def _models_shared(self) -> tuple[str, ...]:
        """Teams whose models `_alike` shares."""
        return tuple(self.world.teams)

    def prepare(self) -> None:
        """Connect boats and aircraft.

        Raises:
            ConfigError: where boats have no deck, or there are teams without a part.
        """
        run, parts = runtime.current(), self.config.landing
        for name in self.teams:
            if name not in (parts.boats, parts.aircraft):
                raise ConfigError(
                    f"{name}: landing.boats = {parts.boats!r} and landing.aircraft = {parts.aircraft!r} name the teams "
                    "of the mission; give any other a script"
                )
        self.boats: Boats = self.teams[parts.boats]
        if not self.manned:
            del self.teams[parts.boats]
            self.world.scripts[parts.boats] = Helm(self.boats)
        self.aircraft: Aircraft | None = self.teams.get(parts.aircraft)
        self._hs = torch.as_tensor(self.world.sea.components.hs).to(run.device, run.torch_dtype)
        self.hs = torch.zeros(self.num_envs, device=run.device, dtype=run.torch_dtype)
        boats = self.boats.fleet.count
        flying = 0 if self.aircraft is None else self.aircraft.fleet.count
        self._place = self.boats.fleet.state.new_zeros((self.num_envs, boats + flying, 3))
        self.radio = Radio(self.config.radio, self._place, self.config.decision_interval, width=MESSAGE)
        self._own = torch.arange(flying, device=run.device)

    # -- one step --------------------------------------------------------------------------------------------------

    def truth(self, due: Due) -> None:
        """Measure the boats, whether they take part or not; then the aircraft."""
        self.boats.truth(due)
        if self.aircraft is not None:
            self.aircraft.truth(due)
            boats = self.boats.fleet.count
            self.boats.served = self.aircraft.ends()["landed"].unflatten(1, (-1, boats)).any(1)

    def sense(self, due: Due) -> None:
        """Boats read their instruments, whether they take part or not; aircraft look at their decks, too."""
        self.boats.sense(due)
        if self.aircraft is not None:
            self.aircraft.sense(due)

    def exchange(self, due: Due) -> None:
        """All have one radio."""
        count, place, said = self.boats.fleet.count, self._place, self.radio.said
        place[:, :count], said[:, :count] = self.boats.fleet.position_n, self.boats.message()
        if self.aircraft is not None:
            place[:, count:] = self.aircraft.fleet.position_n
            said[:, count:, :3], said[:, count:, 3:6] = self.aircraft.own.position_n, self.aircraft.own.velocity_n
        self.radio.talk(due)

    @property
    def heard(self) -> Tensor:
        """Last message of each aircraft's boat and its age, [env, aircraft, MESSAGE + 1]."""
        assert self.aircraft is not None
        return self.radio.heard[:, self.boats.fleet.count + self._own, self.aircraft.boat_of]

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor) -> None:
        """Place boats and aircraft in environments `envs` [n]."""
        self.hs[envs] = self._hs[self.world.env_sea[envs].long()]
        state, course, speed = afloat(self.boats, self.config, len(envs), self.generator)
        self.boats.begin(envs, course, speed)
        self.world.place(self.boats.name, envs, state)
        if self.aircraft is not None:
            x, y = self.boats.centre[:2]
            c, s = course.cos(), course.sin()
            decks = state[..., :2] + torch.stack((c * x - s * y, s * x + c * y), dim=-1)
            over, away = aloft(self.aircraft, decks[:, self.aircraft.boat_of], self.config.landing, self.generator)
            self.world.place(self.aircraft.name, envs, over)
            self.aircraft.begin(envs, away)

    # -- what others ask -------------------------------------------------------------------------------------------

    def imagined(self, team: Any) -> "Mission | None":
        """Make an `ImaginedLanding` for aircraft; None for boats."""
        if isinstance(team, Boats):
            return None
        config = imagined_scenario(self.config, self.world.sea.table.shape[2])
        made = ImaginedLanding(config, self.num_envs, seed=self.seed, teams=(team.name,), source=self.source)
        made.world.teams[team.name].model = team.fleet.model  # whose kernels are compiled
        return made

    def frame(self, env: int) -> Frame:
        """Return the frame: the aircraft's distances from their deck's middle, and overlays (heights, the estimated
        deck, sight lines).
        """
        flying = {} if self.aircraft is None else {self.aircraft.name: {"error_m": self.aircraft.distance[env]}}
        return Frame(flying, overlays_of(self.boats, self.aircraft, env))

    def scene(self, env: int) -> Scene:
        """The surroundings of the first boat."""
        return Scene(overview=(self.boats.name, SEEN_FROM_AFAR))

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Any, config: LandingScenario) -> None:
        """See figures.py."""
        from rl.missions.landing.figures import write_landing_figures  # matplotlib takes a second

        write_landing_figures(out, histories, episode, config)


class ImaginedLanding(Landing):
    """The model in which an honest planner tries plans of the aircraft; see imagined.py.

    Attributes:
        way: [env, boat, k, 16] states of the boats k decisions after what is known was written, and the acceleration of
            their decks (NED, m/s^2). since: int64 [env], decisions of the episode then. foresight: of decks and wind.
    """

    STATE = ("way", "since")

    @staticmethod
    def Team(mission: Any, name: str) -> Any:  # noqa: N802
        """Make team `name`: `Boats` or `ImaginedAircraft`, by its part."""
        return (Boats if name == mission.config.landing.boats else ImaginedAircraft)(mission, name)

    def prepare(self) -> None:
        """Replace the boats that sail by boats that move as foreseen."""
        super().prepare()
        fleet = self.boats.fleet
        self.foresight = Foresight(self.boats.centre, self.config.decision_interval)
        self._ahead = self.foresight.steps
        self.way = fleet.state.new_zeros((self.num_envs, fleet.count, self._ahead, STATE_SIZE + 3))
        self.since = torch.zeros_like(self.steps)
        fleet.model = Foreseen(fleet.model, self)
        self.world.contacts = Contacts(self.world.teams, self.config.decision_interval)
        self.world.scripts[fleet.name] = Adrift(self.boats)

    @property
    def _models_shared(self) -> tuple[str, ...]:
        """Teams whose models `_alike` shares: not the boats, because each `Foreseen` belongs to one mission."""
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

    def truth(self, due: Due) -> None:
        """Put the decks where they are foreseen; then measure the aircraft."""
        self.boats.restored()
        assert self.aircraft is not None
        self.aircraft.truth(due)

    def sense(self, due: Due) -> None:
        """Aircraft read their instruments."""
        assert self.aircraft is not None
        self.aircraft.sense(due)

    def exchange(self, due: Due) -> None:
        """There are no messages."""

    def begin(self, envs: Tensor) -> None:
        """Place boats and aircraft until `believe` moves them; no episode begins in the model."""
        super().begin(envs)
        self.way[envs] = 0.0
        self.way[envs, :, :, :STATE_SIZE] = self.boats.fleet.state[envs].unsqueeze(2)
        self.since[envs] = 0

    def notice(self, team: Aircraft) -> None:
        """Learn from what `team` knows of decks and wind; call once a decision."""
        self.foresight.notice(team)

    def believe(self, team: Aircraft) -> None:
        """Write aircraft as `team` measures them, and decks as it foresees them, into the model."""
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
        wind = self.foresight.wind.mean(1) / self.world.wind.speed_factor(RAISED)  # one for an environment's aircraft
        self.world.wind.set_mean(everywhere, wind)
        ways = self.foresight.ways(team, own.position_n + up + team.known_deck.to)
        self.way.copy_(ways[everywhere.unsqueeze(1), team.turn])  # as the aircraft foresees it that lands there
        self._clear(team)
        transfer(team.pilot, mine.pilot)
        mine.pilot.height -= RAISED
        self.measure_anew()
        mine.touched, mine.settled = team.touches | team.touched, team.settled.clone()
        for name in ("time", "aborts", "turns", "landed", "over", "bearing"):
            setattr(mine, name, getattr(team, name).clone())

    def _clear(self, team: Aircraft) -> None:
        """Lower decks in which aircraft would begin by an error of what is known, until all soles are above them."""
        mine, fleet = self.teams[team.name].fleet, self.boats.fleet
        fleet.state.copy_(self.way[:, :, 0, :STATE_SIZE])
        depth = soles_in_deck(mine, self.world.contacts.carriers[0], self._all).to(self.way)
        deep = depth.amax(1)  # [env, boat]
        down = torch_rotation_matrix(fleet.state[..., QUATERNION])[..., BELOW]
        shift = torch.where(deep > 0, deep + ABOVE, 0.0).unsqueeze(-1) * down
        self.way[..., POSITION] += shift.unsqueeze(2)
        fleet.state[..., POSITION] += shift
        fleet.update()


MISSION = Landing
