"""Parameters of an aircraft that may differ between environments, and the numbers that its equations use."""

import math
from collections.abc import Mapping
from functools import cache, reduce
from typing import NamedTuple

from taichi_sim.uav.fixed_wing.actuators import lag
from taichi_sim.uav.fixed_wing.params import FixedWingParams
from taichi_sim.vehicle import Number


class FixedWingNumbers(NamedTuple):
    """Numbers of the equations: floats, or tensors of one shape. Coefficients as of `Longitudinal`, `Lateral`."""

    inverse_mass: Number  # 1/kg
    Jx: Number  # kg m^2
    Jy: Number
    Jz: Number
    Jxz: Number
    inverse_xx: Number  # of the inertia's inverse, 1/(kg m^2)
    inverse_xz: Number
    inverse_yy: Number
    inverse_zz: Number
    rho: Number  # kg/m^3
    half_rho_S: Number  # noqa: N815  # dynamic pressure times wing area over Va^2, kg/m
    C_L_0: Number
    C_L_alpha: Number
    C_L_q: Number
    C_L_delta_e: Number
    C_D_p: Number
    C_D_q: Number
    C_D_delta_e: Number
    C_m_0: Number
    C_m_alpha: Number
    C_m_q: Number
    C_m_delta_e: Number
    C_Y_0: Number
    C_Y_beta: Number
    C_Y_p: Number
    C_Y_r: Number
    C_Y_delta_a: Number
    C_Y_delta_r: Number
    C_ell_0: Number
    C_ell_beta: Number
    C_ell_p: Number
    C_ell_r: Number
    C_ell_delta_a: Number
    C_ell_delta_r: Number
    C_n_0: Number
    C_n_beta: Number
    C_n_p: Number
    C_n_r: Number
    C_n_delta_a: Number
    C_n_delta_r: Number
    gain: Number  # of thrust and torque, 1
    servo_gone: Number  # these four: `actuators.lag` over a step
    servo_kept: Number
    motor_gone: Number
    motor_kept: Number


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


def aircraft_numbers(craft: FixedWingParams, values: Mapping[str, Number], dt: float) -> FixedWingNumbers:
    """Numbers of an aircraft like `craft` with the parameters `values`, for a step dt (s).

    Args:
        craft: parameters that do not vary.
        values: value of each key of VARYING: Numbers, or tensors of one shape.
        dt: step, s.
    """
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
    """Numbers of the vehicle file itself, with actuators that follow their commands at once."""
    values = {key: float(reduce(getattr, key.split("."), craft)) for key in VARYING}
    return aircraft_numbers(craft, values, math.inf)
