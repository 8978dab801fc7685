"""Checks of the motion of a box in regular waves against boundary-element response amplitude operators (RAOs).

Each environment holds the box, free to move and at rest at first, in a regular wave so low that the response is
linear. The kernel's own loads move it: pressure on its panels, and constant added mass and damping, those of the
boundary-element tables at the resonances of heave, roll and pitch. When transients have died out, amplitudes are
fitted at the wave's frequency (regular.py). Constant coefficients stand for radiation and diffraction, hence tolerances
of tens of per cent. Frequencies above JUDGED times the mode's resonance are not judged: there the response is the small
difference of large loads, and falls off too fast (heave at 1.1 of its resonance by a third to a half). The box that is
the shipped barge is let go once more with the memory and diffraction of its database, and judged over resonances too.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.params import Hull6DofParams
from tests.validation.box import SIZE, Box, box_of
from tests.validation.case import Case
from tests.validation.parameters import shipped
from tests.validation.regular import STEEPNESS, motions
from tests.validation.remembering import hull_of, slowest_decay
from tests.validation.tables import Table, TableError, number, read_csv, read_json

PANELS = (8, 8, 2)  # along, across, up: fine enough for the moment of the wave pressure under the bottom
DT, SAMPLE = 0.04, 6  # s; steps from sample to sample
AT_RESONANCE, JUDGED = 0.9, 1.05  # of the resonance
TOLERANCE_BELOW, TOLERANCE_AT_RESONANCE = 0.2, 0.3  # of the value
COLUMN = {"heave": 2, "roll": 3, "pitch": 4}  # of eta
REMEMBERED, TOLERANCE_REMEMBERED = (0.3, 1.6), 0.05  # of the resonance; of the peak
BARGE = "barge"  # which has a database of the box that it is
ABSENT = 1e-3  # of the largest response of the mode: by symmetry there is none


class Resonance(NamedTuple):
    """Of one mode: frequency (rad/s), added mass and damping about CO there, and the damping ratio."""

    omega: float
    A: float
    B: float
    zeta: float


@dataclass(frozen=True)
class Radiation:
    """The box, its radii of gyration (m) about the CG, and its constant added mass and damping."""

    box: Box
    gyration: tuple[float, ...]
    resonances: dict[str, Resonance]
    added_mass: tuple[float, ...]
    damping: tuple[float, ...]

    def params(self) -> Hull6DofParams:
        """The vehicle."""
        coefficients = {"added_mass": list(self.added_mass), "linear": list(self.damping)}
        return self.box.params(self.box.shape(*PANELS), list(self.gyration), coefficients)

    @property
    def slowest_decay(self) -> float:
        """Its time constant, s."""
        return 1 / min(r.zeta * r.omega for r in self.resonances.values())


def radiation_of(case: Case) -> Radiation:
    """From box_*_meta.json and box_*_added_mass_damping.csv beside the table."""
    found = SIZE.search(case.path.name)
    if not found:
        raise TableError("the name has no box_<length>x<beam>x<draft>")
    meta = _resonances(read_json(case.folder.use(case.path.with_name(f"{found[0]}_meta.json"))))
    table = read_csv(case.folder.use(case.path.with_name(f"{found[0]}_added_mass_damping.csv")))
    resonances, data = meta
    A, B = [0.0] * 6, [0.0] * 6
    for i, mode in ((2, "heave"), (3, "roll"), (4, "pitch")):
        A[i], B[i] = resonances[mode].A, resonances[mode].B
    # Surge, sway and yaw have no resonance: those of the rotation that they are coupled with (yaw: of roll).
    for i, mode in ((0, "pitch"), (1, "roll"), (5, "roll")):
        A[i], B[i] = (_at(table, f"{kind}{i + 1}{i + 1}", resonances[mode].omega) for kind in "AB")
    box = box_of(case)
    box = Box(box.length, box.beam, box.draft, number(data, "KG"), number(data, "mass"))
    gyration = data.get("kxx_kyy_kzz_about_cg")
    if not isinstance(gyration, list) or len(gyration) != 3:
        raise TableError("meta: key 'kxx_kyy_kzz_about_cg' is not three numbers")
    return Radiation(box, tuple(gyration), resonances, tuple(A), tuple(B))


def _resonances(data: dict[str, Any]) -> tuple[dict[str, Resonance], dict[str, Any]]:
    keys = ("wn", "A_at_wn", "B_at_wn", "zeta")
    found = {m: Resonance(*(number(data, "resonances_uncoupled", m, k) for k in keys)) for m in COLUMN}
    return found, data


def _at(table: Table, name: str, omega: float) -> float:
    return float(np.interp(omega, table["omega"], table[name]))


def measure(radiation: Radiation, omega: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Amplitudes [row, 6] of x, y, z, roll, pitch, yaw per metre of wave amplitude.

    omega [row] rad/s, heading [row] rad: where waves travel to, over a box that heads north.
    """
    return np.abs(motions(_model(radiation.params()), omega, heading, radiation.slowest_decay, STEEPNESS))


@cache
def _model(params: Hull6DofParams) -> Hull6Dof:
    return Hull6Dof(params, DT, SAMPLE)


def rao(case: Case) -> None:
    """box_*_rao.csv: amplitudes of heave, roll and pitch; see the module."""
    table = read_csv(case.path)
    radiation = radiation_of(case)
    omega, heading = table["omega"], np.deg2rad(table["heading_deg"])
    ours = measure(radiation, omega, heading)
    for mode, column in COLUMN.items():
        name = f"{mode}_abs"
        if name not in table:
            continue
        theirs, ratio = table[name], omega / radiation.resonances[mode].omega
        there = theirs > ABSENT * theirs.max()
        for what, use, tolerance in (
            ("below resonance", there & (ratio < AT_RESONANCE), TOLERANCE_BELOW),
            ("at resonance", there & (ratio >= AT_RESONANCE) & (ratio <= JUDGED), TOLERANCE_AT_RESONANCE),
        ):
            if use.any():
                error = ours[use, column] / theirs[use] - 1
                case.absolute(f"{mode} RAO {what}, relative", error, 0 * error, tolerance)
    if case.precision == "f64" and is_the_barge(radiation):
        model, database = hull_of(case, BARGE)
        found = np.abs(motions(model, omega, heading, slowest_decay(model, database)))
        for mode, column in COLUMN.items():
            theirs, w_n = table[f"{mode}_abs"], radiation.resonances[mode].omega
            use = (omega > REMEMBERED[0] * w_n) & (omega < REMEMBERED[1] * w_n)
            error = (found[:, column] - theirs)[use] / theirs.max()
            case.absolute(f"{mode} RAO with memory, of the peak", error, 0 * error, TOLERANCE_REMEMBERED)


def is_the_barge(radiation: Radiation) -> bool:
    """Whether the shipped barge is this box."""
    box, hull = radiation.box, shipped(f"{BARGE}.toml")["hull"]
    return (box.length, box.beam, box.draft) == (hull["length"], hull["beam"], hull["draft"])
