"""Parameters of a fixed-wing vehicle file, with the names of R. Beard and T. McLain, and the numbers of its equations.

Small Unmanned Aircraft, Princeton University Press 2012, chapters 3 and 4; configs/vehicles/*.toml hold the numbers.
"""

import math
from collections import namedtuple
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated

from pydantic import Field

from taichi_sim.config import Finite, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.actuators import Actuators, DiscPropeller, ElectricPropeller, lag
from taichi_sim.models.uav.fixed_wing.autopilot import AutopilotParams
from taichi_sim.vehicle import Number, VehicleParams, value_at


class FixedWingPhysical(Strict):
    """Mass, inertia [[Jx, 0, -Jxz], [0, Jy, 0], [-Jxz, 0, Jz]], wing, air."""

    mass: Annotated[Positive, Plausible(0.3, 300.0, "kg", of="S")]
    Jx: Annotated[Positive, Plausible(1e-3, 0.3, "kg m^2", of="mass b^2")]
    Jy: Annotated[Positive, Plausible(1e-3, 0.3, "kg m^2", of="mass b^2")]
    Jz: Annotated[Positive, Plausible(2e-3, 0.3, "kg m^2", of="mass b^2")]
    Jxz: Annotated[Finite, Plausible(1e-3, 0.7, "kg m^2", of="Jx^0.5 Jz^0.5", either=True)]
    S: Annotated[Positive, Plausible(0.02, 1.2, "m^2", of="b^2")]  # wing area
    b: Annotated[Positive, Plausible(0.1, 40.0, "m")]  # span
    c: Annotated[Positive, Plausible(0.5, 3.0, "m", of="S b^-1")]  # mean chord
    rho: Annotated[Positive, Plausible(0.3, 1.6, "kg/m^3")]  # density of the air
    e_oswald: Annotated[float, Field(gt=0, le=1), Plausible(0.3, 1.1)]  # efficiency of the span, 1

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

    def _mistakes(self) -> Iterator[str]:
        if self.determinant <= 0:
            yield f"Jxz = {self.Jxz}: no body has Jxz^2 >= Jx Jz = {self.Jx * self.Jz:.6g}"


class Longitudinal(Strict):
    """Coefficients of lift, drag and pitching moment: per rad, and rates as q c / (2 Va)."""

    C_L_0: Annotated[Finite, Plausible(3e-3, 1.5)]
    C_L_alpha: Annotated[Finite, Plausible(1.0, 8.0)]
    C_L_q: Annotated[Finite, Plausible(0.1, 40.0)]
    C_L_delta_e: Annotated[Finite, Plausible(0.01, 3.0)]
    # parasitic; the rest of the polar is (C_L_0 + C_L_alpha alpha)^2 / (pi e AR)
    C_D_p: Annotated[Finite, Plausible(3e-3, 0.3)]
    C_D_q: Annotated[Finite, Plausible(1e-3, 10.0, either=True)]
    C_D_delta_e: Annotated[Finite, Plausible(1e-3, 2.0, either=True)]  # times the signed elevator, as in the book
    C_m_0: Annotated[Finite, Plausible(5e-4, 0.5, either=True)]
    C_m_alpha: Annotated[Finite, Plausible(-10.0, -0.02)]
    C_m_q: Annotated[Finite, Plausible(-100.0, -0.2)]
    C_m_delta_e: Annotated[Finite, Plausible(-5.0, -0.02)]
    M_blend: Annotated[float, Field(gt=0, le=500), Plausible(3.0, 500.0, "1/rad")]  # sharpness of the stall
    # angle of attack half way into the stall
    alpha0: Annotated[float, Field(gt=0, lt=math.pi / 2), Plausible(0.1, 1.2, "rad")]


class Lateral(Strict):
    """Coefficients of side force, rolling (ell), yawing (n) moment: per rad; rates as p b / (2 Va), r b / (2 Va)."""

    C_Y_0: Annotated[Finite, Plausible(1e-4, 0.2, either=True)]
    C_Y_beta: Annotated[Finite, Plausible(-3.0, -0.01)]
    C_Y_p: Annotated[Finite, Plausible(3e-3, 3.0, either=True)]
    C_Y_r: Annotated[Finite, Plausible(3e-3, 3.0, either=True)]
    C_Y_delta_a: Annotated[Finite, Plausible(2e-3, 1.0, either=True)]
    C_Y_delta_r: Annotated[Finite, Plausible(5e-3, 1.5)]
    C_ell_0: Annotated[Finite, Plausible(1e-4, 0.2, either=True)]
    C_ell_beta: Annotated[Finite, Plausible(-0.7, -1e-3)]
    C_ell_p: Annotated[Finite, Plausible(-2.0, -0.03)]
    C_ell_r: Annotated[Finite, Plausible(3e-3, 1.0)]
    C_ell_delta_a: Annotated[Finite, Plausible(5e-3, 1.0)]
    C_ell_delta_r: Annotated[Finite, Plausible(2e-4, 0.3, either=True)]
    C_n_0: Annotated[Finite, Plausible(1e-4, 0.2, either=True)]
    C_n_beta: Annotated[Finite, Plausible(1e-3, 0.7)]
    C_n_p: Annotated[Finite, Plausible(1e-3, 1.0, either=True)]
    C_n_r: Annotated[Finite, Plausible(-1.0, -5e-4)]
    C_n_delta_a: Annotated[Finite, Plausible(-0.3, -2e-4)]
    C_n_delta_r: Annotated[Finite, Plausible(-0.5, -2e-3)]

    @property
    def has_rudder(self) -> bool:
        """Whether the rudder has any effect."""
        return self.C_Y_delta_r != 0 or self.C_n_delta_r != 0


class FixedWingEnvelope(Strict):
    """Airspeeds and load factors of normal flight."""

    # cruising airspeed, which zero actions hold
    airspeed: Annotated[Positive, Plausible(0.8, 6.0, "m/s", of="airspeed_of_lift")]
    max_airspeed: Annotated[Positive, Plausible(1.0, 6.0, "m/s", of="airspeed")]  # never-exceed airspeed
    n_max: Annotated[float, Field(gt=1), Plausible(1.2, 15.0)]  # limit load factors, 1
    n_min: Annotated[float, Field(lt=0), Plausible(-12.0, -0.2)]

    def _mistakes(self) -> Iterator[str]:
        if self.airspeed > self.max_airspeed:
            yield f"airspeed = {self.airspeed}: above max_airspeed = {self.max_airspeed}"


class FixedWingBody(Strict):
    """Dimensions for pictures and collisions."""

    length: Annotated[Positive, Plausible(0.1, 3.0, "m", of="physical.b")]
    height: Annotated[Positive, Plausible(0.02, 1.0, "m", of="physical.b")]
    collision_radius: Annotated[Positive, Plausible(0.2, 1.5, "m", of="physical.b")]


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
    def airspeed_of_lift(self) -> float:
        """Airspeed at a lift coefficient of 2, m/s."""
        p = self.physical
        return math.sqrt(p.mass * GRAVITY / (p.rho * p.S))

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
