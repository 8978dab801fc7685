"""Boats made by the command for hydrodynamics from a mesh, mass and thrusters alone, beside boats whose truth is known.

| boat | mesh | truth |
|---|---|---|
| Otter, WAM-V 16 | the [hull] of the shipped file | the shipped model: published (Otter), of VRX (WAM-V) |
| CyberShip II | an analytic form (`supply_vessel`) | the model identified by Skjetne, Smogeli and Fossen (2004) |
| KVLCC2 of 7 m | the [hull] of the shipped file | the MMG model of Yasukawa and Yoshimura (2015); tests of MARIN |

Both are put through the same trials (taichi_sim/applications/trials). KVLCC2 gets its published propeller and rudder.
`python tools/validate.py --boats PAGE.md` writes the results into the page.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from taichi_sim.applications.fit.estimate import fit
from taichi_sim.applications.fit.log import read_log
from taichi_sim.applications.fit.synthetic_logs import INTERVAL, write_logs
from taichi_sim.applications.hydro.hull_input import of_vehicle
from taichi_sim.applications.trials import ship
from taichi_sim.applications.trials.basin import Setting
from taichi_sim.applications.trials.results import Outcome
from taichi_sim.config.io import config_folder
from taichi_sim.kernels import runtime
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.mesh import Panels, StationsHull, mesh
from taichi_sim.models.usv.hull.params import CROSS_FLOW, Hull6DofParams
from taichi_sim.models.usv.vessel_base import steady_speed

Array = NDArray[np.float64]
AIM = 0.25  # of each figure
FLIPPED = np.array([1.0, -1.0, -1.0])  # from b to the frame of meshes: y to port, z up
HELM, HEADING = 20.0, 20.0  # deg, of the zigzag
SEED = 3  # of the log's errors
LEGS = [  # of half of the log: seconds, ahead, helm
    (20, 1, 0), (25, 1, 0.3), (30, 1, 1), (15, 1, 0), (30, 1, -1), (15, 1, 0), (20, 1, -0.4),
    *5 * [(6, 1, 0.6), (6, 1, -0.6)], (15, -0.5, 0), (15, 0, 0.8), (15, 0, -0.8), (20, 0, 0),
]  # straight runs, turning circles, a zigzag, astern, on the spot
DAMPED = {"linear.1": 100.0, "linear.5": 50.0, "quadratic.5": 250.0}  # first guesses where the file of a mesh has 0
PRIORS = {  # of the fit: surge, and what turns the boat
    "hydrodynamics.linear.0": 0.4, "hydrodynamics.added_mass.1": 0.8, "hydrodynamics.added_mass.5": 0.8,
    CROSS_FLOW: 0.8, "hydrodynamics.lift": 0.8, "thrusters.lag": 0.4,
    **{f"hydrodynamics.{key}": 1.0 for key in DAMPED},
}  # fmt: skip
TITLE = "## Boats from their meshes"
BOATS_HEAD = "| boat | figure | truth | from the mesh | with the true top speed |"
FIT_HEAD = "| figure | truth | from the mesh | after the fit |"
SHARES = 0.05, 20.0  # of a resistance, between which the true top speed lies
PANELS = "400"  # of half a hull: no waves are computed
POINTS = "6"  # of the offsets' sections

# CyberShip II: Skjetne, Smogeli and Fossen (2004) [S]; the supply vessel of MSS (Fossen; ShipX) has lines of its kind
LENGTH, BEAM, MASS, X_G = 1.255, 0.29, 23.8, 0.046  # m, m, kg, m: [S]
BLOCK, PRISMATIC, WATERPLANE = 0.651, 0.656, 0.870  # C_B, C_P, C_WP of MSS's supply vessel
FRESH = 1000.0  # kg/m^3, of the basin
STERN_WATERPLANE = 0.97  # C_WP of the after half: a broad stern over the propellers; assumed
FREEBOARD = 0.05  # m, assumed
STATIONS, LEVELS = 41, 11
FINEST, FULLEST = 0.4, BLOCK / PRISMATIC  # fullness of a section: least (assumed); amidships
SURGE, YAW = 1.0, 0.3  # N, N m, of the trials: those of [S]'s reference turn (docs/trials.md)
STERN, BOW = (-0.5, 0.08), 0.47  # m, places of thrusters; assumed, where the model has its own
UNIT = 2.0  # N, of each
AT_ONCE = {"lag": 0.0, "turn_rate_deg": 3600.0}  # its forces act at once, as in the identified model


def supply_vessel() -> Panels:
    """A hull with L, B, mass and x_G of CyberShip II, and C_B, C_P, C_WP of MSS's supply vessel.

    Along each half of the length, with s from 0 amidships to 1 at the end, sections have the area 1 - s^p and the
    waterline the half-breadth 1 - s^q of those amidships. Across, the half-breadth is y(z) = b (1 - (z / T)^n), with n
    from the section's fullness n / (n + 1). Where that would be below FINEST, the keel rises instead.
    """
    draught = MASS / FRESH / (BLOCK * LENGTH * BEAM)

    def powers(mean: float, fore: float) -> tuple[float, float]:
        """p of the after and the fore half, from their coefficients p / (p + 1)."""
        aft = 2 * mean - fore
        return aft / (1 - aft), fore / (1 - fore)

    def lcb(fore: float) -> float:
        (p_a, p_f) = powers(PRISMATIC, fore)
        moments = [0.5 - 1 / (p + 2) for p in (p_f, p_a)]
        return LENGTH / 2 * (moments[0] - moments[1]) / (2 * PRISMATIC) - X_G

    areas = powers(PRISMATIC, brentq(lcb, PRISMATIC - 0.2, PRISMATIC + 0.2))
    breadths = powers(WATERPLANE, 2 * WATERPLANE - STERN_WATERPLANE)
    x = np.linspace(-1, 1, STATIONS)
    x = np.sign(x) * (1 - (1 - np.abs(x)) ** 1.5) * (1 - 1e-3)  # closer at the ends
    share = np.sin(np.linspace(np.pi / 2, 0, LEVELS))  # of the depth, from the keel
    rows = []
    for s in x:
        k = int(s > 0)
        breadth, area = 1 - abs(s) ** breadths[k], 1 - abs(s) ** areas[k]
        full = FULLEST * area / breadth
        depth = draught * min(full / FINEST, 1.0)  # the keel rises where sections are fine
        full = float(np.clip(full, FINEST, FULLEST))
        y = BEAM / 2 * breadth * (1 - share ** (full / (1 - full)))
        points = [*zip(y, share * depth, strict=True), (y[-1], -FREEBOARD)]
        rows.append((float(s * LENGTH / 2), tuple((float(b), float(z)) for b, z in points)))
    return mesh(StationsHull(stations=tuple(rows)))


def shipped_hull(name: str) -> Callable[[], Panels]:
    """The panels of a shipped vehicle file."""
    return lambda: of_vehicle(config_folder() / "vehicles" / f"{name}.toml")[0].panels


def write_stl(panels: Panels, file: Path) -> None:
    """Write a hull as a text STL (m, x forward, y to port, z up)."""
    lines = ["solid hull"]
    for corners, centre in zip(panels.corners * FLIPPED, panels.centre * FLIPPED, strict=True):
        for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):  # alike to port and starboard
            points = "\n".join("      vertex " + " ".join(f"{v:.9g}" for v in point) for point in (one, other, centre))
            lines.append(f"  facet normal 0 0 0\n    outer loop\n{points}\n    endloop\n  endfacet")
    file.write_text("\n".join([*lines, "endsolid hull", ""]), encoding="utf-8")


class Figures(NamedTuple):
    """Figures of the trials, means of both sides; NaN where there is none."""

    speed: float  # m/s, steady, full ahead
    diameter: float  # m, tactical
    overshoot: float  # deg, the first of the zigzag
    roll: float  # s, damped period


NAMES = {"speed": "top speed, m/s", "diameter": "tactical diameter, m", "overshoot": "first overshoot 20/20, deg",
         "roll": "roll period, s"}  # fmt: skip


@dataclass(frozen=True)
class Boat:
    """A boat, what the command is told of it, and its truth."""

    name: str
    hull: Callable[[], Panels]
    options: tuple[str, ...]  # of the command
    truth: str  # vehicle file
    ahead: float = 1.0  # share of its full thrust
    helm: float = 1.0  # share of its full helm, in the turning circle
    changes: Mapping[str, Any] = field(default_factory=dict)  # of the truth's file
    made: Mapping[str, Any] = field(default_factory=dict)  # of the made file, where the user knows better
    rolls: bool = True  # whether the truth has a roll of its own
    published: Figures | None = None  # from tests


OTTER_THRUST, WAMV_THRUST = 119.68, 250.06  # N, k_positive n_max^2 of the shipped files
KVLCC2_THRUST = "53.8"  # N, (1 - t_P) rho n^2 D^4 k_0 of its propeller at rest, which the range of speeds follows
BOATS = (
    Boat(
        "otter", shipped_hull("otter"),
        ("--mass", "80", "--cg", "0.153125", "0", "-0.246875", "--thruster", "-0.8", "-0.395", "0", f"{OTTER_THRUST}",
         "--thruster", "-0.8", "0.395", "0", f"{OTTER_THRUST}"), "otter",
    ),
    Boat(
        "wamv", shipped_hull("wamv"),
        ("--mass", "211", "--cg", "0.051", "0", "0.042", "--rho", "997.7735", "--thruster", "-2.65", "-1.027", "0.19",
         f"{WAMV_THRUST}", "--thruster", "-2.65", "1.027", "0.19", f"{WAMV_THRUST}", "--propeller", "0.2"), "wamv",
    ),
    Boat(
        "cybership2", supply_vessel,
        ("--mass", f"{MASS}", "--cg", f"{X_G}", "0", "0", "--rho", f"{FRESH}", "--azimuth", "--propeller", "0",
         *(word for y in (-STERN[1], STERN[1]) for word in ("--thruster", f"{STERN[0]}", f"{y}", "0.05", f"{UNIT}")),
         "--thruster", f"{BOW}", "0", "0.05", f"{UNIT}"), "cybership2",
        0.5, 0.2, made={"actuators": {f"unit_{k}": AT_ONCE for k in (1, 2, 3)}}, rolls=False,
    ),
    Boat(
        "kvlcc2", shipped_hull("kvlcc2_6dof"),
        ("--mass", "3351.75", "--cg", "0.25", "0", "0.053", "--thruster", "-3.36", "0", "0.333", KVLCC2_THRUST,
         "--propeller", "0"), "kvlcc2_6dof",
        published=Figures(1.179, 0.5 * (3.34 + 3.08) * 7.0, 0.5 * (13.7 + 15.1), math.nan),
    ),
)  # fmt: skip


def make(boat: Boat, folder: Path) -> Path:
    """Write mesh and vehicle file of a boat into `folder`, as the command does before its database."""
    from tools import hydrodynamics

    mesh_file = folder / f"{boat.name}_made.stl"
    write_stl(boat.hull(), mesh_file)
    file = mesh_file.with_suffix(".toml")
    file.unlink(missing_ok=True)
    told = [str(mesh_file), *boat.options, "--points", POINTS, "--panels", PANELS, "--only-vehicle", "--quiet"]
    if hydrodynamics.main(told):
        raise RuntimeError(f"{boat.name}: no vehicle file was made")
    if boat.truth == "kvlcc2_6dof":
        file.write_text(_with_propeller(file.read_text(encoding="utf-8"), boat.truth), encoding="utf-8")
    return file


def _with_propeller(text: str, truth: str) -> str:
    """A vehicle file with propeller and rudder of `truth` in the place of its thrusters."""
    source = (config_folder() / "vehicles" / f"{truth}.toml").read_text(encoding="utf-8")
    sections = re.split(r"(?m)^(?=\[)", source)
    kept = [s for s in sections if re.match(r"\[mmg(\]|\.propeller|\.rudder)", s)]
    text = re.sub(r"(?ms)^\[actuators\..*?(?=^\[windage\])", "".join(kept), text)
    return re.sub(r'(?m)^actions = ".*"$', 'actions = "propeller_rudder"', text)


def sailed(
    vehicle: str | Path, changes: Mapping[str, Any], ahead: float, helm: float, zigzag_helm: float, rolls: bool
) -> Figures:
    """Figures of a vehicle; `zigzag_helm` in degrees."""
    setting = Setting(vehicle, dict(changes), ahead=ahead, helm=helm)
    turn = ship.turning_circle(setting)
    swing = ship.zigzag(setting, zigzag_helm, HEADING)
    roll = ship.roll_decay(setting).mean("decay", "damped period") if rolls else math.nan

    def mean(out: Outcome, name: str) -> float:
        return float(np.mean([out.mean(side, name) for side, _ in ship.SIDES]))

    return Figures(mean(turn, "approach speed"), mean(turn, "tactical diameter"),
                   math.degrees(mean(swing, "overshoot 1")), roll)  # fmt: skip


def compared(boat: Boat, file: Path) -> tuple[Figures, Figures, Figures]:
    """Figures of the truth, of the vehicle file made of a mesh, and of that file with a resistance that gives the true
    top speed, all under the same loads.
    """
    true = sailed(boat.truth, boat.changes, boat.ahead, boat.helm, HELM, boat.rolls)
    surge, yaw = np.divide(_full(boat.truth), _full(file)) if boat.truth == "cybership2" else (1.0, 1.0)
    loads = boat.ahead * surge, boat.helm * yaw, HELM * yaw
    made = sailed(file, boat.made, *loads, True)
    params = load_vehicle(file).params
    assert isinstance(params, Hull6DofParams)
    drag = params.hydrodynamics

    def beyond(share: float) -> float:
        """Speed with this share of the resistance beyond the true one; the thrust of [mmg] falls with it."""
        parts = share * drag.linear[0], share * drag.quadratic[0]
        if params.mmg:
            return params.mmg.steady_speed(*parts) - true.speed
        return steady_speed(drag.linear[0] * made.speed + drag.quadratic[0] * made.speed**2, *parts) - true.speed

    share = brentq(beyond, *SHARES)
    scaled = {name: [share * getattr(drag, name)[0], *getattr(drag, name)[1:]] for name in ("linear", "quadratic")}
    return true, made, sailed(file, {**boat.made, "hydrodynamics": scaled}, *loads, False)._replace(roll=made.roll)


def _full(vehicle: str | Path) -> tuple[float, float]:
    """Surge force (N) and yaw moment (N m) of full ahead and of full helm."""
    model = load_vehicle(vehicle)
    if isinstance(model, Hull6Dof):
        most = model.thrusters.allocation.largest
        return most[0], most[2]
    return model.params.surge_force_max, model.params.yaw_moment_max


def ten_minutes(folder: Path) -> tuple[Figures, list[str]]:
    """Figures of the Otter of a mesh after a fit to a log of ten minutes of the true one, and the lines of the fit."""
    from taichi_sim.applications.commands import fit as command

    boat = BOATS[0]
    file = make(boat, folder)
    legs = [(seconds, share * ahead, helm) for share in (1.0, 0.5) for seconds, ahead, helm in LEGS]
    commands = np.concatenate([np.tile(leg[1:], (round(leg[0] / INTERVAL), 1)) for leg in legs])
    (log,) = write_logs(boat.truth, {}, folder, count=1, seed=SEED, commands=commands)
    params, out = load_vehicle(file).params, folder / "otter_fitted.toml"
    assert isinstance(params, Hull6DofParams)
    guessed = {name: [DAMPED.get(f"{name}.{k}", x) for k, x in enumerate(getattr(params.hydrodynamics, name))]
               for name in ("linear", "quadratic")}  # fmt: skip
    changes = {"hydrodynamics": guessed}
    model = load_vehicle(file, **changes)
    logs = [read_log(log, model)]
    found = fit(str(file), logs, PRIORS, starts=1, changes=changes)
    command.save(out, file, model, found, logs, changes)
    return sailed(out, {}, boat.ahead, boat.helm, HELM, True), command.lines(found, logs)


def row(*cells: str, figures: Sequence[float]) -> str:
    """A row of a table: cells, the truth, and others with their differences from it."""
    true, *others = figures
    told = [f"{x:.3g} ({100 * (x / true - 1):+.0f} %)" if math.isfinite(x / true) else f"{x:.3g}" for x in others]
    return f"| {' | '.join((*cells, f'{true:.3g}', *told))} |".replace("nan", "-")


def section_of(page: str) -> str:
    """The section on boats of a page; empty without one."""
    found = re.search(rf"(?ms)^{re.escape(TITLE)}$.*?(?=^## |\Z)", page)
    return found.group().strip() if found else ""


def put_table(page: str, head: str, rows: Sequence[str]) -> str:
    """The page with the rows of the table with this header line replaced."""
    lines = "\n".join([head, re.sub(r"[^|]+", "---", head), *rows, ""])
    return re.sub(rf"(?m)^{re.escape(head)}\n(\|.*\n?)*", lambda _: lines, page)


def write_tables(page: Path) -> None:
    """Make all boats, sail them, fit one to a log, and write the tables of the page's section."""
    runtime.init(precision="f64", threads=1)
    with TemporaryDirectory(prefix="boats-") as name:
        folder = Path(name)
        found = {boat.name: compared(boat, make(boat, folder)) for boat in BOATS}
        after, lines = ten_minutes(folder)
    print(*lines, sep="\n")
    first = found[BOATS[0].name]
    all_rows = [
        row(boat, told, figures=[getattr(f, key) for f in of])
        for boat, of in found.items() for key, told in NAMES.items()
    ]  # fmt: skip
    fit_rows = [row(told, figures=[getattr(f, key) for f in (*first[:2], after)]) for key, told in NAMES.items()]
    text = put_table(put_table(page.read_text(encoding="utf-8"), BOATS_HEAD, all_rows), FIT_HEAD, fit_rows)
    page.write_text(text, encoding="utf-8")
