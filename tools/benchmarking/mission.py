"""The formation mission under the clock: the environment alone, with policies that act, with learning."""

from collections.abc import Callable
from pathlib import Path

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from benchmarking.timing import Case
from rl.learn.env import FormationEnv
from rl.learn.policy import OBS_GROUPS, TrainedPolicy, actor_config
from rl.learn.runner import StageRunner
from rl.missions.formation.controllers import CLASSICAL
from rl.missions.formation.mission import FormationTask
from rl.missions.formation.team import TeamTask
from taichi_sim.config import ScenarioConfig, StageConfig

ACTION_SPREAD = 0.2  # standard deviation of random actions about cruise
ACTION_SETS = 8  # drawn beforehand and taken in turn, so that drawing is not timed
STAGGER_SEED = 7


def begin_anywhere(task: FormationTask) -> FormationTask:
    """Spread the environments over the episode, so that they do not all run out of time in one step."""
    generator = torch.Generator().manual_seed(STAGGER_SEED)
    task.steps.copy_(torch.randint(task.config.episode_steps, (task.num_envs,), generator=generator))
    return task


def decide(task: FormationTask, actions: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """One decision of every vehicle: step, reset what ended, observe."""
    step = task.step(actions)
    task.reset((step.terminated | step.truncated).nonzero().squeeze(1))
    return task.observe()


def cruise(team: TeamTask) -> torch.Tensor:
    """Mean action [action] of the classical controller at the start of an episode: straight on, near cruise."""
    model = team.team.model
    kind = CLASSICAL.get(type(model).__name__)
    if kind is None:
        return torch.zeros(len(team.action_names))
    return kind(model)(team).mean(dim=(0, 1))


def random_decisions(task: FormationTask) -> Callable[[], object]:
    """A function that takes one decision with random actions near cruise."""
    generator = torch.Generator().manual_seed(STAGGER_SEED)
    sets = [
        {
            name: cruise(team) + ACTION_SPREAD * torch.randn(team.action.shape, generator=generator)
            for name, team in task.teams.items()
        }
        for _ in range(ACTION_SETS)
    ]
    turn = iter(range(1 << 62))
    return lambda: decide(task, sets[next(turn) % ACTION_SETS])


def untrained_policy(team: TeamTask, stage: StageConfig) -> TrainedPolicy:
    """A network of the configured size with the weights it would begin training with."""
    example = TensorDict({"policy": team.observe().flatten(0, 1)[:1]}, batch_size=[1])
    options = actor_config(stage)
    options.pop("class_name")
    return TrainedPolicy(MLPModel(example, OBS_GROUPS, "actor", len(team.action_names), **options))


def policy_decisions(task: FormationTask, stages: dict[str, StageConfig]) -> Callable[[], object]:
    """A function that takes one decision of both teams' networks."""
    policies = {name: untrained_policy(team, stages[name]) for name, team in task.teams.items()}
    observed = task.observe()

    def decide_by_policy() -> None:
        nonlocal observed
        observed = decide(task, {name: policies[name].act(seen) for name, seen in observed.items()})

    return decide_by_policy


def environment_cases(config: ScenarioConfig, sizes: tuple[int, ...]) -> list[Case]:
    """Both teams without and with policies, for each number of environments."""
    stages = {name: next((s for s in config.stages.values() if s.team == name), StageConfig(team=name))
              for name in ("usv", "uav")}  # fmt: skip
    agents = config.usv.count + config.uav.count
    cases = []
    for size in sizes:
        for group in ("environment", "inference"):
            task = begin_anywhere(FormationTask(config, size, seed=config.seed))
            call = random_decisions(task) if group == "environment" else policy_decisions(task, stages)
            cases.append(Case(group, str(size), call, size * agents))
    return cases


def learning_cases(config: ScenarioConfig, sizes: tuple[int, ...], folder: Path) -> list[Case]:
    """Whole iterations of the USV stage (rollout, PPO update, log, checkpoint) for each number of environments."""
    configured = next(s for s in config.stages.values() if s.team == "usv")
    cases = []
    for size in sizes:
        stage = configured.model_copy(update={"num_envs": size})
        task = FormationTask(config, size, seed=config.seed, teams=("usv",))
        place = folder / f"learning-{size}"
        place.mkdir()
        runner = StageRunner(FormationEnv(task, "usv"), stage, place)
        work = size * config.usv.count * stage.steps_per_iteration
        cases.append(Case("learning", str(size), lambda runner=runner: runner.learn(1), work))
    return cases


def rates(cases: list[Case], group: str, config: ScenarioConfig) -> list[dict[str, float]]:
    """The JSON of one group of cases: an agent step is one vehicle's decision."""
    agents = config.usv.count + (config.uav.count if group != "learning" else 0)
    return [
        {
            "num_envs": int(case.label),
            "agent_steps_per_s": case.rate,
            "real_time_factor": case.rate / agents * config.decision_interval,
        }
        for case in cases
        if case.group == group
    ]
