"""A fixed-wing aircraft's numbers, its aerodynamics, and its equations of motion.

The model of R. Beard and T. McLain, Small Unmanned Aircraft, Princeton University Press 2012, chapters 3 and 4:
lift that blends into a flat plate's beyond the stall, a parabolic polar, linear coefficients elsewhere. NED world,
forward-right-down body, quaternion body to world. Positive elevator is trailing edge down (C_m_delta_e < 0), positive
aileron rolls right, positive rudder yaws left (C_n_delta_r < 0). delta = (elevator, aileron, rudder, throttle).

An aircraft is data: `FixedWingParams` names its numbers as the book does, configs/vehicles/*.toml holds them.
"""

from typing import Annotated

import taichi as ti
from pydantic import Field, model_validator

from taichi_sim.config import Finite, Positive, Strict
from taichi_sim.conventions import GRAVITY
from taichi_sim.maths.rotation import rotation_matrix
from taichi_sim.uav.fixed_wing import angles
from taichi_sim.uav.fixed_wing.actuators import Actuators
from taichi_sim.uav.fixed_wing.autopilot import AutopilotParams
from taichi_sim.uav.fixed_wing.propeller import DiscPropeller, ElectricPropeller, thrust_torque

PI = 3.141592653589793
STILL = 1e-6  # m/s: below this speed the angle of attack has no meaning, and no force


class Physical(Strict):
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
    def determinant(self) -> float:
        """Jx Jz - Jxz^2 (Gamma of the book)."""
        return self.Jx * self.Jz - self.Jxz**2

    @model_validator(mode="after")
    def _inertia_of_a_body(self):
        if self.determinant <= 0:
            raise ValueError(f"Jxz = {self.Jxz}: no body has Jxz^2 >= Jx Jz = {self.Jx * self.Jz:.6g}")
        return self


class Longitudinal(Strict):
    """Lift, drag, and pitching moment; per rad, and rates as q c / (2 Va)."""

    C_L_0: Finite
    C_L_alpha: Finite
    C_L_q: Finite
    C_L_delta_e: Finite
    C_D_p: Finite  # parasitic; the rest of the polar is (C_L_0 + C_L_alpha alpha)^2 / (pi e AR)
    C_D_q: Finite
    C_D_delta_e: Finite  # times the signed elevator, as the book has it
    C_m_0: Finite
    C_m_alpha: Finite
    C_m_q: Finite
    C_m_delta_e: Finite
    M_blend: Annotated[float, Field(gt=0, le=500)]  # sharpness of the stall, 1/rad
    alpha0: Annotated[float, Field(gt=0, lt=PI / 2)]  # angle of attack half way into the stall, rad


class Lateral(Strict):
    """Side force, rolling (ell) and yawing (n) moment; per rad, and rates as p b / (2 Va), r b / (2 Va)."""

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
        """Whether the rudder does anything."""
        return self.C_Y_delta_r != 0 or self.C_n_delta_r != 0


class Envelope(Strict):
    """Where the aircraft is meant to fly."""

    airspeed: Positive  # of cruise: what a zero action trims for, m/s
    max_airspeed: Positive  # never to be passed, m/s
    n_max: Annotated[float, Field(gt=1)]  # limit load factors, 1
    n_min: Annotated[float, Field(lt=0)]

    @model_validator(mode="after")
    def _cruise_inside(self):
        if self.airspeed > self.max_airspeed:
            raise ValueError(f"airspeed = {self.airspeed}: above max_airspeed = {self.max_airspeed}")
        return self


class Body(Strict):
    """What others see of it and collide with."""

    length: Positive  # m
    height: Positive  # m
    collision_radius: Positive  # m


class FixedWingParams(Strict):
    """Numbers of a fixed-wing vehicle file."""

    physical: Physical
    longitudinal: Longitudinal
    lateral: Lateral
    propeller: Annotated[ElectricPropeller | DiscPropeller, Field(discriminator="law")]
    actuators: Actuators
    envelope: Envelope
    body: Body
    autopilot: AutopilotParams | None = None

    @property
    def collision_radius(self) -> float:
        """Of the sphere around the aircraft, m."""
        return self.body.collision_radius

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, span, height, m."""
        return self.body.length, self.physical.b, self.body.height


@ti.func
def air_data(v_r):
    """(Va, alpha, beta, cos alpha, sin alpha) of the velocity v_r relative to the air, in b (m/s; rad)."""
    h2 = v_r[0] * v_r[0] + v_r[2] * v_r[2]
    h, Va = ti.sqrt(h2), ti.sqrt(h2 + v_r[1] * v_r[1])  # side by side: what a step costs is its longest chain
    inv = 1.0 / ti.max(h, STILL)
    alpha, beta = angles.atan2(v_r[2], v_r[0]), angles.atan2(v_r[1], h)
    return ti.Vector([Va, alpha, beta, v_r[0] * inv, v_r[2] * inv])


@ti.func
def lift_coefficient(p: ti.template(), alpha, cos_alpha, sin_alpha):
    """C_L(alpha) of Longitudinal p: linear below the stall, a flat plate's beyond, blended by sigma (eqs 4.9, 4.10)."""
    sigma = angles.stall_blend(p.M_blend, p.alpha0, alpha)
    plate = 2.0 * sin_alpha * ti.abs(sin_alpha) * cos_alpha
    return (1.0 - sigma) * (p.C_L_0 + p.C_L_alpha * alpha) + sigma * plate


@ti.func
def aerodynamic_force(lon: ti.template(), lat: ti.template(), body: ti.template(), air, omega, delta):
    """Force (N) in b of the air on the airframe, with air = air_data(..); eqs 4.18, 4.19."""
    Va, alpha, beta, cos_alpha, sin_alpha = air[0], air[1], air[2], air[3], air[4]
    scale = ti.static(0.5 * body.rho * body.S) * Va
    pitch = ti.static(0.5 * body.c) * omega[1]
    roll, yaw = ti.static(0.5 * body.b) * omega[0], ti.static(0.5 * body.b) * omega[2]
    C_L = lift_coefficient(lon, alpha, cos_alpha, sin_alpha) + lon.C_L_delta_e * delta[0]
    linear = lon.C_L_0 + lon.C_L_alpha * alpha
    polar = ti.static(1.0 / (PI * body.e_oswald * body.aspect_ratio))
    C_D = lon.C_D_p + linear * linear * polar + lon.C_D_delta_e * delta[0]
    C_Y = lat.C_Y_0 + lat.C_Y_beta * beta + lat.C_Y_delta_a * delta[1] + lat.C_Y_delta_r * delta[2]
    lift = scale * (Va * C_L + lon.C_L_q * pitch)
    drag = scale * (Va * C_D + lon.C_D_q * pitch)
    side = scale * (Va * C_Y + lat.C_Y_p * roll + lat.C_Y_r * yaw)
    return ti.Vector([lift * sin_alpha - drag * cos_alpha, side, -drag * sin_alpha - lift * cos_alpha])


@ti.func
def aerodynamic_moment(lon: ti.template(), lat: ti.template(), body: ti.template(), air, omega, delta):
    """Moment (N m) in b of the air on the airframe, about the centre of mass; eqs 4.20, 4.21."""
    Va, alpha, beta = air[0], air[1], air[2]
    scale = ti.static(0.5 * body.rho * body.S) * Va
    pitch = ti.static(0.5 * body.c) * omega[1]
    roll, yaw = ti.static(0.5 * body.b) * omega[0], ti.static(0.5 * body.b) * omega[2]
    C_ell = lat.C_ell_0 + lat.C_ell_beta * beta + lat.C_ell_delta_a * delta[1] + lat.C_ell_delta_r * delta[2]
    C_m = lon.C_m_0 + lon.C_m_alpha * alpha + lon.C_m_delta_e * delta[0]
    C_n = lat.C_n_0 + lat.C_n_beta * beta + lat.C_n_delta_a * delta[1] + lat.C_n_delta_r * delta[2]
    return scale * ti.Vector(
        [
            body.b * (Va * C_ell + lat.C_ell_p * roll + lat.C_ell_r * yaw),
            body.c * (Va * C_m + lon.C_m_q * pitch),
            body.b * (Va * C_n + lat.C_n_p * roll + lat.C_n_r * yaw),
        ]
    )


@ti.func
def loads(p: ti.template(), air, omega, delta):
    """Force (N) and moment (N m) in b of air and propeller; gravity is not in them."""
    T, Q = thrust_torque(p.propeller, p.physical.rho, air[0], delta[3])
    force = aerodynamic_force(p.longitudinal, p.lateral, p.physical, air, omega, delta)
    moment = aerodynamic_moment(p.longitudinal, p.lateral, p.physical, air, omega, delta)
    return force + ti.Vector([T, 0.0, 0.0]), moment - ti.Vector([Q, 0.0, 0.0])


@ti.func
def rigid_body(p: ti.template(), y, R, force, moment):
    """Derivative [13] of state y (packed as in conventions.py) of Physical p under gravity, force (N) and moment
    (N m) in b; R = R_nb of y. Newton and Euler in body axes: eqs 3.14-3.17.
    """
    v, omega = ti.Vector([y[7], y[8], y[9]]), ti.Vector([y[10], y[11], y[12]])
    v_n = R @ v
    down = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
    a = force * ti.static(1.0 / p.mass) + GRAVITY * down - omega.cross(v)
    J_omega = ti.Vector([p.Jx * omega[0] - p.Jxz * omega[2], p.Jy * omega[1], p.Jz * omega[2] - p.Jxz * omega[0]])
    m = moment - omega.cross(J_omega)
    xx, xz, zz = ti.static(p.Jz / p.determinant, p.Jxz / p.determinant, p.Jx / p.determinant)
    return ti.Vector(
        [
            v_n[0], v_n[1], v_n[2],
            0.5 * (-y[4] * omega[0] - y[5] * omega[1] - y[6] * omega[2]),
            0.5 * (y[3] * omega[0] + y[5] * omega[2] - y[6] * omega[1]),
            0.5 * (y[3] * omega[1] + y[6] * omega[0] - y[4] * omega[2]),
            0.5 * (y[3] * omega[2] + y[4] * omega[1] - y[5] * omega[0]),
            a[0], a[1], a[2],
            xx * m[0] + xz * m[2], m[1] * ti.static(1.0 / p.Jy), xz * m[0] + zz * m[2],
        ]
    )  # fmt: skip


@ti.func
def derivative(p: ti.template(), y, air_n, delta):
    """Derivative [13] of state y in air that moves with air_n (NED, m/s), with surfaces and throttle at delta."""
    R = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
    v_r = ti.Vector([y[7], y[8], y[9]]) - R.transpose() @ air_n
    force, moment = loads(p, air_data(v_r), ti.Vector([y[10], y[11], y[12]]), delta)
    return rigid_body(p.physical, y, R, force, moment)
