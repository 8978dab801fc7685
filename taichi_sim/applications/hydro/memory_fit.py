"""Fit of a memory (taichi_sim/models/usv/hull/radiation_memory.py) to added mass and damping by frequency.

A_inf may change within the error of a panel code: only one A_inf agrees with A and B at all other frequencies (Ogilvie
1964), and that of a mesh is slightly wrong. Motions that symmetry does not couple are fitted separately: surge, heave
and pitch; sway, roll and yaw. Masses are added until two conditions hold. Every kernel misses less than the wanted
share of its energy, int (K - K_fit)^2 dt / int K^2 dt, by Parseval from B. The damping is right at the resonances of
heave, roll and pitch, where it alone limits the response.

Each number of masses is a nonlinear least-squares problem (scipy, trust region) in their frequencies, dampers and
shapes. It fits B(w) and A(w) together. Each pair of modes is scaled by the geometric mean of its two largest values. A
search starts from the masses found before plus one where most is missing, and from random ones. If MOST masses are not
enough, each one is moved once to where most is missing without it.
"""

import contextlib
import queue
from collections.abc import Callable, Sequence
from multiprocessing.queues import Queue
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from taichi_sim.applications.hydro.frequency_sweep import CONTEXT, workers
from taichi_sim.errors import UserError
from taichi_sim.models.usv.hull.radiation_memory import Memory

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
Tell = Callable[[], None]  # report of a mass that has been done
MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
AT_RESONANCE = 0.02  # tolerated relative error of the damping at a resonance; the response has the same error
MOST = 12  # most masses of a group; each costs the simulator as much as half a component of the sea
POOR = 10.0  # multiple of the wanted errors that is accepted with MOST masses; gaps between hulls need many
STARTS = 2  # random starts, the second one only with up to FEW masses
FEW = 4
EVALUATIONS = 300  # most evaluations of one search
ROUNDS, BETTER = 3, 0.97  # rounds of moving masses, at most; ratio of costs that a round must reach to go on
ALL = MOST * (1 + ROUNDS)  # searches for a mass, at most, of a group
FAR = 1e3  # an error that no search accepts
LEAST = 1e-6  # smallest damper, over its mass's frequency
OVERDAMPED = 10.0  # largest damper, over the highest frequency; a useless mass would take any value
ENOUGH = 1e-5  # relative change of the cost, and of the unknowns, at which a search ends
INERTIA = 0.3  # weight of an error of A against one of B
STIFF = 1.0  # weight of a change of A_inf against one of A
COUPLED = 1.0  # smallest reference for a pair's energy, over the geometric mean of the two modes' own energies
NEAR, LIGHTEST = 0.1, 20.0  # at a resonance: width in ln(omega), and upper limit of the additional weight
TUNED = 30.0  # additional weight of added mass at a resonance, which it places, for all coupled modes
BELOW = 0.1, 0.5  # added points, times the lowest frequency: added mass is constant there, damping goes with the cube
BAND = 0.7, 1.5  # times the lowest and highest frequency of a table: range of the masses' frequencies
GROUPS = ((0, 2, 4), (1, 3, 5))  # coupled modes of a hull whose port and starboard are alike
WHOLE = ((0, 1, 2, 3, 4, 5),)  # coupled modes of any other hull
ENERGY = 0.004  # share of a kernel's energy that may be missing
WAIT_S = 0.2  # longest wait for a report of progress
NEGATIVE = 0.02  # tolerated negative damping over the largest eigenvalue of B, as a numerical error


class FitError(UserError, ValueError):
    """No passive memory reproduces the added mass and damping."""


class Pair(NamedTuple):
    """Errors of the fitted kernel of two modes."""

    modes: tuple[str, str]
    missing: float  # missing share of the kernel's energy
    off: float = 0.0  # relative error of the damping at the mode's resonance


class MemorySearch:
    """Search for the masses of one group of g modes."""

    def __init__(
        self, omega: Array, A: Array, B: Array, A_inf: Array, group: tuple[int, ...], at: Sequence[float | None]
    ):
        """Take A, B [n, g, g] at omega [n] (rad/s), A_inf [g, g], and resonances `at` (rad/s; None for a mode
        without one).
        """
        slow = np.array(BELOW)
        omega = np.concatenate([slow * omega[0], omega])
        A, B = np.concatenate([A[[0, 0]], A]), np.concatenate([slow[:, None, None] ** 3 * B[0], B])
        self.omega, self.A, self.B, self.A_inf, self.group = omega, A, B, A_inf, group
        self.size = np.sqrt(np.maximum(np.einsum("nii->ni", B).max(axis=0), 1e-12 * max(np.abs(B).max(), 1e-300)))
        inertia = np.sqrt(np.maximum(np.einsum("nii->ni", A).max(axis=0), 1e-12 * max(np.abs(A).max(), 1e-300)))
        self.of_B, self.of_A = self.size[:, None] * self.size, INERTIA * inertia[:, None] * inertia
        self.upper = np.triu_indices(len(group))
        self.weight = np.sqrt(np.gradient(omega) / np.gradient(omega).mean())[:, None]
        more = np.ones((len(omega), len(group)))
        for n, peak in enumerate(at):
            if peak is not None and self.size[n] > 0:
                ratio = self.size[n] ** 2 / max(float(np.interp(peak, omega, B[:, n, n])), 1e-300)
                more[:, n] += min(ratio, LIGHTEST) * np.exp(-0.5 * (np.log(omega / peak) / NEAR) ** 2)
        here = [np.exp(-0.5 * (np.log(omega / peak) / NEAR) ** 2) for peak in at if peak is not None]
        self.tuned = self.weight * np.sqrt(1 + TUNED * np.sum([0 * omega, *here], axis=0))[:, None]
        self.peaks = dict(enumerate(at))
        self.own = np.sqrt(more[:, self.upper[0]] * more[:, self.upper[1]])

    def run(self, energy: float, tell: Tell) -> tuple[Memory, Array, list[Pair]]:
        """Return memory, A_inf and errors with the fewest masses that miss at most `energy`."""
        if not self.B.any():
            return Memory.none(), self.A_inf, []
        pairs: list[Pair] = []
        x, memory, added = np.empty(0), Memory.none(), 0 * self.A_inf
        for masses in range(1, MOST + 1):
            tell()
            begins = [self._random(masses, start) for start in range(STARTS if masses <= FEW else 1)]
            if masses > 1:
                begins.append(self._one_more(x, masses))
            x = min((self._found(masses, begin) for begin in begins), key=lambda of: of[0])[1]
            memory, added = self._made(x, masses)
            pairs = self._pairs(memory)
            if all(pair.missing <= energy and pair.off <= AT_RESONANCE for pair in pairs):
                return memory, self.A_inf + added, pairs
        x = self._polished(x, tell)
        memory, added = self._made(x, MOST)
        pairs = self._pairs(memory)
        worst = max(pairs, key=lambda pair: max(pair.missing / energy, pair.off / AT_RESONANCE))
        if max(worst.missing / energy, worst.off / AT_RESONANCE) <= POOR:
            return memory, self.A_inf + added, pairs
        raise FitError(
            f"{worst.modes[0]} and {worst.modes[1]}: {100 * worst.missing:.2g} % of the kernel's energy is missing "
            f"(wanted: {100 * energy:.2g} %) and the damping at resonance is {100 * worst.off:.2g} % off (wanted: "
            f"{100 * AT_RESONANCE:g} %) with {MOST} masses: use more frequencies, or a wider range"
        )

    @property
    def _ends(self) -> tuple[float, float]:
        """Bounds of ln(frequency) of the masses."""
        return float(np.log(BAND[0] * self.omega[len(BELOW)])), float(np.log(BAND[1] * self.omega[-1]))

    def _random(self, masses: int, start: int) -> Array:
        """Random start."""
        draw, g = np.random.default_rng([masses, start]), len(self.group)
        peak = self.omega[np.argmax(np.einsum("nii->n", self.B / self.of_B))]
        low, high = self._ends
        spread = np.log(peak) + np.linspace(-0.5, 0.6, masses) + 0.1 * draw.standard_normal(masses)
        spread = np.clip(spread, low + 1e-3, high - 1e-3)
        L = np.diag(np.sqrt(0.6 * np.exp(spread))) + 0.1 * np.tril(draw.standard_normal((masses, masses)), -1)
        G = np.sqrt(peak) * 0.5 * draw.standard_normal((masses, g))
        return np.concatenate([spread, L[np.tril_indices(masses)], G.ravel(), np.zeros(len(self.upper[0]))])

    def _one_more(self, x: Array, masses: int) -> Array:
        """Start from the masses found before, with a small one added where most damping is missing."""
        frequency, L, G, change = self._parts(x, masses - 1)
        K = self._response(x, masses - 1)[2]
        missing = np.einsum("nii->ni", K.real - self.B / self.of_B)
        at = int(np.abs(missing).max(axis=1).argmax())
        size = np.sqrt(0.3 * self.omega[at] * np.abs(missing[at])) * 0.5
        L_more, G_more = np.zeros((masses, masses)), np.concatenate([G, size[None]])
        L_more[:-1, :-1], L_more[-1, -1] = L, np.sqrt(0.3 * self.omega[at])
        log = np.clip(np.log(np.append(frequency, self.omega[at])), *self._ends)
        return np.concatenate([log, L_more[np.tril_indices(masses)], G_more.ravel(), change[self.upper]])

    def _polished(self, x: Array, tell: Tell) -> Array:
        """Move some of MOST masses, one at a time, to where most is missing without them."""
        least = float(np.square(self._residual(x, MOST)).sum()) / 2
        for _ in range(ROUNDS):
            before = least
            for mass in range(MOST):
                tell()
                cost, found = self._found(MOST, self._one_more(self._without(x, mass), MOST))
                if cost < least:
                    least, x = cost, found
            if least > BETTER * before:
                break
        return x

    def _without(self, x: Array, mass: int) -> Array:
        """Unknowns without one of the masses."""
        frequency, L, G, change = self._parts(x, MOST)
        R = np.delete(np.delete(L @ L.T, mass, 0), mass, 1)
        L = np.linalg.cholesky(R + 1e-9 * np.trace(R) * np.eye(MOST - 1))
        rest = np.log(np.delete(frequency, mass)), L[np.tril_indices(MOST - 1)], np.delete(G, mass, 0).ravel()
        return np.concatenate([*rest, change[self.upper]])

    def _found(self, masses: int, begin: Array) -> tuple[float, Array]:
        """Cost and result of one least-squares run."""
        from scipy.optimize import least_squares

        x, (low, high) = begin, self._ends
        inner = 1e-6 * (high - low)
        x[:masses] = np.clip(x[:masses], low + inner, high - inner)
        ends = np.full((2, len(x)), [[-np.inf], [np.inf]])
        ends[:, :masses] = [[low], [high]]
        dampers, most = slice(masses, masses + masses * (masses + 1) // 2), np.sqrt(OVERDAMPED * self.omega[-1])
        ends[:, dampers] = [[-most], [most]]
        x[dampers] = np.clip(x[dampers], -0.99 * most, 0.99 * most)
        found = least_squares(
            self._residual, x, self._jacobian, tuple(ends), x_scale="jac", max_nfev=EVALUATIONS,
            ftol=ENOUGH, xtol=ENOUGH, args=(masses,),
        )  # fmt: skip
        return float(found.cost), found.x

    def _parts(self, x: Array, masses: int) -> tuple[Array, Array, Array, Array]:
        """Unpack the unknowns `x`: frequencies [M], L [M, M], scaled shapes G [M, g], scaled change of A_inf [g, g].

        The dampers are L L^T, plus LEAST times the frequencies on the diagonal. Only the upper triangle of the change
        is filled.
        """
        g, n = len(self.group), masses * (masses + 1) // 2
        L, change = np.zeros((masses, masses)), np.zeros((g, g))
        L[np.tril_indices(masses)] = x[masses : masses + n]
        change[self.upper] = x[masses + n + masses * g :]
        return np.exp(x[:masses]), L, x[masses + n : masses + n + masses * g].reshape(masses, g), change

    def _response(self, x: Array, masses: int) -> tuple[Complex, Complex, Complex]:
        """Return i w [n, 1, 1], H = (s^2 + s R + W^2)^-1 G [n, M, g], and K over `of_B` [n, g, g]."""
        frequency, L, G, _change = self._parts(x, masses)
        s = 1j * self.omega[:, None, None]
        Z = s * (L @ L.T + np.diag(LEAST * frequency)) + np.diag(frequency**2) + s**2 * np.eye(masses)
        H = np.linalg.solve(Z, np.broadcast_to(G.astype(np.complex128), (len(s), *G.shape)))
        return s, H, s * (G.T @ H)

    def _weighed(self, K: Complex, A: Array | float, B: Array | float, change: Array) -> Array:
        """Weighted errors [..., 2 n u + u] of K [..., n, g, g] against B and A, and of the change of A_inf, for u
        pairs.
        """
        rows, lead = (..., *self.upper), K.shape[:-3]
        damping = (K.real - B)[rows] * self.weight * self.own
        added = (K.imag * self.of_B / self.omega[:, None, None] / self.of_A - A)[rows] + change[..., None, :]
        parts = damping.reshape(*lead, -1), (added * self.tuned).reshape(*lead, -1), STIFF * change
        return np.concatenate(parts, axis=-1)

    def _residual(self, x: Array, masses: int) -> Array:
        change = x[len(x) - len(self.upper[0]) :]
        try:
            K = self._response(x, masses)[2]
        except np.linalg.LinAlgError:  # two masses coincide: far from any solution
            return np.full(len(self.upper[0]) * (2 * len(self.omega) + 1), FAR)
        return self._weighed(K, (self.A - self.A_inf) / self.of_A, self.B / self.of_B, change)

    def _jacobian(self, x: Array, masses: int) -> Array:
        """Derivative of `_residual`, [error, unknown]."""
        g, u = len(self.group), len(self.upper[0])
        frequency, L, _G, _change = self._parts(x, masses)
        s, H, _K = self._response(x, masses)
        P, one = L.T @ H, np.eye(g)
        by_frequency = -2 * frequency[:, None, None, None] ** 2 * s * np.einsum("nai,naj->anij", H, H)
        by_L = -(s**2) * np.einsum("nai,nbj->abnij", H, P)
        by_L = (by_L + by_L.swapaxes(-1, -2))[np.tril_indices(masses)]
        by_G = s * np.einsum("ki,naj->aknij", one, H)
        by_G = (by_G + by_G.swapaxes(-1, -2)).reshape(masses * g, *s.shape[:1], g, g)
        K = np.concatenate([by_frequency, by_L, by_G, np.zeros((u, len(self.omega), g, g))])
        change = np.concatenate([np.zeros((len(K) - u, u)), np.eye(u)])
        return self._weighed(K, 0.0, 0.0, change).T

    def _made(self, x: Array, masses: int) -> tuple[Memory, Array]:
        """Memory, and change of A_inf [g, g], from the vector of unknowns."""
        frequency, L, G, change = self._parts(x, masses)
        order = np.argsort(frequency)
        shape = np.zeros((masses, 6))
        shape[:, self.group] = G * self.size
        change = change + np.triu(change, 1).T
        damping = (L @ L.T + np.diag(LEAST * frequency))[np.ix_(order, order)]
        return Memory(frequency[order], damping, shape[order]), change * self.of_A

    def _pairs(self, memory: Memory) -> list[Pair]:
        """Errors of every pair of modes in the group."""
        rows = np.ix_(range(len(self.omega)), self.group, self.group)
        energy = np.asarray(np.trapezoid(self.B**2, self.omega, axis=0))
        short = np.asarray(np.trapezoid((self.B - memory.damps(self.omega)[rows]) ** 2, self.omega, axis=0))
        found = []
        for i, j in zip(*self.upper, strict=True):
            whole = max(energy[i, j], COUPLED * np.sqrt(energy[i, i] * energy[j, j]))
            off, peak = 0.0, self.peaks[i] if i == j else None
            if peak is not None:
                wanted = float(np.interp(peak, self.omega, self.B[:, i, i]))
                off = abs(float(memory.damps(peak)[0, self.group[i], self.group[i]]) / max(wanted, 1e-300) - 1)
            found.append(Pair((MODES[self.group[i]], MODES[self.group[j]]), float(short[i, j] / whole), off))
        return found


class MemoryFit(NamedTuple):
    """A memory, its A_inf [6, 6], and the errors of the fit."""

    memory: Memory
    added_mass_inf: Array
    pairs: tuple[Pair, ...]


def check_passive(omega: Array, B: Array) -> None:
    """Refuse damping [n, 6, 6] that adds energy."""
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
        tqdm(total=len(searches) * ALL, desc="memory", unit="mass", disable=quiet) as bar,
        workers(len(searches), _report_to, progress) as pool,
    ):
        running = [pool.submit(_searched, search, energy) for search in searches]
        while not all(search.done() for search in running):
            with contextlib.suppress(queue.Empty):
                bar.update(progress.get(timeout=WAIT_S))
        found = [search.result() for search in running]
        bar.update(bar.total - bar.n)
        return found


_progress: "list[Queue[int]]" = []  # in a worker: the queue to which it reports its progress


def _report_to(progress: "Queue[int]") -> None:
    _progress[:] = [progress]


def _searched(search: MemorySearch, energy: float) -> tuple[Memory, Array, list[Pair]]:
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        _progress[0].put(1)

    found = search.run(energy, tell)
    _progress[0].put(ALL - done)  # it has ended earlier: few masses are enough
    return found
