"""Viscous roll damping against another program, a model test, and the vehicle file that it goes into."""

import numpy as np
import pytest

from taichi_sim.applications.hydro import hull_input
from taichi_sim.applications.hydro.resistance import HullForm
from taichi_sim.applications.hydro.roll_damping import Rolling
from taichi_sim.applications.hydro.vehicle_file import Flow, Given, vehicle_text
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from tests.validation import boats

RHO, G = 1025.0, 9.81

PROGRAM = [  # friction and eddies over rho V B^2 sqrt(2 g / B), by rolldecay-estimators (M. Alexandersson, MIT)
    # L, B, T, C_B, C_M, OG, amplitude (deg), omega sqrt(B / 2 g)
    ((300.0, 50.0, 12.5, 0.65, 0.98, -2.5, 10.0, 0.6), 1.48798e-05, 0.00099503),
    ((15.04, 2.195, 0.7872, 0.832, 0.9281, -0.6143, 16.9, 0.5864), 0.000340445, 0.00101638),
    ((2.034, 0.3904, 0.1343, 0.5918, 0.9675, -0.1374, 10.73, 0.9865), 0.00163073, 0.0129327),
    ((162.9, 26.38, 7.363, 0.5969, 0.9145, 1.096, 11.29, 0.3811), 1.2885e-05, 0.000239209),
]


@pytest.mark.parametrize(("hull", "friction", "eddies"), PROGRAM)
def test_damping_is_that_of_another_program(hull, friction, eddies):
    """With nu = 1.14e-6 m^2/s, as there; eddies as the linear damping with the same energy over a period."""
    *form, amplitude, frequency = hull
    one, (L, B, T, C_B) = Rolling(*form), form[:4]
    omega, unit = frequency * np.sqrt(2 * G / B), L * B * T * C_B * B**2 * np.sqrt(2 * G / B)
    assert one.friction(1.0, omega, 1.14e-6) / unit == pytest.approx(friction, rel=1e-3)
    equivalent = 8 / (3 * np.pi) * omega * np.radians(amplitude) * one.eddies(1.0)
    assert equivalent / unit == pytest.approx(eddies, rel=1e-4)


@pytest.mark.parametrize(("amplitude", "measured"), [(8.0, 0.713e-2), (6.0, 0.520e-2), (4.0, 0.464e-2)])
def test_kvlcc2_loses_its_roll_as_in_the_basin(amplitude, measured):
    """Share of critical damping of the model of 1:68 at rest, with radiation: means of SSPA's decays 21337 and 21338
    (Alexandersson and Kjellberg 2021, KVLCC2 roll decay, Mendeley Data, CC BY 4.0), by logarithmic decrement.
    """
    s, volume = 68.0, 312653.0
    one = Rolling(320 / s, 58 / s, 20.8 / s, volume / (320 * 58 * 20.8), 0.9954, (20.8 - 18.6) / s)
    omega, stiffness = 2 * np.pi / 2.547, 1000.0 * G * volume / s**3 * 5.73 / s  # GM 5.73 m of the ship
    B = one.friction(1000.0, omega, 1.0e-6) + 8 / (3 * np.pi) * omega * np.radians(amplitude) * one.eddies(1000.0)
    assert not one.outside
    assert B * omega / (2 * stiffness) == pytest.approx(measured, rel=0.3)


@pytest.mark.parametrize("z", [0.0, 0.05])
def test_a_file_has_eddies_where_the_method_holds_and_says_where_it_does_not(tmp_path, z):
    """A vessel of 1.3 m; with a centre of gravity half its draught below the water the method does not hold."""
    boats.write_stl(boats.supply_vessel(), tmp_path / "hull.stl")
    surface = hull_input.read_mesh(tmp_path / "hull.stl", "m", 0.0, None, None)
    craft = hull_input.of_mesh(surface, "hull", boats.MASS, (boats.X_G, 0.0, z), None, (24, 6, 0.05))
    A, omega = np.diag([1.0, 16, 30, 0.1, 2, 1.5]), np.linspace(1.0, 12.0, 12)
    flow = Flow(A, A, omega, np.repeat(A[None], 12, 0), np.zeros((12, 6, 6)), {2: 6.0, 3: 5.0, 4: 6.0})
    C = np.diag([0, 0, 3000.0, 10.0, 300, 0])
    text, _ = vehicle_text(craft, HullForm(surface, 1), flow, C, Given(), RHO, G, "constant", "hydrodynamics hull.stl")
    (tmp_path / "hull.toml").write_text(text)
    model = load_vehicle(tmp_path / "hull.toml", 0.02, 5)
    assert isinstance(model, Hull6Dof)
    drag, within = model.params.hydrodynamics, z == 0.0
    assert (drag.quadratic[3] > 0) == within == ("bilge keels and speed add" in text) == ("OG / T = " not in text)
    assert (drag.linear[3] < 0.01 * 2 * np.sqrt(10.0 * (craft.M[3, 3] + 0.1))) == within
