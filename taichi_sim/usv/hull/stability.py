"""Largest stable step of a hull's integrator, from the eigenvalues of its linear motion about rest.

The state is (heave, roll, pitch, nu); position and heading do not affect stability. Damping is the linear one, plus the
quadratic one at top speed.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from taichi_sim.usv.hull.memory import Modes

Array = NDArray[np.float64]
LARGEST, HALVINGS = 10.0, 40  # s, largest step considered; halvings of the bisection


def linear_motion(M: Array, D: Array, G: Array) -> Array:
    """A [9, 9] of d/dt (z, phi, theta, nu) = A (z, phi, theta, nu); M, D [6, 6] and G [3, 3]."""
    A = np.zeros((9, 9))
    A[:3, 5:8] = np.eye(3)
    inverse = np.linalg.inv(M)
    A[3:, 3:] = -inverse @ D
    A[3:, :3] = -inverse[:, 2:5] @ G
    return A


def runge_kutta_step(A: Array, dt: float) -> Array:
    """Matrix by which the classical Runge-Kutta method advances y' = A y."""
    x, step, term = A * dt, np.eye(len(A)), np.eye(len(A))
    for n in range(1, 5):
        term = term @ x / n
        step = step + term
    return step


def strang_step(A: Array, dt: float, modes: Modes | None = None, inverse: Array | None = None) -> Array:
    """Matrix of one step of drift, midpoint rule and drift (motion.py).

    Its state is (pose, nu, last change of nu) and, with a memory, the real and imaginary parts of its filters
    (memory.py). `inverse` [6, 6] is the inverse mass of a hull with memory.
    """
    filters = 0 if modes is None else len(modes.pole)
    drift, kick = np.eye(15 + 2 * filters), np.eye(15 + 2 * filters)
    drift[:3, 3:9] = A[:3, 3:] * dt / 2
    middle = np.hstack(
        [np.zeros((6, 3)), np.eye(6), np.eye(6) / 2]
    )  # velocity in the middle, predicted with the last change
    change = np.zeros((6, len(kick)))
    change[:, :15] = A[3:, 3:] @ middle
    change[:, :3] = A[3:, :3]
    if modes is not None and inverse is not None:
        gain, x = 1 / (1 - modes.pole * dt / 2), np.zeros((filters, len(kick)), dtype=np.complex128)
        x[:, 15::2], x[:, 16::2] = np.eye(filters), 1j * np.eye(filters)
        x_middle = gain[:, None] * x
        x_middle[:, :15] += (gain * dt / 2)[:, None] * modes.enters @ middle
        change -= inverse @ (modes.leaves.T @ x_middle).real
        after = 2 * x_middle - x
        kick[15::2], kick[16::2] = after.real, after.imag
    kick[3:9] += dt * change
    kick[9:15] = dt * change
    return drift @ kick @ drift


def remembering(modes: Modes, M: Array) -> Callable[[Array, float], Array]:
    """`strang_step` for a hull of mass M [6, 6] with a memory."""
    return partial(strang_step, modes=modes, inverse=np.asarray(np.linalg.inv(M), dtype=np.float64))


def largest_stable_dt(A: Array, step) -> float:
    """Largest dt (s) at which no motion grows under `step(A, dt)`."""

    def stable(dt: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(step(A, dt))).max() <= 1 + 1e-9)

    low, high = 0.0, LARGEST
    if stable(high):
        return high
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
