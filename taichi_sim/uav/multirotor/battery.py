"""A battery that limits the rotors: its voltage falls with charge and load, and the rotors' speed falls with it.

The open-circuit voltage V_0 is linear in the charge, behind a resistance R. The power P is the rotors' shaft power over
their efficiency, plus that of the avionics. The terminal voltage is the larger root of V (V_0 - V) / R = P; where there
is none, the battery gives its largest power, at V_0 / 2. The largest rotor speed of the vehicle file holds at the
nominal voltage and is proportional to the voltage, like the no-load speed of a motor.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import Annotated

import taichi as ti
from pydantic import Field, model_validator

from taichi_sim.config import NonNegative, Positive, Strict

HOUR = 3600.0  # s
MILLI = 1e-3


class Battery(Strict):
    """`[battery]` of a vehicle file. Without it the rotors always have their nominal voltage."""

    capacity_mah: Positive  # mA h
    full: Positive  # open-circuit voltage, full, V
    empty: Positive  # open-circuit voltage, empty, V
    nominal: Positive  # voltage at which a rotor reaches omega_max, V
    resistance: NonNegative  # of battery and leads, ohm
    efficiency: Annotated[float, Field(gt=0, le=1)]  # of motors and their controllers
    avionics: NonNegative = 0.0  # power of everything else, W
    charge: Annotated[float, Field(gt=0, le=1)] = 1.0  # at the beginning of a flight

    @property
    def coulombs(self) -> float:
        """Capacity, A s."""
        return self.capacity_mah * MILLI * HOUR

    @model_validator(mode="after")
    def _falls(self):
        if self.empty > self.full:
            raise ValueError(f"empty = {self.empty:g} V: must not be above full = {self.full:g} V")
        return self


@ti.func
def terminal(b: ti.template(), charge, shaft):
    """(voltage, V; current, A) of a Battery with `charge` (0 to 1) left, while the rotors take the shaft power
    `shaft` (W).
    """
    V_0 = b.empty + ti.static(b.full - b.empty) * ti.max(charge, 0.0)
    P = shaft * ti.static(1.0 / b.efficiency) + b.avionics
    V = 0.5 * (V_0 + ti.sqrt(ti.max(V_0 * V_0 - ti.static(4.0 * b.resistance) * P, 0.0)))
    return V, P / V
