"""Viscous roll damping of a bare hull with round bilges at rest: the simplified Ikeda method.

    K = -B_F p - 1/2 rho L T^4 C_R |p| p

- Friction of the skin in laminar flow, at the roll frequency omega: B_F = 0.787 rho S r^2 sqrt(nu omega), with the mean
  arm r and the surface S of ships (Kato 1958).
- Eddies at the bilges: C_R, a regression over hulls of a series.

Kawahara, Maekawa and Ikeda (2009), A simple prediction formula of roll damping of conventional cargo ships on the basis
of Ikeda's method and its limitation, STAB 2009. OG is the depth of the roll axis, here the CG, below the waterline.
"""

from typing import NamedTuple

import numpy as np

from taichi_sim.applications.hydro.resistance import VISCOSITY, HullForm

WITHIN = {"C_B": (0.5, 0.85), "B / T": (2.5, 4.5), "C_M": (0.9, 1.0), "OG / T": (-1.5, 0.2)}  # of the regression
FULLEST = 0.99  # C_M in it: fuller sections count as this


class Rolling(NamedTuple):
    """A hull that rolls: length, beam, draught (m), C_B, C_M, OG (m)."""

    L: float
    B: float
    T: float
    C_B: float
    C_M: float
    OG: float

    @classmethod
    def of(cls, form: HullForm, OG: float) -> "Rolling":
        """One hull of a form."""
        L, B, T = form.length, form.beam, form.draught
        return cls(L, B, T, form.volume / (L * B * T), form.midship / (B * T), OG)

    @property
    def outside(self) -> list[str]:
        """Ratios that lie outside the range of the regression."""
        ratios = self.C_B, self.B / self.T, self.C_M, self.OG / self.T
        return [
            f"{name} = {value:.3g} (range {low:g} to {high:g})"
            for (name, (low, high)), value in zip(WITHIN.items(), ratios, strict=True)
            if not low <= value <= high
        ]

    def friction(self, rho: float, omega: float, nu: float = VISCOSITY) -> float:
        """B_F at the roll frequency omega (rad/s), N m s."""
        L, B, T, C_B, _, OG = self
        arm = ((0.887 + 0.145 * C_B) * (1.7 * T + C_B * B) - 2 * OG) / np.pi
        return 0.787 * rho * L * (1.75 * T + C_B * B) * arm**2 * float(np.sqrt(nu * omega))

    def eddies(self, rho: float) -> float:
        """1/2 rho L T^4 C_R, N m s^2."""
        c, b, og = self.C_B, self.B / self.T, self.OG / self.T
        a = (0.0155 - 0.0182 * c) * (b - 1.8) ** 3 + np.polyval((-79.414, 215.695, -215.883, 93.894, -14.848), c)
        b_1 = (3.98 * c - 5.1525) * (1.6 - 0.2 * b) * og
        b_1 *= (0.9717 * c**2 - 1.55 * c + 0.723) * og + 0.04567 * c + 0.9408
        b_2 = (0.25 * og + 0.95) * og + np.polyval((-219.2, 443.7, -283.3, 59.6), c)
        b_3 = -15 * c * b + 46.5 * c + 11.2 * b - 28.6
        C_R = float(a * np.exp(b_1 + b_2 * min(self.C_M, FULLEST) ** b_3))
        return 0.5 * rho * self.L * self.T**4 * max(C_R, 0.0)  # of full flat hulls the regression falls below 0
