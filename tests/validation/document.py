"""The report as a page: a section per folder of tables, largest errors against their tolerances, pictures."""

from collections.abc import Iterable
from fnmatch import fnmatch
from itertools import groupby
from pathlib import Path

from taichi_sim.kernels import runtime
from tests.validation.boats import section_of
from tests.validation.case import Check, Folder
from tests.validation.plots import PICTURES
from tests.validation.plots.style import save
from tests.validation.report import PRECISIONS, Report
from tests.validation.tables import TableError

TITLES = {
    "waves": ("Waves", "Dispersion, spectra, the Gerstner surface and its inverse, linear kinematics and pressure."),
    "buoys": (
        "Measured seas",
        "Seas realised from a buoy's spectra against NDBC's own summaries of the same hours: height (m), mean period "
        "(s), direction at the peak (degrees).",
    ),
    "hydrostatics": (
        "Hydrostatics and wave loads",
        "A box of 4 x 2 x 0.5 m draft: closed forms, Froude-Krylov loads of the stepping kernel on a fine mesh, and "
        "motion in waves against a boundary-element code (capytaine).",
    ),
    "ships": (
        "Ships",
        "Hydrodynamic databases of our boundary-element runs against published tables (WAMIT): added mass and damping, "
        "wave loads, mean drift, and the motions that follow. What is checked, and why not all: "
        "`tests/validation/ships.py`.",
    ),
    "otter": (
        "Otter (`hull_6dof`)",
        "The published equations (PythonVehicleSimulator) integrated to convergence. `*_euler_*` tables are the "
        "published program's own Euler steps: there the figure is our distance to the converged run over theirs.",
    ),
    "wamv": ("WAM-V 16 (`hull_6dof`)", "Closed forms from the numbers of VRX."),
    "cybership2": ("CyberShip II (`manoeuvring_3dof`)", "An independent code's right-hand sides and converged runs."),
    "aerosonde": ("Aerosonde (`fixed_wing_6dof`)", "Published checks, trims, modes, and converged flights."),
    "multirotor": (
        "Multirotors (`multirotor_6dof`)",
        "Right-hand sides and converged flights of another code (rotorpy), trims in wind, closed forms, ground effect; "
        "contact of legs with decks.",
    ),
    "dryden": ("Turbulence and wind", "MIL-F-8785C at low altitude, and mean wind profiles."),
    "unity": ("The seed paper's vehicles", "The published movement rules stepped by an independent code."),
}
ORDER = tuple(TITLES)
DETAILED = ("box_*_rao.csv", "froude_krylov_*.csv")  # tables with a row for each quantity
INTRODUCTION = """# Validation

Every table below comes from a closed form or from an independent code, never from this package. An error is the
largest over a table: as a share of the largest magnitude for signed quantities, as a share of each value for positive
ones, or in the unit named. The tolerance is the required one plus half a unit of the table's last printed digit. Each
row shows the check nearest to its tolerance, in double (f64) and single (f32) precision. In tables of motion, lengths
are in m, speeds in m/s and rates in rad/s.

Written by `python tools/validate.py --reference DIR --report docs/validation.md`.
"""


def write(report: Report, reference: Path, file: Path) -> list[str]:
    """Write the page to `file` and pictures to the folder beside it; the pictures that could not be drawn, and why."""
    runtime.init(precision="f64", threads=1)
    folder, missing = Folder(reference.resolve()), []
    parts = [INTRODUCTION, _verdict(report)]
    sections = {_section(check) for check in report.checks}
    for section in sorted(sections, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name)):
        title, text = TITLES.get(section, (section, ""))
        parts += [f"## {title}", text, _table(check for check in report.checks if _section(check) == section)]
        for picture in PICTURES:
            if picture.section == section:
                try:
                    save(picture.draw(folder), file.with_suffix("") / f"{picture.name}.png")
                except TableError as error:
                    missing.append(f"{picture.name}: {error}")
                else:
                    parts.append(f"![{picture.name}]({file.stem}/{picture.name}.png)\n\n{picture.caption}")
    if file.is_file() and (boats := section_of(file.read_text(encoding="utf-8"))):
        parts.append(boats)
    if report.unchecked:
        names = ", ".join(f"`{name}`" for name in report.unchecked)
        parts += ["## Files without a check", f"{names}: notes and by-products."]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n\n".join(part.strip() for part in parts if part) + "\n", encoding="utf-8")
    return missing


def _section(check: Check) -> str:
    """The folder of the table."""
    return Path(check.table).parent.name or "tables"


def _verdict(report: Report) -> str:
    tables = len({check.table for check in report.checks})
    failed = sum(not check.passed for check in report.checks)
    return f"**{len(report.checks)} checks of {tables} tables, {failed} failed.**"


def _table(checks: Iterable[Check]) -> str:
    lines = ["| table | checks | f64: error | tolerance | f32: error | tolerance |", "|---|--:|---|--:|---|--:|"]
    for (table, _), rows in groupby(sorted(checks, key=_row), key=_row):
        rows = list(rows)
        cells = [cell for precision in PRECISIONS for cell in _nearest([c for c in rows if c.precision == precision])]
        lines.append(f"| {Path(table).name} | {len(rows)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _row(check: Check) -> tuple[str, str]:
    """What a row of the page is about: a table, or one quantity of a table that is worth it."""
    detailed = any(fnmatch(Path(check.table).name, pattern) for pattern in DETAILED)
    return check.table, check.quantity if detailed else ""


def _nearest(checks: list[Check]) -> tuple[str, str]:
    """Error and tolerance of the check that is nearest to failing, or has failed."""
    if not checks:
        return "", ""
    worst = max(checks, key=_use)
    if worst.error is None:
        return f"**{worst.problem}: {worst.quantity}**", ""
    text = f"{worst.quantity}: {worst.error:.1e}"
    return text if worst.passed else f"**{text}, failed**", f"{worst.tolerance:.1e}"


def _use(check: Check) -> float:
    """Error over tolerance."""
    if check.error is None or not check.tolerance:
        return float("inf") if not check.passed else 0.0
    return check.error / check.tolerance
