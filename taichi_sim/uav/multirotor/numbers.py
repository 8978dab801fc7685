"""Parameters of a multirotor that may differ between environments, and the numbers that its equations use."""

import math
from collections import namedtuple
from collections.abc import Mapping
from functools import cache
from typing import Any

import torch

from taichi_sim.uav.multirotor.params import MultirotorParams
from taichi_sim.vehicle import Number

INERTIA = ("Jx", "Jy", "Jz", "Jxy", "Jxz", "Jyz")
COEFFICIENTS = ("k_f", "k_m", "k_d", "k_z", "k_h", "k_flap", "J_r")
AXES = range(3)
LEGS = ("legs.stiffness", "legs.damping")
FIELDS = (
    "inverse_mass",  # 1/kg
    *INERTIA,  # kg m^2
    *(f"inverse_{a}{b}" for a in AXES for b in AXES if a <= b),  # inverse of the inertia, 1/(kg m^2)
    *(f"cg_{i}" for i in AXES),  # m, in the airframe's frame
    *(f"drag_{i}" for i in AXES),  # N s^2/m^2
    *COEFFICIENTS,  # of params.Rotor
    "per_tau_up", "per_tau_down",  # 1/s
    "left_up", "left_down",  # fraction of a change of speed that is left after half a step
    "leg_stiffness", "leg_damping",  # each leg, N/m, N s/m; 0 without legs
)  # fmt: skip


@cache
def numbers_of(rotors: int) -> Any:
    """NamedTuple class of the numbers of a multirotor with `rotors` rotors: `FIELDS`, then the gain of each rotor.

    Values are floats, or tensors of one shape.
    """
    return namedtuple("MultirotorNumbers", (*FIELDS, *(f"gain_{k}" for k in range(rotors))))


def gains(p: object, rotors: int) -> tuple[Number, ...]:
    """Gain of each rotor."""
    return tuple(getattr(p, f"gain_{k}") for k in range(rotors))


def varying_keys(craft: MultirotorParams) -> tuple[str, ...]:
    """Keys of the vehicle file that may differ between environments."""
    return (
        "physical.mass",
        *(f"physical.{name}" for name in INERTIA),
        *(f"physical.cg.{i}" for i in AXES),
        *(f"physical.drag.{i}" for i in AXES),
        *(f"rotor.{name}" for name in (*COEFFICIENTS, "tau_up", "tau_down")),
        *(f"rotors.{k}.gain" for k in range(len(craft.rotors))),
        *(LEGS if craft.legs else ()),
    )


def multirotor_numbers(craft: MultirotorParams, values: Mapping[str, Number], dt: float) -> Any:
    """Numbers of a multirotor like `craft` with the parameters `values`, for a step dt (s).

    Args:
        craft: parameters that do not vary.
        values: value of each of `varying_keys`: floats, or tensors of one shape.
        dt: step, s.
    """
    J = [values[f"physical.{name}"] for name in INERTIA]
    up, down = values["rotor.tau_up"], values["rotor.tau_down"]
    return numbers_of(len(craft.rotors))(
        1 / values["physical.mass"], *J, *_inverse(*J),
        *(values[f"physical.cg.{i}"] for i in AXES), *(values[f"physical.drag.{i}"] for i in AXES),
        *(values[f"rotor.{name}"] for name in COEFFICIENTS),
        1 / up, 1 / down, _left(0.5 * dt, up), _left(0.5 * dt, down), *(values.get(key, 0.0) for key in LEGS),
        *(values[f"rotors.{k}.gain"] for k in range(len(craft.rotors))),
    )  # fmt: skip


def _inverse(Jx, Jy, Jz, Jxy, Jxz, Jyz) -> tuple[Number, ...]:
    """Entries xx, xy, xz, yy, yz, zz of the inverse of [[Jx, -Jxy, -Jxz], [-Jxy, Jy, -Jyz], [-Jxz, -Jyz, Jz]]."""
    xx, xy, xz = Jy * Jz - Jyz * Jyz, Jxy * Jz + Jxz * Jyz, Jxy * Jyz + Jxz * Jy
    determinant = Jx * xx - Jxy * xy - Jxz * xz
    yy, yz, zz = Jx * Jz - Jxz * Jxz, Jx * Jyz + Jxy * Jxz, Jx * Jy - Jxy * Jxy
    return tuple(x / determinant for x in (xx, xy, xz, yy, yz, zz))


def _left(time: float, tau: Number) -> Number:
    """exp(-time / tau)."""
    return torch.exp(-time / tau) if isinstance(tau, torch.Tensor) else math.exp(-time / tau)


@cache
def nominal_numbers(craft: MultirotorParams, dt: float = math.inf) -> Any:
    """Numbers of the vehicle file itself."""
    values = {key: _at(craft, key) for key in varying_keys(craft)}
    return multirotor_numbers(craft, values, dt)


def _at(craft: Any, key: str) -> float:
    """The number at a dotted key."""
    for part in key.split("."):
        craft = craft[int(part)] if part.isdigit() else getattr(craft, part)
    return float(craft)
