"""Solution of all frequencies of one hull in several processes, and the database made of it.

Worker processes have one thread each, and end with the command.
"""

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from taichi_sim.applications.hydro.potential_flow import (
    Tank,
    added_mass_limit,
    mean_drift,
    radiated_damping,
    response,
    solve,
)
from taichi_sim.applications.hydro.wetted_surface import TURN_HORIZONTAL, turned_load, turned_matrix
from taichi_sim.errors import needs
from taichi_sim.models.usv.hull.database import HydroDatabase

CONTEXT = get_context("spawn")
WATCHED_S = 1.0  # s between checks that the command still runs
# Workers have one thread each, because they share the cores and the matrices are small. (Threads of a BLAS that wait
# for each other take ten times as long.) glibc keeps the memory of a frequency's matrices for the next frequency,
# because to allocate it anew page by page takes up to half the time.
ENVIRONMENT = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")} | {
    f"MALLOC_{name}_": str(2**33) for name in ("MMAP_THRESHOLD", "TRIM_THRESHOLD")
}
Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]


@contextmanager
def workers(count: int, begin: Callable[..., None] | None = None, *given: object) -> Iterator[ProcessPoolExecutor]:
    """Pool of `count` processes, each of which first calls `begin(*given)`."""
    own = os.getpid(), begin, given
    with patch.dict(os.environ, ENVIRONMENT), ProcessPoolExecutor(count, CONTEXT, _begin, own) as pool:
        try:
            yield pool
        except BaseException:  # an interruption, too: nothing that still runs is wanted
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in active_children():
                worker.terminate()
            raise


def _begin(parent: int, begin: Callable[..., None] | None, given: tuple[object, ...]) -> None:
    """Start a worker that ends when its parent ends, for whatever reason."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCHED_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    if begin is not None:
        begin(*given)


class Floating(NamedTuple):
    """Rigid-body matrix and stiffness [6, 6] of the floating hull about CO, in the frame of wetted_surface.py."""

    M: Array
    C: Array


class Loads(NamedTuple):
    """Loads at one frequency, in the frame of wetted_surface.py, for m headings."""

    added_mass: Array  # [6, 6]
    damping: Array  # [6, 6]
    froude_krylov: Complex  # [m, 6]
    excitation: Complex  # [m, 6]
    drift: Array  # [m, 3]


def require_capytaine() -> str:
    """Return name and version of capytaine."""
    with needs("capytaine", "bem"):
        import capytaine
    return f"capytaine {capytaine.__version__}"


def loads_at(tank: Tank, floating: Floating | None, omega: float, heading_deg: Array) -> Loads:
    """Solve one frequency; in the limits 0 and infinity there is only an added mass.

    Without `floating` there is no mean drift.
    """
    if omega in (0.0, np.inf):
        none = np.empty((0, 6), dtype=complex)
        return Loads(added_mass_limit(tank, omega), np.zeros((6, 6)), none, none, np.empty((0, 3)))
    found = solve(tank, omega, heading_deg)
    if tank.method == "direct":  # with sources, integrated pressures are more accurate
        found = found._replace(damping=radiated_damping(tank, found, omega))
    drift = np.zeros((len(found.diffraction), 3))
    if floating is not None:
        motion = response(found, floating.M, floating.C, omega)
        drift = mean_drift(tank, found, motion, omega, heading_deg)
    total = found.froude_krylov + found.diffraction
    return Loads(found.added_mass, found.damping, found.froude_krylov, total, drift)


def solve_all(
    tank: Tank, floating: Floating | None, omega: Iterable[float], heading_deg: Array, jobs: int, quiet: bool = False
) -> list[Loads]:
    """Loads at each of `omega` (rad/s, inf allowed), computed in `jobs` processes with a progress bar."""
    omega = list(omega)
    found: dict[int, Loads] = {}
    with workers(jobs) as pool:
        order = sorted(range(len(omega)), key=lambda i: -omega[i])
        running = {pool.submit(loads_at, tank, floating, omega[i], heading_deg): i for i in order}
        bar = tqdm(as_completed(running), total=len(running), desc="frequencies", unit="", disable=quiet)
        for done in bar:
            found[running[done]] = done.result()
    return [found[i] for i in range(len(omega))]


def database(
    tank: Tank, floating: Floating, loads: list[Loads], endless: Loads, omega: Array, heading_deg: Array, *,
    hull: str, code: str, settings: Mapping[str, object],
) -> HydroDatabase:  # fmt: skip
    """Make the database in the vehicle's frame; `hull`, `code` and `settings` are entered as they are.

    A heading changes sign with the frame: -30 deg, to starboard in the frame of wetted_surface.py, is +30 deg in the
    vehicle's.
    """
    turned = np.round(-np.asarray(heading_deg) % 360.0, 9)
    order = np.argsort(turned)

    def stack(name: str) -> NDArray:
        return np.stack([getattr(of, name) for of in loads])

    return HydroDatabase(
        rho=tank.rho,
        g=tank.g,
        depth=float(tank.depth) if np.isfinite(tank.depth) else None,
        omega=np.asarray(omega, dtype=float),
        heading_deg=turned[order],
        added_mass=_even(turned_matrix(stack("added_mass"))),
        damping=_even(turned_matrix(stack("damping"))),
        added_mass_inf=_even(turned_matrix(endless.added_mass)),
        excitation=turned_load(stack("excitation"))[:, order],
        froude_krylov=turned_load(stack("froude_krylov"))[:, order],
        volume=tank.hull.volume,
        stiffness=turned_matrix(floating.C),
        drift=(stack("drift") * TURN_HORIZONTAL)[:, order],
        hull=hull,
        code=code,
        settings=settings,
    )


def _even(matrix: Array) -> Array:
    """Symmetric part of a matrix; in exact theory the matrix is symmetric."""
    return (matrix + np.swapaxes(matrix, -1, -2)) / 2
