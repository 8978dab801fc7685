"""The Aerosonde of reference tables: published numbers, ideal actuators, variant A or B."""

import math
from pathlib import Path

from taichi_sim.config.io import validate
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from tests.validation.case import Case
from tests.validation.tables import TableError, number, read_toml

PARAMETERS = "aerosonde.toml"
COPY = Path(__file__).resolve().parents[2] / "tests" / "data" / "reference" / "params" / PARAMETERS
IDEAL = {
    "time_constant": 0.0,
    "rate_limit_deg": math.inf,
    "elevator_limit_deg": 90.0,
    "aileron_limit_deg": 90.0,
    "rudder_limit_deg": 90.0,
    "throttle_time_constant": 0.0,
}
ANY_BODY = {"length": 1.0, "height": 1.0, "collision_radius": 1.0}
ANY_LOAD = {"n_max": 4.0, "n_min": -2.0}
UNUSED = ("C_D_0", "C_D_alpha", "epsilon")  # of the published longitudinal section: no equation has them


def parameters(case: Case, variant: str) -> FixedWingParams:
    """The published aircraft, variant "A" or "B", with ideal actuators."""
    root = case.folder.root
    beside = (root.parent / "params" / PARAMETERS, COPY)
    path = next((p for p in (*sorted(root.rglob(PARAMETERS)), *beside) if p.is_file()), root / PARAMETERS)
    data = read_toml(case.folder.use(path))
    physical = {
        "mass": number(data, "physical", "mass_kg"),
        "S": number(data, "physical", "S_wing_m2"),
        "b": number(data, "physical", "b_m"),
        "c": number(data, "physical", "c_m"),
        **{key: number(data, "physical", key) for key in ("Jx", "Jy", "Jz", "Jxz", "rho", "e_oswald")},
    }
    if number(data, "physical", "gravity") != GRAVITY:
        raise TableError(f"{path.name}: gravity is not {GRAVITY} m/s^2")
    longitudinal = {key: value for key, value in data["longitudinal"].items() if key not in UNUSED}
    if variant == "B":
        longitudinal |= data["variant_B"]
    coefficients = ("C_T0", "C_T1", "C_T2", "C_Q0", "C_Q1", "C_Q2", "KV_rpm_per_volt", "V_max")
    propeller = {
        "law": "electric",
        "D": number(data, "propeller", "D_prop_m"),
        "R_motor": number(data, "propeller", "R_motor_ohm"),
        "i0": number(data, "propeller", "i0_A"),
        **{key: number(data, "propeller", key) for key in coefficients},
    }
    numbers = {"physical": physical, "longitudinal": longitudinal, "lateral": data["lateral"], "propeller": propeller}
    envelope = {"airspeed": 25.0, "max_airspeed": 40.0} | ANY_LOAD
    rest = {"actuators": IDEAL, "envelope": envelope, "body": ANY_BODY}
    return validate(FixedWingParams, numbers | rest, str(path))
