"""Vehicle files whose units or signs are wrong are refused by the key; a published M_rb follows mass and CG."""

import numpy as np
import pytest

from taichi_sim.config import ConfigError
from taichi_sim.kernels.rigid_body import changed_mass
from taichi_sim.models.catalogue import load_vehicle

DT = 0.001  # s


@pytest.mark.parametrize(
    ("vehicle", "changes", "named"),
    [
        ("otter", {"length": 200.0}, "length = 200 m"),
        ("otter", {"beam": 3.0}, "beam = 3 m"),
        ("otter", {"collision_radius": 0.01}, "collision_radius"),
        ("otter", {"thrusters": {"n_max": 992.0}}, "thrusters.n_max = 992 rad/s: .*is it in rpm"),
        ("otter", {"hydrodynamics": {"cross_flow_density": 1.026}}, "cross_flow_density"),  # t/m^3
        ("otter", {"thrusters": {"lag": 100.0}}, "thrusters.lag"),  # ms
        ("x500", {"rotor": {"omega_max": 9549.0}}, "rotor.omega_max = 9549 rad/s: .*is it in rpm"),
        ("otter_3dof", {"X_u": 77.55}, "X_u = .*of the other sign"),
        ("otter_3dof", {"Y_v": 162.5}, "Y_v = .*less than or equal to 0"),
        ("otter_3dof", {"N_rr": 487.0}, "N_r, N_rr"),
        ("otter_3dof", {"X_udot": 5.5}, "X_udot"),
        ("kvlcc2", {"displacement": 3270.0}, "displacement = 3270 m\\^3: .*is it in litres"),
        ("kvlcc2", {"draft": 460.0}, "draft = 460 m: .*is it in mm"),
        ("kvlcc2", {"x_G": 25.0}, "x_G = 25 m: plausible are .* to 2.1 m"),
        ("kvlcc2", {"gyration": 0.25}, "gyration"),  # over the length
        ("kvlcc2", {"rudder": {"angle_max_deg": 0.61}}, "angle_max_deg"),  # rad
        ("kvlcc2", {"rudder": {"rate_deg": 0.276}}, "rate_deg"),  # rad/s
        ("kvlcc2", {"rudder": {"x": -3.5}}, "rudder.x"),  # m
        ("kvlcc2", {"rudder": {"x": 0.5}}, "rudder.x"),
        ("kvlcc2", {"propeller": {"n_ahead": 616.0}}, "n_ahead"),  # rpm
        ("kvlcc2", {"hull": {"N_r": 0.05}}, "hull.N_r"),
        ("kvlcc2", {"hull": {"R_0": 22.0}}, "hull.R_0"),  # times 1000
        ("kvlcc2", {"density": 1.0}, "density"),  # t/m^3
    ],
)
def test_a_wrong_unit_or_sign_is_named(vehicle, changes, named):
    with pytest.raises(ConfigError, match=named):
        load_vehicle(vehicle, DT, **changes)


def test_a_published_inertia_follows_mass_and_cg():
    shipped, changed = (load_vehicle("otter", DT, **given).params.rigid_body for given in (
        {}, {"rigid_body": {"mass": 60.0, "cg": [0.1, 0.0, -0.2]}}))  # fmt: skip
    expected = changed_mass(shipped.M_rb, shipped.mass, shipped.cg, 60.0, (0.1, 0.0, -0.2))
    np.testing.assert_allclose(changed.M_rb, expected)
    assert changed.M_rb[0][0] == 60.0
    np.testing.assert_allclose(changed.M_rb[0][4], 60.0 * -0.2)


@pytest.mark.parametrize(("entry", "value", "named"), [((0, 0), 90.0, r"M_rb\[0\]\[0\]"), ((3, 3), 2.155, "definite")])
def test_an_inertia_that_is_not_of_its_mass_is_refused(entry, value, named):
    M_rb = np.array(load_vehicle("otter", DT).params.rigid_body.M_rb)
    M_rb[entry] = value
    with pytest.raises(ConfigError, match=named):
        load_vehicle("otter", DT, rigid_body={"M_rb": M_rb.tolist()})
