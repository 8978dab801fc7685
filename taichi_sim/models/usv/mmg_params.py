"""Parameters of a vehicle file with model = "mmg_3dof", and of the section [mmg] of a `hull_6dof`, in the dimensionless
form in which they are published.

The units are 0.5 rho L^2 d (mass), 0.5 rho L^4 d (inertia), 0.5 rho L d U^2 (force), 0.5 rho L^2 d U^2 (moment) and L
(positions), with length L, draft d and the speed U through the water (Yasukawa & Yoshimura 2015, sec. 2.2 to 2.5).
"""

# ruff: noqa: N815

import math
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.models.usv.vessel_base import (
    Beam,
    CollisionRadius,
    Height,
    Lag,
    Length,
    WaterDensity,
    Windage,
    steady_speed,
)
from taichi_sim.vehicle import VehicleParams

Count = Annotated[int, Field(ge=1, le=2)]
Fraction = Annotated[float, Field(ge=0, lt=1)]
Angle = Annotated[float, Field(ge=2, le=90)]  # less is a number of radians
Along = Annotated[float, Field(ge=-1, le=1)]  # over the length; more is a number of metres
Astern = Annotated[float, Field(ge=-1, le=0)]
NonPositive = Annotated[float, Field(ge=-10, le=0)]


class HullPolynomial(Strict):
    """Resistance, and the polynomial of v' = v / U and r' = r L / U (eq. 7); derivatives not given are zero."""

    R_0: Annotated[float, Field(gt=0, le=1), Plausible(2e-3, 0.2)]  # resistance in a straight run
    X_vv: Annotated[Finite, Plausible(1e-3, 1.0, either=True)] = 0.0
    X_vr: Annotated[Finite, Plausible(1e-4, 1.0, either=True)] = 0.0
    X_rr: Annotated[Finite, Plausible(5e-4, 1.0, either=True)] = 0.0
    X_vvvv: Annotated[Finite, Plausible(0.01, 10.0)] = 0.0
    Y_v: Annotated[NonPositive, Plausible(-2.0, -0.02)] = 0.0
    Y_r: Annotated[Finite, Plausible(1e-3, 0.9, either=True)] = 0.0
    Y_vvv: Annotated[Finite, Plausible(-10.0, -0.05)] = 0.0
    Y_vvr: Annotated[Finite, Plausible(0.01, 10.0, either=True)] = 0.0
    Y_vrr: Annotated[Finite, Plausible(-5.0, -0.01)] = 0.0
    Y_rrr: Annotated[Finite, Plausible(1e-4, 1.0, either=True)] = 0.0
    N_v: Annotated[Finite, Plausible(-1.0, -5e-3)] = 0.0
    N_r: Annotated[NonPositive, Plausible(-0.5, -2e-3)] = 0.0
    N_vvv: Annotated[Finite, Plausible(1e-3, 2.0, either=True)] = 0.0
    N_vvr: Annotated[Finite, Plausible(-3.0, -5e-3)] = 0.0
    N_vrr: Annotated[Finite, Plausible(1e-3, 3.0, either=True)] = 0.0
    N_rrr: Annotated[Finite, Plausible(-0.5, -5e-4)] = 0.0


class HullDerivatives(HullPolynomial):
    """The polynomial, and added mass."""

    m_x: Annotated[NonNegative, Plausible(1e-3, 1.0)]  # added mass
    m_y: Annotated[NonNegative, Plausible(0.01, 2.0)]
    J_z: Annotated[NonNegative, Plausible(1e-3, 1.0)]  # added inertia


class Propeller(Strict):
    """Thrust (1 - t_P) rho n^2 D^4 K_T(J), K_T = k_0 + k_1 J + k_2 J^2, J = u (1 - w_P) / (n D) (eqs. 9 to 11).

    The wake fraction changes with the drift angle beta_P = beta - x r' at the propeller (eq. 16):
    (1 - w_P) / (1 - w_P0) = 1 + (1 - exp(-C_1 |beta_P|)) (C_2 - 1).
    """

    count: Count = 1  # one on the centreline, or two abreast at the same speed
    diameter: Annotated[Positive, Plausible(0.1, 1.2, "m", of="draft")]  # D
    x: Annotated[Along, Plausible(-0.8, -0.3)]  # x_P', position ahead of midships
    t_P: Annotated[Fraction, Plausible(0.01, 0.5)]  # thrust deduction
    w_P0: Annotated[Fraction, Plausible(0.01, 0.7)]  # wake fraction in a straight run
    C_1: Annotated[NonNegative, Plausible(0.2, 20.0)] = 0.0  # coefficient of the wake in drift and turning
    C_2_positive: Annotated[Positive, Plausible(0.5, 3.0)] = 1.0  # C_2 where beta_P > 0
    C_2_negative: Annotated[Positive, Plausible(0.5, 3.0)] = 1.0  # C_2 where beta_P < 0
    k_0: Annotated[Positive, Plausible(0.05, 1.2)]
    k_1: Annotated[Finite, Plausible(-1.0, -0.02)]
    k_2: Annotated[Finite, Plausible(-0.6, -5e-3)]
    n_ahead: Annotated[Positive, Plausible(0.1, 40.0, "1/s", of="g^0.5 diameter^-0.5")]  # highest revolutions
    n_astern: Annotated[NonNegative, Plausible(0.05, 2.0, "1/s", of="n_ahead")] = 0.0  # highest revolutions astern
    astern: Annotated[NonNegative, Plausible(0.1, 1.5)] = 0.7  # K_T at J = 0 with revolutions astern, over k_0; assumed
    time_constant: Lag = 0.0
    # highest rate of change of the revolutions
    rate: Annotated[Positive, Plausible(3e-3, math.inf, "1/s^2", of="n_ahead g^0.5 length^-0.5")] = 1e3

    def steady_speed(self, n: float, density: float, linear: float, quadratic: float) -> float:
        """Speed u (m/s) of a straight run in calm water at n > 0 (1/s), against (linear + quadratic u) u (N):

        (linear + quadratic u) u = (1 - t_P) rho count D^2 (k_0 n^2 D^2 + k_1 n D u_P + k_2 u_P^2), u_P = (1 - w_P0) u.
        """
        wake, push = 1 - self.w_P0, (1 - self.t_P) * density * self.count * self.diameter**2
        slope, bend = push * self.k_1 * wake * n * self.diameter, push * self.k_2 * wake**2
        return steady_speed(push * self.k_0 * (n * self.diameter) ** 2, linear - slope, quadratic - bend)


class Rudder(Strict):
    """Normal force of the rudder, and its interaction with the hull (eqs. 18 to 26)."""

    count: Count = 1  # each behind a propeller
    area: Annotated[Positive, Plausible(3e-3, 0.15, "m^2", of="length draft")]  # A_R
    span: Annotated[Positive, Plausible(0.2, 1.5, "m", of="draft")]  # H_R
    x: Annotated[Astern, Plausible(-0.7, -0.3)] = -0.5  # x_R', position ahead of midships
    # gradient of the lift; default: Fujii's formula with `aspect_ratio`
    f_alpha: Annotated[Positive, Plausible(0.5, 6.0)] | None = None
    aspect_ratio: Annotated[Positive, Plausible(0.3, 8.0)] | None = None  # Lambda; default: span^2 / area
    t_R: Annotated[Finite, Plausible(0.02, 0.9)] = 0.0  # steering resistance deduction
    a_H: Annotated[Finite, Plausible(0.01, 1.5)] = 0.0  # additional side force on the hull over that of the rudder
    x_H: Annotated[Along, Plausible(-0.8, -0.05)] = 0.0  # x_H', position of the additional side force
    gamma_R_positive: Annotated[Finite, Plausible(0.02, 1.5)]  # flow straightening where beta_R > 0
    gamma_R_negative: Annotated[Finite, Plausible(0.02, 1.5)]  # flow straightening where beta_R < 0
    l_R: Annotated[Finite, Plausible(-1.5, -0.2)]  # l_R', effective position in beta_R = beta - l_R' r'
    epsilon: Annotated[Positive, Plausible(0.3, 2.5)]  # wake at the rudder over wake at the propeller
    kappa: Annotated[NonNegative, Plausible(0.05, 1.5)]  # acceleration of the slipstream
    angle_max_deg: Annotated[Angle, Plausible(5.0, 90.0, "deg")] = 35.0
    time_constant: Lag = 0.0
    rate_deg: Annotated[float, Field(ge=0.5, le=1e3), Plausible(0.5, 1e3, "deg/s")]  # deg/s; less is a number of rad/s

    @property
    def lift_gradient(self) -> float:
        """f_alpha; if it is not given, by Fujii: 6.13 Lambda / (2.25 + Lambda) (note to eq. 24)."""
        if self.f_alpha is not None:
            return self.f_alpha
        ratio = self.span**2 / self.area if self.aspect_ratio is None else self.aspect_ratio
        return 6.13 * ratio / (2.25 + ratio)


def slipstream(propeller: Propeller, rudder: Rudder) -> Iterator[str]:
    """Whether the propeller's slipstream is wider than the rudder's span, as a mistake that names both keys."""
    if propeller.diameter > rudder.span:
        yield f"propeller.diameter = {propeller.diameter} must be at most rudder.span = {rudder.span}"


class HullOnPanels(HullPolynomial):
    """The polynomial of a hull in six degrees of freedom."""

    z: Annotated[Finite, Plausible(0.1, 1.2, "m", of="draft")]  # depth below CO at which its forces act


class PropellerOnPanels(Propeller):
    """The propellers of a hull in six degrees of freedom. Two have their own revolutions."""

    # distance of two propellers from the centreline
    y: Annotated[NonNegative, Plausible(0.05, 0.6, "m", of="beam")] = 0.0
    z: Annotated[Finite, Plausible(0.1, 1.5, "m", of="draft")]  # depth of the shafts below CO


class RudderOnPanels(Rudder):
    """The rudders of a hull in six degrees of freedom. Two turn together."""

    y: Annotated[NonNegative, Plausible(0.05, 0.6, "m", of="beam")] = 0.0  # distance of two rudders from the centreline
    z: Annotated[Finite, Plausible(0.1, 1.5, "m", of="draft")]  # depth below CO at which their forces act


class MmgSection(Strict):
    """`[mmg]`: propellers and rudders of a `hull_6dof` (hull/mmg_drive.py), and its manoeuvring polynomial."""

    length: Annotated[Positive, Plausible(0.7, 1.1, "m", of="length")]  # L, between perpendiculars
    draft: Annotated[Positive, Plausible(0.5, 1.5, "m", of="draft")]  # d
    density: WaterDensity  # rho, of the water, kg/m^3
    hull: HullOnPanels | None = None  # instead of the damping of surge, sway and yaw in [hydrodynamics]
    propeller: PropellerOnPanels
    rudder: RudderOnPanels

    def _mistakes(self) -> Iterator[str]:
        yield from slipstream(self.propeller, self.rudder)
        for name, part in (("propeller", self.propeller), ("rudder", self.rudder)):
            if part.y > 0 and part.count == 1:
                yield f"{name}.y = {part.y} is the distance of two from the centreline: one has y = 0"

    @property
    def resistance(self) -> float:
        """Resistance in a straight run over the squared speed, N s^2/m^2; 0 without a polynomial."""
        return 0.0 if self.hull is None else 0.5 * self.density * self.length * self.draft * self.hull.R_0

    def steady_speed(self, linear: float, quadratic: float) -> float:
        """Speed (m/s) of a straight run in calm water at n_ahead, against the resistance and a further damping of
        (linear + quadratic u) u (N).
        """
        p = self.propeller
        return p.steady_speed(p.n_ahead, self.density, linear, quadratic + self.resistance)


class MmgParams(VehicleParams):
    """Parameters of a vehicle file of `mmg_3dof`."""

    length: Length  # L, between perpendiculars
    beam: Beam
    draft: Annotated[Positive, Plausible(0.02, 1.5, "m", of="beam")]  # d
    height: Height  # keel to the highest part, for drawing
    collision_radius: CollisionRadius
    density: WaterDensity  # rho, of the water, kg/m^3
    displacement: Annotated[Positive, Plausible(0.1, 1.0, "m^3", of="length beam draft", far=1.0)]  # displaced volume
    x_G: Annotated[Finite, Plausible(5e-4, 0.3, "m", of="length", either=True)] = 0.0  # CM ahead of midships
    # radius of gyration in yaw about the centre of mass
    gyration: Annotated[Positive, Plausible(0.1, 0.6, "m", of="length", far=1.0)]
    wave_response: bool = True  # whether waves push the hull; it rides on them in any case
    hull: HullDerivatives
    propeller: Propeller
    rudder: Rudder
    windage: Windage = Windage()

    def _mistakes(self) -> Iterator[str]:
        yield from slipstream(self.propeller, self.rudder)
        if not 0 < self.top_speed < math.inf:
            yield "propeller.k_0, k_1, k_2 with hull.R_0 give no steady speed at n_ahead"

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return self.density * self.displacement

    @property
    def top_speed(self) -> Annotated[float, Plausible(0.02, 0.6, "m/s", of="length^0.5 g^0.5", far=5 / 3)]:
        """Speed (m/s) of a straight run at n_ahead: the polynomial is of hulls that displace water."""
        return self.steady_speed(self.propeller.n_ahead)

    def steady_speed(self, n: float) -> float:
        """Speed (m/s) of a straight run in calm water at n > 0 revolutions (1/s), rudder amidships; the resistance is
        0.5 rho L d R_0 u^2.
        """
        resistance = 0.5 * self.density * self.length * self.draft * self.hull.R_0
        return self.propeller.steady_speed(n, self.density, 0.0, resistance)

    def revolutions(self, speed: float) -> float:
        """Revolutions n (1/s) of a straight run at `speed` > 0 (m/s), the inverse of `steady_speed`."""
        return speed / self.steady_speed(1.0)
