"""Compute a hull's hydrodynamic database: added mass, damping, wave loads and mean drift by a boundary-element code.

    python tools/hydrodynamics.py HULL [--mesh FILE] [--mass KG] [--cg X Y Z] [--unit mm] [--waterline Z] ...

    python tools/hydrodynamics.py otter
    python tools/hydrodynamics.py my_boat.stl --unit mm --waterline 0.35 --mass 180 --cg 0.1 0 -0.2
    python tools/hydrodynamics.py fpso --mesh fpso_half_hull_panels.csv

HULL is a vehicle file of the model hull_6dof (or the name of a shipped one), or a mesh: STL, OBJ, PLY, GDF, or another
format of meshio, x forward, y to port, z up; one closed hull, or its half. NAME.hydro.json is written beside the
vehicle file. For a mesh alone the tool also writes NAME.toml, a vehicle with the mesh's offsets. It needs the extra
`bem` (capytaine). More: docs/hydrodynamics.md.

Exit status: 0 done, 1 bad input, 130 interrupted, 143 terminated.
"""

import argparse
import os
import shlex
import sys
import time
from pathlib import Path

import numpy as np

from rl.runs.signals import sigterm_as_interrupt, status
from taichi_sim.applications.hydro import hull_input, make_database
from taichi_sim.applications.hydro.frequency_sweep import require_capytaine
from taichi_sim.applications.hydro.memory_fit import ENERGY, FitError
from taichi_sim.applications.hydro.mesh_file import UNITS
from taichi_sim.applications.hydro.offsets import is_twin
from taichi_sim.applications.hydro.resistance import HullForm
from taichi_sim.applications.hydro.vehicle_file import UNFINISHED, Flow, Given, Thruster, vehicle_text
from taichi_sim.applications.hydro.wetted_surface import turned_matrix
from taichi_sim.config import ConfigError
from taichi_sim.config.io import replacing
from taichi_sim.errors import UserError, message
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.models.usv.hull.database import HydroDatabase, database_file, hull_hash
from taichi_sim.options import output, positive_float, positive_int, ranged, refuse_unwritable

DT = 1e-3  # s, step for loading a hull, of which only the panels are used


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    p = argparse.ArgumentParser(description="Compute a hull's hydrodynamic database by boundary elements.")
    p.add_argument("hull", metavar="HULL", help="a vehicle file, the name of a shipped one, or a mesh file")
    p.add_argument("--out", type=output, metavar="FILE", help="where to write (default: NAME.hydro.json beside HULL)")
    mesh = p.add_argument_group("meshes")
    mesh.add_argument("--mesh", type=Path, metavar="FILE", help="compute on this mesh of the vehicle, about its CO")
    mesh.add_argument("--unit", choices=UNITS, default="m", help="unit of the mesh (default: m)")
    mesh.add_argument("--waterline", type=float, default=0.0, metavar="Z", help="height of the water in the mesh, m")
    mesh.add_argument("--midships", type=float, metavar="X", help="x of the vehicle's origin in the mesh, m")
    mesh.add_argument("--mass", type=positive_float, metavar="KG", help="mass (default: the displacement of the mesh)")
    mesh.add_argument("--cg", type=float, nargs=3, metavar=("X", "Y", "Z"),
                      help="centre of gravity, m, forward, starboard, down from CO")  # fmt: skip
    mesh.add_argument("--gyration", type=positive_float, nargs=3, metavar=("KX", "KY", "KZ"),
                      help="radii of gyration, m, about the CG")  # fmt: skip
    mesh.add_argument("--freeboard", type=positive_float, metavar="M",
                      help="depth of the new vehicle (default: draught)")  # fmt: skip
    mesh.add_argument("--stations", type=ranged(int, 2, 100), default=24, metavar="N",
                      help="of its offsets (default: 24)")  # fmt: skip
    mesh.add_argument("--points", type=ranged(int, 2, 24), default=3, metavar="N",
                      help="of each, keel to waterline (default: 3)")  # fmt: skip
    drive = p.add_argument_group("what a mesh does not tell, for the new vehicle")
    drive.add_argument(
        "--thruster",
        type=float,
        nargs=4,
        action="append",
        default=[],
        metavar=("X", "Y", "Z", "N"),
        help="place, m, forward, starboard, down from CO, and largest thrust, N; once for each",
    )
    drive.add_argument("--propeller", type=ranged(float, 0.0, 20.0), metavar="D",
                       help="diameter, m; 0: thrust does not fall with speed")  # fmt: skip
    drive.add_argument("--azimuth", action="store_true", help="thrusters turn all round")
    drive.add_argument("--windage", type=positive_float, nargs=3, metavar=("AHEAD", "SIDE", "HEIGHT"),
                       help="areas, m^2, and the height of their centre, m")  # fmt: skip
    what = p.add_argument_group("what is computed")
    what.add_argument("--depth", type=positive_float, default=np.inf, metavar="M", help="of the water (default: deep)")
    what.add_argument("--rho", type=positive_float, default=RHO_SEA, metavar="KG/M3", help=f"default: {RHO_SEA:g}")
    what.add_argument("--frequencies", type=positive_int, metavar="N",
                      help="how many (default: 50; 90 to 150 of twin hulls)")  # fmt: skip
    what.add_argument("--range", type=positive_float, nargs=2, metavar=("LO", "HI"), help="of frequencies, rad/s")
    what.add_argument("--also", type=positive_float, nargs="+", default=(), metavar="W", help="more of them, rad/s")
    what.add_argument("--heading-step", type=ranged(float, 1.0, 90.0), metavar="DEG",
                      help="default: 15; less of long hulls")  # fmt: skip
    what.add_argument("--panels", type=ranged(int, 0, 50_000), default=1200, metavar="N",
                      help="of a half or quarter (1200; 0: as given)")  # fmt: skip
    what.add_argument("--divisions", type=ranged(int, 0, 100), default=0, metavar="N",
                      help="instead: even parts of a panel each way")  # fmt: skip
    what.add_argument("--gap-damping", type=ranged(float, 0.0, 10.0), metavar="E",
                      help="of water between hulls (0.03; 0 none)")  # fmt: skip
    what.add_argument("--method", choices=("direct", "sources"), default="direct", help="default: direct")
    what.add_argument("--no-lid", action="store_true", help="leave irregular frequencies in")
    what.add_argument("--energy", type=positive_float, default=ENERGY, metavar="E", help="share that a memory may miss")
    p.add_argument("--only-vehicle", action="store_true", help="no database: the vehicle file alone, for calm water")
    p.add_argument("--refit", action="store_true", help="fit the memory of the database that is there once more")
    p.add_argument("--jobs", type=positive_int, default=os.cpu_count() or 1, metavar="N",
                   help="processes (default: all cores)")  # fmt: skip
    p.add_argument("--quiet", action="store_true", help="no progress bar")
    return p


def main(argv: list[str] | None = None) -> int:
    """Parse, compute, write; return the exit status."""
    args = parser().parse_args(argv)
    try:
        with sigterm_as_interrupt():
            _run(args, shlex.join(["hydrodynamics", *(sys.argv[1:] if argv is None else argv)]))
    except (UserError, OSError) as error:
        print(f"error: {message(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print("\ninterrupted", *_left(args), sep="; ", file=sys.stderr)
        return status(interrupt)
    return 0


def _left(args: argparse.Namespace) -> list[str]:
    """What an interrupted command leaves of a mesh."""
    file = Path(args.hull).with_suffix(".toml")
    if not file.is_file() or UNFINISHED not in file.read_text(encoding="utf-8"):
        return []
    return [f"{file} is whole but for its database, which the same command begins again"]


def _run(args: argparse.Namespace, command: str) -> None:
    begun = time.monotonic()
    if args.refit:
        _refit(args)
        return
    code = require_capytaine()
    if hull_input.is_vehicle(args.hull):
        file = hull_input.vehicle_path(args.hull)
        craft, length = hull_input.of_vehicle(file)
        surface = None
        if args.mesh:
            surface = hull_input.read_mesh(args.mesh, args.unit, args.waterline, args.midships or 0.0, length)
    else:
        file = Path(args.hull).with_suffix(".toml")
        if file.exists() and UNFINISHED not in file.read_text(encoding="utf-8", errors="replace"):
            raise ConfigError(f"{file}: exists; compute its database with {file.name} --mesh {args.hull}, or rename it")
        refuse_unwritable(file)
        surface = hull_input.read_mesh(Path(args.hull), args.unit, args.waterline, args.midships, None)
        freeboard = args.freeboard or float(-surface.whole[..., 2].min())
        table = args.stations, args.points, freeboard
        craft = hull_input.of_mesh(surface, file.stem, args.mass, args.cg and tuple(args.cg), args.gyration, table)
        units = tuple(Thruster(*of) for of in args.thruster)
        given = Given(units, args.azimuth, args.propeller, args.windage and tuple(args.windage))
    wishes = make_database.Wishes(
        args.rho, GRAVITY, args.depth, args.panels, args.divisions, args.gap_damping, not args.no_lid, args.method,
        make_database.Spectrum(args.frequencies, args.range and tuple(args.range), tuple(args.also), args.heading_step),
        args.jobs, args.quiet,
    )  # fmt: skip
    out = args.out or database_file(file)
    refuse_unwritable(out)
    plan = make_database.plan(craft, surface, wishes)

    def vehicle(flow: Flow, radiation: str) -> list[str]:
        """Write the vehicle of a mesh whole; return messages."""
        if craft.shape is None or surface is None:
            return []
        form = HullForm(surface, 2 if is_twin(surface) else 1)
        C = turned_matrix(plan.floating.C)
        text, told = vehicle_text(craft, form, flow, C, given, args.rho, GRAVITY, radiation, command)
        with replacing(file) as part:
            part.write_text(text, encoding="utf-8")
        return told

    told = vehicle(plan.flow, "constant, as asked" if args.only_vehicle else "constant")
    if craft.shape is not None:
        print(f"{file}: a vehicle, whole but for the database", *told, sep="\n")
    if args.only_vehicle:
        return
    print(f"{len(plan.omega)} frequencies: about {plan.seconds / 60:.2g} min; then the memory, a few more", flush=True)
    found = make_database.run(plan, wishes, code, command)
    found.write(out)  # saves the long computation
    flow = plan.flow._replace(omega=found.omega, added_mass=found.added_mass, damping=found.damping)
    try:
        _complete(found, file, out, args)
    except FitError as error:
        if craft.shape is None:
            raise
        vehicle(flow, "constant, no memory fits")
        raise FitError(f'{error}. {file} is whole with radiation = "constant"') from None
    for line in vehicle(flow, "memory"):
        if line not in told:
            print(line)
    print(f"{out}: {len(found.omega)} frequencies, {len(found.heading_deg)} headings, {time.monotonic() - begun:.0f} s")


def _refit(args: argparse.Namespace) -> None:
    """Fit the memory of an existing database again, after an interruption or with another tolerance."""
    if not hull_input.is_vehicle(args.hull):
        raise ConfigError(f"{args.hull}: --refit is of a vehicle file and its database")
    file = hull_input.vehicle_path(args.hull)
    out = args.out or database_file(file)
    found = HydroDatabase.read(out)
    refuse_unwritable(out)
    if found.hull != hull_hash(hull_input.of_vehicle(file)[0].panels):
        raise ConfigError(f"{out}: of another hull than {file.name}'s: compute it without --refit")
    _complete(found, file, out, args)


def _complete(found: HydroDatabase, file: Path, out: Path, args: argparse.Namespace) -> None:
    """Add a memory, fitted for the vehicle of `file`, to the database and write it."""
    # imported here, because workers of the boundary-element code need no Taichi
    from taichi_sim.applications.hydro.complete_database import completed
    from taichi_sim.kernels import runtime
    from taichi_sim.models.catalogue import load_vehicle
    from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof

    runtime.init("cpu", "f64")
    simulated = load_vehicle(file, DT, hydrodynamics={"radiation": "constant", "drift": False})
    assert isinstance(simulated, Hull6Dof)
    found, pairs = completed(found, simulated, args.energy, quiet=args.quiet)
    found.write(out)
    worst = max(pairs, key=lambda pair: pair.missing)
    assert found.memory is not None
    print(f"memory: {len(found.memory)} masses; {' and '.join(dict.fromkeys(worst.modes))} miss most of their kernel's "
          f"energy, {100 * worst.missing:.2g} %")  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
