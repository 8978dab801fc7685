"""The contract of a mission: all that stages, Gymnasium, evaluation and recordings may use.

A scenario file names its mission (`mission = "formation"`, a package of rl/missions, or a user's `module:Class`). The
class derives from `Mission` and implements `begin`, `observe` and `reward`; every other method has a default here.
A mission owns a `World` with any number of teams. Data of a team are torch tensors [env, vehicle, ...].

    step     the world moves -> `measure` -> `endings` -> `reward`; adapters, not the mission, reset environments
    reset    a sea, a time and a wind are drawn -> `begin` places the vehicles -> `measure_again`

Observation terms are named: `observe` returns an ordered dictionary. Checkpoints and exported policies store names and
widths. A policy refuses observations other than those of its training, and names the difference (learn/policy.py).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from rl.divergence import Divergence, NotFiniteError
from rl.judge import Judge
from rl.scenario import Scenario, derive_seed
from rl.team import Controller, ControllerError, Team
from taichi_sim.arguments import Envs, environments, whole_number
from taichi_sim.config.base import number, span
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import Noise
from taichi_sim.recording.episode import Episode, Scene
from taichi_sim.recording.overlays import Overlay
from taichi_sim.state import Snapshot, Stateful
from taichi_sim.world import World

__all__ = ["COLLIDED", "DIVERGED", "ControllerError", "Endings", "Frame", "Histories", "History", "Mission", "Step",
           "Team"]  # fmt: skip

TIME_SPAN = 3600.0  # s: an episode begins at a random time of its sea
COLLIDED, DIVERGED = "collided", "diverged"  # endings that other modules know, too

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


class Endings(dict[str, Tensor]):
    """Why a team's vehicles ended in a step: name -> bool [env, vehicle]. They are not changed afterwards; `any` joins
    them.
    """

    def __init__(self, flags: Mapping[str, Tensor]):
        """Store the flags."""
        super().__init__(flags)
        self.any = reduce(or_, self.values())


class Step(NamedTuple):
    """Result of one decision; dictionaries are keyed by team."""

    reward: dict[str, Tensor]  # [env, vehicle]
    endings: dict[str, Endings]  # [env, vehicle] flags
    terminated: Tensor  # [env]: some vehicle's episode ended by what happened
    truncated: Tensor  # [env]: time is up, and nothing happened

    def __repr__(self) -> str:
        """Mean reward and endings of each team, and how many environments are over."""
        teams = []
        for name, reward in self.reward.items():
            why = ", ".join(f"{int(flag.sum())} {ending}" for ending, flag in self.endings[name].items() if flag.any())
            teams.append(f"{name} is paid {float(reward.double().mean()):.3g} on average ({why or 'none ended'})")
        terminated, truncated = int(self.terminated.sum()), int(self.truncated.sum())
        over = f"{terminated} terminated, {truncated} truncated of {number(len(self.truncated), 'environment')}"
        return f"<Step: {'; '.join(teams)};\n {over}>"


class Frame(NamedTuple):
    """Contents of a recording of one environment at one moment, besides its vehicles.

    Attributes:
        teams: team -> fields of its `TeamTrack` (taichi_sim/recording/episode.py) without the time axis: target_n,
            target_course, slot_n, error_m.
        overlays: drawings (taichi_sim/recording/overlays.py), of one frame each, the same by name in every frame of an
            episode.
    """

    teams: Mapping[str, Mapping[str, Tensor]] = MappingProxyType({})
    overlays: tuple[Overlay, ...] = ()


class Mission(Stateful, Generic[C, T]):
    """A mission in `num_envs` environments; see the module.

    Class attributes: `Config`, the scenario class, derived from `Scenario`; `logged`, the names that `log` returns;
    `Team`, the class of the entries of `teams`; `Judge`, which measures its evaluation (rl/judge.py).

    Attributes:
        config: the scenario. world: the simulated world. teams: name -> Team, of the teams that take part.
        steps: int64 [env], decisions since the episode began. generator: source of all random draws of episodes.
        noise: counter of the random numbers of sensors and radio. which: int32 [env], the environments that are to be
            measured: 1 after a step, 2 as an episode begins, 0 not at all. program: the Taichi program in which it was
        made, and with which alone it works. device: where tensors live.
    """

    Config: ClassVar[type[Scenario]] = Scenario
    logged: ClassVar[tuple[str, ...]] = ()
    Team: ClassVar[Callable[..., _Team]] = Team
    Judge: ClassVar[type[_Judge]] = Judge

    STATE: tuple[str, ...] = ("world", "steps", "teams", "which", "noise", "divergence")
    SHARED: tuple[str, ...] = ("generator",)

    @runtime.own_settings()
    def __init__(
        self, config: C, num_envs: int, *, seed: int, teams: Sequence[str] | None = None, source: Path | None = None
    ):
        """Build the world and begin an episode in every environment.

        Args:
            config: a `Config`. num_envs: environments. seed: of the seas, of what `prepare` makes, of the episodes.
            teams: those that take part besides scripted ones, which all do (taichi_sim/script.py); default all.
            source: the scenario's file, beside which vehicles are found.
        """
        num_envs, seed = whole_number(num_envs, "num_envs", 1), whole_number(seed, "seed")
        self.config, self.num_envs, self.seed, self.source = config, num_envs, seed, source
        if teams is not None:
            teams = [*teams, *(name for name in config.scripted if name not in teams)]
        self.world = World(config, num_envs, seed=derive_seed(seed, "sea"), teams=teams, source=source)
        self.program, self.device = self.world.program, self.world.program.device
        self.generator = torch.Generator().manual_seed(derive_seed(seed, "episodes"))
        self.steps = torch.zeros(num_envs, dtype=torch.int64, device=self.device)
        self.which = torch.zeros(num_envs, dtype=torch.int32, device=self.device)
        self.noise = Noise(num_envs, derive_seed(seed, "sensors"))
        self._all = torch.arange(num_envs, device=self.device)
        self.teams: dict[str, T] = self.make_teams(
            [name for name in self.world.teams if name not in self.world.scripts]
        )
        self.prepare()
        self._reset(self._all, None, {})
        self.divergence = Divergence(self, self.world, self.device)

    def _alike(self, num_envs: int) -> "Mission":
        """Another mission of the same scenario, seed and teams."""
        other = type(self)(self.config, num_envs, seed=self.seed, teams=tuple(self.world.teams), source=self.source)
        other._use_controllers({name for name, team in self.teams.items() if team._in_use is not None})
        return other

    def restore(self, saved: Snapshot) -> None:
        """Go back to a snapshot of this mission, or of one of the same scenario and seed.

        Raises:
            StateError: for a snapshot of another mission, number of environments, or version; nothing is written then.
        """
        paths = saved.values if isinstance(saved, Snapshot) else ()
        self._use_controllers({name for name in self.teams if any(f".teams[{name!r}]._in_use" in p for p in paths)})
        super().restore(saved)

    def _use_controllers(self, names: set[str]) -> None:
        """Make the classical controllers of these teams, so that a snapshot can restore their memory."""
        for name in names:
            getattr(self.teams[name], "controller")  # noqa: B009

    def __repr__(self) -> str:
        """Scenario, number of environments, time in the episodes, acting teams, sea."""
        done = f"{span(self.steps, 'decisions')} of {self.config.episode_steps}"
        each = ((name, team.fleet) for name, team in self.teams.items())
        teams = (f"{name} ({fleet.count} x {type(fleet.model).__name__})" for name, fleet in each)
        size = f"{number(self.num_envs, 'environment')}, {done}, {', '.join(teams) or 'no teams'}"
        return f"<{type(self).__name__} of {self.config.name!r}: {size};\n {self.world.sea}>"

    # -- what a mission implements ---------------------------------------------------------------------------------

    def make_teams(self, names: Sequence[str]) -> dict[str, T]:
        """Make the teams `names`, whose fleets are in the world. Default: a `Team` each."""
        return {name: self.Team(self, name) for name in names}  # pyright: ignore[reportReturnType]

    def prepare(self) -> None:
        """Make what all episodes share (tracks, obstacles, starts), once, before the first `reset`."""

    def begin(self, envs: Tensor, **where: Tensor) -> None:
        """Place the vehicles of environments `envs` [n], whose sea, time and wind have been drawn (`world.place`).

        `where` holds the additional keyword arguments of `reset`.
        """
        raise NotImplementedError

    def observe(self, team: T) -> dict[str, Tensor]:
        """Observations of each vehicle of a team for its next decision: term -> [env, vehicle, n], of order one."""
        raise NotImplementedError

    def reward(self, team: T, ended: Endings) -> Tensor:
        """Reward of each vehicle of a team for the last step, [env, vehicle]."""
        raise NotImplementedError

    def plan_cost(self, team: T, ended: Tensor) -> Tensor:
        """Cost of the last step for each vehicle, by which plans of a team are compared (rl/planning), [env, vehicle].

        `ended` bool [env, vehicle]: vehicles that ended in this step. Default: minus the reward while a vehicle goes
        on; afterwards only the penalty that the reward contains.
        """
        nothing = torch.zeros_like(ended)
        return -self.reward(team, Endings({COLLIDED: ended, DIVERGED: nothing}))

    def imagined(self, team: T) -> "Mission[C, T] | None":
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

    def measure(self) -> None:
        """Read the world after a step: move targets, compute errors, sense."""

    def measure_again(self, envs: Tensor) -> None:
        """Measure environments `envs` [n] that have begun anew, and forget what belonged to their last episode."""
        self.measure()

    def endings(self, team: T) -> dict[str, Tensor]:
        """Endings of this mission for a team, in addition to the general ones: name -> bool [env, vehicle]."""
        return {}

    # -- what others use -------------------------------------------------------------------------------------------

    def log(self, team: T, step: Step) -> dict[str, Tensor]:
        """Numbers of a step for the training's history: name -> a scalar, called after `reward`."""
        return {}

    def info(self, team: T) -> dict[str, Tensor]:
        """Entries of Gymnasium's info for a team now, besides its endings: name -> [env, vehicle]."""
        return {}

    def controller(self, team: T) -> Controller | None:
        """A classical controller for a team, a policy built from the vehicle model; None if there is none.

        Default: the controller that the vehicle itself offers (`Vehicle.controller`).
        """
        kind = team.fleet.model.controller
        return None if kind is None else kind(team.fleet.model)

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

    def step(self, actions: Mapping[str, Tensor | ArrayLike]) -> Step:
        """Advance one decision interval; `actions[team]` [env, vehicle, action] in [-1, 1] are actions of the vehicle
        models.

        Raises:
            ValueError: for a wrong shape or an action that is not finite; nothing has moved then.
        """
        with runtime.torch_at_rest():
            return self._step(actions)

    def _step(self, actions: Mapping[str, Tensor | ArrayLike]) -> Step:
        taken = self.world.step(actions)
        self.steps += 1
        for name, team in self.teams.items():
            team.previous_action, team.action = team.action, taken[name]
        gone = self.divergence.gone()
        self.which.fill_(1)
        self.noise.tick()
        self.measure()
        ended = {name: self._ended(team) for name, team in self.teams.items()}
        reward = {name: self._paid(team, ended[name]) for name, team in self.teams.items()}
        if bool(self.divergence.envs.any()):
            self._end_diverged(ended, reward, gone)
        terminated = reduce(or_, [e.any.any(dim=1) for e in ended.values()])
        truncated = (self.steps >= self.config.episode_steps) & ~terminated
        return Step(reward, ended, terminated, truncated)

    def _ended(self, team: T) -> Endings:
        fleet = team.fleet
        return Endings({**self.endings(team), **fleet.model.endings(fleet, self.world), DIVERGED: fleet.never})

    def _paid(self, team: T, ended: Endings) -> Tensor:
        """Reward of each vehicle, finite."""
        reward = self.reward(team, ended)
        return self.finite(reward, lambda: f"the reward of {team.name!r}", lambda: self.reward(team, ended))

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

    def infos(self, team: T) -> dict[str, Tensor]:
        """Entries of `info`, finite."""
        return {
            key: self.finite(value, lambda key=key: f"{key!r} of {team.name!r}", lambda key=key: self.info(team)[key])
            for key, value in self.info(team).items()
        }

    def finite(self, values: Tensor, about: Callable[[], str], again: Callable[[], Tensor]) -> Tensor:
        """Return `values` [env, ...], finite: where they are not, their environment is put to rest, and they are
        computed `again`.

        Raises:
            NotFiniteError: if they still are not finite; `about` says what they are.
        """
        if math.isfinite(values.sum()) or bool(values.isfinite().all()):
            return values
        self.divergence.rest(~values.isfinite().flatten(1).all(1), f"{about()} is not finite")
        values = again()
        if not bool(values.isfinite().all()):
            raise NotFiniteError(
                f"{about()} is not finite in environments "
                f"{(~values.isfinite().flatten(1).all(1)).nonzero().flatten().tolist()[:5]}, though the state of all "
                f"vehicles is: the fault is in what {type(self).__name__} computes"
            )
        return values

    @runtime.torch_at_rest()
    def reset(self, envs: Envs | None = None, *, seas: Tensor | None = None, **where: Tensor) -> None:
        """Begin new episodes in environments `envs` (numbers [n], or a bool mask [env]; default: all), on `seas` [n]
        (default: random ones); `where` goes to `begin`.

        Raises:
            ValueError: for environments or seas that do not exist, environments that are named twice, or an array of
                whole numbers that may be meant as a mask; nothing has changed then.
        """
        self.program.check()
        rows: Tensor = self._all if envs is None else environments(envs, self.num_envs)
        drawn = None
        if seas is not None:
            drawn = environments(seas, self.world.sea.num_seas, "seas", whole=True, twice=True, one="sea")
            if len(drawn) != len(rows):
                raise ValueError(f"{len(drawn)} seas for {len(rows)} environments")
        if len(rows):
            self.divergence.begin(rows)
            self._reset(rows, drawn, where)

    def _reset(self, envs: Tensor, seas: Tensor | None, where: dict[str, Tensor]) -> None:
        n = len(envs)
        self.steps[envs] = 0
        drawn = self.draw(self.world.sea.num_seas, n)
        self.world.env_sea[envs] = (drawn if seas is None else seas).to(torch.int32)
        begin = torch.rand(n, generator=self.generator, dtype=torch.float64) * TIME_SPAN
        self.world.time[envs] = begin.to(self.device)
        self.world.renew(envs)
        self.which.zero_()
        self.which[envs] = 2
        self.begin(envs, **where)
        for team in self.teams.values():
            team.action = team.action.index_fill(0, envs, 0.0)  # not in place: it may be a caller's tensor
        self.measure_again(envs)

    def reseed(self, seed: int) -> None:
        """Make the draws of later resets depend on `seed` alone; the seas and what `prepare` made stay."""
        seed = whole_number(seed, "seed")
        self.generator.manual_seed(derive_seed(seed, "episodes"))
        self.world.reseed(derive_seed(seed, "world"))
        self.noise.restart(derive_seed(seed, "sensors"))

    def draw(self, limit: int, n: int) -> Tensor:
        """Draw whole numbers below `limit`, int64 [n]."""
        return torch.randint(limit, (n,), generator=self.generator).to(self.device)
