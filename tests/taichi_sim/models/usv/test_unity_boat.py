import numpy as np
import pytest
import torch

from taichi_sim.config import SeaConfig
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import ELEVATION, GRAVITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.surroundings.sea import Sea

AHEAD, COAST = [1.0, 0.0], [-1.0, 0.0]  # actions: full force, none
DRY = {"pitch_factor": 0.0, "roll_factor": 0.0, "buoyancy_stiffness": 0.0, "buoyancy_damping": 0.0}


@pytest.mark.usefixtures("f64")
class TestAlone:
    def test_sequence_of_an_independent_code(self, bench, make_model, columns):
        table = columns("unity/boat_m100_L6_B2.5_script_dt0.02.csv")
        model = make_model("unity_boat", 0.02, 10, mass=100.0, length=6.0, beam=2.5, **DRY)
        team = bench(model)
        for k in range(len(table.t)):
            ours = (*team.position[:2], *team.velocity[:2], float(team.state[0, 0, 12]))
            theirs = [getattr(table, c)[k] for c in ("z_fwd", "x", "vz", "vx", "yaw_rate_rad_s")]
            assert np.abs(np.array(ours) - theirs).max() < 1e-6
            team.step([2 * table.vertical_input[k] - 1, table.horizontal_input[k]])

    def test_the_surface_followed_is_the_exact_one(self, bench, make_model):
        """At speed on the paper's sea, the mean height under the corners is the exact inverse's to 5 % of hs."""
        model = make_model("unity_boat", 0.02, 1)
        sea = Sea.from_config(SeaConfig(hs=0.5, tp=4.0, components=16, realisations=1), seed=5)
        team = bench(model, sea).step([0.2, 0.05], 50)  # the displacement is found within a few steps
        signs = torch.tensor([[1, -1, 0], [1, 1, 0], [-1, -1, 0], [-1, 1, 0]], dtype=torch.float64)
        corners_b = signs * torch.tensor([model.params.length / 2, model.params.beam / 2, 0.0])
        worst = 0.0
        for _ in range(200):
            state, time = team.state[0, 0].clone(), float(team.time[0])
            corners = state[:3] + corners_b @ torch_rotation_matrix(state[3:7]).T
            exact = sea.elevation(corners[:, 0], corners[:, 1], time).mean()
            team.step([0.2, 0.05])
            worst = max(worst, abs(float(team.surface[0, 0, ELEVATION]) - float(exact)))
        assert worst < 0.05 * 0.5

    def test_terminal_speed(self, bench, make_model):
        """v = J / (m drag) (1 - drag dt), the fixed point of v <- (v + J/m dt)(1 - drag dt)."""
        model = make_model("unity_boat", 0.02, 50, pitch_factor=0.0)
        p = model.params
        speed = bench(model).step(AHEAD, 30).velocity[0]
        assert speed == pytest.approx(p.force_factor / (p.mass * p.drag) * (1 - p.drag * 0.02), rel=1e-9)

    def test_a_current_carries_it(self, bench, make_model):
        """Galileo: begun with the current's velocity on calm water, a track is the still-water one plus V_c t; left
        alone from rest, the boat takes up 1 - (1 - drag dt)^n of the current.
        """
        model = make_model("unity_boat", 0.02, 10)
        V_c = torch.tensor([0.7, -1.2], dtype=torch.float64)
        still, carried, left = bench(model), bench(model), bench(model)
        for team in (carried, left):
            team.current[:] = V_c
        carried.put(velocity_b=(*V_c.tolist(), 0.0))  # heading north: b is n
        for action in ([0.6, 0.4], [0.1, -0.7], [-1.0, 0.2]):
            still.step(action, 10)
            carried.step(action, 10)
            way = [*(V_c * float(still.time[0])).tolist(), 0.0]
            assert carried.position == pytest.approx(still.position + way, abs=1e-9)
            assert carried.euler == pytest.approx(still.euler, abs=1e-9)
        left.step(COAST, 5)
        share = 1 - (1 - model.params.drag * 0.02) ** 50
        assert left.velocity[:2] == pytest.approx(share * V_c.numpy(), rel=1e-9)

    def test_coasting_from_half_action_is_half_the_force(self, bench, make_model):
        model = make_model("unity_boat")
        full, half, none = (bench(model).step([a, 0.0]).velocity[0] for a in (1.0, 0.0, -1.0))
        assert half == pytest.approx(full / 2)
        assert none == 0.0

    def test_floats_at_rest_on_calm_water(self, bench, make_model):
        team = bench(make_model("unity_boat", 0.02, 50)).step(COAST, 30)
        assert np.abs(team.state[0, 0].numpy() - np.eye(13)[3]).max() < 1e-9

    def test_returns_to_the_surface_upright(self, bench, make_model):
        team = bench(make_model("unity_boat", 0.02, 50)).put((0, 0, -0.5), (0.2, 0.1, 0.0)).step(COAST, 60)
        assert np.abs(team.position[2]) < 1e-6
        assert np.abs(team.euler[:2]).max() < 1e-6

    def test_heave_period_of_the_undamped_spring(self, bench, make_model):
        """T = 2 pi sqrt(m / 4 k); the step's own error is (omega dt)^2 / 24."""
        model = make_model("unity_boat", 0.005, 1, drag=0.0, angular_drag=0.0, buoyancy_damping=0.0)
        period = 2 * np.pi * np.sqrt(model.params.mass / (4 * model.params.buoyancy_stiffness))
        team, heights = bench(model).put((0.0, 0.0, 0.1)), []
        for _ in range(round(10 * period / 0.005)):
            heights.append(team.step(COAST).position[2])
        z = np.array(heights)
        rising = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
        at = rising - z[rising] / (z[rising + 1] - z[rising])
        assert np.diff(at).mean() * 0.005 == pytest.approx(period, rel=1e-3)
        assert np.abs(z).max() == pytest.approx(0.1, rel=5e-3)

    @pytest.mark.parametrize("heading", [0.0, 2.0])
    @pytest.mark.parametrize("direction", [0.0, 1.0])
    def test_pushed_down_a_long_slope_by_its_weight(self, heading, direction, bench, make_model, single_wave):
        """Horizontal force -m g grad(zeta), whichever way the boat points."""
        sea = single_wave(500.0, 0.2, direction, phase=np.pi / 2)  # zeta = -a sin(k x): falls along the wave
        slope = -0.2 * 2 * np.pi / 500.0
        model = make_model("unity_boat", drag=0.0, pitch_factor=0.0)
        push = bench(model, sea).put(euler=(0.0, 0.0, heading)).step(COAST).velocity[:2] / 0.02
        downhill = -GRAVITY * slope * np.array([np.cos(direction), np.sin(direction)])
        assert np.allclose(push, downhill, atol=0.01 * np.linalg.norm(downhill))
        assert push @ [np.cos(direction), np.sin(direction)] > 0

    def test_rides_a_long_wave(self, bench, make_model, single_wave):
        """On a swell far longer than the hull and slower than its heave, the boat is where the water is."""
        sea = single_wave(400.0, 1.0)
        team = bench(make_model("unity_boat", 0.02, 5, drag=0.2), sea).put((0.0, 0.0, -1.0))
        for _ in range(200):
            team.step(COAST)
            level = float(sea.elevation(*team.position[:2], float(team.time[0])))
            assert -team.position[2] == pytest.approx(level, abs=0.1)
        assert float(team.surface[0, 0, ELEVATION]) == pytest.approx(level, abs=0.02)

    def test_signs(self, bench, make_model):
        """Yaw turns to starboard and banks into the turn; force raises the bow."""
        model = make_model("unity_boat", 0.02, 5)
        turning = bench(model).step([1.0, 1.0], 4)
        assert turning.velocity[1] > 0 and turning.euler[2] > 0.1 and turning.euler[0] > 1e-4
        port = bench(model).step([1.0, -1.0], 4)
        assert np.allclose(port.euler * [-1, 1, -1], turning.euler)
        ahead = bench(model).step(AHEAD, 4)
        assert ahead.velocity[0] > 0 and ahead.euler[1] > 1e-4
        assert ahead.euler[0] == 0 and ahead.velocity[1] == 0

    def test_quaternion_stays_a_unit(self, bench, make_model):
        sea = Sea.from_config(SeaConfig(realisations=1), seed=2)
        team = bench(make_model("unity_boat", 0.02, 50), sea).step([1.0, 1.0], 60)
        assert float(team.state[0, 0, 3:7].norm()) == pytest.approx(1.0, abs=1e-12)


def _fleet(bench, make_model, envs=24, count=3, only=None):
    """Final state of boats on a sea, all started and steered differently; or of vehicle `only` = (env, i)."""
    sea = Sea.from_config(SeaConfig(realisations=4), seed=7)
    team = bench(make_model("unity_boat", 0.02, 5), sea, envs=envs, count=count)
    rng = np.random.default_rng(1)
    position = torch.tensor(rng.uniform(-50, 50, (envs, count, 2)), dtype=team.state.dtype)
    action = torch.tensor(rng.uniform(-1, 1, (envs, count, 2)), dtype=team.state.dtype)
    team.state[..., :2] = position
    if only:
        env, i = only
        alone = bench(team.model, sea)
        alone.around.env_sea[:] = team.around.env_sea[env]
        alone.state[0, 0] = team.state[env, i]
        return alone.step(action[env : env + 1, i : i + 1], 50).state[0, 0]
    return team.step(action, 50).state


def test_one_boat_does_not_depend_on_the_others(bench, make_model):
    fleet = _fleet(bench, make_model)
    for only in ((0, 0), (5, 2), (23, 1)):
        assert torch.equal(_fleet(bench, make_model, only=only), fleet[only])


def test_bits_do_not_depend_on_threads(bench, make_model):
    states = []
    for threads in (1, 2):
        runtime.init(threads=threads)
        states.append(_fleet(bench, make_model))
    assert torch.isfinite(states[0]).all()
    assert torch.equal(*states)
