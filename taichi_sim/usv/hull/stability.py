"""The largest step a hull's integrator can take: from the eigenvalues of its linear motion about rest.

State (heave, roll, pitch, nu); position and heading do not stiffen it. Damping is linear, and quadratic at top speed.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LARGEST, HALVINGS = 10.0, 40  # s, of the bisection


def linear_motion(M: Array, D: Array, G: Array) -> Array:
    """A [9, 9] of d/dt (z, phi, theta, nu) = A (z, phi, theta, nu); M, D [6, 6] and G [3, 3]."""
    A = np.zeros((9, 9))
    A[:3, 5:8] = np.eye(3)
    inverse = np.linalg.inv(M)
    A[3:, 3:] = -inverse @ D
    A[3:, :3] = -inverse[:, 2:5] @ G
    return A


def runge_kutta_step(A: Array, dt: float) -> Array:
    """The matrix by which classical Runge-Kutta advances y' = A y."""
    x, step, term = A * dt, np.eye(len(A)), np.eye(len(A))
    for n in range(1, 5):
        term = term @ x / n
        step = step + term
    return step


def strang_step(A: Array, dt: float) -> Array:
    """The matrix by which drift, midpoint rule and drift advance (pose, nu, the last step's change of nu)."""
    drift = np.eye(15)
    drift[:3, 3:9] = A[:3, 3:] * dt / 2
    change = dt * np.hstack([A[3:], A[3:, 3:] / 2])  # the middle's velocity is foretold by the last change
    kick = np.zeros((15, 15))
    kick[:9, :9] = np.eye(9)
    kick[3:9] += change
    kick[9:] = change
    return drift @ kick @ drift


def largest_stable_dt(A: Array, step) -> float:
    """Largest dt (s) at which `step(A, dt)` lets no motion grow."""

    def stable(dt: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(step(A, dt))).max() <= 1 + 1e-9)

    low, high = 0.0, LARGEST
    if stable(high):
        return high
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
