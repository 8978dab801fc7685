"""Calm-water resistance of a hull, or of two alike, by published methods.

    R(u) = (1 + k) C_F 1/2 rho S u^2 + C_A 1/2 rho S u^2 + R_W(u) + R_TR(u)

- Friction: the line of the ITTC (1957), C_F = 0.075 / (log10 Re - 2)^2, and the form factor 1 + k of Holtrop (1984)
  for one hull.
- Waves: of a single hull within the range of their regression, Holtrop and Mennen (1982; Holtrop 1984); of all others
  thin-ship theory (Michell 1898) on the hull's own panels, which includes the interference of two hulls:

      R_W = 4 rho g^2 / (pi u^2) integral_0^inf |A|^2 cosh^2 s ds,   lambda = cosh s,   k_0 = g / u^2,
      A = 1/2 sum n_x dS exp(lambda^2 k_0 z + i lambda k_0 x) cos(lambda sinh(s) k_0 y_hull),

  summed over the panels of all hulls but for a transom, behind which the water separates.
- Thrust that falls with speed, counted as resistance because thrusters here push alike at every speed: momentum theory
  (Rankine 1865; Froude 1889) at constant power. With t = T(u) / T(0) and the race's speed w at rest,

      t^3 + 2 t u / w = 1,   w^2 = 8 T(0) / (pi rho D^2).

- A transom that runs dry: Holtrop (1984). Correlation allowance C_A of ships in full scale: Holtrop (1984).

Holtrop, J. and Mennen, G. G. J. (1982), An approximate power prediction method, Int. Shipbuilding Progress 29; Holtrop
(1984), A statistical re-analysis of resistance and propulsion data, ibid. 31. Frame: wetted_surface.py.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, nnls

from taichi_sim.applications.hydro.panelling import refined
from taichi_sim.applications.hydro.wetted_surface import WettedSurface, X, Y, Z, area_vectors

Array = NDArray[np.float64]
VISCOSITY = 1.19e-6  # m^2/s, sea water of 15 deg C (ITTC 2011)
ALONG = 80  # panels along the hull for thin-ship theory
WAVES = 400  # values of s in its integral
DEEPEST = 8.0  # lambda^2 k_0 T / 2 at which the integral ends: waves so short do not reach the hull
FACING, STERN = 0.7, 0.05  # -n_x of a transom's panels, and the part of the length that is the stern; assumed
WITHIN = {"L / B": (3.9, 14.9), "B / T": (2.1, 4.0), "C_P": (0.55, 0.85)}  # Holtrop and Mennen (1982), single hulls
SHIP = 20.0  # m: shorter hulls count as smooth, without a correlation allowance; assumed
FASTEST = 1.2  # Froude number at which displacement hulls count as planing, beyond these methods; assumed
FITTED = 24  # speeds of the fit
TOP_WEIGHT = 1e3  # weight of the top speed in it


@dataclass(frozen=True)
class HullForm:
    """Form of a wetted hull, or of one of `hulls` that are alike."""

    surface: WettedSurface
    hulls: int

    @cached_property
    def fine(self) -> tuple[Array, Array]:
        """Area vectors and centres [n, 3] of fine panels of all hulls."""
        whole = WettedSurface(self.surface.whole)
        panels = refined(whole, float(np.ptp(whole.panels[..., X])) / ALONG).panels
        return area_vectors(panels), panels.mean(axis=1)

    @property
    def is_transom(self) -> NDArray[np.bool_]:
        """Which of the fine panels belong to a transom."""
        area, centre = self.fine
        at_stern = centre[:, X] < self.stern + STERN * self.length
        return at_stern & (-area[:, X] > FACING * np.linalg.norm(area, axis=1))

    @cached_property
    def slopes(self) -> Array:
        """Area ahead (m^2) of fine panels without transoms, and x and z of their centres, [3, n]; one for all panels at
        the same x and z, as the two sides of a hull have.
        """
        area, centre = (values[~self.is_transom] for values in self.fine)
        place, number = np.unique(np.round(centre[:, [X, Z]], 9), axis=0, return_inverse=True)
        return np.stack((np.bincount(number.ravel(), area[:, X]), *place.T), dtype=np.float64)

    @cached_property
    def one(self) -> Array:
        """Corners [n, 3] of one hull."""
        points = self.surface.whole.reshape(-1, 3)
        return points[points[:, Y] > 0] if self.hulls > 1 else points

    @property
    def stern(self) -> float:
        """x of the stern, m."""
        return float(self.one[:, X].min())

    @property
    def length(self) -> float:
        """Length below water, m."""
        return float(np.ptp(self.one[:, X]))

    @property
    def beam(self) -> float:
        """Beam of one hull below water, m."""
        return float(np.ptp(self.one[:, Y]))

    @property
    def draught(self) -> float:
        """m."""
        return float(-self.one[:, Z].min())

    @property
    def stern_draught(self) -> float:
        """Where the flow leaves the hull, m."""
        return float(-self.one[self.one[:, X] < self.stern + STERN * self.length, Z].min())

    @property
    def apart(self) -> float:
        """Distance of each hull's centreplane from that of the craft, m."""
        return float(self.one[:, Y].max() + self.one[:, Y].min()) / 2 if self.hulls > 1 else 0.0

    @property
    def volume(self) -> float:
        """Displaced by one hull, m^3."""
        return self.surface.volume / self.hulls

    @cached_property
    def wetted(self) -> float:
        """Wetted area of all hulls without transoms, m^2."""
        return float(np.linalg.norm(self.fine[0][~self.is_transom], axis=1).sum())

    @cached_property
    def transom(self) -> float:
        """Immersed area of one hull's transom, m^2."""
        return float(-self.fine[0][self.is_transom, X].sum()) / self.hulls

    @cached_property
    def midship(self) -> float:
        """Largest section area of one hull, m^2: what faces ahead before it."""
        area, centre = self.fine
        return float(np.cumsum(area[np.argsort(-centre[:, X]), X]).max()) / self.hulls

    @cached_property
    def lateral(self) -> float:
        """Lateral area of one hull, m^2."""
        return float(np.maximum(self.fine[0][:, Y], 0.0).sum()) / self.hulls

    @property
    def prismatic(self) -> float:
        """C_P."""
        return min(self.volume / (self.midship * self.length), 0.98)

    @property
    def waterplane_share(self) -> float:
        """C_WP."""
        return min(self.surface.waterplane["A"] / self.hulls / (self.length * self.beam), 1.0)

    @property
    def lcb(self) -> float:
        """Centre of buoyancy ahead of half the length, % of the length."""
        return 100 * (float(self.surface.centre_of_buoyancy[X]) - self.stern - self.length / 2) / self.length

    @property
    def run_length(self) -> float:
        """L_R of Holtrop and Mennen, m."""
        C_P = self.prismatic
        return self.length * max(1 - C_P + 0.06 * C_P * self.lcb / (4 * C_P - 1), 0.02)

    @property
    def form_factor(self) -> float:
        """1 + k of one hull (Holtrop 1984), without appendages."""
        L, B, T, V = self.length, self.beam, self.draught, self.volume
        return (
            0.93
            + 0.487118 * (B / L) ** 1.06806 * (T / L) ** 0.46106 * (L / self.run_length) ** 0.121563
            * (L**3 / V) ** 0.36486 * (1 - self.prismatic) ** -0.604247
        )  # fmt: skip

    @property
    def ratios(self) -> dict[str, float]:
        """Ratios of one hull that bound the regression's range."""
        return {"L / B": self.length / self.beam, "B / T": self.beam / self.draught, "C_P": self.prismatic}

    @property
    def outside(self) -> list[str]:
        """Ratios of one hull that lie outside the range of Holtrop and Mennen."""
        return [
            f"{name} = {value:.3g} (range {low:g} to {high:g})"
            for name, value in self.ratios.items()
            for low, high in (WITHIN[name],)
            if not low <= value <= high
        ]


class Race(NamedTuple):
    """Thrust at rest (N) of a propeller, and the speed of its race then, m/s; infinite: the thrust stays."""

    thrust: float
    speed: float

    def lost(self, u: float) -> float:
        """Thrust lost at the hull's speed u (m/s), N."""
        return self.thrust * (1 - float(brentq(lambda t: t**3 + 2 * t * u / self.speed - 1, 0.0, 1.0)))


@dataclass(frozen=True)
class Resistance:
    """Resistance of a form in water of density rho (kg/m^3) under gravity g (m/s^2), by part."""

    form: HullForm
    rho: float
    g: float
    races: tuple[Race, ...] = ()  # of its propellers

    @property
    def by_regression(self) -> bool:
        """Whether wave resistance is that of Holtrop and Mennen; else of thin-ship theory."""
        return self.form.hulls == 1 and not self.form.outside

    def parts(self, u: float) -> dict[str, float]:
        """Friction, waves and transom (N) at u (m/s)."""
        form, q = self.form, 0.5 * self.rho * u * u
        C_F = 0.075 / (np.log10(max(u * form.length / VISCOSITY, 1e4)) - 2) ** 2
        waves = _regression(form, u, self.rho, self.g) if self.by_regression else self.thin_ship(u)
        transom = 0.0
        if form.transom > 0:
            F_T = u / np.sqrt(2 * self.g * form.transom / (form.beam * (1 + form.waterplane_share)))
            transom = form.hulls * q * form.transom * 0.2 * max(1 - 0.2 * F_T, 0.0)
        return {
            "friction": (form.form_factor * C_F + self.allowance) * q * form.wetted,
            "waves": waves,
            "transom": transom,
        }

    def total(self, u: float) -> float:
        """All parts, N."""
        return sum(self.parts(u).values())

    def lost(self, u: float) -> float:
        """Thrust lost at u (m/s), N."""
        return sum(race.lost(u) for race in self.races)

    def driven(self, u: float) -> float:
        """All parts and the thrust lost at u (m/s), N."""
        return self.total(u) + self.lost(u)

    @property
    def allowance(self) -> float:
        """C_A of Holtrop (1984), of ships."""
        form = self.form
        if form.length < SHIP:
            return 0.0
        C_B, T_L = form.volume / (form.length * form.beam * form.draught), min(form.draught / form.length, 0.04)
        return (0.006 * (form.length + 100) ** -0.16 - 0.00205
                + 0.003 * np.sqrt(form.length / 7.5) * C_B**4 * (0.04 - T_L))  # fmt: skip

    def thin_ship(self, u: float) -> float:
        """R_W by Michell's integral, N."""
        form = self.form
        k_0 = self.g / u**2
        area, x, z = form.slopes.astype(np.float32)  # five times as fast, and 1e-6 off
        s = np.linspace(0.0, np.arccosh(max(np.sqrt(2 * DEEPEST / (k_0 * form.draught)), 1.5)), WAVES)
        lam = np.cosh(s)
        depth, phase = (np.outer(of.astype(np.float32), at) for of, at in ((lam**2 * k_0, z), (lam * k_0, x)))
        np.exp(depth, out=depth)
        P, Q = (depth * np.cos(phase)) @ area / 2, (depth * np.sin(phase)) @ area / 2
        squared = (P**2 + Q**2) * np.cos(lam * np.sinh(s) * k_0 * form.apart) ** 2
        return float(4 * self.rho * self.g**2 / (np.pi * u**2) * np.trapezoid(squared * lam**2, s))

    def speed(self, thrust: float) -> float:
        """Speed (m/s) at which the resistance and the thrust lost are `thrust` (N), at most that of FASTEST."""
        most = FASTEST * float(np.sqrt(self.g * self.form.length))
        if self.driven(most) <= thrust:
            return most
        return float(brentq(lambda u: self.driven(u) - thrust, 1e-3 * most, most, xtol=1e-4))

    def fitted(self, top: float) -> tuple[float, float, float]:
        """a, b >= 0 of a u + b u^2, exact at the speed `top` (m/s) and close below it, and the largest error there over
        the resistance at `top`.
        """
        u = top * np.arange(1, FITTED + 1) / FITTED
        R = np.array([self.driven(x) for x in u])
        weight = np.where(u == u[-1], TOP_WEIGHT, 1.0)
        (a, b), _ = nnls(np.stack([u, u * u], axis=1) * weight[:, None], R * weight)
        return float(a), float(b), float(np.abs(a * u + b * u * u - R).max() / R[-1])


def _regression(form: HullForm, u: float, rho: float, g: float) -> float:
    """R_W of Holtrop and Mennen (1982; 1984) without a bulb, N."""
    L, B, T, V, C_P = form.length, form.beam, form.draught, form.volume, form.prismatic
    C_M, C_WP, F = form.midship / (B * T), form.waterplane_share, u / np.sqrt(g * L)
    entrance = 1 + 89 * np.exp(
        -((L / B) ** 0.80856) * (1 - C_WP) ** 0.30484 * max(1 - C_P - 0.0225 * form.lcb, 0.01) ** 0.6367
        * (form.run_length / B) ** 0.34574 * (100 * V / L**3) ** 0.16302
    )  # fmt: skip  # deg
    c_7 = 0.229577 * (B / L) ** (1 / 3) if B / L < 0.11 else B / L if B / L < 0.25 else 0.5 - 0.0625 * L / B
    c_1 = 2223105 * c_7**3.78613 * (T / B) ** 1.07961 * (90 - entrance) ** -1.37565
    c_5 = 1 - 0.8 * form.transom / (B * T * C_M)
    c_15 = -1.69385 if L**3 / V < 512 else 0.0 if L**3 / V > 1726.91 else -1.69385 + (L / V ** (1 / 3) - 8) / 2.36
    c_16 = 8.07981 * C_P - 13.8673 * C_P**2 + 6.984388 * C_P**3 if C_P < 0.8 else 1.73014 - 0.7067 * C_P
    c_17 = 6919.3 * C_M**-1.3346 * (V / L**3) ** 2.00977 * (L / B - 2) ** 1.40692
    m_1 = 0.0140407 * L / T - 1.75254 * V ** (1 / 3) / L - 4.79323 * B / L - c_16
    m_3 = -7.2035 * (B / L) ** 0.326869 * (T / B) ** 0.605375
    wave = 1.446 * C_P - 0.03 * min(L / B, 12.0)

    def at(c: float, m: float, F: float) -> float:
        m_4 = c_15 * 0.4 * np.exp(-0.034 * F**-3.29)
        return float(c * c_5 * V * rho * g * np.exp(m * F**-0.9 + m_4 * np.cos(wave * F**-2)))

    low, high = at(c_1, m_1, min(F, 0.4)), at(c_17, m_3, max(F, 0.55))
    return low + (np.clip(F, 0.4, 0.55) - 0.4) / 0.15 * (high - low) if F > 0.4 else low


HOERNER = np.array([
    [0.0109, 0.1766, 0.3530, 0.4519, 0.4728, 0.4929, 0.4933, 0.5585, 0.6464, 0.8336, 0.9880, 1.3081, 1.6392, 1.8600,
     2.3129, 2.6000, 3.0088, 3.4508, 3.7379, 4.0031],
    [1.9661, 1.9657, 1.8976, 1.7872, 1.5837, 1.2786, 1.2108, 1.0836, 0.9986, 0.8796, 0.8284, 0.7599, 0.6914, 0.6571,
     0.6307, 0.5962, 0.5868, 0.5859, 0.5599, 0.5593],
])  # fmt: skip  # B / 2T and C_d of a section across the flow: Hoerner (1965), read off by Fossen (2011, fig. 6.10)


def cross_flow_coefficient(ratio: ArrayLike) -> float:
    """Hoerner's C_d of a section with this B / 2T."""
    return float(np.interp(ratio, *HOERNER))
