"""What a flight must hold to beyond its equations: work in sheared wind, no NaN in any attitude, limits under full
stick, and single precision as good as double.
"""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, ConfigError
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads
from taichi_sim.models.uav.fixed_wing.trim import trim
from taichi_sim.state.divergence_dump import load_dump
from taichi_sim.world import World, replay

IDEAL = {"time_constant": 0.0, "rate_limit_deg": math.inf, "throttle_time_constant": 0.0}
SURFACES = {"actions": "surfaces", "protection": False}
ROUGHNESS, WIND_10 = 2e-4, 15.0  # m, m/s at 10 m


def flight(model, air, envs=1, height=100.0):
    """`envs` aircraft of one model in an `[air]`, one each, from cruise toward north at a height (m)."""
    return Bench(model, air=AirConfig(**air), envs=envs, seed=3).put((0.0, 0.0, -height), settle=True)


@pytest.fixture
def single():
    """Taichi in single precision."""
    runtime.init(threads=1)
    yield
    runtime.init()


@pytest.mark.slow
def test_in_sheared_wind_the_loads_do_the_work(f64, make_model):
    """Climb against a wind that grows with the logarithm of height: the energy of the motion over ground,
    1/2 m v^2 + 1/2 omega J omega + m g h, changes by the work of the loads, which follow from the velocity relative to
    the air at each height, U10 ln(h / z0) / ln(10 m / z0). A wind of one height, or a velocity that the wind's change
    carries along, is off by 3 % and more.
    """
    dt = 0.01
    model = make_model("aerosonde", dt, 1, actuators=IDEAL, autopilot=SURFACES)
    air = {"speed": WIND_10, "direction_deg": 0.0, "profile": "log", "roughness": ROUGHNESS}
    team, p = flight(model, air, height=12.0), model.p.physical
    J = np.array([[p.Jx, 0, -p.Jxz], [0, p.Jy, 0], [-p.Jxz, 0, p.Jz]])
    action = [-0.1, 0.0, 0.0, 1.0]
    energies, powers, heights = [], [], []
    for _ in range(500):
        team.step(action)
        state, delta = team.state[0, 0], team.aux[0, 0, :4].numpy()
        v, omega, height = state[VELOCITY].numpy(), state[ANGULAR_VELOCITY].numpy(), -float(state[2])
        wind = -WIND_10 * math.log(height / ROUGHNESS) / math.log(10.0 / ROUGHNESS)
        v_r = v - torch_rotation_matrix(state[QUATERNION]).numpy().T @ [wind, 0.0, 0.0]
        load = loads(model.p, v_r, omega, delta)[0, :6]
        powers.append(load[:3] @ v + load[3:] @ omega)
        energies.append(0.5 * p.mass * v @ v + 0.5 * omega @ J @ omega + p.mass * GRAVITY * height)
        heights.append(height)
    work = np.concatenate(([0.0], np.cumsum(0.5 * (np.array(powers[1:]) + powers[:-1]) * dt)))
    left = np.array(energies) - energies[0] - work
    assert heights[-1] > 40.0
    assert np.abs(work).max() > 1000.0
    assert np.abs(left).max() < 2e-3 * np.abs(work).max()


@pytest.mark.parametrize("name", ["aerosonde", "zagi"])
@pytest.mark.slow
def test_no_attitude_or_airspeed_is_a_nan(name, single, make_model):
    """10 s of reversed full deflections from rest, level and nose up, a tail slide, inverted flight, flight backward,
    edgewise and at an angle of attack of 135 deg, and spins of 6 rad/s; in a wind of the cruising airspeed.
    """
    model = make_model(name, 0.02, 5, autopilot=SURFACES)
    cruise = model.cruise.airspeed
    begin = [  # roll, pitch, velocity over ground as parts of cruise, spin (rad/s)
        (0.0, 0.0, (0.0, 0.0, 0.0), 0.0),
        (0.0, math.pi / 2, (0.0, 0.0, 0.0), 0.0),
        (0.0, math.pi / 2, (-1.0, 0.0, 0.0), 0.0),
        (math.pi, 0.0, (1.0, 0.0, 0.0), 0.0),
        (0.0, 0.0, (-1.0, 0.0, 0.0), 0.0),
        (0.0, 0.0, (0.0, 1.0, 0.0), 0.0),
        (0.0, 0.0, (-0.7, 0.0, 0.7), 0.0),
        (0.5, -1.2, (0.4, 0.0, 0.4), 6.0),
    ]
    angles = np.array([[(roll, pitch, 0.0)] for roll, pitch, _, _ in begin])
    v, spins = (np.array([[x] for x in column]) for column in list(zip(*begin, strict=True))[2:])
    team = flight(model, {"speed": cruise, "direction_deg": 90.0, "turbulence": "dryden"}, len(begin))
    team.put((0.0, 0.0, -400.0), angles, cruise * v, spins[..., None] * [1.0, 0.0, 1.0])
    for k in range(100):
        team.step([1.0 if k // 5 % 2 else -1.0] * 4)
        assert torch.isfinite(team.state).all() and torch.isfinite(team.aux).all(), k
    assert torch.allclose(team.state[..., QUATERNION].norm(dim=-1), torch.ones(len(begin), 1), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("actions", ["guidance", "altitude"])
def test_reversals_of_full_stick_leave_the_aerosonde_flying(actions, single, make_model):
    """100 flights of 60 s in 30 kt with turbulence, every demand at one of its ends and drawn anew each second: no
    stall, load factors within their limits but for 10 % of a gust's, no airspeed above the largest, never knife edge.
    """
    model = make_model("aerosonde", 0.02, 5, autopilot={"actions": actions, "protection": True})
    team = flight(model, {"speed": 15.4, "turbulence": "dryden"}, envs=100, height=300.0)
    draw, limits = torch.Generator().manual_seed(1), model.p.envelope
    for k in range(600):
        if k % 10 == 0:
            action = torch.randint(2, (100, 1, 3), generator=draw) * 2.0 - 1.0
        team.step(action)
        team.state[..., 2].clamp_(-400.0, -200.0)  # in the same turbulence throughout
        assert team.fleet.reading("stall_time").max() == 0.0
        n = team.fleet.reading("load_factor")
        assert 1.2 * limits.n_min < n.min() and n.max() < 1.1 * limits.n_max
        assert team.fleet.reading("airspeed").max() < limits.max_airspeed
        assert team.fleet.down_b[..., 2].min() > 0.4  # cos phi cos theta


@pytest.mark.slow
def test_single_precision_flies_like_double(make_model, bench):
    """20 s of turns, climbs and airspeeds of the autopilot, in steady wind: 5 cm, 1 mm/s and 0.01 deg."""
    flown = {}
    for precision in ("f64", "f32"):
        runtime.init(precision=precision, threads=1)
        team = flight(make_model("aerosonde", 0.02, 5), {"speed": 8.0, "direction_deg": 200.0})
        for k in range(200):
            team.step([math.sin(0.05 * k), math.cos(0.03 * k), 0.5 * math.sin(0.02 * k)])
        flown[precision] = team.state[0, 0].double()
    runtime.init()
    apart = (flown["f64"] - flown["f32"]).abs()
    assert (flown["f64"][POSITION] - torch.tensor([0.0, 0.0, -100.0])).norm() > 100.0
    assert apart[POSITION].max() < 0.05
    assert apart[VELOCITY].max() < 1e-3
    assert apart[QUATERNION].max() < 1e-4


@pytest.mark.slow
def test_a_dump_of_any_environment_replays_to_the_bit(single, tmp_path):
    """The turbulence around an aircraft is counted by its environment: a replay, alone, must meet the same."""
    world = World.from_scenario("aerosonde", 4, ("sea.realisations=1", "sea.components=2"), teams=("uav",))
    team, action = world.teams["uav"], torch.zeros(4, 3, 3)
    world.place("uav", torch.arange(4), cruising(4, 3))
    world.step({"uav": action})
    world.dump_folder = tmp_path
    team.state[2, 0, VELOCITY] = 1e38  # finite, and its square is not
    world.step({"uav": action})
    (file,) = tmp_path.glob("*.dump")
    again = replay(load_dump(file)).teams["uav"].state[0]
    assert not torch.isfinite(again[0]).all()
    assert torch.equal(again[1:], team.state[2, 1:])


def cruising(envs, count):
    """States [env, vehicle, 13] 100 m up, 50 m apart."""
    state = torch.zeros((envs, count, STATE_SIZE))
    state[..., 1], state[..., 2], state[..., 3] = 50.0 * torch.arange(count), -100.0, 1.0
    return state


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ({"longitudinal": {"C_m_alpha": 2.0}}, "unstable in pitch.*C_m_alpha = 2"),
        ({"actuators": {"elevator_limit_deg": 10.0}}, "min_airspeed = 17: no steady flight.*elevator at its lower"),
    ],
)
def test_an_aircraft_that_its_autopilot_cannot_fly_is_refused(numbers, told, f64, make_model):
    with pytest.raises(ConfigError, match=told):
        make_model("aerosonde", **numbers)


@pytest.mark.parametrize("flight", [(math.inf, 0.0), (math.nan, 0.0), (25.0, math.nan), (25.0, math.radians(200.0))])
def test_a_trim_that_means_nothing_is_refused(flight, f64, make_model):
    with pytest.raises(ValueError, match="must"):
        trim(make_model("aerosonde").p, *flight)
