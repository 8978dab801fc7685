"""Time of each part of one step of a mission."""

import statistics
import time
from collections import defaultdict
from typing import Any

from tqdm import tqdm

from rl.missions.formation.config import FormationScenario
from rl.missions.formation.mission import Formation
from tools.benchmarking.mission import begin_anywhere, random_decisions

OTHER = "other"


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
    stopwatch.watch(task.world, "_checked", "action checks")
    stopwatch.watch(task.targets, "move", "targets")
    stopwatch.watch(task, "_ended", "endings")
    stopwatch.watch(task, "_paid", "rewards")
    for name, team in task.teams.items():
        stopwatch.watch(team.fleet.model, "step", f"{name} kernel")
        stopwatch.watch(team.now, "measure", "geometry")
        stopwatch.watch(team.sensor, "look", "sensing")
        stopwatch.watch(team, "observe", "observations")
    stopwatch.watch(task, "reset", "resets")
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
