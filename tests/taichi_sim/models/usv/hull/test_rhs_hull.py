"""The right-hand side of hulls: what short steps tend to, in current, wind and under loads from outside."""

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state
from taichi_sim.models.usv.hull.motion import CONTROLS

pytestmark = pytest.mark.usefixtures("f64")
DT, ENVS = 1e-8, 12  # s


@pytest.mark.parametrize(("restoring", "lag"), [("panels", 0.1), pytest.param("linear", 0.0, marks=pytest.mark.slow)])
def test_short_steps_tend_to_the_right_hand_side(restoring, lag, make_model, bench):
    """From random attitudes afloat, velocities and shaft speeds, which without a lag are there at once; an error of the
    order of dt, and rounding over dt.
    """
    model = make_model("otter", DT, 1, restoring=restoring, actions="left_right", thrusters={"lag": lag})
    rng, t = np.random.default_rng(6), model.params.thrusters
    share = rng.uniform(0.1, 1.0, (ENVS, 2))
    shaft, load = share * t.n_max, rng.uniform(-20, 20, (ENVS, 6))
    current, wind = rng.uniform(-1, 1, (ENVS, 2)), rng.uniform(-8, 8, (ENVS, 3))
    eta = rng.uniform(-1, 1, (ENVS, 6)) * [10.0, 10.0, 0.1, 0.3, 0.2, 3.0]
    state = pack_state(eta, rng.uniform(-1, 1, (ENVS, 6)))
    team = bench(model, envs=ENVS)
    team.current[:], team.wind[:], team.fleet.load[:, 0] = (torch.from_numpy(x) for x in (current, wind, load))
    team.state[:, 0] = torch.from_numpy(state)
    if lag:
        team.aux[:, 0, CONTROLS : CONTROLS + 2] = torch.from_numpy(shaft)
    rate = (team.step(share[:, None]).state[:, 0].numpy() - state) / DT
    expected = model.rhs(state, shaft, current, wind, load)
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(rate - expected) <= 2e-6 * scale + 2e-6).all()
    assert scale.min() > 0.1


def test_a_hull_at_rest_afloat_accelerates_by_what_is_added(make_model):
    """Nothing at equilibrium; a load's share of M^-1 beside it; and a shaft's thrust along the hull."""
    model = make_model("otter")
    z, roll, pitch = model.geometry.hydrostatics.equilibrium
    rest = pack_state([0.0, 0.0, z, roll, pitch, 0.8])
    M = model.params.M_rb + model.radiation.inertia
    none = model.rhs(rest, [0.0, 0.0])[0]
    assert np.abs(none).max() < 2e-3  # the kernel's two strips a panel, hydrostatics.py's eight
    load = np.array([3.0, -2.0, 5.0, 1.0, -4.0, 2.0])
    assert M @ (model.rhs(rest, [0.0, 0.0], load=load)[0] - none)[7:] == pytest.approx(load, abs=1e-9)
    thrust = M @ (model.rhs(rest, [60.0, 0.0])[0] - none)[7:]
    left, k = model.params.thrusters.left, model.params.thrusters.k_positive
    assert thrust == pytest.approx([k * 3600.0, 0, 0, 0, left[2] * k * 3600.0, -left[1] * k * 3600.0], abs=1e-9)


def test_coupled_added_mass_and_lift_load_the_hull(constant_model):
    """Kirchhoff's load of the whole added mass, and the lift, beside the same hull with neither."""
    coupling = {"surge_pitch": -0.9, "sway_roll": 3.0, "sway_yaw": 6.0, "heave_pitch": -2.0, "roll_yaw": 1.0}
    lift = {"Y_uv": -90.0, "Y_ur": 40.0, "N_uv": -25.0, "N_ur": -70.0}
    plain = constant_model("otter", hydrodynamics={"radiation": "constant"})
    whole = constant_model("otter", hydrodynamics={"added_coupling": coupling, "lift": lift})
    rng = np.random.default_rng(2)
    for sign in (1.0, -1.0):
        nu = rng.uniform(-1, 1, 6) + [2.0 * sign, 0, 0, 0, 0, 0]
        z, roll, pitch = whole.geometry.hydrostatics.equilibrium
        state = pack_state([0.0, 0.0, z, roll, pitch, 0.0], nu)

        def load(model, state=state):
            return (model.params.M_rb + model.params.M_a) @ model.rhs(state, [0.0, 0.0])[0][7:]

        def kirchhoff(model, nu=nu):
            v, omega = nu[:3], nu[3:]
            p, h = np.split(model.params.M_a @ nu, 2)
            return np.concatenate([np.cross(omega, p), np.cross(omega, h) + np.cross(v, p)])

        u, v, r = nu[0], nu[1], nu[5]
        Y, N = -90.0 * abs(u) * v + 40.0 * u * r, -25.0 * u * v - 70.0 * abs(u) * r
        expected = kirchhoff(plain) - kirchhoff(whole) + [0, Y, 0, 0, 0, N]
        assert load(whole) - load(plain) == pytest.approx(expected, abs=1e-9)
        assert Y * v + N * r <= 0  # it takes energy
