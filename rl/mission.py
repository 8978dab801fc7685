"""The contract of a mission: a world, how an episode begins, and the order of a step.

A scenario file names its mission (`mission = "formation"`, a package of rl/missions, or a user's `module:Class`). The
class derives from `Mission`, names the class of its `Team`s (rl/team.py), which own all else, and implements `begin`.
Data of a team are torch tensors [env, vehicle, ...]. One decision has these phases:

    act       actions are checked, policies act; vehicle actions are made of theirs; nothing has moved yet
    move      the world steps; then everything that is not a vehicle (targets, bodies)
    truth     errors, gaps, contacts, as they are
    judge     endings and rewards, by the truth, finite whatever happened to a state
    begin     environments that ended begin anew: a sea, a time and a wind are drawn, `begin` places vehicles, `truth`
    perceive  instruments are read, sensors and cameras look      once, for all environments
    exchange  messages
    conclude  what each vehicle knows
    observe   named terms, by what is known

`step` does all of it, in this order, and returns rewards, endings and the next observations.
"""

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Generic, NamedTuple, TypeVar, cast

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from rl.judge import Judge
from rl.scenario import Scenario, derive_seed
from rl.step import BEGINS, COLLIDED, DIVERGED, GOES_ON, Due, Endings, Step, VehicleActions
from rl.team import Action, ControllerError, Policy, Team, refuse_moved
from taichi_sim.config import ConfigError
from taichi_sim.config.arguments import Envs, environments, names, whole_number
from taichi_sim.config.base import number, span
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import Noise
from taichi_sim.kernels.rotation import level_states
from taichi_sim.state.divergence import Divergence
from taichi_sim.state.snapshot import Stateful
from taichi_sim.visualisation.recording.east_north_up import Origin
from taichi_sim.visualisation.recording.episode import Episode, Scene
from taichi_sim.visualisation.recording.overlays import Overlay
from taichi_sim.world import World

__all__ = ["COLLIDED", "DIVERGED", "ControllerError", "Endings", "Frame", "Histories", "History", "Mission", "Policy",
           "Step", "Team", "VehicleActions"]  # fmt: skip

OWNED = ("observe", "reward", "endings", "plan_cost", "log", "info", "controller")
MOVED = {name: "a team owns it: write it in a class derived from Team, named by `Team`" for name in OWNED} | {
    "controller": "a team owns it: write `make_controller` in a class derived from Team, named by `Team`",
    "measure": "write `move` for everything that is not a vehicle, `truth` for what is measured",
    "sense": "it is called `perceive`",
    "measure_again": "write `truth`, which is called for environments that begin, too",
}
"""Names of methods that a mission must not have, and what to write instead."""
TOUCHES = 0.1  # m: a sole that is nearer to a deck by telemetry, which tells no contact, stands on it; assumed
TIME_SPAN = 3600.0  # s: an episode begins at a random time of its sea

C = TypeVar("C", bound=Scenario)
T = TypeVar("T", bound=Team)
_Team = Team  # class attributes hide the names of the types
_Judge = Judge


class History(NamedTuple):
    """How a team learned.

    Attributes:
        iterations: column of its progress.csv -> [iteration].
        checkups: controller -> column of its checkups.csv -> [checkup].
    """

    iterations: Mapping[str, NDArray[np.float64]]
    checkups: Mapping[str, Mapping[str, NDArray[np.float64]]] = MappingProxyType({})


Histories = Mapping[str, History]
"""By team."""


class Frame(NamedTuple):
    """Contents of a recording of one environment at one moment, besides its vehicles.

    Attributes:
        teams: team -> fields of its `TeamTrack` (taichi_sim/visualisation/recording/episode.py) without the time axis:
            target_n, target_course, slot_n, error_m.
        overlays: drawings (taichi_sim/visualisation/recording/overlays.py), of one frame each, the same by name in
            every frame of an episode.
    """

    teams: Mapping[str, Mapping[str, Tensor]] = MappingProxyType({})
    overlays: tuple[Overlay, ...] = ()


class Mission(Stateful, ABC, Generic[C, T]):
    """A mission in `num_envs` environments; see the module.

    Class attributes: `Config`, the scenario class, derived from `Scenario`; `Teams`, part -> class of a team; `Team`,
    that of all others; `Judge`, which measures its evaluation (rl/judge.py); `make_world`, its world.

    Attributes:
        config: the scenario. world: the simulated world. teams: name -> Team, of the teams that take part.
        steps: int64 [env], decisions since the episode began. generator: source of all random draws of episodes.
        noise: counter of the random numbers of sensors and radio. due: environments of the phase that runs.
        origin: where on the sea (0, 0) is, of a mission that has a place of its own.
        device: where tensors live.
    """

    Config: ClassVar[type[Scenario]] = Scenario
    Team: ClassVar[Callable[..., _Team]] = Team
    Teams: ClassVar[Mapping[str, Callable[..., _Team]]] = MappingProxyType({})
    Judge: ClassVar[type[_Judge]] = Judge
    make_world: ClassVar[Callable[..., World]] = World
    origin: Origin | None = None

    @runtime.torch_at_rest()
    def __init__(
        self, config: C, num_envs: int, *, seed: int, teams: Sequence[str] | None = None, source: Path | None = None
    ):
        """Build the world and begin an episode in every environment.

        Args:
            config: a `Config`. num_envs: environments. seed: of the seas, of what `prepare` makes, of the episodes.
            teams: those that take part besides scripted ones, which all do (taichi_sim/world.py); default all.
            source: the scenario's file, beside which vehicles are found.
        """
        num_envs, seed = whole_number(num_envs, "num_envs", 1), whole_number(seed, "seed")
        self.config, self.num_envs, self.seed, self.source = config, num_envs, seed, source
        if teams is not None:
            teams = names(teams, "teams")
            if not teams:
                raise ValueError(f"teams = []: a mission has some of {', '.join(config.teams)}")
            teams = [*teams, *(name for name in config.scripted if name not in teams)]
        self.world = self.remember(
            self.make_world(config, num_envs, seed=derive_seed(seed, "sea"), teams=teams, source=source)
        )
        self.device = runtime.current().device
        self.generator = self.share(torch.Generator().manual_seed(derive_seed(seed, "episodes")))
        self.steps = self.remember(torch.zeros(num_envs, dtype=torch.int64, device=self.device))
        self.noise, self.keys = self.remember(Noise(num_envs, derive_seed(seed, "sensors"))), self.world.keys
        which = torch.zeros(num_envs, dtype=torch.int32, device=self.device)
        self.due = self.scratch(Due(which, 0, self.steps, self.noise.table))
        self._all = torch.arange(num_envs, device=self.device)
        self.teams: dict[str, T] = self.remember(
            self.make_teams([name for name in self.world.teams if name not in self.world.scripts])
        )
        self.prepare()
        self._begin(self._all)
        self.make(self.made())
        self.divergence = self.remember(Divergence(self, self.world, self.steps))
        self._perceive()

    def _alike(self, num_envs: int) -> "Mission":
        """Another mission of the same scenario, seed, teams and vehicles."""
        with self.world.same_vehicles():
            return type(self)(self.config, num_envs, seed=self.seed, teams=tuple(self.world.teams), source=self.source)

    def made(self) -> tuple[str, ...]:
        """Names of the teams whose classical controllers are in use."""
        return tuple(name for name, team in self.teams.items() if team.uses_controller)

    def make(self, parts: Sequence[str]) -> None:
        """Make the classical controllers of teams `parts`."""
        for name in parts:
            _ = self.teams[name].controller

    def __init_subclass__(cls) -> None:
        """Refuse a method that a team owns, or that has another name, and classes of teams that the mission cannot use.

        `Teams` of a class adds to that of its base.
        """
        super().__init_subclass__()
        refuse_moved(cls, MOVED)
        base = next(kind for kind in cls.__mro__[1:] if issubclass(kind, Mission))
        own, fixed = cls.__dict__.get("Teams", {}), base.part.__func__ is not Mission.part.__func__
        for key, kind in (*own.items(), *((None, kind) for kind in [cls.__dict__.get("Team")] if kind)):
            named = f"{cls.__name__}.Team" if key is None else f"{cls.__name__}.Teams[{key!r}]"
            if fixed and key not in base.Teams:
                parts = ", ".join(map(repr, base.Teams))
                raise TypeError(f"{named}: {base.__name__} has no such team; `Teams` has {parts}")
            like = base.Teams.get(key, base.Team) if key else base.Team
            if isinstance(like, type) and isinstance(kind, type) and not issubclass(kind, like):
                raise TypeError(f"{named}: {kind.__name__} must derive from {like.__module__}.{like.__name__}")
        cls.Teams = MappingProxyType({**base.Teams, **own})

    def __repr__(self) -> str:
        """Scenario, number of environments, time in the episodes, acting teams, sea."""
        done = f"{span(self.steps, 'decisions')} of {self.config.episode_steps}"
        each = ((name, team.fleet) for name, team in self.teams.items())
        teams = (f"{name} ({fleet.count} x {type(fleet.model).__name__})" for name, fleet in each)
        size = f"{number(self.num_envs, 'environment')}, {done}, {', '.join(teams) or 'no teams'}"
        return f"<{type(self).__name__} of {self.config.name!r}: {size};\n {self.world.sea}>"

    # -- what a mission implements ---------------------------------------------------------------------------------

    @classmethod
    def part(cls, config: C, team: str) -> str:
        """The key in `Teams` of a scenario's team. Default: its name."""
        return team

    @classmethod
    def kinds(cls, config: C) -> dict[str, Callable[..., T]]:
        """The class of each team that no script commands: of its part in `Teams`, or else `Team`."""
        parts = {name: cls.part(config, name) for name in config.teams if name not in config.scripted}
        if cls.part.__func__ is not Mission.part.__func__:
            parts = {name: part for name, part in parts.items() if part in cls.Teams}
        elif unused := cls.Teams.keys() - parts.values():
            raise ConfigError(
                f"{cls.__name__}.Teams: {config.name} has no team {', '.join(map(repr, sorted(unused)))}; there are "
                f"{', '.join(map(repr, parts))}"
            )
        return {name: cls.Teams.get(part, cls.Team) for name, part in parts.items()}  # pyright: ignore[reportReturnType]

    def make_teams(self, names: Sequence[str]) -> dict[str, T]:
        """Make the teams `names`, whose fleets are in the world. Default: of their `kinds`."""
        kinds = self.kinds(self.config)
        return {name: kinds[name](self, name) for name in names}

    def prepare(self) -> None:
        """Make what all episodes share (tracks, obstacles, starts), once, before the first `reset`."""

    @abstractmethod
    def begin(self, envs: Tensor, **where: Tensor) -> None:
        """Place the vehicles of environments `envs` [n], whose sea, time and wind have been drawn (`world.place`).

        `where` holds the additional keyword arguments of `reset`.
        """

    def move(self, due: Due) -> None:
        """Move everything that is not a vehicle, after the world has stepped."""

    def truth(self, due: Due) -> None:
        """Measure what is, where it is `due`: after a step, and where an episode has begun. Default: each team's."""
        for team in self.teams.values():
            team.truth(due)

    def perceive(self, due: Due) -> None:
        """Read instruments and look. Default: each team's `perceive`."""
        for team in self.teams.values():
            team.perceive(due)

    def exchange(self, due: Due) -> None:
        """Send and receive messages. Default: each team's `exchange`."""
        for team in self.teams.values():
            team.exchange(due)

    def conclude(self, due: Due) -> None:
        """Update what vehicles know. Default: each team's `conclude`."""
        for team in self.teams.values():
            team.conclude(due)

    def imagined(self, team: T) -> "Mission | None":
        """Return the model in which an honest planner (rl/planning) tries plans of a team: a mission with as many
        environments.

        It has nominal vehicles and contains only what the team knows. Default: None, there is no such model.
        """
        return None

    def believe(self, team: T) -> None:
        """Write what `team` of the real mission knows now into this mission, which `imagined` has built."""
        raise NotImplementedError

    def notice(self, team: T) -> None:
        """See what `team` of the real mission knows in each decision, before `believe`, for models with a memory."""

    @classmethod
    def piloted(cls, config: C, team: str) -> C | None:
        """The scenario in which a companion of real vehicles (rl/adapters/pilot) builds what `team` observes: it
        contains what telemetry does not tell, and no errors besides. Default: None, there is none.
        """
        return None

    def course(self, team: T) -> tuple[Tensor, Tensor] | None:
        """Place [env, 2] (m) and direction [env] (rad) of the course of `team` now, which a companion lays on a sea.

        Default: there is none. North is north then, and heights are above that of the last vehicle that is followed.
        """
        return None

    def join(self, team: T, place: Tensor) -> None:
        """Let the course of `team` begin where it is nearest to `place` [2] (m), of a mission with an `origin`."""

    def hear(self, team: T, vessels: Tensor) -> None:
        """Take what a companion has heard of ships by AIS: places now and velocities (north, east, m, m/s), length and
        beam (m), age of the report (s), `vessels` [n, 7], the nearest first. Default: nobody listens.
        """

    def followed(self, team: T) -> Mapping[str, float]:
        """Other teams of which a companion of `team` must know each vehicle by telemetry, one for each of `team`; from
        how near it (m) a vehicle may begin. Default: none.
        """
        return {}

    # -- what others use -------------------------------------------------------------------------------------------

    @classmethod
    def one_each(cls, config: C, episodes: int) -> C:
        """The scenario with a separate sea (and separate entries of every other pool) for each of `episodes`."""
        return config.model_copy(update={"sea": config.sea.model_copy(update={"realisations": episodes})})

    def begin_each(self) -> None:
        """Begin an episode in every environment: environment e uses sea e, and entry e of every pool of `one_each`."""
        self.reset(seas=self._all % self.world.sea.num_seas)

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Episode | None, config: C) -> None:
        """Write pictures of a training and of an episode into `out`."""

    def frame(self, env: int) -> Frame:
        """Contents of a recording of environment `env` now, besides its vehicles; they depend on the state alone."""
        return Frame()

    def scene(self, env: int) -> Scene | None:
        """Fixed objects of environment `env` in this episode; None: there are none."""
        return None

    # -- what every mission has ------------------------------------------------------------------------------------

    @runtime.torch_at_rest()
    def step(
        self,
        actions: Mapping[str, Action | Policy],
        *,
        begin: bool = True,
        last: bool = False,
        observe: Iterable[str] | None = None,
        judged: Callable[[Step], object] | None = None,
    ) -> Step:
        """Take one decision in every environment; environments whose episode ends begin anew.

        Args:
            actions: team -> actions of its policy [env, vehicle, `Team.action_names`] in [-1, 1], or a policy, which
                acts when all given actions have been checked. `VehicleActions` are those of the vehicle model instead.
            begin: whether environments begin anew; otherwise they go on as they are.
            last: whether to return the last observations of episodes, too.
            observe: teams that are observed. Default: all.
            judged: is called with the rewards and endings before any environment begins anew.

        Raises:
            ValueError: for a wrong shape or an action that is not finite; nothing has moved then.
        """
        taken, teams = self.act(actions), self.teams if observe is None else tuple(observe)
        gone = self._move(self.world.advance(taken))
        step = self._judge(gone)
        if judged is not None:
            judged(step)
        rows, final = step.over.nonzero().flatten(), None
        if last and len(rows):
            self._perceive()
            final = self.observations(teams)
        if begin and len(rows):
            self.divergence.begin(rows)
            self._begin(rows)
            if final is None:  # those that go on are to perceive, too
                self.due.which.clamp_(min=GOES_ON)
                self._are_due(self.num_envs)
        if begin or final is None:
            self._perceive()
        return step._replace(observations=self.observations(teams), last=final)

    def drive(self, actions: Mapping[str, Tensor | ArrayLike], *, begin: bool = True) -> Step:
        """`step` by actions of the vehicle models, team -> [env, vehicle, `Vehicle.action_names`] in [-1, 1]."""
        return self.step({name: VehicleActions(values) for name, values in actions.items()}, begin=begin)

    def act(self, actions: Mapping[str, Action | Policy]) -> dict[str, Tensor]:
        """Vehicle actions of each team for the `actions` of `step`.

        Raises:
            ValueError: for a wrong shape or an action that is not finite; no policy has acted then.
        """
        teams, given = self.teams, self.world.by_team(actions)
        checked = {
            name: teams[name].checked(action) if name in teams
            else self.world.checked_action(name, cast(Tensor, action))  # of a team that a script commands
            for name, action in given.items() if not callable(action)
        }  # fmt: skip
        acted = {name: policy(teams[name]) for name, policy in given.items() if callable(policy)}
        checked |= {name: teams[name].checked(action) for name, action in acted.items()}
        own = {name: teams[name].taken(checked[name]) for name in given if name in teams}
        return {name: own[name] if name in own else cast(Tensor, checked[name]) for name in given}

    def _move(self, taken: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Count a decision after which vehicles have moved by the actions `taken`, move everything else, and measure
        the truth; flags [env, vehicle] of vehicles that have diverged, by team.
        """
        self.steps += 1
        for name, team in self.teams.items():
            team.previous_action, team.action = team.action, taken[name]
        gone = self.divergence.gone()
        self.noise.tick()
        self._all_are(GOES_ON)
        self.move(self.due)
        self.truth(self.due)
        return gone

    def _judge(self, gone: Mapping[str, Tensor]) -> Step:
        ended = {name: team.ended() for name, team in self.teams.items()}
        reward = {name: team.paid(ended[name]) for name, team in self.teams.items()}
        if bool(self.divergence.envs.any()):
            self._end_diverged(ended, reward, gone)
        terminated = reduce(or_, [e.any.any(dim=1) for e in ended.values()])
        truncated = (self.steps >= self.config.episode_steps) & ~terminated
        return Step(reward, ended, terminated, truncated)

    def _perceive(self) -> None:
        self.perceive(self.due)
        self.exchange(self.due)
        self.conclude(self.due)

    def observations(self, teams: Iterable[str] | None = None) -> dict[str, Tensor]:
        """What the vehicles of `teams` (default: all) observe now: team -> [env, vehicle, n], fresh tensors."""
        return {name: self.teams[name].observations() for name in (self.teams if teams is None else teams)}

    def follow(self, states: Mapping[str, Tensor], actions: Mapping[str, Tensor] | None = None) -> None:
        """Take the `states` of vehicles that move elsewhere (rl/adapters/pilot), by team, [env, vehicle, 13]. Contact
        with decks follows from them.

        With the vehicle `actions` by which they have moved, a decision has passed: as `step`, but the world does not
        move, and nobody is judged. Without, episodes begin there.
        """
        with runtime.torch_at_rest():
            for name, state in states.items():
                fleet = self.world.teams[name]
                fleet.state.copy_(state)
                fleet.update()
            self.world.contacts.suppose(TOUCHES)
            if actions is None:
                self.measure_anew()
            else:
                self._move(actions)
                self._perceive()

    def _all_are(self, which: int) -> None:
        """Make all environments due."""
        self.due.which.fill_(which)
        self._are_due(self.num_envs)

    def _are_due(self, count: int) -> None:
        self.due = Due(self.due.which, count, self.steps, self.noise.table)

    def measure_anew(self) -> None:
        """Measure and perceive everywhere, as if episodes began, after somebody has written states."""
        self._all_are(BEGINS)
        self.truth(self.due)
        self._perceive()

    def _end_diverged(self, ended: dict[str, Endings], reward: dict[str, Tensor], gone: Mapping[str, Tensor]) -> None:
        """End the episodes of environments that were put to rest for all vehicles, with a reward of -1 for those that
        have diverged (`gone`) and of 0 for the others: no other is defined there.
        """
        envs = self.divergence.envs.unsqueeze(1)
        for name, team in self.teams.items():
            flags = {ending: flag & ~envs for ending, flag in ended[name].items()}
            ended[name] = Endings({**flags, DIVERGED: envs | team.fleet.never})
            reward[name] = reward[name].masked_fill(envs, 0.0)
            if name in gone:
                reward[name] = reward[name].masked_fill(gone[name], -1.0)
        self.divergence.envs = torch.zeros_like(self.divergence.envs)

    @runtime.torch_at_rest()
    def reset(self, envs: Envs | None = None, *, seas: Tensor | None = None, **where: Tensor) -> None:
        """Begin new episodes in environments `envs` (numbers [n], or a bool mask [env]; default: all), on `seas` [n]
        (default: random ones); `where` goes to `begin`.

        Raises:
            ValueError: for environments or seas that do not exist, environments that are named twice, or an array of
                whole numbers that may be meant as a mask; nothing has changed then.
        """
        rows: Tensor = self._all if envs is None else environments(envs, self.num_envs)
        drawn = None
        if seas is not None:
            drawn = environments(seas, self.world.sea.num_seas, "seas", whole=True, twice=True, one="sea")
            if len(drawn) != len(rows):
                raise ValueError(f"{len(drawn)} seas for {len(rows)} environments")
        if where:
            inspect.signature(self.begin).bind(rows, **where)  # a TypeError before anything moves
        if len(rows):
            self.divergence.begin(rows)
            self._begin(rows, drawn, **where)
            self._perceive()

    def _begin(self, envs: Tensor, seas: Tensor | None = None, **where: Tensor) -> None:
        """Begin episodes in environments `envs` [n], and measure the truth there."""
        n = len(envs)
        self.steps[envs] = 0
        drawn = self.draw(self.world.sea.num_seas, n)
        self.world.env_sea[envs] = (drawn if seas is None else seas).to(torch.int32)
        begin = torch.rand(n, generator=self.generator, dtype=torch.float64) * TIME_SPAN
        self.world.time[envs] = begin.to(self.device)
        self.world.renew(envs)
        self.due.which.zero_()
        self.due.which[envs] = BEGINS
        self._are_due(n)
        self.begin(envs, **where)
        for team in self.teams.values():
            team.action = team.action.index_fill(0, envs, 0.0)  # not in place: it may be a caller's tensor
        self.truth(self.due)

    def place(self, team: str, envs: Tensor, place: Tensor, heading: Tensor, surge: Tensor | float = 0.0) -> None:
        """Place the vehicles of a team in environments `envs` [n], level, for `begin`; see `World.place`.

        Args:
            place: [n, vehicle, 2 or 3] NED, m. heading: [n, vehicle], rad. surge: speed ahead, [n, vehicle] or one,
                m/s.
        """
        self.world.place(team, envs, level_states(place, heading, surge))

    def scatter(self, team: str, envs: Tensor, within: float) -> None:
        """Place the vehicles of a team in environments `envs` [n], at rest, anywhere within `within` (m) north and east
        of the origin, heading anywhere, for `begin`.
        """
        draw = torch.rand((len(envs), self.teams[team].fleet.count, 3), generator=self.generator)
        self.place(team, envs, within * (2 * draw[..., :2] - 1), 2 * math.pi * draw[..., 2])

    def reseed(self, seed: int) -> None:
        """Make the draws of later resets depend on `seed` alone; the seas and what `prepare` made stay."""
        seed = whole_number(seed, "seed")
        self.generator.manual_seed(derive_seed(seed, "episodes"))
        self.world.reseed(derive_seed(seed, "world"))
        self.noise.restart(derive_seed(seed, "sensors"))

    def draw(self, limit: int, n: int) -> Tensor:
        """Draw whole numbers below `limit`, int64 [n]."""
        return torch.randint(limit, (n,), generator=self.generator).to(self.device)
