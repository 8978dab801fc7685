"""Parameters of a fixed-wing vehicle file, with the names of R. Beard and T. McLain, and the numbers of its equations.

Small Unmanned Aircraft, Princeton University Press 2012, chapters 3 and 4; configs/vehicles/*.toml hold the numbers.
"""

import math
from collections import namedtuple
from collections.abc import Mapping
from functools import cache
from typing import Annotated

from pydantic import Field, model_validator

from taichi_sim.config import Finite, Positive, Strict
from taichi_sim.models.uav.fixed_wing.actuators import Actuators, DiscPropeller, ElectricPropeller, lag
from taichi_sim.models.uav.fixed_wing.autopilot import AutopilotParams
from taichi_sim.vehicle import Number, VehicleParams, value_at


class FixedWingPhysical(Strict):
    """Mass, inertia [[Jx, 0, -Jxz], [0, Jy, 0], [-Jxz, 0, Jz]], wing, air."""

    mass: Positive  # kg
    Jx: Positive  # kg m^2
    Jy: Positive  # kg m^2
    Jz: Positive  # kg m^2
    Jxz: Finite  # kg m^2
    S: Positive  # wing area, m^2
    b: Positive  # span, m
    c: Positive  # mean chord, m
    rho: Positive  # density of the air, kg/m^3
    e_oswald: Annotated[float, Field(gt=0, le=1)]  # efficiency of the span, 1

    @property
    def aspect_ratio(self) -> float:
        """b^2 / S."""
        return self.b**2 / self.S

    @property
    def induced_drag(self) -> float:
        """C_D per C_L^2: 1 / (pi e AR)."""
        return 1 / (math.pi * self.e_oswald * self.aspect_ratio)

    @property
    def determinant(self) -> float:
        """Jx Jz - Jxz^2 (Gamma of the book)."""
        return self.Jx * self.Jz - self.Jxz**2

    @model_validator(mode="after")
    def _inertia_of_a_body(self):
        if self.determinant <= 0:
            raise ValueError(f"Jxz = {self.Jxz}: no body has Jxz^2 >= Jx Jz = {self.Jx * self.Jz:.6g}")
        return self


class Longitudinal(Strict):
    """Coefficients of lift, drag and pitching moment: per rad, and rates as q c / (2 Va)."""

    C_L_0: Finite
    C_L_alpha: Finite
    C_L_q: Finite
    C_L_delta_e: Finite
    C_D_p: Finite  # parasitic; the rest of the polar is (C_L_0 + C_L_alpha alpha)^2 / (pi e AR)
    C_D_q: Finite
    C_D_delta_e: Finite  # times the signed elevator, as in the book
    C_m_0: Finite
    C_m_alpha: Finite
    C_m_q: Finite
    C_m_delta_e: Finite
    M_blend: Annotated[float, Field(gt=0, le=500)]  # sharpness of the stall, 1/rad
    alpha0: Annotated[float, Field(gt=0, lt=math.pi / 2)]  # angle of attack half way into the stall, rad


class Lateral(Strict):
    """Coefficients of side force, rolling (ell), yawing (n) moment: per rad; rates as p b / (2 Va), r b / (2 Va)."""

    C_Y_0: Finite
    C_Y_beta: Finite
    C_Y_p: Finite
    C_Y_r: Finite
    C_Y_delta_a: Finite
    C_Y_delta_r: Finite
    C_ell_0: Finite
    C_ell_beta: Finite
    C_ell_p: Finite
    C_ell_r: Finite
    C_ell_delta_a: Finite
    C_ell_delta_r: Finite
    C_n_0: Finite
    C_n_beta: Finite
    C_n_p: Finite
    C_n_r: Finite
    C_n_delta_a: Finite
    C_n_delta_r: Finite

    @property
    def has_rudder(self) -> bool:
        """Whether the rudder has any effect."""
        return self.C_Y_delta_r != 0 or self.C_n_delta_r != 0


class FixedWingEnvelope(Strict):
    """Airspeeds and load factors of normal flight."""

    airspeed: Positive  # cruising airspeed, which zero actions hold, m/s
    max_airspeed: Positive  # never-exceed airspeed, m/s
    n_max: Annotated[float, Field(gt=1)]  # limit load factors, 1
    n_min: Annotated[float, Field(lt=0)]

    @model_validator(mode="after")
    def _cruise_inside(self):
        if self.airspeed > self.max_airspeed:
            raise ValueError(f"airspeed = {self.airspeed}: above max_airspeed = {self.max_airspeed}")
        return self


class FixedWingBody(Strict):
    """Dimensions for pictures and collisions."""

    length: Positive  # m
    height: Positive  # m
    collision_radius: Positive  # m


class FixedWingParams(VehicleParams):
    """All parameters of a fixed-wing vehicle file."""

    physical: FixedWingPhysical
    longitudinal: Longitudinal
    lateral: Lateral
    propeller: Annotated[ElectricPropeller | DiscPropeller, Field(discriminator="law")]
    actuators: Actuators
    envelope: FixedWingEnvelope
    body: FixedWingBody
    autopilot: AutopilotParams | None = None

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere around the aircraft, m."""
        return self.body.collision_radius

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, span, height, m."""
        return self.body.length, self.physical.b, self.body.height


COEFFICIENTS = {
    name: f"{section}.{name}"
    for section, kind in (("longitudinal", Longitudinal), ("lateral", Lateral))
    for name in kind.model_fields if name.startswith("C_")
}  # fmt: skip
"""Coefficient -> its key in the vehicle file."""
_PHYSICAL = ("mass", "Jx", "Jy", "Jz", "Jxz", "rho")
VARYING = (
    *(f"physical.{name}" for name in _PHYSICAL), *COEFFICIENTS.values(), "propeller.gain", "actuators.time_constant",
    "actuators.throttle_time_constant",
)  # fmt: skip
"""Keys of the vehicle file that may differ between environments."""

FixedWingNumbers = namedtuple("FixedWingNumbers", (
    "dt",  # physics step, s
    "inverse_mass",  # 1/kg
    "Jx", "Jy", "Jz", "Jxz",  # kg m^2
    "inverse_xx", "inverse_xz", "inverse_yy", "inverse_zz",  # of the inertia's inverse, 1/(kg m^2)
    "rho",  # kg/m^3
    "half_rho_S",  # dynamic pressure times wing area over Va^2, kg/m
    *COEFFICIENTS,
    "gain",  # of thrust and torque, 1
    "servo_gone", "servo_kept", "motor_gone", "motor_kept",  # `actuators.lag` over a step
))  # fmt: skip
"""Numbers of the equations: floats, or tensors of one shape."""


def aircraft_numbers(craft: FixedWingParams, values: Mapping[str, Number], dt: float) -> FixedWingNumbers:
    """Compute the kernel's numbers of an aircraft like `craft` with the parameters `values`, for a step dt (s).

    `values` has each key of VARYING: floats, or tensors of one shape. Other parameters are those of `craft`.
    """
    mass, Jx, Jy, Jz, Jxz, rho = (values[f"physical.{name}"] for name in _PHYSICAL)
    determinant = Jx * Jz - Jxz * Jxz  # Gamma of the book
    servo_gone, servo_kept = lag(values["actuators.time_constant"], dt)
    motor_gone, motor_kept = lag(values["actuators.throttle_time_constant"], dt)
    return FixedWingNumbers(
        dt=dt,
        inverse_mass=1 / mass,
        Jx=Jx,
        Jy=Jy,
        Jz=Jz,
        Jxz=Jxz,
        inverse_xx=Jz / determinant,
        inverse_xz=Jxz / determinant,
        inverse_yy=1 / Jy,
        inverse_zz=Jx / determinant,
        rho=rho,
        half_rho_S=0.5 * craft.physical.S * rho,
        **{name: values[key] for name, key in COEFFICIENTS.items()},
        gain=values["propeller.gain"],
        servo_gone=servo_gone,
        servo_kept=servo_kept,
        motor_gone=motor_gone,
        motor_kept=motor_kept,
    )


@cache
def nominal_numbers(craft: FixedWingParams) -> FixedWingNumbers:
    """Compute the kernel's numbers of the vehicle file, with actuators that follow their commands at once."""
    data = craft.model_dump()
    values = {key: float(value_at(data, key)) for key in VARYING}
    return aircraft_numbers(craft, values, math.inf)
