"""The Otter of reference tables: published numbers, linear restoring, shaft speeds as inputs."""

import re
from functools import cache
from typing import Any

import numpy as np

from taichi_sim.config.io import validate
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof, Hull6DofParams
from tests.validation.case import Case
from tests.validation.parameters import published, refined, shipped
from tests.validation.tables import TableError, number

FILE = "otter.toml"
AS_PUBLISHED = {"restoring": "linear", "current_frame": "heading", "actions": "left_right", "windage": {}}
ADDED_MASS = ("Xudot", "Yvdot", "Zwdot", "Kpdot", "Mqdot", "Nrdot")
SHAFT_SPEEDS = re.compile(
    r"(?:^|_)(?P<origin>from_)?n(?P<left>-?\d+(?:\.\d+)?)(?:_n(?P<right>-?\d+(?:\.\d+)?))?(?=_|$)"
)
YAW_QUADRATIC = 10.0  # times the linear coefficient, in the published yaw damping


def parameters(case: Case) -> Hull6DofParams:
    """The published Otter; the shipped vehicle file says what the directory does not."""
    numbers = shipped(FILE) | AS_PUBLISHED
    data = published(case, FILE)
    if data is not None and "model" not in data:
        try:
            numbers |= _sections(data, numbers)
        except (KeyError, TableError) as error:
            raise TableError(f"{FILE}: {error}") from None
    return validate(Hull6DofParams, numbers, FILE)


def _sections(data: dict[str, Any], full: dict[str, Any]) -> dict[str, Any]:
    """Sections of a vehicle file from the published numbers, with the digits of `full` where it is the same number."""
    body, hydro = full["rigid_body"], full["hydrodynamics"]
    damping = refined([number(data, "damping", f"D{i}{i}") for i in range(1, 7)], hydro["linear"])
    B = number(data, "pontoon", "beam_m")
    T = refined(number(data, "pontoon", "draft_m"), hydro["cross_flow_draft"])
    sections = data["damping"]
    C_d = float(np.interp(B / (2 * T), sections["hoerner_B_over_2T"], sections["hoerner_Cd"]))
    restoring = {
        key: refined(number(data, "restoring", key), full["linear"][key]) for key in ("G33", "G44", "G55", "G35")
    }
    shaft = {
        "k_positive": "k_pos",
        "k_negative": "k_neg",
        "n_max": "n_max_rad_s",
        "n_min": "n_min_rad_s",
        "lag": "T_n_s",
    }
    propulsion = {
        ours: refined(number(data, "propulsion", theirs), full["thrusters"][ours]) for ours, theirs in shaft.items()
    }
    for side in ("left", "right"):
        x, _, z = full["thrusters"][side]
        propulsion[side] = [x, number(data, "propulsion", f"lever_arm_{side}_m"), z]
    return {
        "rigid_body": body
        | {
            "mass": number(data, "main", "mass_hull_kg") + number(data, "main", "mass_payload_kg"),
            "cg": data["main"]["rg_total_m"],
            "M_rb": refined(data["rigid_body"]["MRB"], body["M_rb"]),
        },
        "hydrodynamics": hydro
        | {
            "added_mass": refined([-number(data, "added_mass", key) for key in ADDED_MASS], hydro["added_mass"]),
            "linear": damping,
            "quadratic": [0.0, 0.0, 0.0, 0.0, 0.0, YAW_QUADRATIC * damping[5]],
            "cross_flow_length": number(data, "main", "length_m"),
            "cross_flow_draft": T,
            "cross_flow_coefficient": C_d,
        },
        "linear": restoring
        | {"payload_mass": number(data, "main", "mass_payload_kg"), "payload_position": data["main"]["rp_payload_m"]},
        "thrusters": propulsion,
    }  # fmt: skip


@cache
def model(params: Hull6DofParams, dt: float, substeps: int = 1) -> Hull6Dof:
    """A hull; one compiled kernel for all that ask for the same."""
    return Hull6Dof(params, dt, substeps)


def current(name: str) -> tuple[float, float]:
    """North and east velocity (m/s) of the current in a name: current_0.5mps_30deg, current_0.5mps_toward_30deg."""
    found = re.search(r"current_(\d+(?:\.\d+)?)mps(?:_\D+?)?_(-?\d+(?:\.\d+)?)deg", name)
    if found is None:
        return 0.0, 0.0
    speed, direction = float(found[1]), np.deg2rad(float(found[2]))
    return speed * float(np.cos(direction)), speed * float(np.sin(direction))


def shaft_command(name: str) -> tuple[float, float] | None:
    """Left and right shaft speed (rad/s) in a name, n100_n60 or n80 for both; what follows "from" is where it began.

    None where the name has none.
    """
    runs = [m for m in SHAFT_SPEEDS.finditer(name) if not m["origin"]]
    if not runs:
        return None
    left, right = runs[-1]["left"], runs[-1]["right"]
    return float(left), float(right or left)
