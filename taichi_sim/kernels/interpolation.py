"""Values between the rows of a table."""

import numpy as np
from numpy.typing import NDArray

POINTS = 4  # that a cubic goes through


def cubic(x: NDArray[np.float64], y: NDArray, at: NDArray[np.float64]) -> NDArray:
    """The cubic through the four rows nearest to each of `at` [m] (Lagrange): [m, ...] of y [n, ...] at rising x [n],
    n at least 4. Beyond the table it goes on.
    """
    first = np.clip(np.searchsorted(x, at) - POINTS // 2, 0, len(x) - POINTS)
    out = np.zeros((len(at), *y.shape[1:]), dtype=np.result_type(y, np.float64))
    for i in range(POINTS):
        others = [first + j for j in range(POINTS) if j != i]
        weight = np.prod([(at - x[o]) / (x[first + i] - x[o]) for o in others], axis=0)
        out += weight.reshape(-1, *[1] * (y.ndim - 1)) * y[first + i]
    return out
