"""Waves in the far field: Kochin's function, and damping from the energy that they carry away.

    H(theta) = 1/(4 pi) integral (phi_n e - phi e_n) dS,    e = f(z) exp(-i k (x cos theta + y sin theta)),

f = cosh k(z + h) / cosh kh. Waves of a potential phi carry the power (omega / k) c2 |H|^2 dtheta to dtheta, in deep
water c2 = 2 pi rho k^2. So motions of unit velocity are damped by what goes out and by what a damping lid takes,

    B_ij = 2 (omega / k) c2 integral Re(H_i H_j*) dtheta + rho omega K epsilon integral Re(phi_i phi_j*) dS,

symmetric and never negative, as integrated pressures are only on ever finer panels.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.problem import Solution, Tank

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
FEWEST_ANGLES = 180  # of integrals round the hull
ANGLES_PER_PHASE = 6  # of k times the hull's radius


def kochin(solution: Solution, depth: float, angle: Array) -> tuple[Complex, Complex]:
    """H [angle, 6 + heading] of motions of unit velocity and of scattered waves, and dH/d(angle)."""
    k, (x, y, z) = solution.wavenumber, solution.points.T
    n_x, n_y, n_z = solution.area.T
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    cosh, sinh = attenuation(k, z, depth)
    wave = np.exp(-1j * k * (x * c + y * s))
    turn, normal, normal_turn = -1j * k * (y * c - x * s), n_x * c + n_y * s, n_y * c - n_x * s
    e = cosh * wave
    e_n = (-1j * k * cosh * normal + k * sinh * n_z) * wave
    e_n_turned = turn * e_n - 1j * k * cosh * normal_turn * wave
    H = e @ solution.flow - e_n @ solution.potential
    H_turned = (turn * e) @ solution.flow - e_n_turned @ solution.potential
    return H / (4 * np.pi), H_turned / (4 * np.pi)


def attenuation(k: float, z: Array, depth: float) -> tuple[Array, Array]:
    """cosh k(z+h) / cosh kh, and the same with sinh."""
    if k * depth > 20:
        return np.exp(k * z), np.exp(k * z)
    return np.cosh(k * (z + depth)) / np.cosh(k * depth), np.sinh(k * (z + depth)) / np.cosh(k * depth)


def fewest_angles(solution: Solution) -> int:
    """Number of angles for integrals around the hull."""
    radius = np.linalg.norm(solution.points[:, :2], axis=1).max()
    return max(FEWEST_ANGLES, int(np.ceil(ANGLES_PER_PHASE * solution.wavenumber * radius)))


def weight(tank: Tank, omega: float, k: float) -> float:
    """c2: momentum that waves of |H| = 1 carry away per radian, N."""
    shallow = 1.0 if k * tank.depth > 20 else 1 / (1 + 2 * k * tank.depth / np.sinh(2 * k * tank.depth))
    return float(2 * np.pi * tank.rho * tank.g * k**3 / omega**2 * shallow)


def radiated_damping(tank: Tank, solution: Solution, omega: float) -> Array:
    """Damping B [6, 6]; entries that symmetry forbids stay zero."""
    k, n = solution.wavenumber, fewest_angles(solution)
    H = kochin(solution, tank.depth, 2 * np.pi * np.arange(n) / n)[0][:, :6]
    waves = 2 * omega / k * weight(tank, omega, k) * 2 * np.pi / n * (H.conj().T @ H).real
    phi = solution.gap_potential[:, :6]
    lid = tank.rho * tank.gap_damping * omega**3 / tank.g * (phi.conj().T @ (phi * solution.gap_area[:, None])).real
    return np.where(solution.damping == 0.0, 0.0, waves + lid)
