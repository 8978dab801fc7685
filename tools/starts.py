"""Compare the starts of two checkouts: commands from `python` to their results, in alternation.

    python tools/starts.py CHECKOUT [--repetitions N] [--only CASE ...]

Each checkout has a cache of compiled kernels of its own, which the first run of a case fills; `empty` cases have a new
one in each run. Prints seconds on the clock and of CPU, medians of both checkouts, and this one's over the other's.
The caches of both are thrown away. The main job and README's second command are timed only if `--only` names them.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
MISSION = """
from rl.missions import load_scenario, make_mission
import torch
mission = make_mission(load_scenario("cruise"), 256, seed=0)
actions = {name: torch.zeros(256, team.fleet.count, len(team.action_names)) for name, team in mission.teams.items()}
for _ in range(2):
    step = mission.step(actions)
    if not hasattr(mission, "act"):  # before a step was a whole decision
        mission.reset(step.terminated | step.truncated)
        for team in mission.teams.values():
            team.observations()
"""
SNIPPET = """
import numpy as np
import taichi_sim as ts
world = ts.World.from_scenario("paper", num_envs=1024)
actions = {"usv": np.zeros((1024, 3, 2)), "uav": np.zeros((1024, 3, 3))}
actions["usv"][..., 0] = 1.0
for _ in range(50):
    world.step(actions)
print(world.teams["usv"].position_n[0])
print(world.sea.elevation(north=10.0, east=[0.0, 5.0], time=5.0, sea=0))
futures = world.fork([0, 1], copies=64)
"""
CASES = {
    "play": ["-m", "rl.commands.main", "play", "cruise", "--duration", "20", "--out", "{out}.rrd"],
    "snippet": ["-c", SNIPPET],
    "mission": ["-c", MISSION],
    "mission, empty": ["-c", MISSION],
    "train, empty": ["rl/train.py", "--out", "{out}"],
    "test, empty": ["-m", "pytest", "-q", "-n", "2"],
    "test": ["-m", "pytest", "-q", "-n", "2"],
}
LONG = "train, empty", "test, empty", "test"


def run(checkout: Path, case: str, cache: Path) -> tuple[float, float]:
    """Seconds of a case on the clock, and of CPU in all its processes."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "cache" if case.endswith(", empty") else cache
        command = [sys.executable, *(part.replace("{out}", f"{folder}/run") for part in CASES[case])]
        environment = os.environ | {"PYTHONPATH": str(checkout), "TI_OFFLINE_CACHE_FILE_PATH": str(kept)}
        before, begin = os.times(), time.perf_counter()
        subprocess.run(command, cwd=checkout, env=environment, check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        return time.perf_counter() - begin, cpu


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print a table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("checkout", type=Path, help="the other checkout of this project")
    p.add_argument("--repetitions", type=int, default=3)
    p.add_argument("--only", nargs="+", choices=CASES, default=[case for case in CASES if case not in LONG])
    args = p.parse_args(argv)
    both = args.checkout.resolve(), HERE
    print(
        "| case | other, s | this, s | ratio | other, s of CPU | this, s of CPU | ratio |\n"
        "|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        caches = Path(folder) / "0", Path(folder) / "1"
        for case in args.only:
            taken: list[list[tuple[float, float]]] = [[], []]
            for repetition in range(args.repetitions + 1):
                for k in (0, 1) if repetition % 2 else (1, 0):
                    if repetition or not case.endswith(", empty"):  # the first fills the cache
                        seconds = run(both[k], case, caches[k])
                        taken[k] += [seconds] if repetition else []
            columns = []
            for values in zip(*(zip(*t, strict=True) for t in taken), strict=True):
                other, own = map(statistics.median, values)
                columns.append(f"{other:.1f} | {own:.1f} | {own / other:.2f}")
            print(f"| {case} | {' | '.join(columns)} |", flush=True)


if __name__ == "__main__":
    main()
