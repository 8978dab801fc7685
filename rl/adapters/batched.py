"""All vehicles of a mission in thousands of environments, as torch tensors: for learners that train whole teams.

Each dictionary has one entry for each team that acts. Vehicle 0 is the leader.

    observations  [env, vehicle, n], of order one; `observation_names[team]` names the n
    actions       [env, vehicle, a], tensors or arrays, clipped to [-1, 1]; `action_names[team]` names the a
    rewards       [env, vehicle]
    terminated    bool [env, vehicle]: this vehicle's episode ended
    truncated     bool [env, vehicle]: the episode is over for another reason: its time is up, or the episode of another
                  vehicle of any team ended
    infos         name -> [env, vehicle]: the mission's infos (`distance`, m, from the slot) and the reasons why
                  vehicles ended, at the end of the step and before a new episode begins
    last          the observations with which episodes ended, where `step` is asked for them and some have

The episode of an environment is over for all its vehicles at once: when its time is up or when any vehicle's episode
ends.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from torch import Tensor

from rl.mission import Mission, Policy, Team, VehicleActions
from rl.missions import load_scenario, make_mission
from rl.runs.folder import CONFIG, RunError, load_config
from rl.scenario import Scenario
from taichi_sim.config.arguments import ActionError, Envs, environments, numbers, whole_number
from taichi_sim.config.explain_errors import nearly
from taichi_sim.config.io import find_config
from taichi_sim.config.plugins import is_plugin
from taichi_sim.errors import refuse
from taichi_sim.kernels import runtime

ByTeam = dict[str, Tensor]
ABSENT = "absent"
OTHERS = (
    f"{ABSENT!r}, 'constant', 'classical', 'pretrained', FILE.onnx, module:function, or the path of a run folder or of "
    "a checkpoint in one"
)


class Stepped(NamedTuple):
    """The result of one decision, by team; the module describes each field."""

    observations: ByTeam
    rewards: ByTeam
    terminated: ByTeam
    truncated: ByTeam
    infos: dict[str, dict[str, Tensor]]
    last: ByTeam | None = None


class BatchedEnv:
    """`num_envs` environments that step together; the module describes the tensors.

    With `autoreset`, an environment whose episode is over begins anew in the same step and returns the first
    observations of its next episode; `step(..., last=True)` returns the last ones of the episode, too. Without
    `autoreset`, the environment returns these and waits for `reset(envs=...)`.

    The constructor's seed determines the worlds (courses, obstacles, seas, starts). `reset(seed=...)` determines which
    of them the following episodes use. The same two seeds, `num_envs` and actions give the same bits.

    Attributes:
        mission: the simulated mission (rl/mission.py).
        num_envs: number of environments. device: where tensors live.
        vehicles: team -> number of vehicles, for the teams that act. over: bool [env], episodes that are over.
        observation_names, action_names: team -> names. num_states: width of `state`.
    """

    @runtime.own_settings()
    def __init__(
        self,
        scenario: str | Path = "escort",
        num_envs: int = 1,
        *,
        teams: str | Sequence[str] | None = None,
        others: Mapping[str, str | Path] | str | Path | None = None,
        overrides: Iterable[str] = (),
        seed: int | None = None,
        autoreset: bool = True,
    ):
        """Build the mission of a scenario and begin an episode in every environment.

        Args:
            scenario: a TOML file or the name of a shipped scenario.
            num_envs: number of environments.
            teams: the teams that act. Default: all teams that the scenario's stages train (without stages: all teams)
                and that `others` does not name.
            others: team -> policy: "absent" (not simulated), "constant" (every command 0), "classical", a source
                of rl/learn/policy_sources.py ("pretrained", "FILE.onnx", a run's folder), or a checkpoint in a run's
                folder. One such policy is for all that `teams` does not name. A team that neither names is absent.
            overrides: KEY=VALUE each.
            seed: of the worlds; default the scenario's.
            autoreset: described above.
        """
        num_envs = whole_number(num_envs, "num_envs", 1)
        seed = None if seed is None else whole_number(seed, "seed")
        config, source = load_scenario(scenario, overrides), find_config(scenario)
        acting, others = _parts(config, teams, {} if others is None else others)
        there = [name for name in config.teams if name in acting or others.get(name, ABSENT) != ABSENT]
        worlds_seed = config.seed if seed is None else seed
        self.mission: Mission = make_mission(config, num_envs, seed=worlds_seed, teams=there, source=source)
        self.num_envs, self.autoreset, self.device = num_envs, autoreset, self.mission.device
        self._acting = {name: self.mission.teams[name] for name in acting}
        self._others = {
            name: policy_of_other(others[name], team, config)
            for name, team in self.mission.teams.items()
            if name not in acting
        }
        self.vehicles = {name: team.fleet.count for name, team in self._acting.items()}
        self.action_names = {name: team.action_names for name, team in self._acting.items()}
        self.observation_names = {name: team.observation_names for name, team in self._acting.items()}
        self.over = torch.zeros(num_envs, dtype=torch.bool, device=self.device)
        self._observed = self.mission.observations(self._acting)
        self.num_states = self.state().shape[1]

    @runtime.torch_at_rest()
    def reset(self, seed: int | None = None, *, envs: Envs | None = None) -> ByTeam:
        """Begin new episodes in environments `envs` and return observations.

        Episodes follow one random sequence. It starts from the constructor's seed; `seed` starts it anew.

        Args:
            seed: a whole number, or None to go on.
            envs: a bool mask [env], or numbers of environments [n]; default all.

        Raises:
            ValueError: for a seed that is none, environments that do not exist or are named twice, or an array of whole
                numbers that may be meant as a mask (`mask.bool()` is one). Nothing has begun.
        """
        seed = None if seed is None else whole_number(seed, "seed")
        begun = torch.ones_like(self.over)
        if envs is not None:
            begun = torch.zeros_like(begun).index_fill_(0, environments(envs, self.num_envs), True)
        if seed is not None:
            self.mission.reseed(seed)
        self.mission.reset(begun)
        self.over = self.over & ~begun
        self._observed = self.mission.observations(self._acting)
        return self.observations

    def step(self, actions: Mapping[str, Tensor | np.ndarray], *, last: bool = False) -> Stepped:
        """Take one decision in every environment; with `last`, return the last observations of episodes, too.

        Raises:
            ValueError: if a team is missing or unknown, or an action has a wrong shape or is not finite. Nothing has
                moved.
            ResetNeeded: if an episode is over and autoreset is off.
            ProgramError: if another Taichi program runs than when the environments were made.
        """
        if self.over.any():
            raise ResetNeeded(f"the episodes of environments {self.over.nonzero().squeeze(1).tolist()} are over")
        return self.decide(actions, last=last)

    def decide(self, actions: Mapping[str, Tensor | np.ndarray], *, last: bool = False) -> Stepped:
        """`step`, also where episodes are over."""
        if not isinstance(actions, Mapping) or set(actions) != set(self._acting):
            given = sorted(actions) if isinstance(actions, Mapping) else type(actions).__name__
            raise ActionError(f"actions are for {given}, expected is one tensor for each of {[*self._acting]}")
        infos: dict[str, dict[str, Tensor]] = {}
        step = self.mission.step(
            {**self._others, **actions}, begin=self.autoreset, last=last, observe=self._acting,
            judged=lambda _: infos.update(self.infos()),
        )  # fmt: skip
        self._observed = step.observations
        terminated = {name: step.endings[name].any.clone() for name in self._acting}
        truncated = {name: step.over.unsqueeze(1) & ~ended for name, ended in terminated.items()}
        infos = {
            name: told | {key: flags.clone() for key, flags in step.endings[name].items()}
            for name, told in infos.items()
        }
        if not self.autoreset:
            self.over = step.over
        rewards = {name: step.reward[name].clone() for name in self._acting}
        return Stepped(self.observations, rewards, terminated, truncated, infos, step.last)

    def infos(self) -> dict[str, dict[str, Tensor]]:
        """The mission's infos now, by team: name -> [env, vehicle] (copies)."""
        return {name: {key: value.clone() for key, value in of.infos().items()} for name, of in self._acting.items()}

    @runtime.torch_at_rest()
    def state(self) -> Tensor:
        """Privileged information for a central critic, [env, num_states].

        It lists, for each team that acts, all vehicles' observations and then the ground truth that each vehicle does
        not know (`Team.privileged`).
        """
        parts = []
        for name, team in self._acting.items():
            truth = team.privileged
            parts += [self._observed[name]] if truth is None else [self._observed[name], truth]
        return torch.cat([part.flatten(1) for part in parts], dim=1)

    @property
    def observations(self) -> ByTeam:
        """The current observations (copies)."""
        return {name: observed.clone() for name, observed in self._observed.items()}


def _parts(
    config: Scenario, teams: str | Sequence[str] | None, others: Mapping[str, str | Path] | str | Path
) -> tuple[list[str], Mapping[str, str | Path]]:
    """The acting teams in the order of the scenario, and the policies of the others."""
    allowed = [name for name in config.teams if name not in config.scripted]
    if isinstance(others, str | Path):
        named = allowed if teams is None else [teams] if isinstance(teams, str) else teams
        others = {name: others for name in allowed if name not in named}
    if not isinstance(others, Mapping):
        raise ValueError(f"others = {others!r}: a dictionary is expected, team -> {OTHERS}")
    if teams is None:
        teams = [name for name in config.trained or allowed if name not in others]
    acting = [teams] if isinstance(teams, str) else list(teams)
    named = [("teams", name) for name in acting] + [("others", name) for name in others]
    argument, name = next(((argument, name) for argument, name in named if name not in allowed), ("", ""))
    what = f"a script acts for {name!r}" if name in config.scripted else f"there is no team {name!r}"
    hint = f", did you mean {close!r}?" if (close := nearly(name, allowed)) else ""
    both = [name for name in acting if name in others]
    refuse(
        ValueError,
        (argument, f"{argument}: {what}{hint}; allowed are {', '.join(allowed)}"),
        (both, f"others: {', '.join(both)} is also named in teams: it either acts or is one of the others"),
        (not acting, f"teams: none acts; allowed are {', '.join(allowed)}"),
    )
    return [name for name in allowed if name in acting], others


def policy_of_other(other: str | Path, team: Team, config: Scenario) -> Policy:
    """The policy of a simulated `team` that does not learn, by its name in OTHERS (any but "absent")."""
    if other == "constant":
        return lambda team: VehicleActions(torch.zeros_like(team.action))
    if other == "classical":
        from rl.learn.policy import ClassicalPolicy

        policy: Policy = ClassicalPolicy()
    elif str(other) == "pretrained" or str(other).endswith(".onnx") or is_plugin(str(other)):
        from rl.learn.policy_sources import policies_from

        policy = policies_from([str(other)], config, [team.name])[team.name]
    else:
        policy = _trained_policy(Path(other), team.name, config)
    team.checked(policy(team))  # it fits
    return policy


def _trained_policy(path: Path, team: str, config: Scenario) -> Policy:
    """The newest policy of `team` in run folder `path`, or the policy of checkpoint `path`."""
    from rl.learn.policy import TrainedPolicy, checkpoints

    if not path.exists():
        raise ValueError(f"others[{team!r}] = {str(path)!r}: no such choice, folder or file; allowed are {OTHERS}")
    run, saved = (path, checkpoints(path / team)) if path.is_dir() else (path.resolve().parent.parent, [path])
    trained = load_config(run)[0] if path.is_dir() or (run / CONFIG).is_file() else config
    stage = trained.stage_of(team)
    if stage is None or not saved:
        raise RunError(f"{path}: no trained {team} policy (no {team}/model_N.pt, or no stage that describes it)")
    return TrainedPolicy.load(saved[-1], stage)


class Agents:
    """Vehicles as agents (`usv_0` is the leader, `usv_1`, ..., `uav_2`), in the order of the teams.

    Attributes:
        names: of all agents.
        observation_spaces, action_spaces: agent -> Box.
        state_space: of `BatchedEnv.state`, one for all agents.
    """

    def __init__(self, env: BatchedEnv):
        """Name each vehicle of the teams that act."""
        self._rows, self._vehicles = env.num_envs, env.vehicles
        self._place = {f"{team}_{k}": (team, k) for team, count in env.vehicles.items() for k in range(count)}
        self.names = list(self._place)
        observed = {team: (len(names),) for team, names in env.observation_names.items()}
        commanded = {team: (len(names),) for team, names in env.action_names.items()}
        self.observation_spaces = {
            name: Box(-np.inf, np.inf, observed[team], np.float32) for name, (team, _) in self._place.items()
        }
        self.action_spaces = {
            name: Box(-1.0, 1.0, commanded[team], np.float32) for name, (team, _) in self._place.items()
        }
        self.state_space = Box(-np.inf, np.inf, (env.num_states,), np.float32)

    def split(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Convert tensors by team [env, vehicle, ...] to tensors by agent [env, ...]."""
        return {name: values[team][:, k] for name, (team, k) in self._place.items()}

    def split_infos(self, infos: Mapping[str, Mapping[str, Tensor]]) -> dict[str, dict[str, Tensor]]:
        """Convert infos by team (name -> [env, vehicle]) to infos by agent (name -> [env])."""
        return {
            name: {key: value[:, k] for key, value in infos[team].items()} for name, (team, k) in self._place.items()
        }

    def stacked(self, actions: Mapping[str, Tensor | np.ndarray], alone: bool = False) -> ByTeam:
        """Convert actions by agent [env, a], tensors or arrays, to actions by team [env, vehicle, a].

        Those of an environment `alone` are [a].
        """
        if not isinstance(actions, Mapping):
            raise ActionError(f"actions are a {type(actions).__name__}, expected is a dictionary by agent")
        if set(actions) != set(self._place):
            missing, unknown = sorted(set(self._place) - set(actions)), sorted(set(actions) - set(self._place))
            problem = f"{missing} are missing" if missing else f"there is no agent {unknown}"
            raise ActionError(f"actions: {problem}; expected one for each of {', '.join(self.names)}")
        rows: dict[str, list[Tensor]] = {team: [] for team in self._vehicles}
        for name, (team, _) in self._place.items():
            row, shape = numbers(actions[name], f"actions of {name}"), self.action_spaces[name].shape or ()
            shape = shape if alone else (self._rows, *shape)
            if tuple(row.shape) != shape:
                raise ActionError(f"the action of {name} has shape {tuple(row.shape)}, expected {shape}")
            rows[team].append((row[None] if alone else row).double())  # each of a type of its own
        return {team: torch.stack(of_team, dim=1) for team, of_team in rows.items()}
