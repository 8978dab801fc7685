"""The numbers of an aircraft that may differ between environments, and what its equations make of them."""

import math
from collections.abc import Mapping
from functools import cache, reduce
from typing import Any, NamedTuple

from taichi_sim.uav.fixed_wing.actuators import lag
from taichi_sim.uav.fixed_wing.params import FixedWingParams


class FixedWingNumbers(NamedTuple):
    """What the equations work with: floats, or tensors of one shape; coefficients as in `Longitudinal`, `Lateral`."""

    inverse_mass: float  # 1/kg
    Jx: float  # kg m^2
    Jy: float
    Jz: float
    Jxz: float
    inverse_xx: float  # of the inertia's inverse, 1/(kg m^2)
    inverse_xz: float
    inverse_yy: float
    inverse_zz: float
    rho: float  # kg/m^3
    half_rho_S: float  # noqa: N815  # dynamic pressure times wing area over Va^2, kg/m
    C_L_0: float
    C_L_alpha: float
    C_L_q: float
    C_L_delta_e: float
    C_D_p: float
    C_D_q: float
    C_D_delta_e: float
    C_m_0: float
    C_m_alpha: float
    C_m_q: float
    C_m_delta_e: float
    C_Y_0: float
    C_Y_beta: float
    C_Y_p: float
    C_Y_r: float
    C_Y_delta_a: float
    C_Y_delta_r: float
    C_ell_0: float
    C_ell_beta: float
    C_ell_p: float
    C_ell_r: float
    C_ell_delta_a: float
    C_ell_delta_r: float
    C_n_0: float
    C_n_beta: float
    C_n_p: float
    C_n_r: float
    C_n_delta_a: float
    C_n_delta_r: float
    gain: float  # of thrust and torque, 1
    servo_gone: float  # of `actuators.lag` over a step
    servo_kept: float
    motor_gone: float
    motor_kept: float


COEFFICIENTS = tuple(name for name in FixedWingNumbers._fields if name.startswith("C_"))
_PHYSICAL = ("mass", "Jx", "Jy", "Jz", "Jxz", "rho")


def _section(coefficient: str) -> str:
    return "longitudinal" if coefficient.split("_")[1] in ("L", "D", "m") else "lateral"


VARYING = (
    *(f"physical.{name}" for name in _PHYSICAL),
    *(f"{_section(name)}.{name}" for name in COEFFICIENTS),
    "propeller.gain",
    "actuators.time_constant",
    "actuators.throttle_time_constant",
)
"""Keys of the vehicle file that may differ between environments."""


def aircraft_numbers(craft: FixedWingParams, values: Mapping[str, Any], dt: float) -> FixedWingNumbers:
    """The numbers of an aircraft like `craft` but for `values` (by VARYING; floats or tensors), stepped by dt (s)."""
    mass, Jx, Jy, Jz, Jxz, rho = (values[f"physical.{name}"] for name in _PHYSICAL)
    determinant = Jx * Jz - Jxz * Jxz  # Gamma of the book
    servo_gone, servo_kept = lag(values["actuators.time_constant"], dt)
    motor_gone, motor_kept = lag(values["actuators.throttle_time_constant"], dt)
    return FixedWingNumbers(
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
        **{name: values[f"{_section(name)}.{name}"] for name in COEFFICIENTS},
        gain=values["propeller.gain"],
        servo_gone=servo_gone,
        servo_kept=servo_kept,
        motor_gone=motor_gone,
        motor_kept=motor_kept,
    )


@cache
def nominal_numbers(craft: FixedWingParams) -> FixedWingNumbers:
    """Those of the vehicle file itself, with actuators that are where they are told to be."""
    values = {key: float(reduce(getattr, key.split("."), craft)) for key in VARYING}
    return aircraft_numbers(craft, values, math.inf)
