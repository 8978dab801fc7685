"""Checks of our hydrostatics and of the pressure under waves: closed forms of a box, Gerstner's exact pressure."""

import numpy as np

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.kernels.rigid_body import rigid_body_mass
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import mesh
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components
from tests.validation.box import Box, box_of
from tests.validation.case import TOLERANCE, Case
from tests.validation.tables import number, read_csv, read_json

PANELS = (4, 2, 2)
GZ_TOLERANCE = 0.01  # of each value
PARTICLE_PHASES = 16  # at which a particle's pressure is asked for


def _hull(box: Box, rho: float = RHO_SEA, g: float = GRAVITY) -> Hydrostatics:
    return Hydrostatics(mesh(box.shape(*PANELS)), box.mass, box.cg, rho, g)


def closed_forms(case: Case, length: float, beam: float, draft: float) -> None:
    """box_<length>x<beam>x<draft>.json: volume, centres, metacentric heights, stiffness, periods without added mass."""
    data = read_json(case.path)
    box = Box(length, beam, draft, number(data, "KG"), number(data, "mass"))
    hull = _hull(box, number(data, "rho"), number(data, "g"))
    G = hull.stiffness()
    GM_T, GM_L = hull.metacentric_heights
    KB = draft - hull.centre_of_buoyancy[2]
    ours = {"mass": hull.rho * hull.volume, "KB": KB, "GM_T": GM_T, "GM_L": GM_L, "C33": G[0, 0], "C44": G[1, 1],
            "C55": G[2, 2], "BM_T": GM_T + box.KG - KB, "BM_L": GM_L + box.KG - KB}  # fmt: skip
    if "kxx" in data and "kyy" in data:
        k = np.array([number(data, "kxx"), number(data, "kyy"), 1.0])
        M = np.diag(rigid_body_mass(box.mass, (0.0, 0.0, 0.0), box.mass * np.diag(k**2)))
        ours |= {"Ixx_cg": M[3], "Iyy_cg": M[4]}
        for name, inertia, stiffness in zip(("heave", "roll", "pitch"), M[2:5], np.diag(G), strict=True):
            ours[f"T_{name}_no_added_mass"] = 2 * np.pi * np.sqrt(inertia / stiffness)
    for name, value in ours.items():
        if name in data:
            case.elementwise(name, value, number(data, name))


def righting_arm(case: Case) -> None:
    """gz_wall_sided*.csv: righting arm and moment while no edge of the box enters or leaves the water."""
    table = read_csv(case.path)
    hull = _hull(box_of(case))
    emersion = next((c for c in table.header if c.startswith("side_emersion_m")), None)
    if emersion:
        table = table.where(table[emersion] < hull.panels.draft)
    GZ = hull.righting_arm(np.deg2rad(table["heel_deg"]))
    for name, ours in (("GZ_m", GZ), ("righting_moment_Nm", GZ * hull.weight)):
        scale = np.where(table[name] == 0, 1.0, np.abs(table[name]))
        case.absolute(f"{name}, relative", ours / scale, table[name] / scale, GZ_TOLERANCE)


def gerstner_pressure(case: Case, wavelength: float, amplitude: float) -> None:
    """gerstner_exact_pressure_lambda*_a*.csv: our stretched linear pressure along the orbits of particles.

    It differs from the exact one by second order: the error is counted in rho g k a^2 (1 - exp 2kb) / 2, the exact
    solution's own second-order term at the particle's rest b, and must be below 1.
    """
    table = read_csv(case.path)
    b, k = table["label_depth_b"], 2 * np.pi / wavelength
    omega = np.sqrt(GRAVITY * k)
    one = np.ones((1, 1))
    sea = Sea(Components(amplitude * one, k * one, omega * one, 0 * one, 0 * one))
    t = 2 * np.pi / omega * np.arange(PARTICLE_PHASES) / PARTICLE_PHASES
    radius = amplitude * np.exp(k * b)[:, None]
    ours = sea.pressure(radius * np.sin(omega * t), 0.0, -b[:, None] - radius * np.cos(omega * t), t)
    exact = table[next(c for c in table.header if c.startswith("gauge_pressure_Pa"))][:, None]
    second = RHO_SEA * GRAVITY * k * amplitude**2 * (1 - np.exp(2 * k * b))[:, None] / 2
    rounding = TOLERANCE[case.precision] * (RHO_SEA * GRAVITY * amplitude + np.abs(exact))
    error = (ours.double().cpu().numpy() - exact) / (second + rounding)
    case.absolute("pressure of particles, over its second-order term", error, 0 * error, 1.0)
