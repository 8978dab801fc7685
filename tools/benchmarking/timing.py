"""Timing on a noisy machine: all cases in turn, several rounds, medians.

After warm-up (compilation, caches), the number of calls of each case is chosen so that one repetition takes about
`seconds`. Each round then runs one repetition of every case, so that a slow minute of the machine affects all alike.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tqdm import tqdm

WARM_UP_CALLS = 2


@dataclass
class Case:
    """A case to time: `call` does `work` units (agent steps, substeps) of its group."""

    group: str
    label: str
    call: Callable[[], object]
    work: float
    begin: Callable[[], object] | None = None  # called before each repetition, not timed
    calls: int = 1  # calls per repetition
    seconds: list[float] = field(default_factory=list)  # time per call in each repetition

    def repeat(self) -> float:
        """Run one repetition; return seconds per call."""
        if self.begin:
            self.begin()
        start = time.perf_counter()
        for _ in range(self.calls):
            self.call()
        return (time.perf_counter() - start) / self.calls

    @property
    def rate(self) -> float:
        """Units of work per second, the median."""
        return self.work / statistics.median(self.seconds)

    @property
    def spread(self) -> tuple[float, float]:
        """Rates of the slowest and the fastest repetition over the median."""
        median = statistics.median(self.seconds)
        return median / max(self.seconds), median / min(self.seconds)


def measure(cases: Sequence[Case], *, seconds: float, repetitions: int, show_progress: bool = True) -> None:
    """Time all cases; results go to `case.seconds`."""
    with tqdm(cases, desc="warm up", unit="case", disable=not show_progress) as bar:
        for case in bar:
            case.calls = WARM_UP_CALLS
            case.repeat()
            case.calls = max(1, round(seconds / max(case.repeat(), 1e-9)))
    with tqdm(total=repetitions * len(cases), desc="measure", unit="case", disable=not show_progress) as bar:
        for _ in range(repetitions):
            for case in cases:
                case.seconds.append(case.repeat())
                bar.update(1)
