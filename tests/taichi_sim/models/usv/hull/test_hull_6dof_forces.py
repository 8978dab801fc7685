"""Propellers, wind and payload of `hull_6dof`."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.kernels.conventions import RHO_SEA

pytestmark = pytest.mark.usefixtures("f64")

PAYLOAD = 200.0  # kg, added to the barge's 4100


@pytest.fixture(scope="module")
def laden(constant_model):
    """The barge with its payload."""
    return constant_model("barge", rigid_body={"mass": 4100.0 + PAYLOAD})


@pytest.fixture(scope="module")
def otter(make_model):
    return make_model("otter", actions="left_right")


def column(team, name):
    """A column of the auxiliary state [env]."""
    return team.aux[:, 0, team.model.aux_names.index(name)].numpy()


def test_shaft_speed_answers_a_step_exponentially(otter, bench):
    """n(t) = n_c (1 - exp(-t / T)) whatever the step, and down again."""
    team, t = bench(otter), otter.params.thrusters
    for step in range(1, 26):
        team.step([1.0, -0.5])
        share = -math.expm1(-step * otter.dt / t.lag)
        assert column(team, "shaft_left")[0] == pytest.approx(t.n_max * share, rel=1e-12)
        assert column(team, "shaft_right")[0] == pytest.approx(0.5 * t.n_min * share, rel=1e-12)
    top = column(team, "shaft_left")[0]
    team.step([0.0, 0.0], 5)
    assert column(team, "shaft_left")[0] == pytest.approx(top * math.exp(-5 * otter.dt / t.lag), rel=1e-12)


def test_left_and_right_commands(otter, bench):
    """Thrust k |n| n of each propeller, held at its limits; the left one turns the hull to starboard."""
    team, t = bench(otter, envs=5), otter.params.thrusters
    actions = [[1.0, 1.0], [-1.0, -1.0], [0.5, 0.0], [0.0, 0.5], [1.5, -2.0]]
    team.step(torch.tensor(actions)[:, None], 100)
    ahead, astern = t.k_positive * t.n_max**2, -t.k_negative * t.n_min**2
    assert column(team, "thrust_left") == pytest.approx([ahead, astern, ahead / 4, 0.0, ahead], rel=1e-6, abs=1e-6)
    assert column(team, "thrust_right") == pytest.approx([ahead, astern, 0.0, ahead / 4, astern], rel=1e-6, abs=1e-6)
    u, r = team.state[:, 0, 7], team.state[:, 0, 12]
    assert u[0] > 1.0 and u[1] < -0.5
    assert r[2] > 0.05 and float(r[3]) == pytest.approx(-float(r[2]), rel=1e-6)


def test_surge_and_yaw_commands(laden, bench):
    """Surge from nothing at -1 to full thrust at 1; yaw by the difference, also without surge."""
    team, t = bench(laden, envs=6), laden.params.thrusters
    actions = [[-1.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 0.5], [-1.0, 1.0], [-1.0, -1.0]]
    team.step(torch.tensor(actions)[:, None], 250)
    left, right = column(team, "thrust_left"), column(team, "thrust_right")
    full = t.k_positive * t.n_max**2  # astern the same
    assert left == pytest.approx(np.array([0, 1, 0.5, 1, 1, -1]) * full, abs=1e-6 * full)
    assert right == pytest.approx(np.array([0, 1, 0.5, 0, -1, 1]) * full, abs=1e-6 * full)
    speed = team.state[:, 0, [7, 8, 12]]
    assert speed[0].abs().max() < 1e-9
    assert speed[3, 2] > 0.01 and speed[4, 2] > 0.02 and float(speed[5, 2]) == pytest.approx(-float(speed[4, 2]))


def test_top_speed_and_draft_of_the_laden_barge(laden, bench):
    """d u + b u^2 = 2 k n^2 of the steady barge; a payload m sinks it by m / (rho A)."""
    h, t = laden.params.hydrodynamics, laden.params.thrusters
    team = bench(laden).step([1.0, 0.0], 3500)
    thrust = 2 * t.k_positive * t.n_max**2
    u = float(team.state[0, 0, 7])
    assert h.linear[0] * u + h.quadratic[0] * u * u == pytest.approx(thrust, rel=5e-3)
    assert laden.top_speed == pytest.approx(u, rel=5e-3)
    afloat = bench(laden).step([-1.0, 0.0], 2000)
    assert float(afloat.state[0, 0, 2]) == pytest.approx(PAYLOAD / (RHO_SEA * 8.0), rel=1e-3)  # 4 m x 2 m


def test_wind_pushes_back_sideways_and_over(otter, bench):
    """Head wind, beam wind from port, and a hull that runs with the wind."""
    team = bench(otter, envs=3)
    team.wind[:] = torch.tensor([[-8.0, 0.0, 0.0], [0.0, 8.0, 0.0], [2.0, 1.0, 0.0]])
    team.state[2, 0, 7:9] = torch.tensor([2.0, 1.0])
    team.step([0.0, 0.0])
    w, air = otter.params.windage, 0.5 * 1.225 * 8.0**2
    force = np.stack([column(team, "wind_x"), column(team, "wind_y")], axis=1)
    expected = [[-air * w.c_x * w.frontal_area, 0], [0, air * w.c_y * w.lateral_area], [0, 0]]
    assert force == pytest.approx(np.array(expected), rel=1e-9, abs=1e-6)
    team.state[2, 0, 7:] = 0.0
    team.step([0.0, 0.0], 250)
    ahead, beam = team.state[0, 0], team.state[1, 0]
    assert ahead[7] < -0.05 and ahead[8].abs() < 1e-9
    assert beam[8] > 0.05 and beam[4] > 1e-3  # rolls to starboard, which is to leeward


def test_wind_moments_have_fossens_signs(otter):
    """Fossen (2021), sec. 10.1: C_N = c_n sin 2 gamma; the side force acts towards the end that meets the wind."""
    w = otter.params.windage
    length, M = otter.params.length, otter.params.M_rb + otter.radiation.inertia
    state = np.tile(np.eye(13)[3], (4, 1))
    # blows to: port quarter (from the starboard bow), port bow (from the starboard quarter), port (abeam), nowhere
    air = 10.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [0, -1, 0], [0, 0, 0]]) / math.sqrt(2.0)
    load = (otter.rhs(state, [0.0, 0.0], wind=air) - otter.rhs(state, [0.0, 0.0]))[:, 7:] @ M
    q = 0.5 * 1.225 * 10.0**2
    bow, quarter, abeam, none = load
    assert bow[5] == pytest.approx(-q * w.c_n * w.lateral_area * length, rel=1e-9)  # turns the bow away from the wind
    assert quarter[5] == pytest.approx(-bow[5]) and abs(abeam[5]) < 1e-9
    assert bow[1] < 0 and bow[0] < 0 < quarter[0]
    # the force acts at the height of the centre of the areas: heel to port, and bow up when pushed back
    assert load[:, 3] == pytest.approx(w.height * load[:, 1]) and bow[3] < 0
    assert load[:, 4] == pytest.approx(-w.height * load[:, 0]) and bow[4] > 0
    assert np.abs(none).max() < 1e-12
