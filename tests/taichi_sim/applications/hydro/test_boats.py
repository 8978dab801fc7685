"""Boats made from meshes: the hulls whose truth is known, thrust that falls with speed, lift beside Coriolis loads."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from taichi_sim.applications.hydro.hull_input import read_mesh
from taichi_sim.applications.hydro.resistance import HullForm, Race
from taichi_sim.applications.hydro.vehicle_file import lift
from tests.validation import boats

RHO = 1025.0  # kg/m^3


def test_the_hull_of_cybership_2_has_its_published_particulars(tmp_path):
    boats.write_stl(boats.supply_vessel(), tmp_path / "hull.stl")
    hull = read_mesh(tmp_path / "hull.stl", "m", 0.0, None, None)
    length, beam, draught = np.ptp(hull.whole.reshape(-1, 3), axis=0)
    assert (length, beam) == pytest.approx((boats.LENGTH, boats.BEAM), rel=2e-3)
    assert boats.FRESH * hull.volume == pytest.approx(boats.MASS, rel=0.01)
    assert hull.volume / (length * beam * draught) == pytest.approx(boats.BLOCK, rel=0.01)
    assert hull.waterplane["A"] / (length * beam) == pytest.approx(boats.WATERPLANE, rel=0.01)
    assert hull.centre_of_buoyancy[0] == pytest.approx(boats.X_G, abs=2e-3 * boats.LENGTH)


@pytest.mark.parametrize("u", [0.0, 0.7, 3.0, 12.0])
def test_a_propeller_keeps_its_power(u):
    """Power of an actuator disc: T times the mean of the speeds far ahead and far behind, (u + u_behind) / 2."""
    thrust, diameter = 120.0, 0.2
    disc = RHO * np.pi / 4 * diameter**2
    left = thrust - Race(thrust, np.sqrt(2 * thrust / disc)).lost(u)
    behind = np.sqrt(u * u + 2 * left / disc)
    assert left * (u + behind) / 2 == pytest.approx(thrust * np.sqrt(2 * thrust / disc) / 2, rel=1e-9)


def test_lift_and_coriolis_loads_make_the_whole_whatever_the_added_mass():
    """With u: Y = -A11 u r and N = -(A22 - A11) u v - A26 u r are Coriolis and Munk loads of added mass."""
    form = cast(HullForm, SimpleNamespace(length=7.0, beam=1.2, draught=0.4, volume=2.6, hulls=1, stern_draught=0.4))
    rng = np.random.default_rng(2)
    wholes = []
    for _ in range(2):
        A = np.diag(rng.uniform(0.9, 1.1, 6) * [200.0, 2500.0, 1.0, 1.0, 1.0, 6000.0])
        A[1, 5] = A[5, 1] = rng.uniform(-300.0, 300.0)
        own = lift(form, A, RHO)
        wholes.append((own["Y_uv"], own["Y_ur"] - A[0, 0], own["N_uv"] - (A[1, 1] - A[0, 0]), own["N_ur"] - A[1, 5]))
    assert wholes[0] == pytest.approx(wholes[1], rel=1e-9)


@pytest.mark.slow
def test_a_log_of_ten_minutes_closes_what_a_mesh_left_open_in_the_plane(f64, tmp_path):
    boat = boats.BOATS[0]
    true = boats.sailed(boat.truth, {}, boat.ahead, boat.helm, boats.HELM, rolls=False)
    after, _ = boats.ten_minutes(tmp_path)
    assert after.speed == pytest.approx(true.speed, rel=0.05)
    assert after.diameter == pytest.approx(true.diameter, rel=0.1)
    assert after.overshoot == pytest.approx(true.overshoot, rel=boats.AIM)
