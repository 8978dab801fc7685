"""Comparison of this checkout with another one: both are measured in alternation; the result is the median of
ratios.
"""

import argparse
import importlib
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

ONE = "one environment"
PAPER = Path(__file__).resolve().parents[2] / "configs" / "paper.toml"  # this checkout's, for both
SCENARIO_SIZE = 1024
GROUPS = ("environment", ONE, "inference", "scenarios", "learning", "physics")


class Worker:
    """A process that measures one checkout: this file as a script (`main`)."""

    def __init__(self, checkout: Path, groups: Sequence[str], sizes: Sequence[int]):
        """Start the process and let it build its cases."""
        command = [sys.executable, __file__, str(checkout), ",".join(groups), ",".join(map(str, sizes))]
        places = checkout, checkout / "tools", *filter(None, [os.environ.get("PYTHONPATH")])
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, places))}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.checkout, self.cases = checkout, self.ask("cases")

    def ask(self, order: str) -> Any:
        """The answer to an order."""
        assert self._process.stdin and self._process.stdout
        try:
            print(order, file=self._process.stdin, flush=True)
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise RuntimeError(f"{self.checkout} cannot be measured: see the message above")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def compare(
    other: Path, own: Path, *, groups: Sequence[str], sizes: Sequence[int], seconds: float, repetitions: int
) -> list[dict[str, Any]]:
    """Time each case that both checkouts have: seconds per call of both, and the ratio of speeds, `own` over `other`.

    A repetition runs one, the other, the other, the first again; each half gives one ratio.
    """
    workers = Worker(other, groups, sizes), Worker(own, groups, sizes)
    shared = [case for case in workers[0].cases if case in workers[1].cases]
    where = [[worker.cases.index(case) for case in shared] for worker in workers]
    calls = []
    for k in tqdm(range(len(shared)), desc="warm up", unit="case"):
        calls.append([worker.ask(f"warm {where[w][k]} {seconds}") for w, worker in enumerate(workers)])
    taken: list[list[list[float]]] = [[[], []] for _ in shared]
    for repetition in tqdm(range(repetitions), desc="measure", unit="round"):
        for k in range(len(shared)):
            order = (0, 1, 1, 0) if repetition % 2 else (1, 0, 0, 1)
            for w in order:
                taken[k][w].append(workers[w].ask(f"run {where[w][k]} {calls[k][w]}"))
    for worker in workers:
        worker.close()
    return [_row(case, *times) for case, times in zip(shared, taken, strict=True)]


def _row(case: str, before: list[float], now: list[float]) -> dict[str, Any]:
    ratios = sorted(b / n for b, n in zip(before, now, strict=True))
    return {
        "case": case,
        "seconds_other": statistics.median(before),
        "seconds_own": statistics.median(now),
        "ratio": statistics.median(ratios),
        "ratio_quartiles": [ratios[len(ratios) // 4], ratios[(3 * len(ratios)) // 4]],
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The ratios as a readable table."""
    lines = [f"{'':44}{'other, ms':>12}{'this, ms':>12}{'times as fast':>15}   quartiles"]
    for row in rows:
        low, high = row["ratio_quartiles"]
        lines.append(
            f"{row['case']:44}{1000 * row['seconds_other']:12.3f}{1000 * row['seconds_own']:12.3f}"
            f"{row['ratio']:15.2f}   [{low:.2f} .. {high:.2f}]"
        )
    return "\n".join(lines)


def gymnasium_cases(kind: Any) -> list[Any]:
    """A step of Gymnasium's environment of each team of `paper`, with resets; `kind` is the class `Case`."""
    import numpy as np

    place = "rl.adapters.gymnasium" if importlib.util.find_spec("rl.adapters") else "rl.gym"  # the latter until 380d926
    kept = importlib.import_module(place).TeamEnv
    cases = []
    for team in ("usv", "uav"):
        env = kept(team, scenario=PAPER, seed=1)
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

    start = (getattr(benchmark, "shared", None) or benchmark.cli).start  # cli: its name in earlier checkouts
    start(argparse.Namespace(arch="cpu", threads=0))
    config = benchmark.load_scenario(PAPER, ())
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
    """Time the cases of one checkout on request.

        python against.py CHECKOUT GROUP[,GROUP ...] SIZE[,SIZE ...]

    It starts with CHECKOUT on PYTHONPATH, so that all imports come from there, including the benchmark cases; only this
    file belongs to the measuring checkout. It reads orders from stdin until that closes, and answers each with a line
    of JSON: `cases` (the names), `warm INDEX SECONDS` (number of calls in that time), `run INDEX CALLS` (seconds per
    call).
    """
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
