"""Hydrodynamic database of a hull: results of a boundary-element code in one text file in the folder of the vehicle
file.

`NAME.hydro.json` is written by tools/hydrodynamics.py (docs/hydrodynamics.md). All quantities are in the body frame b
(forward-right-down), moments about CO, in SI units. The time factor is exp(-i omega t). A wave with its crest at CO at
t = 0 has the elevation Re(a exp(i (k.x - omega t))), and its load is Re(X a exp(-i omega t)). A heading is the
direction in which the waves travel, relative to the bow, clockwise from above: 0 is a following sea, 90 is to
starboard. The hull has no forward speed. Added mass and damping are those of harmonic motion at omega.

The file identifies its hull by `hull_hash`, so that a database of another hull is detected.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, FiniteFloat

from taichi_sim.config import ConfigError, Positive, Strict
from taichi_sim.config.io import replacing, validate
from taichi_sim.models.usv.hull.mesh import Panels
from taichi_sim.models.usv.hull.radiation_memory import Memory

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SUFFIX = ".hydro.json"
MICROMETRES = 1e6  # per metre; grid on which corners are compared
FEWEST = 4  # frequencies, at least
DIGITS = 6  # significant digits of the numbers in a file
RADIATION = ("added_mass", "damping", "added_mass_inf")
Headings = Annotated[tuple[Annotated[float, Field(ge=0, le=360)], ...], Field(min_length=1)]
Modes = Annotated[tuple[FiniteFloat, ...], Field(min_length=6, max_length=6)]
Modes6 = Annotated[tuple[Modes, ...], Field(min_length=6, max_length=6)]
Level = Annotated[tuple[FiniteFloat, ...], Field(min_length=3, max_length=3)]
Frequency = Annotated[float, Field(gt=0, allow_inf_nan=False)]
FORMAT = Literal["taichi-sim hydrodynamics 1"]


class _File(Strict):
    """The keys of a file: complex numbers as two tables, and the memory (radiation_memory.py) as three."""

    model_config = ConfigDict(extra="ignore")

    format: FORMAT
    hull: str
    code: str
    settings: dict[str, object] = {}
    rho: Positive
    g: Positive
    depth: Positive | None = None
    volume: Positive
    omega: Annotated[tuple[Frequency, ...], Field(min_length=FEWEST)]
    heading_deg: Headings
    stiffness: Modes6
    added_mass_inf: Modes6
    added_mass: tuple[Modes6, ...]
    damping: tuple[Modes6, ...]
    excitation_re: tuple[tuple[Modes, ...], ...]
    excitation_im: tuple[tuple[Modes, ...], ...]
    froude_krylov_re: tuple[tuple[Modes, ...], ...]
    froude_krylov_im: tuple[tuple[Modes, ...], ...]
    drift: tuple[tuple[Level, ...], ...] | None = None
    by_panels_re: tuple[tuple[Modes, ...], ...] | None = None
    by_panels_im: tuple[tuple[Modes, ...], ...] | None = None
    memory_frequency: tuple[Frequency, ...] | None = None
    memory_damping: tuple[tuple[FiniteFloat, ...], ...] = ()
    memory_shape: tuple[Modes, ...] = ()
    memory_inf: Modes6 | None = None

    @property
    def memory(self) -> Memory | None:
        """The fitted memory, if there is one."""
        if self.memory_frequency is None:
            return None
        return Memory(np.array(self.memory_frequency), np.array(self.memory_damping), np.array(self.memory_shape))

    def _mistakes(self) -> Iterator[str]:
        for key in ("omega", "heading_deg"):
            if np.any(np.diff(getattr(self, key)) <= 0):
                yield f"{key} must rise"
        n, m = len(self.omega), len(self.heading_deg)
        for key in ("added_mass", "damping"):
            if len(getattr(self, key)) != n:
                yield f"{key} has {len(getattr(self, key))} entries, and omega {n}"
        for key in ("excitation", "froude_krylov", "drift", "by_panels"):
            for name in (key,) if key == "drift" else (f"{key}_re", f"{key}_im"):
                table = getattr(self, name)
                if [len(row) for row in table or ()] != ([m] * n if table is not None else []):
                    yield f"{name} is not of {n} frequencies (omega) and {m} headings (heading_deg)"
        if (self.by_panels_re is None) != (self.by_panels_im is None):
            yield "by_panels_re, by_panels_im: give both, or neither"
        count = len(self.memory_frequency or ())
        if [count] * count != [len(row) for row in self.memory_damping] or count != len(self.memory_shape):
            yield f"memory_damping, memory_shape are not of {count} frequencies (memory_frequency)"
        try:
            _ = self.memory
        except ValueError as error:
            yield f"memory_damping: {error}"


def database_file(vehicle_file: Path) -> Path:
    """Path of the database of a vehicle file: NAME.hydro.json in the folder of NAME.toml."""
    return vehicle_file.with_suffix(SUFFIX)


def hull_hash(panels: Panels) -> str:
    """Hash (16 hexadecimal digits) of the panels' corners, rounded to micrometres; independent of their order."""
    whole = np.rint(panels.corners * MICROMETRES).astype("<i8")
    rows = sorted(tuple(sorted(map(tuple, panel))) for panel in whole.tolist())
    return hashlib.sha256(np.array(rows, dtype="<i8").tobytes()).hexdigest()[:16]


@dataclass(frozen=True)
class HydroDatabase:
    """Loads of harmonic motions and of waves on one hull, at n frequencies and m headings (signs: see the module's
    docstring).
    """

    hull: str  # hull_hash of the vehicle's panels
    code: str  # name and version of the boundary-element code
    rho: float  # kg/m^3
    g: float  # m/s^2
    depth: float | None  # m; None for deep water
    omega: Array  # [n] rising, rad/s
    heading_deg: Array  # [m] rising, deg
    added_mass: Array  # [n, 6, 6] A(omega): kg, kg m, kg m^2
    damping: Array  # [n, 6, 6] B(omega): N s/m, N s, N m s
    added_mass_inf: Array  # [6, 6] A at infinite frequency
    excitation: Complex  # [n, m, 6] Froude-Krylov plus diffraction load: N/m, N
    froude_krylov: Complex  # [n, m, 6] load of the undisturbed wave's pressure: N/m, N
    volume: float  # displaced volume, m^3
    stiffness: Array  # [6, 6] C of water and weight: N/m, N, N m
    drift: Array | None = None  # [n, m, 3] mean surge, sway, yaw load of the free hull over amplitude^2: N/m^2, N/m
    by_panels: Complex | None = None  # [n, m, 6] froude_krylov on the simulator's own panels: N/m, N
    memory: Memory | None = None  # fitted to added_mass, damping and added_mass_inf
    memory_inf: Array | None = None  # [6, 6] added_mass_inf that goes with the memory
    settings: Mapping[str, object] = field(default_factory=dict)  # panels, lids, versions, command

    @property
    def diffraction(self) -> Complex:
        """Diffraction load, [n, m, 6], N/m and N."""
        return self.excitation - self.froude_krylov

    @property
    def resonances(self) -> list[float]:
        """Natural frequencies of heave, roll and pitch (rad/s) in the settings; empty without them."""
        found = self.settings.get("resonances")
        return list(found) if isinstance(found, list) else []

    @property
    def symmetric(self) -> bool:
        """Whether headings cover one side only, because port and starboard are alike."""
        return bool(self.heading_deg[-1] <= 180)

    @classmethod
    def read(cls, path: Path) -> "HydroDatabase":
        """Read the database in a file."""
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            why = "" if Path(path).is_file() else (
                "; a copy of a vehicle needs its database in the same folder, or hydrodynamics.radiation = \"constant\""
            )  # fmt: skip
            raise ConfigError(f"{path}: cannot be read: {error}{why}") from None
        given = validate(_File, data, str(path))

        def array(key: str) -> Array | None:
            values = getattr(given, key)
            return None if values is None else np.array(values, dtype=np.float64)

        def waves(name: str) -> Any:
            real = array(f"{name}_re")
            return None if real is None else real + 1j * np.asarray(array(f"{name}_im"))

        return cls(
            **{key: getattr(given, key) for key in ("hull", "code", "rho", "g", "depth", "volume", "settings")},
            **{key: array(key) for key in ("omega", "heading_deg", "stiffness", "drift", "memory_inf", *RADIATION)},
            **{key: waves(key) for key in ("excitation", "froude_krylov", "by_panels")},
            memory=given.memory,
        )

    def write(self, path: Path) -> None:
        """Write the file with six significant digits, one line per key and one line per frequency."""
        tables: dict[str, float | NDArray | None] = {
            "rho": self.rho, "g": self.g, "depth": self.depth, "volume": self.volume,
            "omega": self.omega, "heading_deg": self.heading_deg, "stiffness": self.stiffness,
            "added_mass_inf": self.added_mass_inf, "added_mass": self.added_mass, "damping": self.damping,
            "excitation_re": self.excitation.real, "excitation_im": self.excitation.imag,
            "froude_krylov_re": self.froude_krylov.real, "froude_krylov_im": self.froude_krylov.imag,
        }  # fmt: skip
        if self.drift is not None:
            tables["drift"] = self.drift
        if self.by_panels is not None:
            tables |= {"by_panels_re": self.by_panels.real, "by_panels_im": self.by_panels.imag}
        if self.memory is not None:
            tables |= {f"memory_{name}": getattr(self.memory, name) for name in ("frequency", "damping", "shape")}
            tables["memory_inf"] = self.added_mass_inf if self.memory_inf is None else self.memory_inf
        texts: dict[str, object] = {"format": get_args(FORMAT)[0], "hull": self.hull, "code": self.code}
        texts["settings"] = dict(self.settings)
        lines = [f'"{key}": {json.dumps(value)}' for key, value in texts.items()]
        lines += [f'"{key}": {_text(value)}' for key, value in tables.items()]
        with replacing(path) as part:
            part.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _text(value: float | NDArray | None) -> str:
    """JSON of a number, None or an array; an array of three or more axes has one line per entry of the first axis."""
    if value is None:
        return "null"
    if np.ndim(value) == 0:
        return f"{value + 0.0:.{DIGITS}g}" if value else "0"
    between = ",\n  " if np.ndim(value) >= 3 else ","
    return "[" + between.join(map(_text, np.asarray(value))) + "]"
