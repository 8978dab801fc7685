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
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.models.usv.hull.mesh import Panels
from taichi_sim.models.usv.hull.radiation_memory import Memory

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FORMAT = "taichi-sim hydrodynamics 1"
SUFFIX = ".hydro.json"
MICROMETRES = 1e6  # per metre; grid on which corners are compared
FEWEST = 4  # frequencies, at least
DIGITS = 6  # significant digits of the numbers in a file


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
        """Read the database in a file.

        Raises:
            ConfigError: if the file is unreadable or incomplete; the message names file and key.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ConfigError(
                f"{path}: there is no such file: a copy of a vehicle needs its database in the same folder; or "
                'set hydrodynamics.radiation = "constant"'
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: cannot be read: {error}") from None
        except ValueError as error:
            raise ConfigError(f"{path}: not valid JSON: {error}") from None
        try:
            return _parsed(data)
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from None

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
        texts: dict[str, object] = {"format": FORMAT, "hull": self.hull, "code": self.code}
        texts["settings"] = dict(self.settings)
        lines = [f'"{key}": {json.dumps(value)}' for key, value in texts.items()]
        lines += [f'"{key}": {_text(value)}' for key, value in tables.items()]
        Path(path).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _text(value: float | NDArray | None) -> str:
    """JSON of a number, None or an array; an array of three or more axes has one line per entry of the first axis."""
    if value is None:
        return "null"
    if np.ndim(value) == 0:
        return f"{value + 0.0:.{DIGITS}g}" if value else "0"
    between = ",\n  " if np.ndim(value) >= 3 else ","
    return "[" + between.join(map(_text, np.asarray(value))) + "]"


def _parsed(data: object) -> HydroDatabase:
    """Convert decoded JSON; a ValueError names the key."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f"key 'format': not {FORMAT!r}, so this is no hydrodynamic database of this version")
    settings = data.get("settings", {})
    if not isinstance(settings, dict):
        raise ValueError("key 'settings' is not an object")
    omega, heading = _axis(data, "omega"), _axis(data, "heading_deg")
    if len(omega) < FEWEST:
        raise ValueError(f"key 'omega' has {len(omega)} frequencies: cubic interpolation needs at least {FEWEST}")
    if omega[0] <= 0:
        raise ValueError(f"key 'omega': every frequency must be above 0, the first is {omega[0]:g} rad/s")
    if heading[0] < 0 or heading[-1] > 360:
        raise ValueError("key 'heading_deg': headings are from 0 to 360")
    by_omega, waves = (len(omega), 6, 6), (len(omega), len(heading), 6)

    def waves_of(name: str) -> Complex:
        return _numbers(data, f"{name}_re", waves) + 1j * _numbers(data, f"{name}_im", waves)

    drift = _numbers(data, "drift", (*waves[:2], 3)) if data.get("drift") is not None else None
    memory_inf = _numbers(data, "memory_inf", (6, 6)) if data.get("memory_inf") is not None else None
    by_panels = waves_of("by_panels") if data.get("by_panels_re") is not None else None
    depth = None if data.get("depth") is None else _positive(data, "depth")
    return HydroDatabase(
        _string(data, "hull"), _string(data, "code"),
        _positive(data, "rho"), _positive(data, "g"), depth, omega, heading,
        _numbers(data, "added_mass", by_omega), _numbers(data, "damping", by_omega),
        _numbers(data, "added_mass_inf", (6, 6)), waves_of("excitation"), waves_of("froude_krylov"),
        _positive(data, "volume"), _numbers(data, "stiffness", (6, 6)), drift, by_panels, _memory(data), memory_inf,
        settings,
    )  # fmt: skip


def _memory(data: Mapping[str, object]) -> Memory | None:
    if data.get("memory_frequency") is None:
        return None
    count = len(_numbers(data, "memory_frequency", None))
    frequency = _numbers(data, "memory_frequency", (count,))
    damping, shape = _numbers(data, "memory_damping", (count, count)), _numbers(data, "memory_shape", (count, 6))
    if np.any(frequency <= 0):
        raise ValueError("key 'memory_frequency' must be above 0")
    try:
        return Memory(frequency, damping, shape)
    except ValueError as error:
        raise ValueError(f"key 'memory_damping': {error}") from None


def _entry(data: Mapping[str, object], key: str) -> object:
    if key not in data:
        raise ValueError(f"key {key!r} is missing")
    return data[key]


def _string(data: Mapping[str, object], key: str) -> str:
    value = _entry(data, key)
    if not isinstance(value, str):
        raise ValueError(f"key {key!r} is not a text")
    return value


def _numbers(data: Mapping[str, object], key: str, shape: tuple[int, ...] | None) -> Array:
    """Finite numbers of the given shape (None: one axis of any length)."""
    try:
        values = np.array(_entry(data, key), dtype=np.float64)
    except (TypeError, ValueError) as error:
        if str(error).startswith("key "):
            raise
        raise ValueError(f"key {key!r} is not a table of numbers") from None
    if (values.ndim != 1 or not values.size) if shape is None else values.shape != shape:
        raise ValueError(f"key {key!r} has shape {values.shape}, expected {'one axis' if shape is None else shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"key {key!r} holds a value that is not finite")
    return values


def _axis(data: Mapping[str, object], key: str) -> Array:
    values = _numbers(data, key, None)
    if np.any(np.diff(values) <= 0):
        raise ValueError(f"key {key!r} must rise")
    return values


def _positive(data: Mapping[str, object], key: str) -> float:
    value = float(_numbers(data, key, ()))
    if value <= 0:
        raise ValueError(f"key {key!r} must be above 0, got {value:g}")
    return value
