"""Parameters of a vehicle file with model = "mmg_3dof", and of the section [mmg] of a `hull_6dof`, in the dimensionless
form in which they are published.

The units are 0.5 rho L^2 d (mass), 0.5 rho L^4 d (inertia), 0.5 rho L d U^2 (force), 0.5 rho L^2 d U^2 (moment) and L
(positions), with length L, draft d and the speed U through the water (Yasukawa & Yoshimura 2015, sec. 2.2 to 2.5).
"""

# ruff: noqa: N815

import math
from typing import Annotated

from pydantic import Field, model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.models.usv.vessel_base import WaterDensity, Windage, check_top_speed, steady_speed
from taichi_sim.vehicle import VehicleParams

Count = Annotated[int, Field(ge=1, le=2)]
Fraction = Annotated[float, Field(ge=0, lt=1)]
Angle = Annotated[float, Field(ge=2, le=90)]  # less is a number of radians
Along = Annotated[float, Field(ge=-1, le=1)]  # over the length; more is a number of metres
Astern = Annotated[float, Field(ge=-1, le=0)]
NonPositive = Annotated[float, Field(ge=-10, le=0)]
SLENDEREST = 0.1  # least block coefficient; assumed
GYRATION = 0.1, 0.6  # least and largest radius of gyration over the length; assumed, about 0.25 is usual
SWIFTEST = 1.0  # largest Froude number: the polynomial is of hulls that displace water


class HullPolynomial(Strict):
    """Resistance, and the polynomial of v' = v / U and r' = r L / U (eq. 7); derivatives not given are zero."""

    R_0: Annotated[float, Field(gt=0, le=1)]  # resistance in a straight run
    X_vv: Finite = 0.0
    X_vr: Finite = 0.0
    X_rr: Finite = 0.0
    X_vvvv: Finite = 0.0
    Y_v: NonPositive = 0.0
    Y_r: Finite = 0.0
    Y_vvv: Finite = 0.0
    Y_vvr: Finite = 0.0
    Y_vrr: Finite = 0.0
    Y_rrr: Finite = 0.0
    N_v: Finite = 0.0
    N_r: NonPositive = 0.0
    N_vvv: Finite = 0.0
    N_vvr: Finite = 0.0
    N_vrr: Finite = 0.0
    N_rrr: Finite = 0.0


class HullDerivatives(HullPolynomial):
    """The polynomial, and added mass."""

    m_x: NonNegative  # added mass
    m_y: NonNegative
    J_z: NonNegative  # added inertia


class Propeller(Strict):
    """Thrust (1 - t_P) rho n^2 D^4 K_T(J), K_T = k_0 + k_1 J + k_2 J^2, J = u (1 - w_P) / (n D) (eqs. 9 to 11).

    The wake fraction changes with the drift angle beta_P = beta - x r' at the propeller (eq. 16):
    (1 - w_P) / (1 - w_P0) = 1 + (1 - exp(-C_1 |beta_P|)) (C_2 - 1).
    """

    count: Count = 1  # one on the centreline, or two abreast at the same speed
    diameter: Positive  # D, m
    x: Along  # x_P', position ahead of midships
    t_P: Fraction  # thrust deduction
    w_P0: Fraction  # wake fraction in a straight run
    C_1: NonNegative = 0.0  # coefficient of the wake in drift and turning
    C_2_positive: Positive = 1.0  # C_2 where beta_P > 0
    C_2_negative: Positive = 1.0  # C_2 where beta_P < 0
    k_0: Positive
    k_1: Finite
    k_2: Finite
    n_ahead: Positive  # highest revolutions, 1/s
    n_astern: NonNegative = 0.0  # highest revolutions astern, 1/s
    astern: NonNegative = 0.7  # K_T at J = 0 with revolutions astern, over k_0; assumed
    time_constant: NonNegative = 0.0  # s
    rate: Positive = 1e3  # highest rate of change of the revolutions, 1/s^2

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
    area: Positive  # A_R, m^2
    span: Positive  # H_R, m
    x: Astern = -0.5  # x_R', position ahead of midships
    f_alpha: Positive | None = None  # gradient of the lift; default: Fujii's formula with `aspect_ratio`
    aspect_ratio: Positive | None = None  # Lambda; default: span^2 / area
    t_R: Finite = 0.0  # steering resistance deduction
    a_H: Finite = 0.0  # additional side force on the hull over that of the rudder
    x_H: Along = 0.0  # x_H', position of the additional side force
    gamma_R_positive: Finite  # flow straightening where beta_R > 0
    gamma_R_negative: Finite  # flow straightening where beta_R < 0
    l_R: Finite  # l_R', effective position in beta_R = beta - l_R' r'
    epsilon: Positive  # wake at the rudder over wake at the propeller
    kappa: NonNegative  # acceleration of the slipstream
    angle_max_deg: Angle = 35.0
    time_constant: NonNegative = 0.0  # s
    rate_deg: Annotated[float, Field(ge=0.5, le=1e3)]  # deg/s; less is a number of rad/s

    @property
    def lift_gradient(self) -> float:
        """f_alpha; if it is not given, by Fujii: 6.13 Lambda / (2.25 + Lambda) (note to eq. 24)."""
        if self.f_alpha is not None:
            return self.f_alpha
        ratio = self.span**2 / self.area if self.aspect_ratio is None else self.aspect_ratio
        return 6.13 * ratio / (2.25 + ratio)


def check_slipstream(propeller: Propeller, rudder: Rudder) -> None:
    """Refuse a propeller whose slipstream is wider than the rudder's span.

    Raises:
        ValueError: naming both keys.
    """
    if propeller.diameter > rudder.span:
        raise ValueError(f"propeller.diameter = {propeller.diameter} must be at most rudder.span = {rudder.span}")


class HullOnPanels(HullPolynomial):
    """The polynomial of a hull in six degrees of freedom."""

    z: Finite  # depth below CO at which its forces act, m


class PropellerOnPanels(Propeller):
    """The propellers of a hull in six degrees of freedom. Two have their own revolutions."""

    y: NonNegative = 0.0  # distance of two propellers from the centreline, m
    z: Finite  # depth of the shafts below CO, m


class RudderOnPanels(Rudder):
    """The rudders of a hull in six degrees of freedom. Two turn together."""

    y: NonNegative = 0.0  # distance of two rudders from the centreline, m
    z: Finite  # depth below CO at which their forces act, m


class MmgSection(Strict):
    """`[mmg]`: propellers and rudders of a `hull_6dof` (hull/mmg_drive.py), and its manoeuvring polynomial."""

    length: Positive  # L, between perpendiculars, m
    draft: Positive  # d, m
    density: WaterDensity  # rho, of the water, kg/m^3
    hull: HullOnPanels | None = None  # instead of the damping of surge, sway and yaw in [hydrodynamics]
    propeller: PropellerOnPanels
    rudder: RudderOnPanels

    @model_validator(mode="after")
    def _consistent(self):
        check_slipstream(self.propeller, self.rudder)
        for name, part in (("propeller", self.propeller), ("rudder", self.rudder)):
            if part.y > 0 and part.count == 1:
                raise ValueError(f"{name}.y = {part.y} is the distance of two from the centreline: one has y = 0")
        return self

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

    length: Positive  # L, between perpendiculars, m
    beam: Positive  # m
    draft: Positive  # d, m
    height: Positive  # keel to the highest part, for drawing, m
    collision_radius: Positive  # m
    density: WaterDensity  # rho, of the water, kg/m^3
    displacement: Positive  # displaced volume, m^3
    x_G: Finite = 0.0  # centre of mass ahead of midships, m
    gyration: Positive  # radius of gyration in yaw about the centre of mass, m
    wave_response: bool = True  # whether waves push the hull; it rides on them in any case
    hull: HullDerivatives
    propeller: Propeller
    rudder: Rudder
    windage: Windage = Windage()

    @model_validator(mode="after")
    def _consistent(self):
        check_slipstream(self.propeller, self.rudder)
        block = self.displacement / (self.length * self.beam * self.draft)
        if not SLENDEREST <= block <= 1:
            raise ValueError(
                f"displacement = {self.displacement} m^3 is {block:.3g} times length x beam x draft; hulls have "
                f"{SLENDEREST} to 1"
            )
        if abs(self.x_G) > self.length / 2:
            raise ValueError(f"x_G = {self.x_G} m is outside the hull: at most {self.length / 2:g} m from midships")
        if not GYRATION[0] <= self.gyration / self.length <= GYRATION[1]:
            low, high = (share * self.length for share in GYRATION)
            raise ValueError(f"gyration = {self.gyration} m: a hull of this length has {low:.3g} to {high:.3g} m")
        speed = self.steady_speed(self.propeller.n_ahead)
        if not 0 < speed < math.inf:
            raise ValueError("propeller.k_0, k_1, k_2 with hull.R_0 give no steady speed at n_ahead")
        check_top_speed(speed, self.length, "propeller.n_ahead (1/s), diameter, hull.R_0", SWIFTEST)
        return self

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return self.density * self.displacement

    def steady_speed(self, n: float) -> float:
        """Speed (m/s) of a straight run in calm water at n > 0 revolutions (1/s), rudder amidships; the resistance is
        0.5 rho L d R_0 u^2.
        """
        resistance = 0.5 * self.density * self.length * self.draft * self.hull.R_0
        return self.propeller.steady_speed(n, self.density, 0.0, resistance)

    def revolutions(self, speed: float) -> float:
        """Revolutions n (1/s) of a straight run at `speed` > 0 (m/s), the inverse of `steady_speed`."""
        return speed / self.steady_speed(1.0)
