"""Computation of a hull's database: panels, lids, resonances, frequencies, with messages about each.

Frequencies run from well below to well above the resonances of heave, roll and pitch, plus a tail for the memory of
waves. A coarse pass gives the resonances. With added mass A(omega) known at a few frequencies, a natural frequency is
an omega whose square is an eigenvalue of (M + A(omega))^-1 C.
"""

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.frequency_sweep import Floating, Loads, database, loads_at, solve_all
from taichi_sim.applications.hydro.hull_input import FloatingHull, check_floating, divided
from taichi_sim.applications.hydro.offsets import compared
from taichi_sim.applications.hydro.panelling import gap_lid, inner_lid, of_number, wetted
from taichi_sim.applications.hydro.potential_flow import Solution, Tank, added_mass_limit, solve
from taichi_sim.applications.hydro.vehicle_file import Flow
from taichi_sim.applications.hydro.wetted_surface import PLANES, WettedSurface, X, turned_matrix
from taichi_sim.config import ConfigError
from taichi_sim.models.usv.hull.database import HydroDatabase, hull_hash

Array = NDArray[np.float64]
BELOW, ABOVE = 0.2, 2.5  # times the lowest and highest resonance: the range that motions in waves need
TAIL = 4.5  # times the highest resonance: damping has decayed there, and the kernel's beginning depends on it
IN_TAIL = 0.2  # share of the frequencies in the tail
VERTICAL = [2, 3, 4]
SPIKE = 6.0  # times the damping at either neighbour: a peak that the frequencies do not resolve
NAMES = ("heave", "roll", "pitch")
COARSE = 120  # panels of the coarse pass that finds the resonances
MOST = 4000  # most panels; matrices take 2 x 16 x MOST^2 bytes per process and symmetry
FINER = 1.25  # times the wanted panels, from which a mesh gives way to the table of offsets that was made of it
PER_WAVE = 3.0  # fewest panels per shortest wave, in the tail of the frequencies
GAP_SIZE = 2.0  # panel size of the damping lid over that of the hull
COUNT, COUNT_TWIN = 50, (90, 150)  # frequencies of a single hull; of two, where the water resonates sharply: bounds
PER_WIDTH = 1.5  # frequencies per width (epsilon omega) of a resonance of the water between two hulls; assumed
FEW = 0.6  # share of these from which a warning is due; assumed
HEADING_STEPS, MORE_ORDERS = (15.0, 10.0, 7.5, 5.0), 2.0  # deg; harmonics of loads over headings beyond k L / 2
GAP_DAMPING = 0.03  # epsilon of the damping lid; assumed (docs/hydrodynamics.md)
# Tolerated relative differences of the simulator's panels from a mesh (LCB: over the length); assumed. A metacentric
# height is a small difference of large lengths.
OFF = {"volume": 0.02, "waterplane": 0.02, "waterplane Ixx": 0.05, "waterplane Iyy": 0.05, "LCB": 0.005,
       "KB below water": 0.05, "GM_T": 0.2, "GM_L": 0.2}  # fmt: skip


class Resonances(NamedTuple):
    """Natural frequencies, rad/s."""

    heave: float
    roll: float
    pitch: float


def resonances(omega: Array, added_mass: Array, M: Array, C: Array) -> Resonances:
    """Natural frequencies of coupled heave, roll and pitch, from A [n, 6, 6] at omega [n], rigid-body M and stiffness C
    [6, 6].

    Each mode is identified by its largest share of an eigenvector.
    """
    found = []
    V = np.ix_(VERTICAL, VERTICAL)
    for mode in range(3):
        w = float(omega[len(omega) // 2])
        for _ in range(60):
            A = np.array([[np.interp(w, omega, added_mass[:, i, j]) for j in VERTICAL] for i in VERTICAL])
            value, vector = np.linalg.eig(np.linalg.solve(M[V] + A, C[V]))
            size = np.sqrt(np.abs(np.diag(M[V] + A)))[:, None] * np.abs(vector)
            own = int(np.argmax(size[mode] / np.linalg.norm(size, axis=0)))
            new = float(np.sqrt(max(value[own].real, 0.0)))
            if abs(new - w) < 1e-6 * w:
                break
            w = (w + new) / 2
        found.append(w)
    return Resonances(*found)


def spikes(omega: Array, damping: Array, kept: tuple[float, ...]) -> NDArray[np.intp]:
    """Indices of omega [n] at which the damping [n, 6, 6] of a mode has an isolated peak, except at frequencies in
    `kept`.

    Such a peak is narrower than a step, so it cannot be resolved: an irregular frequency that no lid removed, or
    perhaps a resonance without damping in a gap between hulls.
    """
    size = np.einsum("nii->ni", damping)
    beside = np.maximum(np.maximum(size[:-2], size[2:]), 1e-3 * size.max(axis=0))
    found = 1 + np.flatnonzero((size[1:-1] > SPIKE * beside).any(axis=1))
    return found[~np.isin(omega[found], kept)]


class Spectrum(NamedTuple):
    """Wave frequencies and headings that the user asked for."""

    count: int | None
    range: tuple[float, float] | None  # rad/s
    also: tuple[float, ...]  # additional frequencies, rad/s
    heading_step: float | None  # deg


class Wishes(NamedTuple):
    """Options of the command."""

    rho: float  # kg/m^3
    g: float  # m/s^2
    depth: float  # m; inf: deep water
    panels: int  # 0: a mesh as it is
    divisions: int
    gap_damping: float | None
    lid: bool
    method: str
    spectrum: Spectrum
    jobs: int
    quiet: bool


class Plan(NamedTuple):
    """A computation that is ready to run, and what is known before it."""

    craft: FloatingHull
    surface: WettedSurface
    mesh: WettedSurface | None
    tank: Tank
    floating: Floating
    resonances: Resonances
    omega: Array  # rad/s
    heading: Array  # deg
    size: float  # m, of panels
    flow: Flow  # of a coarse pass; in the limits of slow and fast motion, of the plan's panels
    seconds: float  # estimate of the time that the frequencies take


def plan(craft: FloatingHull, mesh: WettedSurface | None, wishes: Wishes) -> Plan:
    """Prepare the database of a hull on its own panels, or on `mesh`, and print what is known of it.

    Raises:
        resonance.
    """
    surface, size = _surface(craft, mesh, wishes)
    for line in check_floating(craft, surface, wishes.rho, wishes.g):
        print(line)
    C = surface.stiffness(craft.mass, craft.cg_z_up, wishes.rho, wishes.g)
    floating = Floating(turned_matrix(craft.M), C)
    tried, coarse = _coarse(craft, floating, wishes)
    of = resonances(tried, np.stack([own.added_mass for own in coarse]), floating.M, floating.C)
    print(", ".join(f"{n} {w:.3g} rad/s" for n, w in zip(NAMES, of, strict=True)) + " (resonances)")
    lid = inner_lid(surface, size) if wishes.lid else np.empty((0, 4, 3))
    gap = gap_lid(surface, GAP_SIZE * size)
    epsilon = GAP_DAMPING if wishes.gap_damping is None else wishes.gap_damping
    tank = Tank(surface, lid, gap, wishes.rho, wishes.g, wishes.depth, epsilon, wishes.method)
    omega = _omega(of, wishes.spectrum, epsilon if len(gap) else None, size, wishes.g)
    heading = _headings(surface, wishes.spectrum.heading_step, max(of), wishes.g)
    alike = " and ".join(PLANES[a] for a in surface.planes)
    print(
        f"{len(surface)} panels{f' ({alike} alike)' if alike else ''}, {len(lid)} of a lid, {len(gap)} between hulls; "
        f"{_per_wave(omega[-1], size, wishes.g):.1f} panels per shortest wave, "
        f"{_per_wave(ABOVE * max(of), size, wishes.g):.1f} at {ABOVE} x the highest resonance"
    )
    slow, endless = (turned_matrix(added_mass_limit(tank, limit)) for limit in (0.0, np.inf))
    begun = time.perf_counter()
    loads_at(tank, floating, float(omega[-1]), heading)
    each = time.perf_counter() - begun
    flow = Flow(
        slow, endless, tried, *(turned_matrix(np.stack([getattr(own, name) for own in coarse]))
                                for name in ("added_mass", "damping")), dict(zip(VERTICAL, of, strict=True)),
    )  # fmt: skip
    seconds = each * len(omega) / wishes.jobs
    return Plan(craft, surface, mesh, tank, floating, of, omega, heading, size, flow, seconds)


def run(made: Plan, wishes: Wishes, code: str, command: str) -> HydroDatabase:
    """Compute the database of a plan."""
    tank, floating, omega, surface = made.tank, made.floating, made.omega, made.surface
    loads = solve_all(tank, floating, omega, made.heading, wishes.jobs, wishes.quiet)
    endless = Loads(turned_matrix(made.flow.endless), *(np.empty(0) for _ in range(4)))
    left_out = spikes(omega, np.stack([of_one.damping for of_one in loads]), wishes.spectrum.also)
    if len(left_out):
        print(
            f"left out {', '.join(f'{w:.4g}' for w in omega[left_out])} rad/s: damping there is more than "
            f"{SPIKE:g} times that at both neighbours (an irregular frequency, or too sharp a resonance)"
        )
        omega, loads = np.delete(omega, left_out), [of_one for n, of_one in enumerate(loads) if n not in left_out]
    uneven = max(_asymmetry(of_one.added_mass) for of_one in loads)
    settings: dict[str, object] = {
        "command": command, "method": wishes.method, "panels": len(surface),
        "alike": " and ".join(PLANES[a] for a in surface.planes),
        "lid_panels": len(tank.inner_lid), "gap_panels": len(tank.gap_lid),
        "gap_damping": tank.gap_damping if len(tank.gap_lid) else 0.0, "panel_size": float(f"{made.size:.3g}"),
        "mesh": made.mesh is not None, "resonances": [float(f"{w:.4g}") for w in made.resonances],
        "reciprocity": float(f"{uneven:.2g}"), "drift": "far field, free hull without viscous damping",
    }  # fmt: skip
    hull = hull_hash(made.craft.panels)
    return database(tank, floating, loads, endless, omega, made.heading, hull=hull, code=code, settings=settings)


def _surface(craft: FloatingHull, mesh: WettedSurface | None, wishes: Wishes) -> tuple[WettedSurface, float]:
    if mesh is None:
        if not wishes.divisions:
            return divided(craft.panels, wishes.panels)
        tiny = 0.01 * float(np.ptp(craft.panels.centre, axis=0).max())
        found = wetted(craft.panels, tiny, wishes.divisions)
        return found, float(np.median(found.edge))
    _check_same(craft, mesh, wishes)
    if wishes.panels and len(mesh) > (FINER * wishes.panels if craft.shape else MOST):
        own, size = divided(craft.panels, wishes.panels)
        print(f"the mesh has {len(mesh)} panels below water: computed on {len(own)} of the vehicle's table of offsets")
        return own, size
    mesh = of_number(mesh, wishes.panels) if wishes.panels else mesh
    return mesh, float(np.sqrt(np.linalg.norm(mesh.area, axis=1).mean()))


def _check_same(craft: FloatingHull, mesh: WettedSurface, wishes: Wishes) -> None:
    """Print how the simulator's panels differ from the mesh, and refuse more than OFF."""
    print(f"{'':24}{'offsets':>14}{'mesh':>14}{'off':>10}")
    length = np.ptp(mesh.whole[..., X])
    wrong = []
    for name, (ours, theirs) in compared(craft.panels, mesh, craft.mass, craft.cg_z_up, wishes.rho, wishes.g).items():
        off = (ours - theirs) / (length if name.startswith("LCB") else abs(theirs))
        print(f"{name:24}{ours:14.6g}{theirs:14.6g}{100 * off:9.2f} %{' of the length' * name.startswith('LCB')}")
        allowed = OFF[name.split(",")[0]]
        if not abs(off) <= allowed:
            wrong.append(f"{name}: {ours:.4g} of the panels, {theirs:.4g} of the mesh (allowed: {100 * allowed:g} %)")
    if not wrong:
        return
    if craft.shape is not None:
        raise ConfigError(
            f"{craft.name}: its table of offsets is not the mesh's hull: {'; '.join(wrong)}. Raise --points or "
            "--stations; a table holds one hull or two alike, so of any other write a vehicle file with its [hull] and "
            "give this mesh as --mesh"
        )
    turned = WettedSurface(mesh.whole * [-1.0, 1.0, 1.0])
    LCB = [side.centre_of_buoyancy[0] for side in (wetted(craft.panels, length), mesh, turned)]
    exchanged = abs(LCB[2] - LCB[0]) < abs(LCB[1] - LCB[0]) / 2
    hint = "are bow and stern exchanged (x points forward)? " if exchanged else ""
    raise ConfigError(
        f"the mesh is not of {craft.name}: {'; '.join(wrong)}; {hint}check --unit, --waterline and --midships"
    )


def _coarse(craft: FloatingHull, floating: Floating, wishes: Wishes) -> tuple[Array, list[Solution]]:
    """A coarse pass: frequencies (rad/s) from 0.25 of the lowest resonance to 1.5 of the highest without added mass,
    and solutions there.
    """
    surface, size = divided(craft.panels, COARSE)
    tank = Tank(surface, inner_lid(surface, size), np.empty((0, 4, 3)), wishes.rho, wishes.g, wishes.depth, 0.0)
    w = np.sqrt(np.diag(floating.C)[VERTICAL] / np.diag(floating.M)[VERTICAL])
    tried = np.geomspace(0.25 * w.min(), 1.5 * w.max(), 8)
    return tried, [solve(tank, w, np.empty(0)) for w in tried]


def _omega(of: Resonances, wanted: Spectrum, epsilon: float | None, size: float, g: float) -> Array:
    """Frequencies, rad/s: evenly spaced over the resonances, wider apart in the tail, as high as the panels allow.

    `epsilon` is the damping of water between two hulls, if there are two. Each of `wanted.also` replaces the nearest
    one within half a step.
    """
    top = np.sqrt(2 * np.pi * g / (PER_WAVE * size))
    low, high, end = BELOW * min(of), min(ABOVE * max(of), top), min(TAIL * max(of), top)
    count = wanted.count or COUNT
    if epsilon is not None:
        width = max(epsilon, 1e-3) * (low + high) / 2
        needed = int(PER_WIDTH * (high - low) / width / (1 - IN_TAIL))
        count = wanted.count or int(np.clip(needed, *COUNT_TWIN))
        if count < FEW * min(needed, COUNT_TWIN[1]):
            print(f"warning: {count} frequencies may miss resonances of the water between the hulls, some {width:.2g} "
                  f"rad/s wide; a memory may not fit: --frequencies {min(needed, COUNT_TWIN[1])}")  # fmt: skip
    if wanted.range:
        omega = np.linspace(*wanted.range, count)
    else:
        tail = round(IN_TAIL * count * min(1.0, np.log(end / high) / np.log(TAIL / ABOVE)))
        omega = _digits([*np.linspace(low, high, count - tail), *np.geomspace(high, end, tail + 1)[1:]])
    for name, w in zip(NAMES, of, strict=True):
        if not omega[0] < w < omega[-1]:
            line = f"the frequencies {omega[0]:.3g} to {omega[-1]:.3g} rad/s miss the {name} resonance of {w:.3g} rad/s"
            if wanted.range:
                raise ConfigError(f"--range: {line}")
            print(f"warning: {line}: finer panels (--panels) would reach it")
    if wanted.range and _per_wave(omega[-1], size, g) < PER_WAVE:
        print(f"warning: panels of {size:.3g} m are coarse for waves of {omega[-1]:.3g} rad/s: raise --panels")
    kept = list(omega)
    for w in wanted.also:
        near = int(np.abs(omega - w).argmin())
        step = np.diff(omega)[min(near, len(omega) - 2)]
        if omega[near] in kept and abs(omega[near] - w) <= step / 2:
            kept.remove(omega[near])
    return _digits(sorted({*kept, *wanted.also}))


def _digits(omega) -> Array:
    return np.array([float(f"{w:.6g}") for w in omega])


def _headings(surface: WettedSurface, step: float | None, omega: float, g: float) -> Array:
    """Headings towards port, deg; only those of one side if port and starboard are alike.

    The default `step` resolves the k L / 2 harmonics of the loads of waves of `omega` (rad/s).
    """
    if step is None:
        order = omega**2 / g * float(np.ptp(surface.whole[..., X])) / 2 + MORE_ORDERS
        step = next((step for step in HEADING_STEPS if 180 / step >= order), HEADING_STEPS[-1])
    if not 0 < step <= 90 or abs(180 / step - round(180 / step)) > 1e-9:
        raise ConfigError(f"--heading-step {step:g}: must divide 180 deg")
    if 1 in surface.planes:
        return -np.linspace(0, 180, round(180 / step) + 1)
    return -np.arange(0, 360, step)


def _per_wave(omega: float, size: float, g: float) -> float:
    return 2 * np.pi * g / omega**2 / size


def _asymmetry(A: Array) -> float:
    """Largest difference of A and its transpose over the geometric mean of the diagonal entries."""
    d = np.sqrt(np.abs(np.diag(A)))
    return float((np.abs(A - A.T) / np.maximum(np.outer(d, d), 1e-300))[np.ix_(*[d > 1e-6 * d.max()] * 2)].max())
