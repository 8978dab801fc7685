"""Time of the parts of a learning iteration, in one of several processes that learn together.

    learning.py SCENARIO ENVIRONMENTS ITERATIONS THREADS FILE      started by torchrun, once for each process

It trains the first stage of a scenario with ENVIRONMENTS in all processes together, warms up, and times ITERATIONS.
Rank 0 writes the result to FILE (JSON).
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

if __package__ in (None, ""):  # run as a script
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

WARM_UP = 3  # iterations before timing
INFERENCE, ENVIRONMENT, RETURNS, UPDATE, TALK = "inference", "environment", "returns", "update", "synchronisation"


class Communication:
    """Number, bytes and time of the messages between processes while they learn."""

    def __init__(self):
        """Start with no messages."""
        self.calls, self.bytes, self.seconds = 0, 0, 0.0
        self._originals: list[tuple[Any, str, Any]] = []

    def watch(self, owner: Any, name: str) -> None:
        """Measure calls of a function whose first argument is the message."""
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
        """Stop measuring."""
        for owner, name, original in self._originals:
            setattr(owner, name, original)


def train(config: Any, envs: int, iterations: int) -> dict[str, Any]:
    """Time iterations of a scenario's first stage with `envs` environments on all processes together.

    Returns medians of the total and of each part, s, and the number and bytes of collective operations.
    """
    import torch.distributed as dist

    from rl.learn.env import MissionEnv
    from rl.learn.runner import StageRunner
    from rl.missions import make_mission
    from rl.runs import ranks
    from tools.benchmarking.mission import Stopwatch, first_stage

    stage = first_stage(config).model_copy(update={"num_envs": envs, "checkpoint_interval": 10**6})
    own, rank = ranks.envs_each(envs), ranks.here().rank
    task = make_mission(config, own, seed=rank, teams=(stage.team,))
    seconds, parts, talk = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        runner = StageRunner(MissionEnv(task, stage.team), stage, Path(folder))
        runner.continue_history()
        together, runner.is_distributed = runner.is_distributed, False
        communication, stopwatch = Communication(), Stopwatch()
        communication.watch(ranks, "_reduce_")  # gradients and divergence, logs, pending signals
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
            start, before, calls, sent = (
                time.perf_counter(),
                communication.seconds,
                communication.calls,
                communication.bytes,
            )
            runner.learn(1)
            if number >= WARM_UP:
                seconds.append(time.perf_counter() - start)
                waited = communication.seconds - before
                read = stopwatch.read()
                parts.append(read | {UPDATE: read[UPDATE] - waited, TALK: waited})
                talk.append((communication.calls - calls, communication.bytes - sent))
        communication.stop()
        weights = sum(p.numel() * p.element_size() for p in runner.alg.get_policy().parameters())
    return {
        "seconds": statistics.median(seconds),
        "spread": statistics.pstdev(seconds) / statistics.mean(seconds),
        "parts": {part: statistics.median(of[part] for of in parts) for part in parts[0]},
        "calls": talk[-1][0],
        "bytes": talk[-1][1],
        "actor_bytes": weights,
        "agent_steps": own * ranks.here().count * task.teams[stage.team].fleet.count * stage.steps_per_iteration,
    }


def main() -> None:
    """Train, time, and write the result."""
    from rl.commands import shared
    from rl.missions import load_scenario
    from rl.runs import ranks

    scenario, envs, iterations, threads, file = sys.argv[1:]
    with ranks.joined() as place:
        shared.start(argparse.Namespace(arch="cpu", threads=int(threads)))
        result = train(load_scenario(scenario), int(envs), int(iterations))
        if place.first:
            Path(file).write_text(json.dumps(result), encoding="utf-8")


if __name__ == "__main__":
    main()
