"""Radiation memory: the load of the waves that a hull has radiated before.

Cummins (1962) splits radiation into added mass at infinite frequency, A_inf, and a convolution with the past velocity,

    tau_rad = -A_inf nu_dot - mu,   mu(t) = int_0^t K(t - s) nu(s) ds,   K(i w) = B(w) + i w (A(w) - A_inf).

Here the convolution is realised by a mechanical system that the hull shakes, about CO in b. The system has M unit
masses on springs, with dampers on them and between them:

    y_ddot + R y_dot + W^2 y = G nu,   mu = G^T y_dot,      K(s) = s G^T (s^2 + s R + W^2)^-1 G,

W is diagonal; R is symmetric and positive semidefinite. By this form, K has the properties of radiation (Perez and
Fossen 2009, Modeling, Identification and Control 30, 1): it is stable, strictly proper, symmetric and passive, and K(0)
= 0. No fit can create energy. Its modes are stepped (radiation.py), x_f' = p_f x_f + b_f nu, mu = Re sum_f c_f x_f, by
the implicit midpoint rule, which keeps passivity: over a step h the masses and springs store h (mu nu - y_dot^T R
y_dot), all evaluated at the middle of the step.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
REAL = 1e-9  # imaginary part of a real pole, over its size


class Modes(NamedTuple):
    """A bank of first-order filters with complex poles; one filter stands for a conjugate pair."""

    pole: Complex  # [F], rad/s
    enters: Complex  # [F, 6], b
    leaves: Complex  # [F, 6], c


class Memory:
    """M masses on springs with dampers (see the module's docstring); a hull without memory has none.

    Attributes:
        frequency: diagonal of W, [M], rad/s.
        damping: R, [M, M], 1/s.
        shape: G, [M, 6]; shape^T shape is in N s/m, N s and N m s per second.
    """

    def __init__(self, frequency: ArrayLike, damping: ArrayLike, shape: ArrayLike):
        """Take the numbers."""
        self.frequency = np.asarray(frequency, dtype=np.float64)
        self.damping = np.asarray(damping, dtype=np.float64).reshape(len(self.frequency), len(self.frequency))
        self.shape = np.asarray(shape, dtype=np.float64).reshape(len(self.frequency), 6)
        if len(self) and np.linalg.eigvalsh(self.damping)[0] < -1e-5 * np.abs(self.damping).max():
            raise ValueError("the memory's damping is not positive: it would make energy")

    @classmethod
    def none(cls) -> "Memory":
        """A memory without masses."""
        return cls(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 6)))

    def __len__(self) -> int:
        """Number of masses."""
        return len(self.frequency)

    def transfer(self, omega: ArrayLike) -> Complex:
        """K(i w) [n, 6, 6] at omega [n] (rad/s)."""
        w = np.atleast_1d(np.asarray(omega, dtype=np.float64))[:, None, None]
        Z = 1j * w * self.damping + np.diag(self.frequency**2) - w**2 * np.eye(len(self))
        G = np.broadcast_to(self.shape.astype(np.complex128), (len(w), *self.shape.shape))
        return 1j * w * (self.shape.T @ np.linalg.solve(Z, G))

    def damps(self, omega: ArrayLike) -> Array:
        """B [n, 6, 6] at omega [n] (rad/s)."""
        return self.transfer(omega).real

    def adds(self, omega: ArrayLike) -> Array:
        """A - A_inf [n, 6, 6] at omega [n] (rad/s, > 0)."""
        return self.transfer(omega).imag / np.atleast_1d(omega)[:, None, None]

    @property
    def slow_inertia(self) -> Array:
        """A - A_inf [6, 6] in the limit of omega = 0."""
        return (self.shape / self.frequency[:, None] ** 2).T @ self.shape

    def kernel(self, time: ArrayLike) -> Array:
        """K(t) [n, 6, 6] at time [n] (s, >= 0)."""
        t, (pole, enters, leaves) = np.atleast_1d(np.asarray(time, dtype=np.float64)), self.modes
        return np.einsum("nf,fi,fj->nij", np.exp(np.outer(t, pole)), leaves, enters).real

    @cached_property
    def modes(self) -> Modes:
        """The modes of the system."""
        n = len(self)
        if not n:
            return Modes(np.zeros(0, complex), np.zeros((0, 6), complex), np.zeros((0, 6), complex))
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(self.frequency**2), -self.damping]])
        pole, vectors = (np.asarray(x, dtype=np.complex128) for x in np.linalg.eig(A))
        inverse = np.linalg.inv(vectors)
        enters, leaves = inverse[:, n:] @ self.shape, (self.shape.T @ vectors[n:]).T
        size = np.sqrt(np.linalg.norm(leaves, axis=1) / np.maximum(np.linalg.norm(enters, axis=1), 1e-300))[:, None]
        real = np.abs(pole.imag) < REAL * np.abs(pole)
        keep = real | (pole.imag > 0)
        enters, leaves = enters * size, leaves / size * np.where(real, 1.0, 2.0)[:, None]
        scale = np.abs(self.shape).max(axis=0)  # entries that symmetry makes zero stay zero in the kernel
        enters, leaves = (np.where(scale > 0, values, 0.0) for values in (enters, leaves))
        return Modes(pole[keep], _cleaned(enters[keep]), _cleaned(leaves[keep]))


def _cleaned(values: Complex) -> Complex:
    """`values` [F, 6] without rounding errors of motions that symmetry does not couple, judged by each column's
    scale.
    """
    size = np.abs(values) / np.maximum(np.abs(values).max(axis=0), 1e-300)
    return np.where(size < 1e-9 * np.maximum(size.max(axis=1, keepdims=True), 1e-300), 0.0, values)
