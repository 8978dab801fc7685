"""A multirotor's controller: allocation and what saturation spares, bandwidths, tracking, and vehicle files refused."""

import math

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import ConfigError
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.uav.multirotor.controller import allocate, allocation, effectiveness

pytestmark = pytest.mark.usefixtures("f64")
DT, SUBSTEPS = 0.02, 5


def ring(count, radius=0.3, offset=0.0, first=0.3):
    """Rotors on a circle, their spins alternating, its centre `offset` (m) ahead."""
    angle = first + 2 * np.pi * np.arange(count) / count
    return [
        {"position": [offset + radius * math.cos(a), radius * math.sin(a), -0.05], "spin": ("ccw", "cw")[k % 2]}
        for k, a in enumerate(angle)
    ]


def in_line(count):
    """Rotors one behind the other."""
    return [mount | {"position": [0.3 * k - 0.45, 0.0, 0.0]} for k, mount in enumerate(ring(count))]


def coaxial():
    """Four arms with two rotors each, that turn against each other."""
    return [
        {"position": [x, y, z], "spin": spin}
        for x, y in ((0.2, 0.2), (-0.2, -0.2), (0.2, -0.2), (-0.2, 0.2))
        for z, spin in ((-0.08, "ccw"), (0.02, "cw"))
    ]


FRAMES = {
    "quadrotor": ring(4),
    "hexarotor": ring(6),
    "octorotor, cg off": ring(8, 0.4, 0.03),
    "coaxial": coaxial(),
    "twelve": ring(12),
}


def craft(**changes):
    """The x500 with other numbers."""
    return load_vehicle("x500", DT, SUBSTEPS, **changes)


# -- allocation --------------------------------------------------------------------------------------------------------


def allocated(p, wanted, low, high):
    """Thrusts [n, rotor] and parts [n, 2] of roll and pitch, and of yaw, for (T, M_x, M_y, M_z) [n, 4]."""
    a, count = allocation(p), len(p.rotors)
    f, parts = np.empty((len(wanted), count)), np.empty((len(wanted), 2))

    @ti.kernel
    def run(
        wanted: ti.types.ndarray(ndim=2), f: ti.types.ndarray(ndim=2), parts: ti.types.ndarray(ndim=2),
        low: float, high: float,
    ):  # fmt: skip
        for n in range(wanted.shape[0]):
            M = ti.Vector([wanted[n, 1], wanted[n, 2], wanted[n, 3]])
            given, turned, yawed = allocate(a, wanted[n, 0], M, low, high)
            parts[n, 0], parts[n, 1] = turned, yawed
            for k in ti.static(range(count)):
                f[n, k] = given[k]

    run(np.ascontiguousarray(wanted), f, parts, low, high)
    return f, parts


@pytest.mark.parametrize("frame", FRAMES)
def test_thrusts_give_what_is_asked_or_roll_and_pitch_first(frame):
    """Small demands exactly; large ones within bounds: the parts told are those given, roll and pitch in proportion,
    whole wherever some collective thrust holds them.
    """
    p = craft(rotors=FRAMES[frame], physical={"mass": 0.5 * len(FRAMES[frame])}).p
    B, high, rng = effectiveness(p), 9.0, np.random.default_rng(5)
    count, weight = len(p.rotors), p.physical.mass * GRAVITY
    small = np.array([weight, 0.0, 0.0, 0.0]) + rng.uniform(-1, 1, (50, 4)) * [2.0, 0.1, 0.1, 0.02]
    f, parts = allocated(p, small, 0.0, high)
    assert f @ B.T == pytest.approx(small, abs=1e-10)
    assert (parts == pytest.approx(1.0)) and f.min() > 0.0
    large = rng.uniform(-1, 1, (400, 4)) * [2 * high * count, 2.0 * count, 2.0 * count, 0.5 * count]
    f, parts = allocated(p, large, 0.0, high)
    given = f @ B.T
    assert f.min() >= 0.0 and f.max() <= high and parts.min() < 1.0
    assert given[:, 1:3] == pytest.approx(parts[:, :1] * large[:, 1:3], abs=1e-9)
    assert given[:, 3] == pytest.approx(parts[:, 1] * large[:, 3], abs=1e-9)
    alone = (np.array(allocation(p).P)[:, 1:3] @ large[:, 1:3].T).T / np.array(allocation(p).P)[:, 0]
    spread, room = np.ptp(alone, axis=1), high / np.array(allocation(p).P)[:, 0].max()
    assert (parts[spread < room, 0] == 1.0).all() and (parts[spread > room * 1.5, 0] < 1.0).all()
    fits = (parts[:, 0] == 1.0) & (parts[:, 1] < 1.0)
    assert fits.any()  # yaw gave way, roll and pitch did not


@pytest.mark.slow
@pytest.mark.parametrize(
    "frame",
    [name if name == "twelve" else pytest.param(name, marks=pytest.mark.slow) for name in FRAMES],
)
def test_any_frame_hovers_and_follows(frame):
    model = craft(
        rotors=FRAMES[frame],
        physical={"mass": 0.5 * len(FRAMES[frame])},
        envelope={"airspeed": 5.0, "max_airspeed": 10.0},
    )
    team = Bench(model).put((0.0, 0.0, -30.0), settle=True)
    team.step((0.0,) * 4, 10)
    assert team.position == pytest.approx([0.0, 0.0, -30.0], abs=1e-6)
    team.step((0.3, -0.2, -0.5, 0.0), 50)
    assert team.velocity == pytest.approx([3.0, -2.0, -1.5], abs=0.15)


# -- loops -------------------------------------------------------------------------------------------------------------


def amplitude(model, column, action, frequency, unit, periods=12):
    """Of a sinusoid of `frequency` (rad/s) through the loop: what of it arrives at the instrument."""
    team = Bench(model).put((0.0, 0.0, -100.0), settle=True)
    interval = model.dt * model.substeps
    steps = round(2 * np.pi * periods / frequency / interval)
    time, seen = interval * (0.5 + np.arange(steps)), []
    for t in time:
        team.step(np.array(action) * math.sin(frequency * t))
        seen.append(team.fleet.reading(column).item())
    late = time > time[-1] / 2
    basis = np.stack((np.sin(frequency * time[late]), np.cos(frequency * time[late]), np.ones(late.sum())), axis=1)
    found = np.linalg.lstsq(basis, np.array(seen)[late], rcond=None)[0]
    return float(np.hypot(*found[:2])) / unit


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x500", "t650"])
def test_bandwidths_are_those_told(name):
    """At the frequencies told, 1 / sqrt 2 of a small sinusoid arrives: rates, yaw rate, velocity, climb."""
    rates = load_vehicle(name, 0.005, 1, control={"actions": "rates"})
    velocity = load_vehicle(name, 0.005, 4)
    told, demands = rates.bandwidths, rates.demands
    for axis, k in (("roll", 1), ("pitch", 2)):
        action = 0.05 * np.eye(4)[k]
        found = amplitude(rates, f"{axis}_rate", action, told.rate, 0.05 * demands.rate)
        assert found == pytest.approx(math.sqrt(0.5), rel=0.06)
    found = amplitude(rates, "yaw_rate", 0.05 * np.eye(4)[3], told.yaw_rate, 0.05 * demands.yaw_rate)
    assert found == pytest.approx(math.sqrt(0.5), rel=0.06)
    told = velocity.bandwidths
    for column, k, frequency, unit in (
        ("north_velocity", 0, told.velocity, demands.speed),
        ("east_velocity", 1, told.velocity, demands.speed),
    ):
        found = amplitude(velocity, column, 0.02 * np.eye(4)[k], frequency, 0.02 * unit)
        assert found == pytest.approx(math.sqrt(0.5), rel=0.1)


def test_a_faster_controller_makes_faster_loops():
    """Gains follow from the lag; at 200 Hz the rate loop is that of PX4's order, some 25 rad/s."""
    slow, fast = (load_vehicle("x500", control={"rate_hz": rate}) for rate in (50.0, 200.0))
    assert fast.bandwidths.rate == pytest.approx(slow.bandwidths.rate * 0.02875 / 0.02125, rel=1e-2)
    assert 20.0 < fast.bandwidths.rate < 40.0
    assert any("loop of" in name for name in fast.signals)


@pytest.mark.parametrize("name", ["x500", "t650"])
def test_velocity_steps_are_followed(name):
    """Steps of half the range, nose anywhere: 90 % in 1.5 s, overshoot below 12 %, the other axes little disturbed."""
    team = Bench(load_vehicle(name, DT, SUBSTEPS)).put((0.0, 0.0, -100.0), (0.0, 0.0, 2.0), settle=True)
    for action, rise in (((0.5, 0.0, 0.0, 0.0), 1.5), ((0.5, -0.5, 0.0, 0.0), 1.5), ((0.5, -0.5, -0.5, 0.0), 1.5)):
        before, seen = told(team), []
        for _ in range(60):
            team.step(action)
            seen.append(told(team))
        wanted = np.array(action[:3]) * [10.0, 10.0, 3.0]
        seen, size = np.array(seen) - wanted, np.linalg.norm(wanted - before)
        assert np.linalg.norm(seen[round(rise * 10) - 1]) < 0.15 * size
        along = seen @ (wanted - before) / size
        assert along.max() < 0.12 * size
        assert np.linalg.norm(seen[-1]) < 0.04 * size  # an integral's tail
        across = np.linalg.norm(seen - np.outer(along, (wanted - before) / size), axis=1)
        assert across.max() < max(0.1 * size, 0.25)


def told(team):
    """Velocity [3] ahead, to the right and down, level and turned with the nose, m/s."""
    v, (c, s) = team.velocity, (math.cos(team.euler[2]), math.sin(team.euler[2]))
    return np.array([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]])


def test_a_turn_keeps_velocity_with_the_nose():
    """At 45 deg/s: a circle; drag, which turns with it, costs a tenth of the speed; sideways within 3 %."""
    team = Bench(load_vehicle("x500", DT, SUBSTEPS)).put((0.0, 0.0, -100.0), velocity_b=(5.0, 0.0, 0.0), settle=True)
    team.step((0.5, 0.0, 0.0, 0.5), 60)
    ahead = []
    for _ in range(80):
        team.step((0.5, 0.0, 0.0, 0.5))
        ahead.append(told(team))
    ahead = np.array(ahead)
    assert np.abs(np.linalg.norm(ahead, axis=1) - 5.0).max() < 0.5
    assert np.abs(ahead[:, 1]).max() < 0.15
    before = team.euler[2]
    team.step((0.5, 0.0, 0.0, 0.5), 10)
    assert (team.euler[2] - before) % (2 * math.pi) == pytest.approx(math.radians(45.0), rel=0.01)


def test_upside_down_it_comes_back():
    team = Bench(load_vehicle("x500", DT, SUBSTEPS)).put((0.0, 0.0, -200.0), settle=True)
    team.state[0, 0, 3:7] = torch.tensor([math.cos(1.45), math.sin(1.45), 0.0, 0.0])
    team.step((0.0,) * 4, 60)
    assert np.abs(team.euler[:2]).max() < 0.05
    assert np.abs(team.velocity).max() < 0.5


def test_rotor_actions_go_from_least_by_hover_to_greatest():
    model = craft(control={"actions": "rotors"}, rotor={"omega_min": 100.0})
    hover = np.array(model.allocation.hover)
    for action, speeds in (
        (-1.0, 100.0 + 0 * hover),
        (0.0, hover),
        (0.5, 0.5 * (hover + 1000.0)),
        (1.0, 1000.0 + 0 * hover),
    ):
        team = Bench(model).put()
        team.step((action,) * 4, 10)
        assert team.aux[0, 0, -4:].numpy() == pytest.approx(speeds, rel=1e-9)
        assert model.action(torch.tensor(speeds)).numpy() == pytest.approx(np.full(4, action))


# -- refused -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"physical": {"mass": 4.0}}, "thrust to weight is 0.871"),
        ({"physical": {"mass": 3.4}}, "thrust to weight is 1.03: a controller needs more than 1.11"),
        ({"rotors": [r | {"spin": "cw"} for r in ring(4)]}, "they cannot yaw: all turn the same way"),
        ({"rotors": in_line(4)}, "they cannot roll: their hubs lie in one line"),
        ({"rotors": ring(4)[:1] + ring(4)}, "rotors.0 and rotors.1 coincide"),
        ({"rotors": []}, "at least 1"),
        ({"rotors": ring(13)}, "at most 12"),
        ({"rotor": {"tau_up": 0.0}}, "rotor.tau_up = 0.0: input should be greater than 0"),
        ({"rotor": {"tau_down": -0.1}}, "rotor.tau_down = -0.1"),
        ({"rotor": {"omega_min": 1200.0}}, "omega_min = 1200: must be below omega_max = 1000"),
        ({"rotor": {"kf": 1.0}}, "rotor.kf"),
        ({"physical": {"cg": [0.3, 0.0, 0.0]}}, "hover asks it for"),
        ({"physical": {"Jz": 0.06}}, "none above the sum of the two others"),
        ({"envelope": {"max_airspeed": 30.0}}, "the rotors hold 17.4 m/s at most"),
        ({"control": {"speed": 20.0}}, "must not be above envelope.max_airspeed = 16"),
        ({"control": {"actions": "rate"}}, "control.actions = 'rate'"),
        ({"battery": {"capacity_mah": 1.0}}, "battery.full"),
    ],
)  # fmt: skip
def test_a_vehicle_that_cannot_fly_is_refused(changes, told):
    with pytest.raises(ConfigError) as caught:
        craft(**changes)
    assert told in str(caught.value) and "x500.toml" in str(caught.value)


def test_a_step_too_long_is_refused():
    with pytest.raises(ConfigError, match="the largest stable dt is"):
        load_vehicle("x500", 0.5, 1, rotor={"k_flap": 2e-4, "k_d": 5e-3}, control={"actions": "rotors", "speed": 1.0},
                     envelope={"airspeed": 1.0, "max_airspeed": 1.0})  # fmt: skip
