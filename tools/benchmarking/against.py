"""Comparison of this checkout with another one: both are measured in alternation; the result is the median of
ratios.
"""

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

WORKER = Path(__file__).with_name("worker.py")
GROUPS = ("environment", "one environment", "inference", "scenarios", "learning", "physics")


class Worker:
    """A process that measures one checkout (worker.py)."""

    def __init__(self, checkout: Path, groups: Sequence[str], sizes: Sequence[int]):
        """Start the process and let it build its cases."""
        command = [sys.executable, str(WORKER), str(checkout), ",".join(groups), ",".join(map(str, sizes))]
        places = checkout, checkout / "tools", *filter(None, [os.environ.get("PYTHONPATH")])
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, places))}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.checkout, self.cases = checkout, self.ask("cases")

    def ask(self, order: str) -> Any:
        """The answer to an order.

        Raises:
            RuntimeError: if the process has ended.
        """
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
