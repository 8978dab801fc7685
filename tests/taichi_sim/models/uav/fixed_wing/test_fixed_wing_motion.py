"""Flights of fixed-wing aircraft: invariants, actuators, wind, what is refused."""

import math

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.fixed_wing import actuators
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.params import aircraft_numbers

pytestmark = pytest.mark.usefixtures("f64")
DT, SUBSTEPS = 0.02, 5
IDEAL = {"time_constant": 0.0, "rate_limit_deg": math.inf, "throttle_time_constant": 0.0}


def params(name="aerosonde", **sections):
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml")
    for key in ("model", "autopilot"):  # flown by its surfaces
        data.pop(key)
    data |= {key: data[key] | numbers for key, numbers in sections.items()}
    return validate(FixedWing6DOF.Params, data, name)


def model(name="aerosonde", dt=DT, substeps=SUBSTEPS, **sections):
    return FixedWing6DOF(params(name, **sections), dt, substeps)


@pytest.fixture(scope="module")
def ideal(f64):
    return model(actuators=IDEAL)


@pytest.fixture(scope="module")
def shipped(f64):
    return model()


@pytest.fixture(scope="module")
def start(bench):
    """A team in cruise, 100 m up: start(model, **size)."""
    return lambda of, **size: bench(of, **size).put((0.0, 0.0, -100.0), settle=True)


def wild(step):
    """Actions that excite every axis."""
    return [0.1 * math.sin(0.5 * step), 0.2 * math.cos(0.3 * step), 0.1 * math.sin(0.2 * step), 0.3 * math.sin(step)]


def test_zero_action_is_cruise(shipped, start):
    team = start(shipped).step([0.0] * 4, 50)
    readings = dict(zip(shipped.aux_names, team.aux[0, 0].tolist(), strict=True))
    cruise = shipped.cruise
    assert readings["airspeed"] == pytest.approx(25.0, abs=1e-6)
    assert readings["alpha"] == pytest.approx(cruise.alpha, abs=1e-7)
    assert readings["beta"] == pytest.approx(0.0, abs=1e-7)
    # lift carries the weight but for the propeller's pull: n_z = cos(theta) in steady level flight
    assert readings["load_factor"] == pytest.approx(math.cos(cruise.theta), abs=1e-6)
    assert [readings[n] for n in shipped.action_names] == pytest.approx(cruise.controls.tolist(), abs=1e-12)
    north, east, down = team.position
    assert (math.hypot(north, east), down) == pytest.approx((25.0 * 5.0, -100.0), abs=1e-5)


def test_signs_of_the_controls(ideal, start):
    """Elevator down pitches down, aileron rolls right, rudder yaws left, throttle speeds up."""
    effects = []
    for k in range(4):
        action = [0.0] * 4
        action[k] = 0.1
        effects.append(start(ideal).step(action).state[0, 0])
    assert effects[0][11] < 0 < effects[1][10]
    assert effects[2][12] < 0
    assert effects[3][7] > ideal.cruise.state[7]


# -- wind --------------------------------------------------------------------------------------------------------


def test_steady_wind_carries_the_flight_along(ideal, start):
    wind = np.array([4.0, -7.0, 1.5])
    still, windy = start(ideal), start(ideal)
    R = torch_rotation_matrix(windy.state[0, 0, QUATERNION])
    windy.state[..., VELOCITY] += R.T @ torch.tensor(wind)
    windy.wind[:] = torch.tensor(wind)
    for step in range(60):
        still.step(wild(step))
        windy.step(wild(step))
    drift = wind * 60 * DT * SUBSTEPS
    assert windy.position - still.position == pytest.approx(drift, abs=1e-10)
    assert windy.velocity - still.velocity == pytest.approx(wind, abs=1e-11)
    assert torch.allclose(windy.state[..., QUATERNION], still.state[..., QUATERNION], atol=1e-12, rtol=0)
    assert torch.allclose(windy.aux[..., :8], still.aux[..., :8], atol=1e-11, rtol=0)
    assert windy.aux[0, 0, 8:11].tolist() == pytest.approx(wind.tolist(), abs=1e-12)
    assert float(still.state[0, 0, ANGULAR_VELOCITY].norm()) > 0.05


# -- energy and momentum -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("throttle", [0.4, -1.0])
def test_energy_comes_from_thrust_and_goes_into_drag(throttle, bench, start):
    """Over a climb and a glide the change of 1/2 m v^2 + 1/2 omega J omega + m g h is the work of the loads."""
    fine = model(dt=0.01, substeps=1, actuators=IDEAL)
    p, team = fine.p.physical, start(fine)
    J = np.array([[p.Jx, 0, -p.Jxz], [0, p.Jy, 0], [-p.Jxz, 0, p.Jz]])

    def energy():
        state = team.state[0, 0].numpy()
        v, omega = state[VELOCITY], state[ANGULAR_VELOCITY]
        return 0.5 * p.mass * v @ v + 0.5 * omega @ J @ omega - p.mass * GRAVITY * state[2]

    def power():
        state, delta = team.state[0, 0].numpy(), team.aux[0, 0, :4].numpy()
        load = loads(fine.p, state[VELOCITY], state[ANGULAR_VELOCITY], delta)[0, :6]
        return load[:3] @ state[VELOCITY] + load[3:] @ state[ANGULAR_VELOCITY]

    action = [0.0, 0.0, 0.0, throttle]
    team.step(action)
    before, height, powers = energy(), -team.position[2], [power()]
    for _ in range(600):
        team.step(action)
        powers.append(power())
    powers = np.array(powers)
    work = 0.01 / 3 * (powers[0] + powers[-1] + 4 * powers[1:-1:2].sum() + 2 * powers[2:-1:2].sum())
    assert energy() - before == pytest.approx(work, rel=1e-5)
    assert (-team.position[2] - height) * math.copysign(1.0, throttle) > 5
    assert abs(work) > 500


def test_in_a_vacuum_it_falls_and_keeps_its_angular_momentum(bench):
    """No air: a parabola, and J omega constant in the world although the body tumbles (Jxz included)."""
    fine = FixedWing6DOF(params(actuators=IDEAL, physical={"rho": 1e-30}), 0.002, 50, design=params())
    p = fine.p.physical
    J = torch.tensor([[p.Jx, 0, -p.Jxz], [0, p.Jy, 0], [-p.Jxz, 0, p.Jz]], dtype=torch.float64)
    team = bench(fine).put((0.0, 0.0, -500.0), (0.3, -0.4, 1.0), (20.0, 3.0, -4.0), (1.5, -2.0, 1.0))

    def momentum():
        return torch_rotation_matrix(team.state[0, 0, QUATERNION]) @ J @ team.state[0, 0, ANGULAR_VELOCITY]

    first, rates = momentum(), team.state[0, 0, ANGULAR_VELOCITY].clone()
    position, velocity = team.position.copy(), team.velocity.copy()
    team.step([0.0] * 4, 30)
    t = 30 * 50 * 0.002
    assert torch.allclose(momentum(), first, atol=1e-8)
    assert float((team.state[0, 0, ANGULAR_VELOCITY] - rates).norm()) > 0.5
    fallen = position + velocity * t + [0.0, 0.0, 0.5 * GRAVITY * t * t]
    assert team.position == pytest.approx(fallen, abs=1e-7)


# -- actuators ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.1, 0.02])
def test_a_lag_is_that_of_its_time_constant_whatever_the_step(shipped, dt):
    """Deflections and their integral over 0.4 s: c + (x - c) exp(-t / tau), c t + (x - c) tau (1 - exp(-t / tau))."""
    p = shipped.p.actuators.model_copy(update={"rate_limit_deg": math.inf})
    lags = aircraft_numbers(shipped.p, shipped.nominal, dt)

    @ti.kernel
    def respond(delta: ti.types.ndarray(), command: ti.types.ndarray(), integral: ti.types.ndarray(), steps: ti.i32):
        for _once in range(1):
            x = ti.Vector([delta[0], delta[1], delta[2], delta[3]])
            c = ti.Vector([command[0], command[1], command[2], command[3]])
            total = x * 0.0
            for _ in range(steps):
                x, mean = actuators.advance(p, lags, x, c)
                total += mean * dt
            for k in ti.static(range(4)):
                delta[k], integral[k] = x[k], total[k]

    x, c = np.array([-0.1, 0.2, 0.0, 0.7]), np.array([0.3, -0.2, 0.1, 0.0])
    delta, integral = x.copy(), np.zeros(4)
    respond(delta, c, integral, round(0.4 / dt))
    tau = np.array([p.time_constant] * 3 + [p.throttle_time_constant])
    assert delta == pytest.approx(c + (x - c) * np.exp(-0.4 / tau), abs=1e-13)
    assert integral == pytest.approx(0.4 * c + (x - c) * tau * (1 - np.exp(-0.4 / tau)), abs=1e-13)


def test_servos_are_limited_in_rate_and_travel(start):
    """Full aileron: 60 deg/s for 0.1 s, and in the end the limit."""
    slow = model(actuators={"time_constant": 0.0, "rate_limit_deg": 60.0, "aileron_limit_deg": 10.0})
    team = start(slow)
    team.step([0.0, 1.0, 0.0, 0.0])
    assert team.aux[0, 0, 1].item() == pytest.approx(slow.neutral[1] + math.radians(6.0), rel=1e-12)
    team.step([0.0, 3.0, 0.0, 0.0], 3)
    assert team.aux[0, 0, 1].item() == pytest.approx(math.radians(10.0), rel=1e-12)


def test_actions_invert_controls(shipped):
    controls = torch.tensor([[-0.3, 0.1, -0.05, 0.2], [0.2, -0.3, 0.4, 1.0]], dtype=torch.float64)
    action = shipped.action(controls)
    lower, upper = (torch.tensor(x) for x in (shipped.p.actuators.lower, shipped.p.actuators.upper))
    neutral = torch.tensor(shipped.neutral)
    back = neutral + action.clamp(min=0) * (upper - neutral) + action.clamp(max=0) * (neutral - lower)
    assert torch.allclose(back, controls, atol=1e-12)
    assert shipped.action(controls.to("meta")).device.type == "meta"  # where the controls are, whatever the device


# -- robustness --------------------------------------------------------------------------------------------------


def test_nan_in_one_aircraft_leaves_its_neighbours_bits(shipped, start):
    healthy, sick = start(shipped, envs=3, count=2), start(shipped, envs=3, count=2)
    sick.state[1, 0, 8] = math.nan
    for step in range(5):
        healthy.step(wild(step))
        sick.step(wild(step))
    assert torch.isnan(sick.state[1, 0]).any()
    others = torch.ones(3, 2, dtype=torch.bool)
    others[1, 0] = False
    assert torch.equal(sick.state[others], healthy.state[others])
    assert torch.equal(sick.aux[others], healthy.aux[others])
    assert torch.equal(sick.fleet.derived[others], healthy.fleet.derived[others])


def test_an_aircraft_at_rest_in_still_air_falls(shipped, bench):
    team = bench(shipped).put((0.0, 0.0, -100.0))
    team.step([0.0] * 4)
    assert torch.isfinite(team.state).all() and team.velocity[2] > 0.5


@pytest.mark.parametrize(("name", "mode"), [("aerosonde", "roll"), ("zagi", "short_period")])
def test_a_step_too_long_for_the_modes_is_refused(name, mode):
    with pytest.raises(ConfigError, match=rf"dt = 0\.2 s: RK4 holds the mode {mode}.*largest stable dt is 0\.\d+ s"):
        model(name, dt=0.2)


def test_another_aircraft_is_another_file(start):
    """The Zagi, a seventh of the mass: trims at its own speed and holds it."""
    zagi = model("zagi")
    team = start(zagi)
    team.step([0.0] * 4, 30)
    assert zagi.p.physical.mass < model().p.physical.mass / 7
    assert team.velocity == pytest.approx([12.0, 0.0, 0.0], abs=1e-6)
    assert zagi.p.size == (0.7, 1.4224, 0.2) and zagi.p.collision_radius == 0.8


@pytest.mark.parametrize(
    ("section", "numbers", "told"),
    [
        ("physical", {"Jxz": 1.5}, "Jxz"),
        ("physical", {"mass": -1.0}, "physical.mass = -1.0"),
        ("propeller", {"law": "steam"}, "law"),
        ("lateral", {"C_n_bta": 0.1}, "did you mean 'C_n_beta'"),
        ("envelope", {"airspeed": 50.0}, "max_airspeed"),
        ("envelope", {"airspeed": 8.0}, "stall"),
    ],
)
def test_wrong_numbers_are_refused_by_name(section, numbers, told):
    with pytest.raises(ConfigError, match=told):
        model(**{section: numbers})
