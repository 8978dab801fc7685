"""Radiation memory: the load of the waves that a hull has radiated before.

Cummins (1962) splits radiation into added mass at infinite frequency, A_inf, and a convolution with the past velocity,

    tau_rad = -A_inf nu_dot - mu,   mu(t) = int_0^t K(t - s) nu(s) ds,   K(i w) = B(w) + i w (A(w) - A_inf).

Here the convolution is realised by a mechanical system that the hull shakes, about CO in b. The system has M unit
masses on springs, with dampers on them and between them:

    y_ddot + R y_dot + W^2 y = G nu,   mu = G^T y_dot,      K(s) = s G^T (s^2 + s R + W^2)^-1 G,

W is diagonal; R is symmetric and positive semidefinite. By this form, K has the properties of radiation (Perez and
Fossen 2009, Modeling, Identification and Control 30, 1): it is stable, strictly proper, symmetric and passive, and K(0)
= 0. No fit can create energy. The system is stepped in its modes, x_f' = p_f x_f + b_f nu, mu = Re sum_f c_f x_f, by
the implicit midpoint rule, which keeps passivity: over a step h the masses and springs store h (mu nu - y_dot^T R
y_dot), all evaluated at the middle of the step.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

from functools import cached_property
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray

from taichi_sim.kernels.lanes import blocks, filled, totals, variables

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
REAL = 1e-9  # imaginary part of a real pole, over its size


class Modes(NamedTuple):
    """A bank of first-order filters with complex poles; one filter stands for a conjugate pair."""

    pole: Complex  # [F], rad/s
    enters: Complex  # [F, 6], b
    leaves: Complex  # [F, 6], c

    def bank(self, dt: float) -> "Bank":
        """Discretise the filters for steps of dt (s)."""
        seen = (self.enters != 0) | (self.leaves != 0)
        groups, rows, first, begin = [], [], 0, 0
        for pattern in sorted({tuple(row) for row in seen.tolist()}):
            use = (seen == np.array(pattern)).all(axis=1)
            modes = tuple(int(mode) for mode in np.flatnonzero(pattern))
            gain, enters = 1 / (1 - self.pole[use] * dt / 2), self.enters[use] * dt / 2
            columns = [gain, *(x[:, mode] for mode in modes for x in (enters, self.leaves[use]))]
            size = filled(len(gain))
            rows += [np.pad(part, (0, size - len(gain))) for column in columns for part in (column.real, column.imag)]
            groups.append(FilterGroup(begin, first, size, modes))
            begin, first = begin + 2 * len(columns) * size, first + 2 * size
        return Bank(tuple(groups), first, np.concatenate([*rows, np.zeros(filled(1))]))


class FilterGroup(NamedTuple):
    """Filters that are coupled to the same modes of motion."""

    begin: int  # index of their first number
    first: int  # index of their first state; real parts, then imaginary parts
    size: int  # number of filters, padded with idle ones to whole vectors (lanes.py)
    modes: tuple[int, ...]


class Bank(NamedTuple):
    """Filters as a kernel processes them.

    The numbers of a group are, for all its filters each: real and imaginary part of 1 / (1 - p dt/2), then of b dt/2
    and of c for every mode.
    """

    groups: tuple[FilterGroup, ...]
    size: int  # number of states
    numbers: Array  # ends with zeros, so that it is never empty


class Memory:
    """M masses on springs with dampers (see the module's docstring); a hull without memory has none.

    Attributes:
        frequency: diagonal of W, [M], rad/s.
        damping: R, [M, M], 1/s.
        shape: G, [M, 6]; shape^T shape is in N s/m, N s and N m s per second.
    """

    def __init__(self, frequency: ArrayLike, damping: ArrayLike, shape: ArrayLike):
        """Take the numbers.

        Raises:
            ValueError: if the dampers would create energy.
        """
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


@ti.func
def radiate(bank: ti.template(), numbers: ti.template(), states: ti.template(), e, i, first: ti.template(), nu):
    """Load -mu (N, N m, about CO, b) in the middle of a step, where the velocity through the water is `nu`.

    The states of the filters are advanced to the end of the step. They lie in the auxiliary state from column `first`
    on. `bank` is Modes.bank, `numbers` are its numbers, `states` is the auxiliary state, both in lanes.
    """
    load = ti.static(variables(6, numbers[0] * 0.0))
    for g in ti.static(range(len(bank.groups))):
        group, size = ti.static(bank.groups[g], blocks(bank.groups[g].size))
        for f in range(size):
            n = ti.static(blocks(group.begin)) + f
            real = ti.static(blocks(first + group.first)) + f
            x, y = states[e, i, real], states[e, i, real + size]
            a, b = x, y
            for c in ti.static(range(len(group.modes))):
                a += numbers[n + ti.static((4 * c + 2) * size)] * nu[group.modes[c]]
                b += numbers[n + ti.static((4 * c + 3) * size)] * nu[group.modes[c]]
            gain_re, gain_im = numbers[n], numbers[n + size]
            x_m, y_m = gain_re * a - gain_im * b, gain_re * b + gain_im * a
            for c in ti.static(range(len(group.modes))):
                leaves_re = numbers[n + ti.static((4 * c + 4) * size)]
                leaves_im = numbers[n + ti.static((4 * c + 5) * size)]
                load[group.modes[c]] += leaves_im * y_m - leaves_re * x_m
            states[e, i, real], states[e, i, real + size] = 2 * x_m - x, 2 * y_m - y
    return totals(load)
