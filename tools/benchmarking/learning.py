"""Where the time of learning goes: one of the processes that learn together, with a stopwatch on every part.

    learning.py SCENARIO ENVIRONMENTS ITERATIONS THREADS FILE      as many times as there are processes, by torchrun

It trains the first stage of a scenario with so many environments in all, warms up, times so many iterations, and rank 0
writes what one took to FILE (JSON).
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import taichi_sim  # noqa: F401  (makes rl, tools and tests importable from any folder)

WARM_UP = 3  # iterations
INFERENCE, ENVIRONMENT, RETURNS, UPDATE, TALK = "inference", "environment", "returns", "update", "synchronisation"


class Traffic:
    """What processes tell each other while they learn: its number, bytes and time."""

    def __init__(self):
        """Nothing yet."""
        self.calls, self.bytes, self.seconds = 0, 0, 0.0
        self._originals: list[tuple[Any, str, Any]] = []

    def watch(self, owner: Any, name: str) -> None:
        """Count calls of a function whose first argument is what is told."""
        original = getattr(owner, name)
        self._originals.append((owner, name, original))

        def counted(tensor: Any, *args: Any, **options: Any) -> Any:
            start = time.perf_counter()
            try:
                return original(tensor, *args, **options)
            finally:
                self.seconds += time.perf_counter() - start
                self.calls += 1
                self.bytes += tensor.numel() * tensor.element_size()

        setattr(owner, name, counted)

    def stop(self) -> None:
        """Watch no more."""
        for owner, name, original in self._originals:
            setattr(owner, name, original)


def train(config: Any, envs: int, iterations: int) -> dict[str, Any]:
    """What one iteration of a scenario's first stage takes, with `envs` environments on all processes together: seconds
    in all and of its parts, medians; collectives and their bytes.
    """
    import torch.distributed as dist

    from rl import processes
    from rl.learn.env import MissionEnv
    from rl.learn.runner import StageRunner
    from rl.missions import make_mission
    from tools.benchmarking.mission import first_stage
    from tools.benchmarking.parts import Stopwatch

    stage = first_stage(config).model_copy(update={"num_envs": envs, "checkpoint_interval": 10**6})
    own, rank = processes.envs_each(envs), processes.here().rank
    task = make_mission(config, own, seed=rank, teams=(stage.team,))
    seconds, parts, talk = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        runner = StageRunner(MissionEnv(task, stage.team), stage, Path(folder))
        runner.continue_history()
        together, runner.is_distributed = runner.is_distributed, False
        traffic, stopwatch = Traffic(), Stopwatch()
        traffic.watch(processes, "_reduce_")  # gradients and divergence, what is logged, whether to go on
        for owner, method, part in (
            (runner.alg, "act", INFERENCE),
            (runner.env, "step", ENVIRONMENT),
            (runner.alg, "compute_returns", RETURNS),
            (runner.alg, "update", UPDATE),
        ):
            stopwatch.watch(owner, method, part)
        for number in range(WARM_UP + iterations):
            if together:
                dist.barrier()
            stopwatch.read()
            start, before, calls, told = time.perf_counter(), traffic.seconds, traffic.calls, traffic.bytes
            runner.learn(1)
            if number >= WARM_UP:
                seconds.append(time.perf_counter() - start)
                waited = traffic.seconds - before
                read = stopwatch.read()
                parts.append(read | {UPDATE: read[UPDATE] - waited, TALK: waited})
                talk.append((traffic.calls - calls, traffic.bytes - told))
        traffic.stop()
        weights = sum(p.numel() * p.element_size() for p in runner.alg.get_policy().parameters())
    return {
        "seconds": statistics.median(seconds),
        "spread": statistics.pstdev(seconds) / statistics.mean(seconds),
        "parts": {part: statistics.median(of[part] for of in parts) for part in parts[0]},
        "calls": talk[-1][0],
        "bytes": talk[-1][1],
        "actor_bytes": weights,
        "agent_steps": own * processes.here().count * task.teams[stage.team].fleet.count * stage.steps_per_iteration,
    }


def main() -> None:
    """Train, time, and tell."""
    from rl import cli, processes
    from rl.missions import load_scenario

    scenario, envs, iterations, threads, file = sys.argv[1:]
    with processes.joined() as place:
        cli.start(argparse.Namespace(arch="cpu", threads=int(threads)))
        told = train(load_scenario(scenario), int(envs), int(iterations))
        if place.first:
            Path(file).write_text(json.dumps(told), encoding="utf-8")


if __name__ == "__main__":
    main()
