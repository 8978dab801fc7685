"""Waves in the far field: Kochin's function, radiation damping from the radiated energy, and mean drift.

    H(theta) = 1/(4 pi) integral (phi_n e - phi e_n) dS,    e = f(z) exp(-i k (x cos theta + y sin theta)),

with f = cosh k(z + h) / cosh kh. Waves of a potential phi carry the power (omega / k) c2 |H|^2 dtheta in the sector
dtheta; in deep water c2 = 2 pi rho k^2. The damping of motions of unit velocity follows from the radiated energy, plus
that which a damping lid absorbs:

    B_ij = 2 (omega / k) c2 integral Re(H_i H_j*) dtheta + rho omega K epsilon integral Re(phi_i phi_j*) dS.

It is symmetric and never negative. Integrated pressures are so only in the limit of fine panels.

The mean drift of the freely floating hull in regular waves follows from momentum over a distant cylinder (Maruo 1960;
Newman 1967). H is of the waves scattered by the fixed hull plus those of its motions, per metre of the amplitude a of
waves that travel to beta:

    X = -a^2 (c1 cos beta Re H(beta) + c2 integral |H|^2 cos theta dtheta),  Y with sines,
    N = a^2/k (-c1 Im H'(beta) - c2 integral Im(H* H') dtheta),

with c1 = 2 pi rho omega in deep water. In depth h both c1 and c2 are larger by coth kh, and c2 is smaller by 1 + 2kh /
sinh 2kh. The drift includes the loads on a damping lid. There is no viscous damping: a roll that only potential damping
limits drifts too much at its resonance.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.problem import Solution, Tank
from taichi_sim.hydro.surface import cos_sin

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
FEWEST_ANGLES = 180  # in integrals around the hull
ANGLES_PER_PHASE = 6  # angles per radian of k times the hull's radius


def kochin(solution: Solution, depth: float, angle: Array) -> tuple[Complex, Complex]:
    """H [angle, 6 + heading] of motions of unit velocity and of scattered waves, and its derivative by the angle."""
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
    """cosh k(z+h) / cosh kh and sinh k(z+h) / cosh kh."""
    if k * depth > 20:
        return np.exp(k * z), np.exp(k * z)
    return np.cosh(k * (z + depth)) / np.cosh(k * depth), np.sinh(k * (z + depth)) / np.cosh(k * depth)


def fewest_angles(solution: Solution) -> int:
    """Number of angles for integrals around the hull."""
    radius = np.linalg.norm(solution.points[:, :2], axis=1).max()
    return max(FEWEST_ANGLES, int(np.ceil(ANGLES_PER_PHASE * solution.wavenumber * radius)))


def weight(tank: Tank, omega: float, k: float) -> float:
    """c2: momentum (N) that waves of |H| = 1 carry away per radian."""
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


def response(solution: Solution, M: Array, C: Array, omega: float) -> Complex:
    """Motions [heading, 6] per metre of wave amplitude: m, rad/m."""
    Z = -(omega**2) * (M + solution.added_mass) - 1j * omega * solution.damping + C
    return np.linalg.solve(Z, (solution.froude_krylov + solution.diffraction).T).T


def mean_drift(tank: Tank, solution: Solution, motion: Complex, omega: float, heading_deg: Array) -> Array:
    """Mean surge and sway force (N/m^2) and yaw moment (N/m) per squared wave amplitude, [heading, 3]."""
    k, n = solution.wavenumber, fewest_angles(solution)
    around = 2 * np.pi * np.arange(n) / n
    velocity = -1j * omega * motion.T  # [6, heading]; the solution has potentials of unit velocity

    def total(angle: Array) -> tuple[Complex, Complex]:
        """H and its derivative [angle, heading] of all waves from the free hull."""
        of = kochin(solution, tank.depth, angle)
        H, H_turned = (1j * (h[:, :6] @ velocity + h[:, 6:]) for h in of)
        return H, H_turned

    H, H_turned = total(around)
    ahead, ahead_turned = (np.diagonal(h) for h in total(np.deg2rad(heading_deg)))
    c1 = 2 * np.pi * tank.rho * tank.g * k / omega
    c2 = weight(tank, omega, k)
    c, s = cos_sin(heading_deg)
    step = 2 * np.pi / n
    X = -c1 * c * ahead.imag - c2 * step * np.cos(around) @ np.abs(H) ** 2
    Y = -c1 * s * ahead.imag - c2 * step * np.sin(around) @ np.abs(H) ** 2
    N = (c1 * ahead_turned.real - c2 * step * (H.conj() * H_turned).imag.sum(axis=0)) / k
    return np.stack([X, Y, N], axis=1)
