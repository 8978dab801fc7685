"""Mean drift of the freely floating hull in regular waves, from its waves in the far field.

Momentum over a distant cylinder (Maruo 1960; Newman 1967): with Kochin's function H(theta) (far_field.py) of waves
scattered by the held hull and of those of its motions, per metre of amplitude a of waves to beta,

    X = -a^2 (c1 cos beta Re H(beta) + c2 integral |H|^2 cos theta dtheta),  Y with sines,
    N = a^2/k (-c1 Im H'(beta) - c2 integral Im(H* H') dtheta),

in deep water c1 = 2 pi rho omega, c2 = 2 pi rho k^2; in depth h both are greater by coth kh, and c2 less by
1 + 2kh / sinh 2kh. Loads on the hull and on a damping lid are taken together. There is no viscous damping: a roll that
only potential damping limits drifts too much at its resonance.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.far_field import fewest_angles, kochin, weight
from taichi_sim.hydro.frames import cos_sin
from taichi_sim.hydro.problem import Solution, Tank

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


def response(solution: Solution, M: Array, C: Array, omega: float) -> Complex:
    """Motions [heading, 6] per metre of wave amplitude: m, rad/m."""
    Z = -(omega**2) * (M + solution.added_mass) - 1j * omega * solution.damping + C
    return np.linalg.solve(Z, (solution.froude_krylov + solution.diffraction).T).T


def mean_drift(tank: Tank, solution: Solution, motion: Complex, omega: float, heading_deg: Array) -> Array:
    """Mean surge and sway force (N/m^2) and yaw moment (N/m) [heading, 3] per squared amplitude."""
    k, n = solution.wavenumber, fewest_angles(solution)
    around = 2 * np.pi * np.arange(n) / n
    velocity = -1j * omega * motion.T  # [6, heading]; potentials of motions are of unit velocity

    def total(angle: Array) -> tuple[Complex, Complex]:
        """H and its derivative [angle, heading] of the waves that the free hull sends out."""
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
