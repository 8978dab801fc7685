"""Wind load on the part of a hull above water, from the velocity (u, v) of the air relative to the hull, in b:

    X = q C_X A_f,   Y = q C_Y A_l,   N = q C_N A_l L,   q = 1/2 rho (u^2 + v^2),

    C_X = c_x u / V,   C_Y = c_y v / V,   C_N = -c_n 2 u v / V^2    (Fossen 2021, eqs. 10.26-10.28).

X and Y act at the height of the centre of the areas. The coefficients are those of `Windage`.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.config import NonNegative, Strict
from taichi_sim.kernels.rigid_body import is_nothing, linear

RHO_AIR = 1.225  # kg/m^3, standard atmosphere at sea level
STILL = 1e-9  # m^2/s^2; avoids a division by zero without wind


class Windage(Strict):
    """Wind on the part above water: X = q C_X A_f, Y = q C_Y A_l, N = q C_N A_l L, with q from the relative wind.

    C_X = -c_x cos(gamma), C_Y = c_y sin(gamma), C_N = c_n sin(2 gamma) (Fossen 2021, eqs. 10.26-10.28).
    """

    frontal_area: NonNegative = 0.0  # A_f, m^2
    lateral_area: NonNegative = 0.0  # A_l, m^2
    c_x: NonNegative = 0.7  # Fossen (2021), sec. 10.1: 0.50-0.90
    c_y: NonNegative = 0.85  # Fossen (2021), sec. 10.1: 0.70-0.95
    c_n: NonNegative = 0.1  # Fossen (2021), sec. 10.1: 0.05-0.20
    height: NonNegative = 0.0  # of the centre of the areas above CO, m


@ti.func
def load(height: ti.template(), p: ti.template(), R, nu, air):
    """Load (N, N m, about CO, b) of the wind `air` (m/s, n) on areas with their centre `height` (m) above CO.

    `p` has wind_x = rho c_x A_f / 2, wind_y = rho c_y A_l / 2 and wind_n = rho c_n A_l L (numbers.py).
    """
    tau = nu * 0.0
    if ti.static(not (is_nothing(p.wind_x) and is_nothing(p.wind_y))):
        met = R.transpose() @ air - linear(nu)
        u, v = met[0], met[1]
        speed = ti.sqrt(u * u + v * v + STILL)
        X = p.wind_x * speed * u
        Y = p.wind_y * speed * v
        # sin(2 gamma) V^2 = -2 u v: the force acts towards the end that the wind meets first
        N = -p.wind_n * u * v
        tau = ti.Vector([X, Y, 0.0, height * Y, -height * X, N])
    return tau
