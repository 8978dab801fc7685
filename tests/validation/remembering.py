"""Hulls of tables with the radiation and diffraction of a boundary-element database: shipped, or computed and kept.

A computed one needs capytaine (extra `bem`) and minutes; `--bem FOLDER` keeps it from run to run. Hulls have no viscous
damping, as boundary-element codes have none, but what NAME_meta.json says was added (`B_external_linear`); shipped ones
have a little in surge, sway and yaw besides, by which they come to rest. Added damping takes the ship's own
velocity, as in tables (`damping_relative_to = "current"`).
"""

import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.errors import MissingExtraError
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.database import SUFFIX, HydroDatabase
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.params import Hull6DofParams
from tests.validation.case import Case
from tests.validation.tables import InputsMissingError, TableError, number, read_csv, read_json

DT, SAMPLE = 0.005, 16  # s for a hull of 1 m, and as the root of its length; steps from sample to sample
LEVEL = (1, 1, 0, 0, 0, 1)  # surge, sway, yaw
NO_DAMPING = {"linear": (0.0,) * 6, "quadratic": (0.0,) * 6, "cross_flow_length": 0.0}
OSCILLATING = (2, 3, 4)  # heave, roll, pitch
EXTERNAL = "B_external_linear"  # of a ship's meta file
KINDS = ("added_mass_damping", "excitation", "drift", "rao")
SLOWEST = 2000.0  # s for a hull of 200 m, and as the root of its length: no transient is waited for longer


def vehicle_file(name: str) -> Path:
    """Where the shipped vehicle of that name is, or would be."""
    return config_folder() / "vehicles" / f"{name}.toml"


def database_of(case: Case, name: str) -> HydroDatabase:
    """NAME.hydro.json beside the table, shipped, or computed on NAME_half_hull_panels.csv.

    Raises:
        InputsMissingError: if there is none and none can be computed.
    """
    for place in (case.path.with_name(name + SUFFIX), vehicle_file(name).with_suffix(SUFFIX)):
        if place.is_file():
            return HydroDatabase.read(place)
    return _made(case, name)[0]


def hull_of(case: Case, name: str) -> tuple[Hull6Dof, HydroDatabase]:
    """The shipped vehicle of that name, or one made of the table's panels, with its database and added damping.

    Raises:
        InputsMissingError: see database_of. TableError: if the added damping couples modes, which no hull here has.
    """
    model, database = _undamped(case, name)
    meta = case.path.with_name(f"{name}_meta.json")
    added = external_damping(read_json(case.folder.use(meta))) if meta.is_file() else np.zeros((6, 6))
    return damped(model, added), database


def damped(model: Hull6Dof, added: np.ndarray) -> Hull6Dof:
    """The same hull with the linear damping `added` [6, 6] (N s/m, N m s) of its own motion beside its radiation.

    Raises:
        TableError: if it couples modes.
    """
    if np.any(added != np.diag(np.diag(added))):
        raise TableError(f"meta: key {EXTERNAL!r} couples modes: a hull's damping is one number a mode")
    if not added.any():
        return model
    water = model.params.hydrodynamics
    # of what a file says in heave, roll and pitch, radiation's share at the resonance is taken back
    least = np.where(np.diag(added) > 0, model.radiation.counted, 0.0)
    linear = np.maximum(water.linear, least) + np.diag(added)
    own = {"linear": tuple(linear.tolist()), "damping_relative_to": "current"}
    params = model.params.model_copy(update={"hydrodynamics": water.model_copy(update=own)})
    return Hull6Dof(params, model.dt, model.substeps)


def external_damping(meta: Any) -> np.ndarray:
    """Linear damping [6, 6] that a ship's published motions have beside radiation, in the table's frame; none is zero.

    Raises:
        TableError: if it is no 6 x 6 matrix.
    """
    return matrix(meta, EXTERNAL) if EXTERNAL in meta else np.zeros((6, 6))


def _undamped(case: Case, name: str) -> tuple[Hull6Dof, HydroDatabase]:
    if not vehicle_file(name).is_file():
        database, params = _made(case, name)
        return _model(params), database
    file = read_toml(vehicle_file(name))
    little = tuple(level * d for level, d in zip(LEVEL, file["hydrodynamics"]["linear"], strict=True))
    water = NO_DAMPING | {"linear": little, "radiation": "memory"}
    adrift = {"thrusters": None} if "thrusters" in file else {}  # two propellers idle ahead
    model = load_vehicle(name, _dt(file["length"]), SAMPLE, hydrodynamics=water, **adrift)
    assert isinstance(model, Hull6Dof) and model.radiation.database is not None
    return model, model.radiation.database


def slowest_decay(model: Hull6Dof, database: HydroDatabase) -> float:
    """Time constant of the slowest of heave, roll and pitch, s."""
    found, omega = [], np.asarray(database.settings["resonances"], dtype=float)
    beyond = np.maximum(np.array(model.params.hydrodynamics.linear) - model.radiation.counted, 0.0)
    for mode, w in zip(OSCILLATING, omega, strict=True):
        A, B = (np.interp(w, database.omega, x[:, mode, mode]) for x in (database.added_mass, database.damping))
        B += beyond[mode]
        found.append(2 * (model.params.M_rb[mode, mode] + A) / B)
    return min(max(found), SLOWEST * np.sqrt(model.params.length / 200))


def _dt(length: float) -> float:
    return float(f"{DT * np.sqrt(length):.2g}")


@cache
def _model(params: Hull6DofParams) -> Hull6Dof:
    return Hull6Dof(params, _dt(params.length), SAMPLE)


def _made(case: Case, name: str) -> tuple[HydroDatabase, Hull6DofParams]:
    """Of a ship that is known by panels, mass and tables: computed once, kept in the folder of `--bem`."""
    panels, meta = (case.path.with_name(name + end) for end in ("_half_hull_panels.csv", "_meta.json"))
    if not panels.is_file():
        raise InputsMissingError(f"inputs missing: neither {name}{SUFFIX} nor {panels.name}")
    from taichi_sim.applications.hydro import hull_input
    from taichi_sim.applications.hydro.wetted_surface import turned_matrix

    data = read_json(case.folder.use(meta))
    M = turned_matrix(matrix(data, "M"))
    mass = float(M[0, 0])
    cg = (M[1, 5] / mass, 0.0, M[0, 4] / mass)  # x, z: of the coupling with yaw and pitch
    surface = hull_input.read_mesh(case.folder.use(panels), "m", 0.0, 0.0, None)
    draught = float(-surface.whole[..., 2].min())
    with redirect_stdout(sys.stderr):
        craft = hull_input.of_mesh(surface, name, mass, cg, (1.0, 1.0, 1.0), (24, 3, draught))
    craft = replace(craft, M=M)
    kept = case.folder.computed / (name + SUFFIX)
    assert craft.shape is not None
    length, breadth = (float(np.ptp(surface.whole[..., i])) for i in (0, 1))
    numbers: dict[str, Any] = {
        "length": length, "beam": breadth, "height": 2 * draught, "collision_radius": length / 2,
        "rigid_body": {"mass": mass, "cg": cg, "M_rb": M.tolist()},
        "hydrodynamics": NO_DAMPING | {"added_mass": (0.0,) * 6}, "hull": craft.shape.model_dump(),
    }  # fmt: skip
    if not kept.is_file():
        floating = _model(validate(Hull6DofParams, numbers, name))
        _compute(case, name, craft, surface, data, floating, kept)
    numbers["hydrodynamics"] |= {"radiation": "memory", "database": str(kept)}
    return HydroDatabase.read(kept), validate(Hull6DofParams, numbers, name)


def _compute(case: Case, name: str, craft: Any, surface: Any, data: Any, floating: Hull6Dof, kept: Path) -> None:
    from taichi_sim.applications.hydro import make_database
    from taichi_sim.applications.hydro.complete_database import completed
    from taichi_sim.applications.hydro.frequency_sweep import require_capytaine

    try:
        code = require_capytaine()
    except MissingExtraError as error:
        raise InputsMissingError(f"inputs missing: no {name}{SUFFIX}, and to compute it: {error}") from None
    also = tuple(sorted({float(w) for w in _frequencies(case, name)}))
    spectrum = make_database.Spectrum(None, None, also, None)
    wishes = make_database.Wishes(
        number(data, "rho"), GRAVITY, np.inf, 0, 0, 0.0, True, "direct", spectrum, os.cpu_count() or 1, False
    )  # the mesh as it is
    kept.parent.mkdir(parents=True, exist_ok=True)
    with redirect_stdout(sys.stderr):
        found = make_database.run(make_database.plan(craft, surface, wishes), wishes, code, f"validate: {name}")
        completed(found, floating)[0].write(kept)


def _frequencies(case: Case, name: str) -> Sequence[float]:
    """Of all tables of a ship, rad/s."""
    tables = (case.path.with_name(f"{name}_{kind}.csv") for kind in KINDS)
    return np.concatenate([read_csv(table)["omega"] for table in tables if table.is_file()]).tolist()


def matrix(meta: Any, key: str) -> np.ndarray:
    """A 6 x 6 matrix of a ship's meta file.

    Raises:
        TableError: if there is none of that name.
    """
    try:
        return np.array(meta[key], dtype=np.float64).reshape(6, 6)
    except (KeyError, TypeError, ValueError):
        raise TableError(f"meta: key {key!r} is not a 6 x 6 matrix") from None
