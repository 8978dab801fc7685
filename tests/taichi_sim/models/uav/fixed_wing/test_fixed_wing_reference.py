"""The shipped Aerosonde against an independent code's tables, in both precisions."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF

ORDER = [0, 1, 2, 7, 8, 9, 3, 4, 5, 6, 10, 11, 12]  # ours in their order: position, velocity, quaternion, rates
STATE = ("n", "e", "d", "u", "v", "w", "e0", "e1", "e2", "e3", "p", "q", "r")
IDEAL = {"time_constant": 0.0, "rate_limit_deg": math.inf, "throttle_time_constant": 0.0}
AS_PUBLISHED = {"C_D_p": 0.0, "C_D_delta_e": 0.0135}


def aircraft(**sections):
    """The shipped Aerosonde, with some numbers of some sections changed."""
    data = read_toml(config_folder() / "vehicles" / "aerosonde.toml")
    assert data.pop("model") == "fixed_wing_6dof"
    data.pop("autopilot")  # flown by its surfaces
    for name, numbers in sections.items():
        data[name] |= numbers
    return validate(FixedWing6DOF.Params, data, "aerosonde.toml")


@pytest.mark.parametrize(("name", "drag"), [("rhs_samples_A", AS_PUBLISHED), ("rhs_samples_B_wind", {})])
def test_derivatives_at_random_states(name, drag, precision, columns):
    table = columns(f"aerosonde/{name}.csv")
    state = np.empty((len(table.n), 13))
    state[:, ORDER] = np.stack([getattr(table, c) for c in STATE], axis=1)
    controls = np.stack([table.elev, table.ail, table.rud, table.thr], axis=1)
    wind = np.stack([table.wn, table.we, table.wd], axis=1)
    model = FixedWing6DOF(aircraft(longitudinal=drag), 0.02, 1)
    ours = model.rhs(state, controls, wind=wind)[:, ORDER]
    theirs = np.stack([getattr(table, f"d_{c}") for c in STATE], axis=1)
    tolerance = {"f64": 1e-9, "f32": 2e-5}[precision]
    assert np.abs((ours - theirs) / np.abs(theirs).max(axis=0)).max() < tolerance


@pytest.fixture(scope="module")
def flown(precision, columns, bench):
    """A table, and the flight from its first row with its controls, at its rows."""

    def fly(name):
        table = columns(f"aerosonde/{name}.csv")
        stride = round((table.t[1] - table.t[0]) / 0.02)
        team = bench(FixedWing6DOF(aircraft(actuators=IDEAL), 0.02, stride))
        start = [[getattr(table, c)[0] for c in names] for names in (("north", "east", "down"),
                 ("phi", "theta", "psi"), ("u", "v", "w"))]  # fmt: skip
        team.put(*start)
        controls = np.stack([table.elevator, table.aileron, table.rudder, table.throttle], axis=1)
        actions = team.model.action(torch.tensor(controls))
        rows = [(team.position.copy(), team.euler, team.velocity)]
        for action in actions[:-1]:
            team.step(action)
            rows.append((team.position.copy(), team.euler, team.velocity))
        return table, *(np.array(x) for x in zip(*rows, strict=True))

    return fly


@pytest.mark.parametrize("name", ["elevator_doublet_B", "aileron_doublet_B", "phugoid_release_Va27_B"])
def test_twenty_seconds_at_a_step_of_a_fiftieth(name, flown, precision):
    metres, degrees = (1e-3, 0.01) if precision == "f64" else (0.1, 0.2)
    table, position, euler, velocity = flown(name)
    assert table.t[-1] >= 20.0
    assert np.abs(position - np.stack([table.north, table.east, table.down], axis=1)).max() < metres
    assert np.rad2deg(np.abs(euler - np.stack([table.phi, table.theta, table.psi], axis=1)).max()) < degrees
    speed = np.sqrt(table.u**2 + table.v**2 + table.w**2)
    assert np.abs(np.linalg.norm(velocity, axis=1) - speed).max() < metres
