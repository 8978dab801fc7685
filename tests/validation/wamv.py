"""Checks of hull_6dof against closed forms for the WAM-V 16: buoyancy of round pontoons, a step of surge force.

Numbers come from wamv.toml of the reference directory, else from the shipped vehicle file.
"""

import numpy as np

from taichi_sim.bench import Bench
from taichi_sim.config.io import validate
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof, Hull6DofParams
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import TwinPontoons, mesh
from tests.validation.case import TOLERANCE, Case
from tests.validation.parameters import published, shipped
from tests.validation.tables import even_interval, number, read_csv

FILE = "wamv.toml"
POINTS = 4  # of buoyancy, two on each pontoon
GIRTH_PANELS = 60  # of a half circle
BUOYANCY_TOLERANCE = 0.01  # of each value: a polygon for a circle
FRESH_WATER = 997.7735  # kg/m^3, of the published world
RADIUS, LENGTH, PONTOON_Y = 0.213, 4.9, 1.03  # m, published
LARGEST_DT = 0.02  # s
ANY_RESTORING = {"G33": 3e4, "G44": 2e4, "G55": 5e4}  # N/m, N m: surge does not feel it
SHAFT = 100.0  # rad/s, of full thrust: any speed will do


def buoyancy(case: Case) -> None:
    """buoyancy_per_point*.csv: our pontoons lowered into the water, a quarter of their buoyancy (f64)."""
    table = read_csv(case.path)
    hydro = (published(case, FILE) or {}).get("hydro", {})
    rho = hydro.get("water_density", FRESH_WATER)
    r, L = hydro.get("hull_radius_m", RADIUS), hydro.get("hull_length_m", LENGTH)
    stations = ((-L / 2, 2 * r, 0.0), (L / 2, 2 * r, 0.0))
    shape = TwinPontoons(y=PONTOON_Y, freeboard=r, section="round", panels_girth=GIRTH_PANELS, stations=stations)
    immersion = table["immersion_m"]
    hull = Hydrostatics(mesh(shape), 1.0, (0.0, 0.0, 0.0), rho)
    ours = -hull.buoyancy(np.minimum(immersion, r)[:, None] * [1.0, 0.0, 0.0])[:, 2] / POINTS
    name = next((c for c in table.header if c.startswith("force_per_point_N")), "force_per_point_N")
    scale = np.where(table[name] == 0, 1.0, table[name])
    case.absolute(f"{name}, relative", ours / scale, table[name] / scale, BUOYANCY_TOLERANCE)


def surge_step(case: Case, force: float, mass: float) -> None:
    """surge_step_<force>N_m<mass>*.csv: the hull under a thrust that begins at once, free in surge alone."""
    table = read_csv(case.path)
    interval = even_interval(table["t"])
    steps = int(np.ceil(interval / LARGEST_DT - 1e-6))
    bench = Bench(Hull6Dof(_surge_hull(case, force, mass), interval / steps, steps))
    bench.put(velocity_b=(table["u"][0], 0.0, 0.0))
    ours = [bench.read().nu[0, 0]]
    for _ in range(len(table) - 1):
        bench.step([1.0, 1.0])
        ours.append(bench.read().nu[0, 0])
    case.absolute("u, m/s", np.array(ours), table["u"], TOLERANCE[case.precision], table.resolution("u"))


def _surge_hull(case: Case, force: float, mass: float) -> Hull6DofParams:
    """The WAM-V with everything that would couple surge to other motions taken to the origin, and no lag."""
    numbers = shipped(FILE)
    hydro = (published(case, FILE) or {}).get("hydro")
    if hydro:
        numbers["hydrodynamics"] |= {
            "linear": [number(hydro, key) for key in ("xU", "yV", "zW", "kP", "mQ", "nR")],
            "quadratic": [number(hydro, "xUU"), number(hydro, "yVV"), 0.0, 0.0, 0.0, number(hydro, "nRR")],
        }
    k = force / 2 / SHAFT**2
    _, y, _ = numbers["thrusters"]["right"]
    numbers["thrusters"] = {"left": [0.0, -y, 0.0], "right": [0.0, y, 0.0], "k_positive": k, "k_negative": k,
                            "n_max": SHAFT, "n_min": -SHAFT, "lag": 0.0}  # fmt: skip
    numbers["rigid_body"] |= {"mass": mass, "cg": [0.0, 0.0, 0.0]}
    numbers |= {"restoring": "linear", "linear": ANY_RESTORING, "actions": "left_right", "windage": {}}
    return validate(Hull6DofParams, numbers, FILE)
