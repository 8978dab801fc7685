import math

import numpy as np
import pytest
import torch

from taichi_sim.kernels import runtime

SCRIPT = {
    "thrust_factor": 1.0,
    "boost_min": 1.0,
    "max_pitch_deg": 45.0,
    "max_roll_deg": 45.0,
    "roll_rule": "script",
}
LEVEL = [0.0, 0.0, -1.0]


@pytest.mark.usefixtures("f64")
class TestAlone:
    def test_sequence_of_an_independent_code(self, bench, make_model, columns):
        table = columns("unity/aircraft_script_dt0.02.csv")
        model = make_model("unity_aircraft", 0.02, 5, **SCRIPT)
        team = bench(model).put((table.z_fwd[0], table.x[0], -table.y_up[0]))
        for k in range(len(table.t)):
            roll, pitch, yaw = (np.rad2deg(float(team.fleet.reading(name))) for name in ("roll", "pitch", "yaw"))
            assert np.abs(team.position - [table.z_fwd[k], table.x[k], -table.y_up[k]]).max() < 1e-5
            assert np.abs(team.velocity - [table.vz[k], table.vx[k], -table.vy[k]]).max() < 1e-5
            assert (roll, pitch) == pytest.approx((-table.roll_deg[k], -table.pitch_deg[k]), abs=1e-5)
            assert (yaw - table.yaw_deg[k] + 180) % 360 == pytest.approx(180, abs=1e-5)
            team.step([-table.act_pitch[k], table.act_yaw[k], 2 * table.act_boost[k] - 1])

    @pytest.mark.parametrize(("action", "bound"), [(-1.0, "boost_min"), (1.0, "boost_max")])
    def test_terminal_speed_at_both_ends_of_boost(self, action, bound, bench, make_model):
        """v = thrust_factor T a / (m drag) (1 - drag dt), no gravity and no lift: height is kept."""
        model = make_model("unity_aircraft", 0.02, 50)
        p = model.params
        team = bench(model).put((0.0, 0.0, -60.0)).step([0.0, 0.0, action], 20)
        force = p.thrust_factor * p.thrust * getattr(p, bound)
        assert team.velocity[0] == pytest.approx(force / (p.mass * p.drag) * (1 - p.drag * 0.02), rel=1e-9)
        assert team.position[1] == 0 and team.position[2] == -60.0

    def test_boost_action_inverts_the_mapping(self, bench, make_model):
        model = make_model("unity_aircraft")
        p = model.params
        for boost in (p.boost_min, 0.1, 1.0, p.boost_max):
            speed = bench(model).step([0.0, 0.0, model.boost_action(boost)]).velocity[0]
            expected = p.thrust_factor * p.thrust * boost / p.mass * 0.02 * (1 - p.drag * 0.02)
            assert speed == pytest.approx(expected, rel=1e-12)

    def test_signs(self, bench, make_model):
        """Positive pitch climbs, positive yaw turns right and banks right."""
        model = make_model("unity_aircraft", 0.02, 5)
        climb = bench(model).step([1.0, 0.0, 0.0], 5)
        assert climb.velocity[2] < 0 and climb.euler[1] > 0.1
        right = bench(model).step([0.0, 1.0, 0.0], 5)
        assert right.velocity[1] > 0 and right.euler[2] > 0.1 and right.euler[0] > 0.1
        left = bench(model).step([0.0, -1.0, 0.0], 5)
        assert np.allclose(left.euler, right.euler * [-1, 1, -1], atol=1e-15)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_pitch_and_roll_are_clamped(self, sign, bench, make_model):
        limits = {"max_pitch_deg": 30.0, "max_roll_deg": 40.0, "roll_rule": "script"}
        model = make_model("unity_aircraft", 0.02, 50, **limits)
        team = bench(model).step([sign, sign, 0.0], 5)
        assert np.rad2deg(team.euler[:2]) == pytest.approx([sign * 40.0, sign * 30.0], abs=1e-9)

    @pytest.mark.parametrize("yaw", [-1.0, 0.0, 1.0])
    def test_coordinated_roll_ends_where_the_script_ends(self, yaw, bench, make_model):
        """At the script's three yaw commands, from a bank to the other side."""
        ends = []
        for rule in ("script", "coordinated"):
            model = make_model("unity_aircraft", 0.02, 50, roll_rule=rule, max_roll_deg=45.0)
            ends.append(bench(model).put(euler=(-0.4, 0.0, 0.0)).step([0.0, yaw, -1.0], 20).euler[0])
        assert ends[0] == pytest.approx(yaw * math.pi / 4, abs=1e-4)
        assert ends[1] == pytest.approx(ends[0], abs=1e-4)

    def test_yaw_rate_reaches_its_speed_in_half_a_second(self, bench, make_model):
        """The increment moves by 2 dt per step, so full yaw is reached after 0.5 s, then 100 deg/s."""
        model = make_model("unity_aircraft", 0.02, 1)
        team = bench(model)
        for _ in range(25):
            assert float(team.fleet.reading("yaw_increment")) < 1.0
            team.step([0.0, 1.0, -1.0])
        assert float(team.fleet.reading("yaw_increment")) == pytest.approx(1.0)
        before = float(team.fleet.reading("yaw"))
        team.step([0.0, 1.0, -1.0], 10)
        assert np.rad2deg(float(team.fleet.reading("yaw")) - before) / 0.2 == pytest.approx(100.0)

    def test_body_rates_turn_the_attitude(self, bench, make_model):
        """The stored angular velocity, integrated by the exponential map, is the attitude's change."""
        model = make_model("unity_aircraft", 1e-4, 1, roll_rule="script")
        team = bench(model).put(euler=(0.5, 0.4, 1.0)).step([1.0, 1.0, -1.0], 2000)
        w0, q0 = team.state[0, 0, 10:13].clone(), team.state[0, 0, 3:7].clone()
        q1 = team.step([1.0, 1.0, -1.0]).state[0, 0, 3:7]
        conjugate = q0 * torch.tensor([1.0, -1, -1, -1], dtype=q0.dtype)
        w, x, y, z = conjugate.tolist()
        left = torch.tensor([[x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], dtype=q0.dtype)
        rate = 2 * (left @ q1) / 1e-4
        assert torch.allclose(rate, w0, atol=2e-3)
        assert float(w0.norm()) > 0.1


def _flight(bench, make_model, only=None, envs=40, count=3):
    team = bench(make_model("unity_aircraft", 0.02, 5), envs=envs, count=count)
    rng = np.random.default_rng(2)
    action = torch.tensor(rng.uniform(-1, 1, (envs, count, 3)), dtype=team.state.dtype)
    if only:
        env, i = only
        return bench(team.model).step(action[env : env + 1, i : i + 1], 30).state[0, 0]
    return team.step(action, 30).state


def test_one_aircraft_does_not_depend_on_the_others(bench, make_model):
    team = _flight(bench, make_model)
    for only in ((0, 0), (17, 2), (39, 1)):
        assert torch.equal(_flight(bench, make_model, only), team[only])


@pytest.mark.slow
def test_bits_do_not_depend_on_threads(bench, make_model):
    states = []
    for threads in (1, 2):
        runtime.init(threads=threads)
        states.append(_flight(bench, make_model))
    assert torch.isfinite(states[0]).all()
    assert torch.equal(*states)
