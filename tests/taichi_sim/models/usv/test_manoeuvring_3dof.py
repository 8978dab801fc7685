import functools
import json

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state
from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.config.io import config_folder, read_toml
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, ELEVATION, GRAVITY, POSITION, QUATERNION
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_rotation_matrix
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.surroundings.sea import Sea

RUNS = {
    "surge_decay_u0.5": (0.0, 0.0, 0.0),
    "surge_step_tau2": (2.0, 0.0, 0.0),
    "turn_tau_1_0_0.3": (1.0, 0.0, 0.3),
    "sway_yaw_decay": (0.0, 0.0, 0.0),
}
SYMMETRIC = {"actions": "surge_sway_yaw"}
NO_DAMPING = {
    **{f"X_{k}": 0.0 for k in ("u", "uu", "uuu")},
    **{f"{force}_{k}": 0.0 for force in "YN" for k in ("v", "vv", "rv", "r", "vr", "rr")},
}


def _params(name="cybership2", **overrides):
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml") | overrides
    del data["model"]
    return Manoeuvring3dof.Params(**data)


@functools.cache
def _model(name="cybership2", dt=0.02, substeps=10, **overrides):
    """One model, and so one compiled kernel, for all tests that ask for the same."""
    return Manoeuvring3dof(_params(name, **overrides), dt, substeps)


def _action(params, tau):
    """What asks for the forces tau of a model with actions = "surge_sway_yaw"."""
    limits = (params.surge_force_max, params.sway_force_max or 1.0, params.yaw_moment_max)
    return [t / limit for t, limit in zip(tau, limits, strict=True)]


def _start(team, u=0.0, v=0.0, r=0.0):
    """Give the first vehicle of every environment body velocity u, v (m/s) and yaw rate r (rad/s)."""
    team.state[..., 7], team.state[..., 8], team.state[..., 12] = u, v, r
    return team


def _plane(model, eta, nu, tau, current=(0.0, 0.0)):
    """Rates [n, 6] of x, y, psi, u, v, r at eta = [x, y, psi] and nu = [u, v, r], each [n, 3] or [3]."""
    eta, nu = np.atleast_2d(eta, nu)
    nothing = np.zeros((len(eta), 3))
    states = pack_state(np.hstack((eta[:, :2], nothing, eta[:, 2:])), np.hstack((nu[:, :2], nothing, nu[:, 2:])))
    rates = model.rhs(states, tau, current)
    psi_dot = 2 * (states[:, 3] * rates[:, 6] - states[:, 6] * rates[:, 3])
    assert not rates[:, [2, 4, 5, 9, 10, 11]].any()
    return np.column_stack((rates[:, :2], psi_dot, rates[:, [7, 8, 12]]))


def _track_errors(bench, columns, name):
    """Largest distance (m) and heading error (rad) along a reference trajectory; dt = 0.02 s or just below."""
    table, tau = columns(f"cybership2/{name}.csv"), RUNS[name]
    interval = table.t[1]
    substeps = int(np.ceil(interval / 0.02 - 1e-9))
    model = _model(dt=interval / substeps, substeps=substeps, **SYMMETRIC)
    team = _start(bench(model), table.u[0], table.v[0], table.r[0])
    track = [(*team.position[:2], team.euler[2])]
    for _ in table.t[1:]:
        team.step(_action(model.params, tau))
        track.append((*team.position[:2], team.euler[2]))
    x, y, psi = np.array(track).T
    turned = (psi - table.psi + np.pi) % (2 * np.pi) - np.pi
    return np.hypot(x - table.x, y - table.y).max(), np.abs(turned).max()


class TestSinglePrecision:
    @pytest.mark.parametrize("name", ["surge_decay_u0.5", "turn_tau_1_0_0.3"])
    def test_trajectories_of_an_independent_code(self, name, bench, columns):
        runtime.init(precision="f32", threads=1)
        distance, heading = _track_errors(bench, columns, name)
        assert distance < 0.05
        assert heading < np.deg2rad(0.5)


@pytest.mark.usefixtures("f64")
class TestEquations:
    def test_right_hand_side_of_an_independent_code(self, columns):
        t = columns("cybership2/rhs_samples.csv")
        eta, nu, tau = (
            np.stack([getattr(t, c) for c in names.split()], 1) for names in ("x y psi", "u v r", "tauX tauY tauN")
        )
        ours = _plane(_model(), eta, nu, tau)
        theirs = np.stack([getattr(t, f"d_{c}") for c in ("x", "y", "psi", "u", "v", "r")], 1)
        assert (np.abs(ours - theirs).max(0) / np.abs(theirs).max(0)).max() < 1e-9

    @pytest.mark.parametrize("name", RUNS)
    def test_trajectories_of_an_independent_code(self, name, bench, columns):
        distance, heading = _track_errors(bench, columns, name)
        assert distance < 1e-6
        assert heading < 1e-6

    def test_eigenvalues_of_an_independent_code(self, reference):
        table = json.loads((reference / "cybership2" / "summary.json").read_text())["eigenvalues_straight"]
        for u, theirs in table.items():
            ours = np.sort(_params().eigenvalues(float(u)).real)
            assert ours == pytest.approx(np.sort(np.array(theirs)[:, 0]), rel=1e-4)  # theirs: differences

    def test_kinetic_energy_is_kept_without_damping(self, bench):
        """C is skew-symmetric, so nu^T M nu changes only by the work of tau."""
        model = _model(**NO_DAMPING, **SYMMETRIC)
        team = _start(bench(model), 0.4, -0.2, 0.5)
        nu = np.array([0.4, -0.2, 0.5])
        before = nu @ model.params.M @ nu
        team.step([0.0, 0.0, 0.0], 150)
        after = team.state[0, 0, [7, 8, 12]].numpy()
        assert np.abs(after - nu).max() > 0.1
        assert after @ model.params.M @ after == pytest.approx(before, rel=1e-9)

    def test_steady_surge_balances_drag_and_thrust(self, bench):
        """-X_u u - X_uu u^2 - X_uuu u^3 = tau; the run must have reached it."""
        p = _params()
        u = float(bench(_model(**SYMMETRIC)).step([1.0, 0.0, 0.0], 500).state[0, 0, 7])
        assert -(p.X_u * u + p.X_uu * u * u + p.X_uuu * u**3) == pytest.approx(p.surge_force_max, rel=1e-6)
        assert p.steady_surge(p.surge_force_max) == pytest.approx(u, rel=1e-6)

    def test_port_and_starboard_mirror(self, bench):
        model = _model(**SYMMETRIC)
        port = _start(bench(model), 0.3, -0.1, -0.2).step([0.5, -0.3, -0.2], 100)
        starboard = _start(bench(model), 0.3, 0.1, 0.2).step([0.5, 0.3, 0.2], 100)
        assert abs(starboard.position[1]) > 1.0
        assert port.position == pytest.approx(starboard.position * [1, -1, 1], abs=1e-12)
        assert port.euler == pytest.approx(-starboard.euler, abs=1e-12)

    def test_started_with_the_current_the_track_is_the_still_water_one_carried_along(self, bench):
        model, V_c = _model("otter_3dof"), np.array([0.3, -0.4])
        psi = 0.7
        nu_c = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]]) @ V_c
        still = _start(bench(model).put(euler=(0, 0, psi)), 0.5, 0.1, 0.2).step([0.2, 0.3], 300)
        moving = _start(bench(model).put(euler=(0, 0, psi)), 0.5 + nu_c[0], 0.1 + nu_c[1], 0.2)
        moving.current[:] = torch.from_numpy(V_c)
        moving.step([0.2, 0.3], 300)
        assert moving.position[:2] - 60.0 * V_c == pytest.approx(still.position[:2], abs=1e-10)
        assert moving.euler == pytest.approx(still.euler, abs=1e-12)
        assert moving.velocity[:2] == pytest.approx(still.velocity[:2] + V_c, abs=1e-12)

    def test_rhs_in_a_current_is_the_still_water_one_seen_over_ground(self):
        """n-frame acceleration does not know the current: R (nu_dot + S(r) nu) is the same."""
        model, psi, r = _model(), 0.7, 0.3
        R = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
        nu, V_c, tau = np.array([0.4, -0.1, r]), np.array([0.3, -0.5]), [1.0, 0.2, -0.1]
        over_ground = nu + [*(R.T @ V_c), 0.0]
        still, moving = _plane(model, [0, 0, psi], nu, tau)[0], _plane(model, [0, 0, psi], over_ground, tau, V_c)[0]
        assert moving[:3] == pytest.approx(still[:3] + [*V_c, 0.0], abs=1e-14)
        turn = r * np.array([[0.0, -1.0], [1.0, 0.0]])
        accelerations = [R @ (dot[3:5] + turn @ v[:2]) for dot, v in ((still, nu), (moving, over_ground))]
        assert accelerations[0] == pytest.approx(accelerations[1], abs=1e-14)

    def test_otter_cross_flow_is_the_strip_integral(self):
        """Y and N of the quadratic terms against -q sum |v + x r| (v + x r) dx over 21 strips, on a grid."""
        p, q, x = _params("otter_3dof"), 100.516, np.linspace(-1, 1, 21)
        v, r = (a.reshape(-1, 1) for a in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)))
        w = v + x * r
        theirs = -0.1 * q * np.stack(((np.abs(w) * w).sum(1), (x * np.abs(w) * w).sum(1)), 1)
        nu = np.hstack((0 * v, v, r))
        forces = _plane(_model("otter_3dof"), 0 * nu, nu, 0 * nu)[:, 3:] @ p.M.T
        linear_and_yaw = np.hstack((p.Y_v * v, p.N_r * (r + 10 * np.abs(r) * r)))
        ours = forces[:, 1:] - linear_and_yaw  # u = 0: no Coriolis force but in X
        assert (np.abs(ours - theirs).max(0) / np.abs(theirs).max(0)).max() < 0.15

    def test_refuses_a_step_beyond_the_stability_limit(self):
        p = _params("otter_3dof", X_u=-4000.0)  # decays by 4000 / 85.5 per second: dt <= 2.785 / 46.8
        limit = 2.785293563 * 85.5 / 4000.0
        Manoeuvring3dof(p, 0.999 * limit, 1)
        with pytest.raises(ConfigError, match=r"allowed are up to 0\.0595"):
            Manoeuvring3dof(p, 1.001 * limit, 1)

    def test_refuses_inertia_that_is_not_positive(self):
        with pytest.raises(ValueError, match="positive definite"):
            _params(I_z=0.01, N_rdot=0.0)


@pytest.mark.usefixtures("f64")
class TestActuators:
    @pytest.mark.parametrize(
        ("actions", "action", "tau"),
        [
            ("acceleration_yaw", [0.0, 0.5], [1.0, 0.0, 0.75]),
            ("acceleration_yaw", [-1.0, -1.0], [0.0, 0.0, -1.5]),
            ("surge_sway_yaw", [-0.5, 0.4, 1.0], [-1.0, 0.6, 1.5]),
        ],
    )
    def test_actions_map_to_forces(self, actions, action, tau, bench):
        """First accelerations from rest: M^-1 tau."""
        model = _model(dt=1e-6, substeps=1, actions=actions, **NO_DAMPING)
        rates = bench(model).step(action).state[0, 0, [7, 8, 12]].numpy() / 1e-6
        assert rates == pytest.approx(np.linalg.solve(model.params.M, tau), abs=1e-5)

    @pytest.mark.parametrize("dt", [0.02, 0.5])
    def test_lag_is_exact_at_any_step(self, bench, dt):
        """Without drag, m11 u = X (t - T (1 - exp(-t / T)))."""
        p = _params(time_constant=0.8, **NO_DAMPING)
        u = float(bench(Manoeuvring3dof(p, dt, round(2.0 / dt))).step([1.0, 0.0]).state[0, 0, 7])
        exact = p.surge_force_max * (2.0 - 0.8 * (1 - np.exp(-2.0 / 0.8))) / p.M[0, 0]
        assert u == pytest.approx(exact, rel=1e-12)


@pytest.mark.usefixtures("f64")
class TestWaves:
    @pytest.mark.parametrize("heading", [0.0, 2.0])
    def test_accelerates_with_the_water_of_a_long_wave(self, heading, bench, single_wave):
        """From rest at the steepest point of a long low wave: -g times the slope k a, on any heading."""
        wavelength, amplitude = 500.0, 0.1
        slope = 2 * np.pi / wavelength * amplitude
        sea = single_wave(wavelength, amplitude, phase=-np.pi / 2)  # zeta = a sin k x, at t = 0
        model = _model(dt=0.01, substeps=6, Y_rdot=-0.3, N_vdot=-0.3)
        team = bench(model, sea).put(euler=(0, 0, heading)).step([-1.0, 0.0])
        assert team.velocity[:2] / 0.06 == pytest.approx([-GRAVITY * slope, 0.0], rel=5e-3, abs=5e-3 * GRAVITY * slope)

    def test_a_wave_as_long_as_the_hull_does_not_push_it_ahead(self, bench, single_wave):
        sea = single_wave(1.255, 0.01, phase=-np.pi / 2)
        team = bench(_model(dt=0.001), sea).step([-1.0, 0.0])
        assert abs(team.velocity[0]) < 0.02 * GRAVITY * (2 * np.pi / 1.255 * 0.01) * 0.01

    def test_yaw_moment_turns_the_hull_along_a_quartering_crest(self, bench, single_wave):
        """Long wave: N = -g (m L^2 / 12 - N_rdot) d slope_y / dx, with d slope_y / dx = -kx ky zeta in b."""
        k, amplitude, psi = 2 * np.pi / 500.0, 0.5, np.pi / 4
        model = _model(dt=0.01, substeps=6, x_g=0.0, **NO_DAMPING)
        p = model.params
        team = bench(model, single_wave(500.0, amplitude, direction=psi)).step([-1.0, 0.0])
        moment = GRAVITY * (p.mass * p.length**2 / 12 - p.N_rdot) * (k * k / 2) * amplitude
        assert float(team.state[0, 0, 12]) / 0.06 == pytest.approx(moment / p.M[2, 2], rel=2e-2)

    def test_response_switched_off_leaves_the_track_of_calm_water(self, bench, single_wave):
        model = _model(wave_response=False)
        sea = single_wave(20.0, 0.3, 1.0)
        rough, calm = (bench(model, s).step([0.5, 0.1], 50) for s in (sea, None))
        assert rough.position[:2] == pytest.approx(calm.position[:2], abs=1e-10)
        assert rough.position[2] != 0.0

    def test_rides_the_surface(self, bench):
        """Height and attitude are those of the exact surface at the hull, heave and rates their derivatives."""
        sea = Sea.from_config(SeaConfig(hs=0.3, tp=4.0, components=16, realisations=1), seed=5)
        model = _model("otter_3dof", 0.01, 2)
        team = bench(model, sea).step([0.5, 0.3], 20)
        signs = torch.tensor([[1, -1, 0], [1, 1, 0], [-1, -1, 0], [-1, 1, 0]], dtype=torch.float64)
        corners_b = 0.5 * signs * torch.tensor([model.params.length, model.params.beam, 0.0])
        for _ in range(100):
            before = team.state[0, 0].clone()
            state = team.step([0.5, 0.3]).state[0, 0]
            corners = state[POSITION] + corners_b @ torch_rotation_matrix(state[QUATERNION]).T
            zeta = sea.elevation(corners[:, 0], corners[:, 1], float(team.time[0]))
            assert float(team.surface[0, 0, ELEVATION]) == pytest.approx(float(zeta.mean()), abs=0.02 * 0.3)
            assert float(state[2]) == -float(team.surface[0, 0, ELEVATION])
            assert torch.abs(corners[:, 2] + zeta).max() < 0.03
            assert team.velocity == pytest.approx((state - before)[POSITION].numpy() / 0.02, abs=0.02)
            turned = torch_rotation_matrix(before[QUATERNION]).T @ torch_rotation_matrix(state[QUATERNION])
            rates = torch.stack((turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]))
            assert state[ANGULAR_VELOCITY].numpy() == pytest.approx(rates.numpy() / 2 / 0.02, abs=0.02)
        assert torch_euler_from_quaternion(state[QUATERNION])[:2].abs().max() > 0.0

    def test_nan_in_one_vehicle_leaves_the_others_alone(self, bench, single_wave):
        model = _model()
        clean, broken = (bench(model, single_wave(20.0, 0.3), envs=2, count=3) for _ in range(2))
        broken.state[1, 1] = float("nan")
        for team in (clean, broken):
            team.step([0.4, 0.2], 20)
        others = torch.ones((2, 3), dtype=torch.bool)
        others[1, 1] = False
        assert torch.equal(clean.state[others], broken.state[others])
        assert torch.isnan(broken.state[1, 1]).any()
