"""Motions of ships in `tools/validate.py`: damping that was added to the published ones."""

import numpy as np
import pytest

from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from tests.validation.regular import motions
from tests.validation.remembering import NO_DAMPING, damped, external_damping
from tests.validation.ships import motions_of
from tests.validation.tables import Table, TableError

pytestmark = pytest.mark.usefixtures("f64")
ROLL = 3
DECAY = 11.0  # s, time constant of the barge's roll at 5 % of critical damping
ADRIFT = {"thrusters": None, "windage": {"frontal_area": 0.0, "lateral_area": 0.0}}
ADDED = np.diag([0.0, 0.0, 0.0, 2.0e3, 0.0, 0.0])  # N m s, of roll


def barge() -> Hull6Dof:
    model = load_vehicle("barge")
    assert isinstance(model, Hull6Dof)
    return model


def test_roll_at_resonance_is_the_load_over_all_damping():
    """Closed form of one mode: where the stiffness is w^2 (M + A), |roll| = |X| / (w (B + B_ext))."""
    found = barge().radiation.database
    assert found is not None
    n = len(found.omega) // 2
    w, roll = found.omega[n], np.arange(6) == ROLL
    M = 5000.0 * np.eye(6)
    A = found.added_mass[n, ROLL, ROLL]
    only = roll[:, None] & roll
    found = type(found)(**vars(found) | {
        "added_mass": found.added_mass * only, "damping": found.damping * only, "excitation": found.excitation * roll,
    })  # fmt: skip
    C = np.diag(np.where(roll, w**2 * (M[0, 0] + A), 1e9))
    beam = Table(("omega", "heading_deg"), ((repr(float(w)), "90"),))
    for added in (None, 0 * ADDED, ADDED):
        meta = {"M": M.tolist(), "C": C.tolist()} | ({} if added is None else {"B_external_linear": added.tolist()})
        B = found.damping[n, ROLL, ROLL] + (0.0 if added is None else added[ROLL, ROLL])
        column = np.abs(found.heading_deg - 90).argmin()
        expected = np.abs(found.excitation[n, column, ROLL]) / (w * B)
        assert np.abs(motions_of(found, meta, beam)[0, ROLL]) == pytest.approx(expected, rel=1e-9)


def test_the_simulator_s_hull_has_the_added_damping_beside_radiation():
    """All of it in roll, where a file's damping counts as far as it exceeds radiation; other modes keep theirs."""
    plain = barge()
    assert damped(plain, 0 * ADDED) is plain
    before, after = (model.constants for model in (plain, damped(plain, ADDED)))
    linear = [[getattr(own, f"linear_{i}") for i in range(6)] for own in (before, after)]
    assert np.subtract(linear[1], linear[0])[ROLL] == pytest.approx(ADDED[ROLL, ROLL], abs=1e-6)
    assert linear[1][:ROLL] == linear[0][:ROLL] and linear[1][ROLL + 1 :] == linear[0][ROLL + 1 :]


@pytest.mark.slow
@pytest.mark.parametrize(("relative_to", "least", "most"), [("current", 0.0, 0.03), ("water", 0.06, 0.3)])
def test_added_roll_damping_takes_the_hull_s_own_motion_if_the_file_says_so(relative_to, least, most):
    """Roll of the barge in beam waves of its resonance, run in time with a twentieth of critical damping added.

    Its database makes (-w^2 (M + A) - i w (B + B_ext) + C) eta = X of it, where the damping takes the hull's velocity.
    Water that rolls with the waves' slope drives the hull by B_ext times its own rate.
    """
    plain = barge()
    found = plain.radiation.database
    assert found is not None
    C, M = found.stiffness, plain.params.M_rb + found.added_mass
    n = int(np.abs(C[ROLL, ROLL] - found.omega**2 * M[:, ROLL, ROLL]).argmin())
    w, M, beam = found.omega[n], M[n], int(np.flatnonzero(found.heading_deg == 90.0)[0])
    added = np.zeros((6, 6))
    added[ROLL, ROLL] = 2 * 0.05 * w * M[ROLL, ROLL]
    theirs = np.linalg.solve(-(w**2) * M - 1j * w * (found.damping[n] + added) + C, found.excitation[n, beam])[ROLL]
    free = load_vehicle("barge", 0.02, 8, hydrodynamics=NO_DAMPING | {"radiation": "memory"}, **ADRIFT)
    own = {"damping_relative_to": relative_to, "linear": damped(free, added).params.hydrodynamics.linear}
    hull = load_vehicle("barge", 0.02, 8, hydrodynamics=NO_DAMPING | {"radiation": "memory"} | own, **ADRIFT)
    ours = motions(hull, np.array([w]), np.array([np.pi / 2]), DECAY)[0, ROLL]
    assert least < abs(ours - theirs) / abs(theirs) < most


def test_damping_of_the_hull_s_own_motion_needs_memory():
    with pytest.raises(ConfigError, match='damping_relative_to = "current" needs radiation = "memory"'):
        load_vehicle("barge", hydrodynamics={"radiation": "constant", "damping_relative_to": "current"})


def test_damping_that_couples_modes_is_refused():
    with pytest.raises(TableError, match="B_external_linear.*couples"):
        damped(barge(), ADDED + ADDED[ROLL, ROLL] * (np.eye(6, k=1)))
    with pytest.raises(TableError, match="B_external_linear.*6 x 6"):
        external_damping({"B_external_linear": [1.0]})
