"""The contract of a mission: what stages, Gymnasium, evaluation and recordings may ask of one, and nothing else.

A scenario file names its mission (`mission = "formation"`, one of rl/missions, or `module:Class` of anybody's). The
class derives from `Mission` and gives `begin`, `observe` and `reward`; what it leaves out has the default written
here. A mission owns a `World` with any number of teams; everything about a team is a torch tensor [env, vehicle, ...].

    step     the world moves -> `measure` -> `endings` -> `reward`; nothing is reset: the adapters decide when
    reset    a sea, a time and a wind are drawn -> `begin` places the vehicles -> `measure_again`

Terms are named: `observe` returns a dictionary, in order. Names and widths travel with checkpoints and exported
policies, and a policy refuses, by name, what it was not trained on (learn/policy.py).
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rl.judge import Judge
from rl.scenario import Scenario
from rl.seeds import derive_seed
from rl.team import Team
from taichi_sim.config.summary import number, span
from taichi_sim.kernels import runtime
from taichi_sim.recording.episode import Scene
from taichi_sim.recording.overlays import Overlay
from taichi_sim.state import Snapshot, Stateful
from taichi_sim.world import World

TIME_SPAN = 3600.0  # s: an episode begins at a random time of its sea
COLLIDED, DIVERGED = "collided", "diverged"  # endings that others than the mission know

Histories = Mapping[str, Mapping[str, NDArray[np.float64]]]
"""team -> column of a stage's progress.csv -> [iterations]."""


class ControllerError(RuntimeError):
    """There is no controller for what a team consists of."""


class Endings(Mapping[str, Tensor]):
    """Why a team's vehicles ended in a step: name -> bool [env, vehicle]."""

    def __init__(self, flags: Mapping[str, Tensor]):
        """Take the flags; they are not to be changed any more."""
        self._flags = dict(flags)
        self.any = reduce(or_, self._flags.values())

    def __getitem__(self, name: str) -> Tensor:
        """Whether it ended a vehicle."""
        return self._flags[name]

    def __iter__(self) -> Iterator[str]:
        """Names, in order."""
        return iter(self._flags)

    def __len__(self) -> int:
        """Number of names."""
        return len(self._flags)


class Step(NamedTuple):
    """What one decision brought; dictionaries are by team."""

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
    """What a recording shows of one environment at one moment, besides its vehicles.

    Attributes:
        teams: team -> fields of its `TeamTrack` (taichi_sim/recording/episode.py) without the time axis: target_n,
            target_course, slot_n, error_m.
        overlays: drawings (taichi_sim/recording/overlays.py), of one frame each, the same by name in every frame of an
            episode.
    """

    teams: Mapping[str, Mapping[str, Tensor]] = MappingProxyType({})
    overlays: tuple[Overlay, ...] = ()


class Mission(Stateful):
    """A mission in `num_envs` environments; see the module.

    Class attributes: `Config`, its scenario, which derives from `Scenario`; `logged`, names in `log`; `Team`, what
    `teams` holds; `Judge`, what its evaluation measures, and how each figure is defined (rl/judge.py).

    Attributes:
        config: the scenario. world: the simulated world. teams: name -> Team, those that take part.
        steps: int64 [env], decisions since the episode began. generator: of all random draws of episodes.
        device: where tensors live.
    """

    Config: ClassVar[type[Scenario]] = Scenario
    logged: ClassVar[tuple[str, ...]] = ()
    Team: ClassVar[Any] = Team
    Judge: ClassVar[Any] = Judge

    STATE: tuple[str, ...] = ("world", "steps", "teams")
    SHARED: tuple[str, ...] = ("generator",)

    def __init__(
        self,
        config: Any,
        num_envs: int,
        *,
        seed: int,
        teams: Sequence[str] | None = None,
        source: Path | None = None,
    ):
        """Build the world and begin an episode in every environment.

        Args:
            config: a `Config`. num_envs: environments. seed: of the seas, of what `prepare` makes, of the episodes.
            teams: those that take part besides scripted ones, which all do (taichi_sim/script.py); default all.
            source: the scenario's file, beside which vehicles are found.
        """
        self.config, self.num_envs, self.seed, self.source = config, num_envs, seed, source
        if teams is not None:
            teams = [*teams, *(name for name in config.scripted if name not in teams)]
        self.world = World(config, num_envs, seed=derive_seed(seed, "sea"), teams=teams, source=source)
        self.device = runtime.current().device
        self.generator = torch.Generator().manual_seed(derive_seed(seed, "episodes"))
        self.steps = torch.zeros(num_envs, dtype=torch.int64, device=self.device)
        self._all = torch.arange(num_envs, device=self.device)
        self.teams: dict[str, Any] = self.make_teams(
            [name for name in self.world.teams if name not in self.world.scripts]
        )
        self.prepare()
        self.reset()

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
        """Make the classical controllers of these teams, so that they can be given a memory."""
        for name in names:
            getattr(self.teams[name], "controller")  # noqa: B009

    def __repr__(self) -> str:
        """Scenario, size, how far the episodes are, teams that decide, sea."""
        done = f"{span(self.steps, 'decisions')} of {self.config.episode_steps}"
        each = ((name, team.fleet) for name, team in self.teams.items())
        teams = (f"{name} ({fleet.count} x {type(fleet.model).__name__})" for name, fleet in each)
        size = f"{number(self.num_envs, 'environment')}, {done}, {', '.join(teams) or 'no teams'}"
        return f"<{type(self).__name__} of {self.config.name!r}: {size};\n {self.world.sea}>"

    # -- what a mission gives --------------------------------------------------------------------------------------

    def make_teams(self, names: Sequence[str]) -> dict[str, Any]:
        """Make the teams `names`, whose fleets are in the world. Default: a `Team` each."""
        return {name: self.Team(self, name) for name in names}

    def prepare(self) -> None:
        """Make what all episodes share (tracks, obstacles, starts), once, before the first `reset`."""

    def begin(self, envs: Tensor, **where: Any) -> None:
        """Place the vehicles of environments `envs` [n], whose sea, time and wind have been drawn (`world.place`).

        `where` is what `reset` was given beside.
        """
        raise NotImplementedError

    def observe(self, team: Any) -> dict[str, Tensor]:
        """What each vehicle of a team is told for its next decision: term -> [env, vehicle, n], of order one."""
        raise NotImplementedError

    def reward(self, team: Any, ended: Endings) -> Tensor:
        """What each vehicle of a team is paid for the last step, [env, vehicle]."""
        raise NotImplementedError

    def plan_cost(self, team: Any, ended: Tensor) -> Tensor:
        """What the last step costs each vehicle of a team whose plans are compared (rl/planning), [env, vehicle].

        `ended` bool [env, vehicle] are those that have just ended. Default: minus the reward of one that goes on, and
        nothing after the end but what the reward says of it.
        """
        nothing = torch.zeros_like(ended)
        return -self.reward(team, Endings({COLLIDED: ended, DIVERGED: nothing}))

    def imagined(self, team: Any) -> "Mission | None":
        """A mission of as many environments in which an honest planner (rl/planning) can try plans of a team: nominal
        craft, nothing that the team does not know. Default: None, there is no way to build one.
        """
        return None

    def believe(self, team: Any) -> None:
        """Make this mission, which `imagined` has built, what `team` of the real one knows now."""
        raise NotImplementedError

    def measure(self) -> None:
        """Read the world after a step: move targets, compute errors, sense."""

    def measure_again(self, envs: Tensor) -> None:
        """The same after environments `envs` [n] have begun anew: what they remember is to be forgotten."""
        self.measure()

    def endings(self, team: Any) -> dict[str, Tensor]:
        """What in this mission ends vehicles of a team, beside what ends them anywhere: name -> bool [env, vehicle]."""
        return {}

    # -- what others ask -------------------------------------------------------------------------------------------

    def log(self, team: Any, step: Step) -> dict[str, Tensor]:
        """Numbers of a step to write to the training's history: name -> a scalar, after `reward`."""
        return {}

    def info(self, team: Any) -> dict[str, Tensor]:
        """What Gymnasium's info says of a team now, besides its endings: name -> [env, vehicle]."""
        return {}

    def controller(self, team: Any) -> Any:
        """A classical controller for a team, built from its model: a policy; None if there is none.

        Default: what the vehicle itself brings (`Vehicle.controller`).
        """
        kind = team.fleet.model.controller
        return None if kind is None else kind(team.fleet.model)

    @classmethod
    def one_each(cls, config: Any, episodes: int) -> Any:
        """The scenario with a sea (and whatever else is drawn from a pool) of its own for each of `episodes`."""
        return config.model_copy(update={"sea": config.sea.model_copy(update={"realisations": episodes})})

    def begin_each(self) -> None:
        """Begin an episode in every environment, number e on sea e (and whatever else `one_each` provides)."""
        self.reset(seas=self._all % self.world.sea.num_seas)

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Any, config: Any) -> None:
        """Write pictures of a training and of an episode into `out`."""

    def frame(self, env: int) -> Frame:
        """What a recording shows of environment `env` now, besides its vehicles. It depends on the state alone."""
        return Frame()

    def scene(self, env: int) -> Scene | None:
        """Fixed objects of environment `env` in this episode; None: there are none."""
        return None

    # -- what every mission has ------------------------------------------------------------------------------------

    def step(self, actions: Mapping[str, Any]) -> Step:
        """Advance one decision interval; `actions[team]` is [env, vehicle, action] in [-1, 1], the vehicles' own.

        Raises:
            ValueError: for a wrong shape or an action that is not finite; nothing has moved then.
        """
        with runtime.torch_at_rest():
            return self._step(actions)

    def _step(self, actions: Mapping[str, Any]) -> Step:
        taken = self.world.step(actions)
        self.steps += 1
        for name, team in self.teams.items():
            team.previous_action, team.action = team.action, taken[name]
        self.measure()
        ended = {name: self._ended(team) for name, team in self.teams.items()}
        reward = {name: self._paid(team, ended[name]) for name, team in self.teams.items()}
        terminated = reduce(or_, [e.any.any(dim=1) for e in ended.values()])
        truncated = (self.steps >= self.config.episode_steps) & ~terminated
        return Step(reward, ended, terminated, truncated)

    def _ended(self, team: Any) -> Endings:
        fleet = team.fleet
        flags = {**self.endings(team), **fleet.model.endings(fleet, self.world)}
        flags.setdefault(DIVERGED, ~fleet.state.sum(-1).isfinite())
        return Endings(flags)

    def _paid(self, team: Any, ended: Endings) -> Tensor:
        """The reward; -1 for a vehicle whose state is not finite, of which nothing can be said."""
        return self.reward(team, ended).masked_fill(ended[DIVERGED], -1.0)

    def reset(self, envs: Tensor | None = None, *, seas: Tensor | None = None, **where: Any) -> None:
        """Begin new episodes in environments `envs` [n] (default: all), on `seas` [n] (default: random ones); `where`
        goes to `begin`.
        """
        rows: Tensor = self._all if envs is None else envs
        if len(rows):
            with runtime.torch_at_rest():
                self._reset(rows, seas, where)

    def _reset(self, envs: Tensor, seas: Tensor | None, where: dict[str, Any]) -> None:
        n = len(envs)
        self.steps[envs] = 0
        drawn = self.draw(self.world.sea.num_seas, n)
        self.world.env_sea[envs] = (drawn if seas is None else seas).to(torch.int32)
        begin = torch.rand(n, generator=self.generator, dtype=torch.float64) * TIME_SPAN
        self.world.time[envs] = begin.to(self.device)
        self.world.renew(envs)
        self.begin(envs, **where)
        for team in self.teams.values():
            team.action = team.action.index_fill(0, envs, 0.0)  # not in place: it may be a caller's tensor
        self.measure_again(envs)

    def reseed(self, seed: int) -> None:
        """Make the draws of later resets depend on `seed` alone; the seas and what `prepare` made stay."""
        self.generator.manual_seed(derive_seed(seed, "episodes"))
        self.world.reseed(derive_seed(seed, "world"))

    def draw(self, limit: int, n: int) -> Tensor:
        """Whole numbers below `limit`, int64 [n]."""
        return torch.randint(limit, (n,), generator=self.generator).to(self.device)
