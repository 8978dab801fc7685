"""The aircraft variants of a trim_and_modes*.json, for the pictures of its trims and modes."""

import math
import re
from typing import Any, NamedTuple

from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import Trim, TrimError, trim
from tests.validation.aerosonde_numbers import parameters
from tests.validation.case import Case, Folder
from tests.validation.plots.style import OTHER, OURS
from tests.validation.tables import TableError, number, read_json

PARTS = ("trim", "modes")
NAMES = {"A": "variant A (as published, hardly any drag)", "B": "variant B (with parasitic drag)"}
COLOURS = {"A": OTHER, "B": OURS}


class Variant(NamedTuple):
    """One variant: its letter, the aircraft, and what the table says of it ("trim", "modes")."""

    letter: str
    aircraft: FixedWingParams
    given: dict[str, Any]

    def steady(self, Va: float) -> Trim | None:
        """Our trim at Va (m/s), at the table's climb and turn; None where there is none."""
        gamma, radius = math.radians(number(self.given, "trim", "gamma_deg")), self.given["trim"].get("R_turn")
        try:
            return trim(self.aircraft, float(Va), gamma, turn_radius=radius)
        except TrimError:  # beyond the stall, or beyond full throttle
            return None


def variants(folder: Folder) -> list[Variant]:
    """The variants of the first table.

    Raises:
        TableError: if there is no table, it has none, or one of them lacks its trim or modes.
    """
    found = sorted(folder.root.rglob("trim_and_modes*.json"))
    if not found:
        raise TableError("no trim_and_modes*.json")
    data, case = read_json(found[0]), Case(folder, found[0], "f64")
    keys = [key for key in data if re.match(r"[AB]_", key)] if isinstance(data, dict) else []
    if not keys:
        raise TableError("no key begins with A_ or B_")
    for key in keys:
        if any(not isinstance(data[key], dict) or not isinstance(data[key].get(part), dict) for part in PARTS):
            raise TableError(f"{key} lacks one of {', '.join(PARTS)}")
    return [Variant(key[0], parameters(case, key[0]), data[key]) for key in keys]
