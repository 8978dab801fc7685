"""How much residuals depend on each other: factors of the standard deviations that make up for it.

Least squares count every sample as independent. Errors of a filter's estimate, of an interpolated sensor, or of a model
that is not quite right last for several samples, so that there are fewer independent ones. The errors of a channel are
taken as white noise and a first-order process side by side, whose autocorrelation is a share that falls exponentially.
Both variances and the time constant are those whose residuals have the autocovariance that is found, given that the
first state of each window takes its part out of them. A channel's factor follows from the generalised variance of the
numbers (sandwich; White 1980): g' R g / g' g, where R is the covariance and g the sensitivity of the channel.
"""

import numpy as np
from scipy.optimize import nnls

from taichi_sim.applications.fit.gauss_newton import OUTLIER, NormalEquations, Point, Problem
from taichi_sim.applications.fit.log_table import Array

CONSTANTS = 0.7 * 2.0 ** np.arange(8)  # samples: time constants that are tried
WINDOWS = 24  # windows whose first states' part is computed; the others are alike
SHORTEST = 5  # samples of a channel in a window, for its autocovariance
SURE = 9.0  # chi-squared by which a process must explain the autocovariance better than white noise alone


def spreads(problem: Problem, point: Point, normal: NormalEquations, sigma: Array) -> Array:
    """Factors [channel], at least 1, of the standard deviations `sigma` of the residuals."""
    channels = range(len(sigma))
    rows = [[np.flatnonzero(new[:, c]) for c in channels] for new in problem.new]
    covariances = [_covariance(point, rows, sigma, c) for c in channels]
    if all(found is None for found in covariances) or not len(point.phi):
        return np.ones(len(sigma))
    p, own = len(point.phi), point.slope.shape[-1] - 6
    each, whole = np.zeros((len(sigma), p)), np.zeros((len(sigma), p))
    for _, mine, B, C, _ in normal.blocks:
        taken = np.linalg.solve(C, B.T)
        for k, w in enumerate(mine):
            of = np.r_[0 : own - p, own - p + 6 * k : own - p + 6 * k + 6]
            sensitivity = (point.slope[w, ..., :p] - point.slope[w, ..., p:] @ taken[of]) / sigma[:, None]
            for c, found in enumerate(covariances):
                if found is not None:
                    g = sensitivity[rows[w][c], c]
                    each[c] += np.einsum("ik,ij,jk->k", g, _matrix(len(g), *found), g)
                    whole[c] += (g**2).sum(axis=0)
    ratio = np.where(whole > 0, each / np.where(whole > 0, whole, 1.0), 1.0).max(axis=1)
    return np.sqrt(np.maximum(ratio, 1.0))


def _matrix(n: int, white: float, process: float, constant: float) -> Array:
    """Covariance [n, n] of white noise and a process, with these variances."""
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return white * np.eye(n) + process * np.exp(-apart / constant)


def _covariance(point: Point, rows: list, sigma: Array, c: int) -> tuple[float, float, float] | None:
    """Variances of white noise and process of channel `c`, over white noise's alone, and the time constant, in samples.

    None: white noise alone explains the residuals.
    """
    n = min(len(of[c]) for of in rows)
    if n < SHORTEST:
        return None
    lags, scaled = n // 2 + 1, np.clip(point.left / sigma, -OUTLIER, OUTLIER)
    sums, pairs = np.zeros(lags), np.zeros(lags)
    for w, of in enumerate(rows):
        x = scaled[w, of[c], c]
        for k in range(lags):
            sums[k] += x[: len(x) - k] @ x[k:]
            pairs[k] += len(x) - k
    found, by_white, by_process = sums / pairs, np.zeros(lags), np.zeros((len(CONSTANTS), lags))
    looked = np.linspace(0, len(rows) - 1, min(WINDOWS, len(rows))).astype(int)
    for w in looked:
        left = _projector(point, sigma, w, rows[w], c)
        by_white += _lags(left, lags)
        for j, constant in enumerate(CONSTANTS):
            by_process[j] += _lags(left @ _matrix(len(left), 0.0, 1.0, constant) @ left + left - left @ left, lags)
    by_white, by_process = by_white / len(looked), by_process / len(looked)
    weight = np.sqrt(pairs) / max(found[0], 1e-12)  # over the deviation of an autocovariance of white noise
    alone, missed = nnls((weight * by_white)[:, None], weight * found)
    fits = [nnls(weight[:, None] * np.stack((by_white, one), 1), weight * found) for one in by_process]
    best = int(np.argmin([left for _, left in fits]))
    (white, process), left = fits[best]
    if missed**2 - left**2 < SURE or alone[0] <= 0:
        return None
    return white / alone[0], process / alone[0], float(CONSTANTS[best])


def _projector(point: Point, sigma: Array, w: int, rows: list, c: int) -> Array:
    """The part of window w's errors in channel c that its first state leaves in the residuals [sample, sample]."""
    slope = point.slope[w, ..., -6:] / sigma[:, None]
    all_of = np.concatenate([slope[of, k] for k, of in enumerate(rows)])
    basis = np.linalg.qr(all_of)[0]
    first = sum(len(of) for of in rows[:c])
    mine = basis[first : first + len(rows[c])]
    return np.eye(len(mine)) - mine @ mine.T


def _lags(covariance: Array, lags: int) -> Array:
    """Means of the diagonals of a matrix, from the main one on."""
    return np.array([np.mean(np.diagonal(covariance, k)) for k in range(lags)], dtype=np.float64)
