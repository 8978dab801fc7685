"""The hull that a command names: a vehicle file with panels, or a mesh, of which a vehicle file is made."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from taichi_sim.applications.hydro import mesh_check, mesh_file
from taichi_sim.applications.hydro.offsets import offsets
from taichi_sim.applications.hydro.panelling import Z_UP, wetted
from taichi_sim.applications.hydro.wetted_surface import WettedSurface, X, mirrored
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml, validate, with_tuples
from taichi_sim.errors import named
from taichi_sim.kernels.conventions import RHO_SEA
from taichi_sim.kernels.rigid_body import rigid_body_mass
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import HullShape, Panels, StationsHull, mesh
from taichi_sim.models.usv.hull.params import RigidBody

Array = NDArray[np.float64]
MODEL = "hull_6dof"
HEAVIER = 0.05  # relative difference of mass and displaced mass that gives a warning
LIGHTER = 20.0  # displaced mass over mass from which the input must be wrong
TRIES = 40  # iterations towards a wanted number of panels


@dataclass(frozen=True)
class FloatingHull:
    """A floating hull in the vehicle's frame: the simulator's panels, mass (kg), CG (m) and rigid-body matrix."""

    name: str
    panels: Panels
    mass: float
    cg: tuple[float, float, float]
    M: Array  # [6, 6] about CO
    shape: StationsHull | None = None  # offsets made of a mesh, for a new vehicle file
    assumed: tuple[str, ...] = ()  # what nobody gave

    @property
    def cg_z_up(self) -> Array:
        """CG in the frame of wetted_surface.py, m."""
        return np.array(self.cg) * Z_UP


def is_vehicle(name: str) -> bool:
    """Whether `name` names a vehicle file (a path, or a shipped one) rather than a mesh."""
    return Path(name).suffix in ("", ".toml")


def vehicle_path(name: str) -> Path:
    """Path of a vehicle file, given by its path or, if it is shipped, by its name."""
    if Path(name).suffix == ".toml" and Path(name).is_file():
        return Path(name)
    folder = config_folder() / "vehicles"
    shipped = folder / f"{Path(name).stem}.toml"
    if shipped.is_file():
        return shipped
    known = sorted(f.stem for f in folder.glob("*.toml") if read_toml(f).get("model") == MODEL)
    raise ConfigError(f"{name}: no such vehicle; shipped hulls are {', '.join(known)}, or give a .toml or a mesh file")


def of_vehicle(file: Path) -> tuple[FloatingHull, float]:
    """Read the hull of a vehicle file; also return its length, m."""
    data = read_toml(file)
    if data.get("model") != MODEL:
        raise ConfigError(f"{file}: model = {data.get('model')!r}: only {MODEL} has a hull of panels")
    for key in ("hull", "rigid_body", "length"):
        if key not in data:
            raise ConfigError(f"{file}: {key} is missing")
    body = validate(RigidBody, data["rigid_body"], f"{file}: rigid_body")
    with named(f"{file}: hull: ", ConfigError, ValueError):
        shape = TypeAdapter(HullShape).validate_python(with_tuples(data["hull"]))
    craft = FloatingHull(file.stem, mesh(shape), body.mass, tuple(body.cg), np.asarray(body.matrix, dtype=float))
    return craft, float(data["length"])


def read_mesh(path: Path, unit: str, waterline: float, midships: float | None, length: float | None) -> WettedSurface:
    """Read the wetted surface of a mesh file and move it to CO.

    `waterline` and `midships` are z and x of CO in the mesh (m); without `midships`, the middle of the mesh.
    """
    panels, planes = mesh_file.read(path, unit)
    if X in planes and midships:  # the plane of symmetry is not CO's
        panels, planes = np.concatenate([panels, mirrored(panels, X)]), tuple(a for a in planes if a != X)
    x = panels[..., X]
    middle = 0.0 if X in planes else (x.min() + x.max()) / 2
    moved = panels - [middle if midships is None else midships, 0.0, waterline]
    return mesh_check.checked(mesh_file.Polygons(moved, planes), path.name, length)


def of_mesh(
    surface: WettedSurface, name: str, mass: float | None, cg: tuple[float, float, float] | None,
    gyration: tuple[float, float, float] | None, table: tuple[int, int, float],
) -> FloatingHull:  # fmt: skip
    """Make a hull of offsets from a wetted mesh, and print each number that is assumed.

    `table` holds the number of stations, the number of points and the freeboard (m).
    """
    given = {"mass": mass, "cg": cg, "gyration": gyration}
    whole = surface.whole.reshape(-1, 3)
    length, beam = np.ptp(whole[:, 0]), np.ptp(whole[:, 1])
    if mass is None:
        mass = float(f"{RHO_SEA * surface.volume:.6g}")
        print(f"{name}: no --mass: {mass:g} kg, its displacement in sea water")
    if cg is None:
        cg = (round(float(surface.centre_of_buoyancy[0]), 4) + 0.0, 0.0, 0.0)
        print(f"{name}: no --cg: {cg}, over the centre of buoyancy in the waterline")
    if gyration is None:
        roll, pitch = (float(f"{r:.4g}") for r in (0.35 * beam, 0.25 * length))
        gyration = roll, pitch, pitch
        print(f"{name}: no --gyration: {gyration} m, 0.35 of the beam and 0.25 of the length")
    try:
        shape = offsets(surface, *table)
    except ValueError:  # a section without water or with a hole, half-breadths below 0
        raise ConfigError(
            f"{name}: no table of offsets can be made of it: a table holds one hull or two alike, without a hole; "
            "write a vehicle file with its [hull], and give this mesh as --mesh"
        ) from None
    M = rigid_body_mass(mass, cg, mass * np.diag(np.square(np.array(gyration))))
    return FloatingHull(name, mesh(shape), mass, cg, np.asarray(M, dtype=float), shape,
                        tuple(key for key, value in given.items() if value is None))  # fmt: skip


def check_floating(craft: FloatingHull, surface: WettedSurface, rho: float, g: float) -> list[str]:
    """Return messages about mass, displacement and stability."""
    displaced, whole = rho * surface.volume, rho * Hydrostatics(craft.panels, craft.mass, craft.cg).volume_below_deck
    if craft.mass >= whole:
        raise ConfigError(
            f"{craft.name}: its mass of {craft.mass:.6g} kg is above the {whole:.6g} kg it displaces up to its deck"
        )
    if displaced > LIGHTER * craft.mass:
        raise ConfigError(
            f"{craft.name}: its mass is {craft.mass:.6g} kg, and it displaces {displaced:.6g} kg: check mass, "
            "--waterline and --unit"
        )
    C = surface.stiffness(craft.mass, craft.cg_z_up, rho, g)
    GM_T, GM_L = C[3, 3] / (craft.mass * g), (C[4, 4] - C[2, 4] ** 2 / C[2, 2]) / (craft.mass * g)
    for name, GM in (("transverse", GM_T), ("longitudinal", GM_L)):
        if GM <= 0:
            raise ConfigError(
                f"{craft.name}: its {name} metacentric height is {GM:.4g} m: it capsizes; lower the centre of gravity "
                f"(z = {craft.cg[2]:g} m, positive down), or check mass, unit and axes (x forward, z up in a mesh)"
            )
    off = craft.mass / displaced - 1
    lines = [
        f"mass {craft.mass:.6g} kg, displaced to the design waterline {displaced:.6g} kg ({100 * off:+.2f} %); "
        f"GM_T {GM_T:.4g} m, GM_L {GM_L:.4g} m"
    ]
    if abs(off) > HEAVIER:
        lines.append(
            f"warning: mass and displaced mass differ by {100 * off:+.1f} %: the hull does not float at the design "
            "waterline, for which the loads are computed"
        )
    trim = craft.cg[0] - surface.centre_of_buoyancy[0]
    if abs(trim) > 0.02 * np.ptp(surface.whole[..., X]):
        lines.append(f"warning: the centre of gravity is {trim:+.3g} m ahead of the centre of buoyancy: the hull trims")
    return lines


def divided(panels: Panels, wanted: int) -> tuple[WettedSurface, float]:
    """Divide the hull into about `wanted` panels, not counting images; also return their size, m."""
    high = float(np.ptp(panels.centre, axis=0).max())
    low = 1e-3 * high
    for _ in range(TRIES):
        size = float(np.sqrt(low * high))
        found = wetted(panels, size)
        if abs(len(found) - wanted) < 0.02 * wanted or high / low < 1.001:
            break
        low, high = (size, high) if len(found) > wanted else (low, size)
    return found, size
