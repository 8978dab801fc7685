"""A hull's hydrodynamic database: what a boundary-element code says of it, in one text file beside its vehicle file.

`NAME.hydro.json` is written by tools/hydrodynamics.py (docs/hydrodynamics.md). All in the body frame b
(forward-right-down), moments about CO, SI units; time factor exp(-i omega t): with the elevation
Re(a exp(i (k.x - omega t))) of a wave whose crest is at CO at t = 0, a load is Re(X a exp(-i omega t)). A heading is
the direction the waves travel to, relative to the bow, clockwise seen from above: 0 is following, 90 to starboard.
The hull is held at zero speed; added mass and damping are those of harmonic motion at omega.

The file names its hull by `hull_hash`, so that a database of another hull is found out.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.usv.hull.memory import Memory
from taichi_sim.usv.hull.mesh import Panels

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FORMAT = "taichi-sim hydrodynamics 1"
SUFFIX = ".hydro.json"
MICROMETRES = 1e6  # per metre: the grid on which corners are compared
FEWEST = 4  # frequencies
DIGITS = 6  # significant ones of the numbers in a file
CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def database_file(vehicle_file: Path) -> Path:
    """Where the database of a vehicle file is: NAME.hydro.json beside NAME.toml."""
    return vehicle_file.with_suffix(SUFFIX)


def hull_hash(panels: Panels) -> str:
    """16 hexadecimal digits of the panels' corners to the micrometre, in whatever order they come."""
    corners = np.stack(
        [panels.centre + s * panels.along + t * panels.up + s * t * panels.twist for s, t in CORNERS], axis=1
    )
    whole = np.rint(corners * MICROMETRES).astype("<i8")
    rows = sorted(tuple(sorted(map(tuple, panel))) for panel in whole.tolist())
    return hashlib.sha256(np.array(rows, dtype="<i8").tobytes()).hexdigest()[:16]


@dataclass(frozen=True)
class HydroDatabase:
    """Loads of harmonic motions and waves on one hull at n frequencies and m headings; see the module for signs."""

    hull: str  # hull_hash of the vehicle's panels
    code: str  # what computed it, with its version
    rho: float  # kg/m^3
    g: float  # m/s^2
    depth: float | None  # m; None is deep water
    omega: Array  # [n] rising, rad/s
    heading_deg: Array  # [m] rising, deg
    added_mass: Array  # [n, 6, 6] A(omega): kg, kg m, kg m^2
    damping: Array  # [n, 6, 6] B(omega): N s/m, N s, N m s
    added_mass_inf: Array  # [6, 6] A at infinite frequency
    excitation: Complex  # [n, m, 6] of a held hull, Froude-Krylov and diffraction: N/m, N
    froude_krylov: Complex  # [n, m, 6] of the undisturbed wave's pressure
    volume: float  # displaced, m^3
    stiffness: Array  # [6, 6] C of water and weight: N/m, N, N m
    drift: Array | None = None  # [n, m, 3] mean surge, sway, yaw load of the free hull over amplitude^2: N/m^2, N/m
    by_panels: Complex | None = None  # [n, m, 6] froude_krylov as the simulator's own panels have it: N/m, N
    memory: Memory | None = None  # fitted to added_mass, damping and added_mass_inf
    memory_inf: Array | None = None  # [6, 6] added_mass_inf as it agrees with the memory
    settings: Mapping[str, Any] = field(default_factory=dict)  # panels, lids, versions, command

    @property
    def diffraction(self) -> Complex:
        """[n, m, 6]: what the held hull's own waves add to `froude_krylov`, N/m and N."""
        return self.excitation - self.froude_krylov

    @property
    def symmetric(self) -> bool:
        """Whether headings are of one side only, for the hull has two alike."""
        return bool(self.heading_deg[-1] <= 180)

    @classmethod
    def read(cls, path: Path) -> "HydroDatabase":
        """The database in a file.

        Raises:
            ConfigError: naming file and key, if it is unreadable or not a whole database.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ConfigError(
                f"{path}: there is no such file: a copy of a vehicle needs its database beside it; or set "
                'hydrodynamics.radiation = "constant"'
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
        """Write the file, numbers to six significant digits, one line a key and a line a frequency."""
        tables: dict[str, Any] = {
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
        texts: dict[str, Any] = {"format": FORMAT, "hull": self.hull, "code": self.code}
        texts["settings"] = dict(self.settings)
        lines = [f'"{key}": {json.dumps(value)}' for key, value in texts.items()]
        lines += [f'"{key}": {_text(value)}' for key, value in tables.items()]
        Path(path).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _text(value: Any) -> str:
    """JSON of a number, None or an array; an array of three or more axes has a line for each entry of its first."""
    if value is None:
        return "null"
    if np.ndim(value) == 0:
        return f"{value + 0.0:.{DIGITS}g}" if value else "0"
    between = ",\n  " if np.ndim(value) >= 3 else ","
    return "[" + between.join(map(_text, value)) + "]"


def _parsed(data: Any) -> HydroDatabase:
    """The database in decoded JSON; ValueError naming the key."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f"key 'format': not {FORMAT!r}, so this is no hydrodynamic database of this version")
    settings = data.get("settings", {})
    if not isinstance(settings, dict):
        raise ValueError("key 'settings' is not an object")
    omega, heading = _axis(data, "omega"), _axis(data, "heading_deg")
    if len(omega) < FEWEST:
        raise ValueError(f"key 'omega' has {len(omega)} frequencies: at least {FEWEST}, for it is read by cubics")
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


def _memory(data: Mapping[str, Any]) -> Memory | None:
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


def _entry(data: Mapping[str, Any], key: str) -> Any:
    if key not in data:
        raise ValueError(f"key {key!r} is missing")
    return data[key]


def _string(data: Mapping[str, Any], key: str) -> str:
    value = _entry(data, key)
    if not isinstance(value, str):
        raise ValueError(f"key {key!r} is not a text")
    return value


def _numbers(data: Mapping[str, Any], key: str, shape: tuple[int, ...] | None) -> Array:
    """Finite numbers of the given shape (None: of one axis)."""
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


def _axis(data: Mapping[str, Any], key: str) -> Array:
    values = _numbers(data, key, None)
    if np.any(np.diff(values) <= 0):
        raise ValueError(f"key {key!r} must rise")
    return values


def _positive(data: Mapping[str, Any], key: str) -> float:
    value = float(_numbers(data, key, ()))
    if value <= 0:
        raise ValueError(f"key {key!r} must be above 0, got {value:g}")
    return value
