"""Cases that time a mission: the environment alone, with acting policies, with learning, and drawn as pictures;
the time of each part of one step.
"""

import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from rl.adapters.render import Pictures
from rl.learn.actor import Actor
from rl.learn.env import MissionEnv
from rl.learn.policy import TrainedPolicy
from rl.learn.runner import StageRunner
from rl.mission import Mission, Team
from rl.missions import load_scenario, make_mission
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.mission import Formation
from rl.scenario import Scenario, StageConfig
from tools.benchmarking.timing import Case

ACTION_SPREAD = 0.2  # standard deviation of random actions about cruise
ACTION_SETS = 8  # sets of actions drawn beforehand, so that drawing is not timed
STAGGER_SEED = 7
SIZE = (640, 480)
OTHER = "other"  # time of a step that no part has taken
SCENARIOS = {
    "paper": ("track.worlds=4", "sea.realisations=4"),
    "otter": ("sea.realisations=4",),
    "encounter": ("sea.realisations=4",),
    "escort": ("escort.worlds=4", "sea.realisations=4"),
}


def begin_anywhere(task: Mission) -> Mission:
    """Spread the environments over the episode, so that their time does not run out in the same step."""
    generator = torch.Generator().manual_seed(STAGGER_SEED)
    task.steps.copy_(torch.randint(task.config.episode_steps, (task.num_envs,), generator=generator))
    return task


def cruise(team: Team) -> torch.Tensor:
    """Mean action [action] of the classical controller at the start of an episode: straight ahead near cruise."""
    controller = team.make_controller()
    if controller is None:
        return torch.zeros(team.action.shape[-1])
    return controller(team.known).mean(dim=(0, 1))


def random_decisions(task: Mission) -> Callable[[], object]:
    """A function that takes one decision with random actions near cruise."""
    generator = torch.Generator().manual_seed(STAGGER_SEED)
    sets = [
        {
            name: cruise(team)
            + ACTION_SPREAD * torch.randn(team.action.shape, generator=generator).to(team.action.device)
            for name, team in task.teams.items()
        }
        for _ in range(ACTION_SETS)
    ]
    turn = iter(range(1 << 62))
    return lambda: task.drive(sets[next(turn) % ACTION_SETS])


def untrained_policy(team: Team, stage: StageConfig) -> TrainedPolicy:
    """A network of the configured size with initial weights."""
    return TrainedPolicy(Actor(stage, team.observations().shape[-1], len(team.action_names)))


def policy_decisions(task: Mission, stages: dict[str, StageConfig]) -> Callable[[], object]:
    """A function that takes one decision with every team's network."""
    policies = {name: untrained_policy(team, stages[name]) for name, team in task.teams.items()}
    observed = task.observations()

    def decide_by_policy() -> None:
        nonlocal observed
        observed = task.step({name: policies[name].act(seen) for name, seen in observed.items()}).observations

    return decide_by_policy


def first_stage(config: Scenario) -> StageConfig:
    """The stage whose learning is timed."""
    return next(iter(config.stages.values()))


def agents(config: Scenario) -> int:
    """Vehicles of all teams in one environment."""
    return sum(team.count for team in config.teams.values())


def environment_cases(config: Scenario, sizes: tuple[int, ...]) -> list[Case]:
    """All teams without and with policies, for each number of environments."""
    stages = {name: config.stage_of(name) or StageConfig(team=name) for name in config.teams}
    cases = []
    for size in sizes:
        for group in ("environment", "inference"):
            task = begin_anywhere(make_mission(config, size, seed=config.seed))
            call = random_decisions(task) if group == "environment" else policy_decisions(task, stages)
            cases.append(Case(group, str(size), call, size * agents(config)))
    return cases


def scenario_cases(size: int, *overrides: str) -> list[Case]:
    """Steps without policies: corrected boats and aircraft, each team of the main job, the whole escort.

    The escort is also timed with wave crests that hide objects from lookouts.
    """
    cases = []
    for label, name, teams, own in (
        ("lanes", "lanes", ("usv", "uav"), ()),
        ("cruise, boats", "cruise", ("usv",), ()),
        ("cruise, aircraft", "cruise", ("uav",), ()),
        ("escort", "escort", ("usv", "uav"), ()),
        ("escort, crests", "escort", ("usv", "uav"), ("usv.lookout.crests=true",)),
    ):
        config = load_scenario(name, (*overrides, *own))
        task = begin_anywhere(make_mission(config, size, seed=config.seed, teams=teams))
        work = size * sum(config.teams[team].count for team in teams)
        cases.append(Case("scenarios", label, random_decisions(task), work))
    return cases


def learning_cases(config: Scenario, sizes: tuple[int, ...], folder: Path) -> list[Case]:
    """Whole iterations of the first stage (rollout, PPO update, log, checkpoint) for each number of environments."""
    configured = first_stage(config)
    cases = []
    for size in sizes:
        stage = configured.model_copy(update={"num_envs": size})
        task = make_mission(config, size, seed=config.seed, teams=(stage.team,))
        place = folder / f"learning-{size}"
        place.mkdir()
        runner = StageRunner(MissionEnv(task, stage.team), stage, place)
        work = size * config.teams[stage.team].count * stage.steps_per_iteration
        cases.append(Case("learning", str(size), lambda runner=runner: runner.learn(1), work))
    return cases


def rates(cases: list[Case], group: str, config: Scenario) -> list[dict[str, float]]:
    """One group of cases as JSON; an agent step is one vehicle's decision."""
    vehicles = config.teams[first_stage(config).team].count if group == "learning" else agents(config)
    return [
        {
            "num_envs": int(case.label),
            "agent_steps_per_s": case.rate,
            "real_time_factor": case.rate / vehicles * config.decision_interval,
        }
        for case in cases
        if case.group == group
    ]


def measure_pictures(*, seconds: float, repetitions: int) -> dict[str, float]:
    """Median milliseconds for a picture of one environment, 640x480 px, by scenario."""
    found = {}
    for name, overrides in SCENARIOS.items():
        mission = make_mission(load_scenario(name, overrides), 1, seed=1)
        pictures, times = Pictures(mission, SIZE), []
        still = {team: torch.zeros_like(of.action) for team, of in mission.teams.items()}
        pictures.draw()
        start = time.perf_counter()
        while len(times) < repetitions or time.perf_counter() - start < seconds:
            mission.drive(still)
            pictures.keep()
            begin = time.perf_counter()
            pictures.draw()
            times.append(1000 * (time.perf_counter() - begin))
        found[name] = statistics.median(times)
    return found


class Stopwatch:
    """Times methods of chosen objects; a timed method called within another counts for the outer one."""

    def __init__(self):
        """Start with no methods."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside = False

    def watch(self, owner: Any, method: str, part: str) -> None:
        """Count the time of `owner.method` for `part`."""
        original = getattr(owner, method)
        self.seconds[part] = 0.0

        def timed(*args, **options):
            if self._inside:
                return original(*args, **options)
            self._inside = True
            start = time.perf_counter()
            try:
                return original(*args, **options)
            finally:
                self.seconds[part] += time.perf_counter() - start
                self._inside = False

        setattr(owner, method, timed)

    def read(self) -> dict[str, float]:
        """Seconds of each part since the last reading."""
        taken = dict(self.seconds)
        for part in self.seconds:
            self.seconds[part] = 0.0
        return taken


def watch(task: Formation) -> Stopwatch:
    """A stopwatch on every part of `task`."""
    stopwatch = Stopwatch()
    stopwatch.watch(task.world.sea, "phases", "sea phases")
    stopwatch.watch(task, "act", "action checks")
    for targets in task.targets.values():
        stopwatch.watch(targets, "move", "targets")
    for name, team in task.teams.items():
        stopwatch.watch(team, "ended", "endings")
        stopwatch.watch(team, "paid", "rewards")
        stopwatch.watch(team.fleet.model, "step", f"{name} kernel")
        stopwatch.watch(team.now, "measure", "geometry")
        stopwatch.watch(team.sensor, "look", "sensing")
        stopwatch.watch(team, "observations_now", "observations")
    stopwatch.watch(task, "_begin", "resets")
    return stopwatch


def measure_parts(
    config: FormationScenario, num_envs: int, *, seconds: float, repetitions: int, show_progress: bool = True
) -> dict[str, float]:
    """Median milliseconds of each part of one decision of `num_envs` environments with both teams."""
    task = begin_anywhere(Formation(config, num_envs, seed=config.seed))
    call = random_decisions(task)
    call()
    stopwatch = watch(task)
    readings: dict[str, list[float]] = defaultdict(list)
    for _ in tqdm(range(repetitions), desc="parts", unit="round", disable=not show_progress):
        stopwatch.read()
        start, steps = time.perf_counter(), 0
        while steps == 0 or time.perf_counter() - start < seconds:
            call()
            steps += 1
        whole = (time.perf_counter() - start) / steps
        parts = {part: spent / steps for part, spent in stopwatch.read().items()}
        for part, spent in (parts | {OTHER: whole - sum(parts.values())}).items():
            readings[part].append(1000 * spent)
    return {part: statistics.median(values) for part, values in readings.items()}
