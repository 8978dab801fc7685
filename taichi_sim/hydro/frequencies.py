"""Choice of frequencies: from well below to well above the resonances, plus a tail for the memory of waves.

A coarse pass gives the resonances of heave, roll and pitch. With added mass A(omega) known at a few frequencies, a
natural frequency is an omega whose square is an eigenvalue of (M + A(omega))^-1 C.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BELOW, ABOVE = 0.2, 2.5  # times the lowest and highest resonance: the range that motions in waves need
TAIL = 4.5  # times the highest resonance: damping has decayed there, and the kernel's beginning depends on it
IN_TAIL = 0.2  # share of the frequencies in the tail
VERTICAL = [2, 3, 4]
SPIKE = 6.0  # times the damping at either neighbour: a peak that the frequencies do not resolve
NAMES = ("heave", "roll", "pitch")


class Resonances(NamedTuple):
    """Natural frequencies, rad/s."""

    heave: float
    roll: float
    pitch: float


def resonances(omega: Array, added_mass: Array, M: Array, C: Array) -> Resonances:
    """Natural frequencies of coupled heave, roll and pitch, from A [n, 6, 6] at omega [n], rigid-body M and stiffness C
    [6, 6].

    Each mode is identified by its largest share of an eigenvector.
    """
    found = []
    V = np.ix_(VERTICAL, VERTICAL)
    for mode in range(3):
        w = float(omega[len(omega) // 2])
        for _ in range(60):
            A = np.array([[np.interp(w, omega, added_mass[:, i, j]) for j in VERTICAL] for i in VERTICAL])
            value, vector = np.linalg.eig(np.linalg.solve(M[V] + A, C[V]))
            size = np.sqrt(np.abs(np.diag(M[V] + A)))[:, None] * np.abs(vector)
            own = int(np.argmax(size[mode] / np.linalg.norm(size, axis=0)))
            new = float(np.sqrt(max(value[own].real, 0.0)))
            if abs(new - w) < 1e-6 * w:
                break
            w = (w + new) / 2
        found.append(w)
    return Resonances(*found)


def trial(C: Array, M: Array) -> Array:
    """Frequencies [8] of the coarse pass: 0.25 to 1.5 times the resonances without added mass."""
    w = np.sqrt(np.diag(C)[VERTICAL] / np.diag(M)[VERTICAL])
    return np.geomspace(0.25 * w.min(), 1.5 * w.max(), 8)


def chosen(of: Resonances, count: int, top: float) -> Array:
    """Frequencies [count], rad/s: evenly spaced over the resonances, wider apart in the tail, none above `top`."""
    low, high, end = BELOW * min(of), min(ABOVE * max(of), top), min(TAIL * max(of), top)
    tail = round(IN_TAIL * count * min(1.0, np.log(end / high) / np.log(TAIL / ABOVE)))
    even = np.linspace(low, high, count - tail)
    return _digits([*even, *np.geomspace(high, end, tail + 1)[1:]])


def with_also(omega: Array, also: tuple[float, ...]) -> Array:
    """Add the frequencies `also` to `omega`; each replaces the nearest one within half a step."""
    kept = list(omega)
    for w in also:
        near = int(np.abs(omega - w).argmin())
        step = np.diff(omega)[min(near, len(omega) - 2)]
        if omega[near] in kept and abs(omega[near] - w) <= step / 2:
            kept.remove(omega[near])
    return _digits(sorted({*kept, *also}))


def _digits(omega) -> Array:
    return np.array([float(f"{w:.6g}") for w in omega])


def missed(omega: Array, of: Resonances) -> list[str]:
    """Messages about resonances outside a range of frequencies."""
    return [
        f"the frequencies {omega[0]:.3g} to {omega[-1]:.3g} rad/s miss the {name} resonance of {w:.3g} rad/s"
        for name, w in zip(NAMES, of, strict=True)
        if not omega[0] < w < omega[-1]
    ]


def spikes(omega: Array, damping: Array, kept: tuple[float, ...]) -> NDArray[np.intp]:
    """Indices of omega [n] at which the damping [n, 6, 6] of a mode has an isolated peak, except at frequencies in
    `kept`.

    Such a peak is narrower than a step, so it cannot be resolved: an irregular frequency that no lid removed, or
    perhaps a resonance without damping in a gap between hulls.
    """
    size = np.einsum("nii->ni", damping)
    beside = np.maximum(np.maximum(size[:-2], size[2:]), 1e-3 * size.max(axis=0))
    found = 1 + np.flatnonzero((size[1:-1] > SPIKE * beside).any(axis=1))
    return found[~np.isin(omega[found], kept)]
