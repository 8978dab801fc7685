"""Fit of a memory (taichi_sim/usv/hull/memory.py) to added mass and damping by frequency.

A_inf may change within the error of a panel code: only one A_inf agrees with A and B at all other frequencies (Ogilvie
1964), and that of a mesh is slightly wrong. Motions that symmetry does not couple are fitted separately: surge, heave
and pitch; sway, roll and yaw. Masses are added (search.py) until two conditions hold. Every kernel misses less than the
wanted share of its energy, int (K - K_fit)^2 dt / int K^2 dt, by Parseval from B. The damping is right at the
resonances of heave, roll and pitch, where it alone limits the response.
"""

import contextlib
import queue
from collections.abc import Sequence
from multiprocessing.queues import Queue
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from taichi_sim.hydro.search import MODES, MOST, FitError, MemorySearch, Pair
from taichi_sim.hydro.workers import CONTEXT, workers
from taichi_sim.usv.hull.memory import Memory

Array = NDArray[np.float64]
GROUPS = ((0, 2, 4), (1, 3, 5))  # coupled modes of a hull whose port and starboard are alike
WHOLE = ((0, 1, 2, 3, 4, 5),)  # coupled modes of any other hull
ENERGY = 0.004  # share of a kernel's energy that may be missing
WAIT_S = 0.2  # longest wait for a report of progress
NEGATIVE = 0.02  # tolerated negative damping over the largest eigenvalue of B, as a numerical error


class MemoryFit(NamedTuple):
    """A memory, its A_inf [6, 6], and the errors of the fit."""

    memory: Memory
    added_mass_inf: Array
    pairs: tuple[Pair, ...]


def check_passive(omega: Array, B: Array) -> None:
    """Refuse damping [n, 6, 6] that adds energy.

    Raises:
        FitError: naming the frequency and the pair of modes.
    """
    size = np.sqrt(np.maximum(np.einsum("nii->ni", B).max(axis=0), 1e-12 * np.abs(B).max()))
    normal = B / size[:, None] / size
    values, vectors = np.linalg.eigh((normal + normal.transpose(0, 2, 1)) / 2)
    worst = int(values[:, 0].argmin())
    if values[worst, 0] < -NEGATIVE * values[:, -1].max():
        one, two = sorted(np.argsort(-np.abs(vectors[worst, :, 0]))[:2])
        raise FitError(
            f"damping of {MODES[one]} and {MODES[two]} is negative at {omega[worst]:.4g} rad/s ({values[worst, 0]:.2g} "
            "of the largest): an irregular frequency, or too coarse a mesh for it"
        )


def fit_memory(
    omega: Array, A: Array, B: Array, A_inf: Array, energy: float = ENERGY, *,
    resonances: Sequence[float | None] = (None,) * 6, symmetric: bool = True, quiet: bool = True,
) -> MemoryFit:  # fmt: skip
    """Fit a memory to A, B [n, 6, 6] at omega [n] (rad/s, rising, > 0) and A_inf [6, 6], about CO, b.

    `resonances` holds the natural frequencies (rad/s) of modes that have one. Damping alone limits the response there,
    so it has more weight.

    Raises:
        FitError: if the damping is not passive, or more than POOR times `energy` is missing with MOST masses.
    """
    A, B, A_inf = ((x + x.swapaxes(-1, -2)) / 2 for x in (A, B, A_inf))
    check_passive(omega, B)
    groups = GROUPS if symmetric else WHOLE
    inf, parts, pairs = A_inf.copy(), [], []
    searches = []
    for group in groups:
        rows, at = np.ix_(range(len(omega)), group, group), [resonances[mode] for mode in group]
        searches.append(MemorySearch(omega, A[rows], B[rows], A_inf[np.ix_(group, group)], group, at))
    for group, (part, group_inf, found) in zip(groups, _run(searches, energy, quiet), strict=True):
        inf[np.ix_(group, group)] = group_inf
        parts.append(part)
        pairs += found
    size = [len(part) for part in parts]
    damping, begin = np.zeros((sum(size), sum(size))), 0
    for part in parts:
        damping[begin : begin + len(part), begin : begin + len(part)] = part.damping
        begin += len(part)
    memory = Memory(
        np.concatenate([part.frequency for part in parts]), damping, np.concatenate([part.shape for part in parts])
    )
    return MemoryFit(memory, inf, tuple(pairs))


def _run(searches: list[MemorySearch], energy: float, quiet: bool) -> list[tuple[Memory, Array, list[Pair]]]:
    """Run all searches at once; return the result of each."""
    progress = CONTEXT.Queue()
    with (
        tqdm(total=len(searches) * MOST, desc="memory", unit="mass", disable=quiet) as bar,
        workers(len(searches), _report_to, progress) as pool,
    ):
        running = [pool.submit(_searched, search, energy) for search in searches]
        while not all(search.done() for search in running):
            with contextlib.suppress(queue.Empty):
                done, more = progress.get(timeout=WAIT_S)
                bar.total += more
                bar.update(done)
        return [search.result() for search in running]


_progress: "list[Queue[tuple[int, int]]]" = []  # in a worker: the queue to which it reports its progress


def _report_to(progress: "Queue[tuple[int, int]]") -> None:
    _progress[:] = [progress]


def _searched(search: MemorySearch, energy: float) -> tuple[Memory, Array, list[Pair]]:
    return search.run(energy, lambda done, more: _progress[0].put((done, more)))
