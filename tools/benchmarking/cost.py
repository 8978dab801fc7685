"""A model of the time of a learning iteration on P processes; all its numbers are measured.

    T(P) = W(n / P) (1 + s sqrt(2 ln P)) + S (2 log2(P) l + 2 (P - 1) / P b / B)

W(e) = a + c e      time of a process with e environments on a core of its own, s: a line through measurements;
s                   spread of that time between iterations over its mean. All wait for the slowest process, which is
                    about sqrt(2 ln P) standard deviations late for P normal draws;
S, b                number of synchronisations in an iteration, and bytes of each;
l, B                latency of a message, and bandwidth, between machines: an all-reduce by halving and doubling takes
                    2 log2(P) messages and moves 2 (P - 1) / P of its bytes (Thakur et al. 2005, section 4.5).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


class Link(NamedTuple):
    """Latency and bandwidth between processes."""

    name: str
    latency: float  # latency of a message, s
    bandwidth: float  # bytes/s


LINKS = (  # typical figures; assumed
    Link("memory of one machine", 20e-6, 2e9),
    Link("10 Gbit/s Ethernet", 60e-6, 1.1e9),
    Link("100 Gbit/s, RDMA", 5e-6, 11e9),
)


class Cost(NamedTuple):
    """The numbers of the model."""

    fixed: float  # a, s
    each: float  # c, s for each environment
    spread: float  # s
    calls: int  # S
    bytes: float  # b, bytes of one synchronisation
    steps: float  # agent-steps of one environment in an iteration

    def work(self, envs: float) -> float:
        """Time W of a process with `envs` environments, s."""
        return self.fixed + self.each * envs

    def seconds(self, envs: int, processes: int, link: Link) -> float:
        """Time T of an iteration, s."""
        late = 1 + self.spread * math.sqrt(2 * math.log(processes)) if processes > 1 else 1.0
        talk = 2 * math.log2(processes) * link.latency
        talk += 2 * (processes - 1) / processes * self.bytes / link.bandwidth
        return self.work(envs / processes) * late + self.calls * talk

    def rate(self, envs: int, processes: int, link: Link) -> float:
        """Learning speed, agent-steps/s."""
        return envs * self.steps / self.seconds(envs, processes, link)

    def worth(self, envs: int, link: Link, least: float = 0.5) -> int:
        """The largest power of two of processes whose efficiency, compared with one process, is at least `least`."""
        one, count = self.rate(envs, 1, link), 1
        while count < envs and self.rate(envs, 2 * count, link) >= least * 2 * count * one:
            count *= 2
        return count


def fitted(seconds: Mapping[int, float], spread: float, calls: int, of_each: float, steps: float) -> Cost:
    """Fit the model to one process on one core (environments -> seconds) by least squares of relative errors."""
    envs, taken = np.array(list(seconds)), np.array(list(seconds.values()))
    matrix = np.stack([np.ones_like(taken), envs], axis=1) / taken[:, None]
    fixed, each = np.linalg.lstsq(matrix, np.ones_like(taken), rcond=None)[0]
    return Cost(max(float(fixed), 0.0), float(each), spread, calls, of_each, steps)
