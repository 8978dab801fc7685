"""A process that times the cases of one checkout on request.

    python worker.py CHECKOUT GROUP[,GROUP ...] SIZE[,SIZE ...]

It starts with CHECKOUT on PYTHONPATH, so that all imports come from there, including the benchmark cases; only this
file belongs to the measuring checkout. It reads orders from stdin and answers each with a line of JSON: `cases` (the
names), `warm INDEX SECONDS` (number of calls in that time), `run INDEX CALLS` (seconds per call).
"""

import argparse
import importlib
import importlib.util
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

ONE = "one environment"
SCENARIO_SIZE = 1024


def gymnasium_cases(kind: Any) -> list[Any]:
    """A step of Gymnasium's environment of each team of `paper`, with resets; `kind` is the class `Case`."""
    import numpy as np

    place = "rl.adapters.gymnasium" if importlib.util.find_spec("rl.adapters") else "rl.gym"  # the latter until 380d926
    kept = importlib.import_module(place).TeamEnv
    cases = []
    for team in ("usv", "uav"):
        env = kept(team, scenario="paper", seed=1)
        env.reset(seed=2)
        still = np.zeros(env.action_space.shape, dtype=np.float32)

        def call(env=env, still=still) -> None:
            _, _, terminated, truncated, _ = env.step(still)
            if terminated or truncated:
                env.reset()

        cases.append(kind(ONE, f"Gymnasium, {team}", call, 1))
    return cases


def build(checkout: Path, groups: list[str], sizes: tuple[int, ...], folder: Path) -> list[Any]:
    """The cases of `groups` in `checkout`."""
    base = "tools." if (checkout / "tools" / "__init__.py").is_file() else ""
    benchmark = importlib.import_module(f"{base}benchmark")  # the checkout's
    Case = importlib.import_module(f"{base}benchmarking.timing").Case  # noqa: N806

    benchmark.cli.start(argparse.Namespace(arch="cpu", threads=0))
    config = benchmark.load_scenario("paper", ())
    cases = []
    if "environment" in groups or "inference" in groups:
        cases += [case for case in benchmark.environment_cases(config, sizes) if case.group in groups]
    if ONE in groups:
        cases += gymnasium_cases(Case)
    if "scenarios" in groups:
        cases += benchmark.scenario_cases(SCENARIO_SIZE)
    if "learning" in groups:
        cases += benchmark.learning_cases(config, (512,), folder)
    if "physics" in groups:
        cases += [case for case, _ in benchmark.physics_cases(config, 4096, False)]
    return cases


def main() -> None:
    """Answer orders until stdin closes."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # prints of the checkout go to stderr
    checkout, groups, sizes = Path(sys.argv[1]).resolve(), sys.argv[2].split(","), sys.argv[3].split(",")
    with tempfile.TemporaryDirectory() as folder:
        cases = build(checkout, groups, tuple(map(int, sizes)), Path(folder))
        for line in sys.stdin:
            order, *numbers = line.split()
            answer: Any = [f"{case.group}, {case.label}" for case in cases]
            if order != "cases":
                case = cases[int(numbers[0])]
                if order == "warm":
                    case.calls = 2
                    case.repeat()
                    answer = max(1, round(float(numbers[1]) / max(case.repeat(), 1e-9)))
                else:
                    case.calls = int(numbers[1])
                    answer = case.repeat()
            print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
