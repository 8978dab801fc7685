"""Multirotors in flight: what is conserved, steady wind, water below, battery, numbers of their own, endings."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, WorldConfig
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.world import World
from tests.probes import ground_ratios

pytestmark = pytest.mark.usefixtures("f64")
DT, SUBSTEPS = 0.02, 5
ROTORS = {"control": {"actions": "rotors"}}
GUST = {"amplitude": (1.0, 2.0, -3.0), "start_time": 1.0, "rise_time": 0.5}
AIR = AirConfig.model_validate({"speed": 6.0, "direction_deg": 200.0, "profile": "log", "gust": GUST})
WIND = AirConfig.model_validate({"speed": 8.0, "direction_deg": 30.0, "profile": "uniform"})
LOAD = (0.4, -0.3, 0.5, 0.02, 0.03, -0.02)  # N, N m


@pytest.fixture(scope="module")
def x500(f64, make_model):
    """The shipped x500."""
    return make_model("x500", DT, SUBSTEPS)


# -- what is conserved -------------------------------------------------------------------------------------------------


def test_momentum_in_a_vacuum_is_that_of_weight_and_load(make_model):
    """No air: momentum gains the impulse of weight and load; angular momentum, that of the rotors included, that of the
    load's moment, while the rotors speed up and slow down; by Simpson's rule.
    """
    fine, times = 0.005, 100
    model = make_model("x500", fine, 1, **ROTORS)
    team = Bench(model).put((0.0, 0.0, -500.0), (0.3, -0.4, 1.0), (3.0, 1.0, -2.0), (0.9, -0.6, 0.4))
    nothing = {key: 0.0 for key in ("k_d", "k_z", "k_h", "k_flap")} | {"k_f": 1e-30, "k_m": 1e-30, "J_r": 4e-5}
    drag = {f"physical.drag.{k}": 0.0 for k in range(3)}
    team.fleet.set_numbers({f"rotor.{key}": value for key, value in nothing.items()} | drag)
    team.fleet.load[:] = torch.tensor(LOAD)
    body, (force, moment), J = model.p.physical, np.split(np.array(LOAD), 2), model.p.physical.inertia
    held, given = [], []
    for k in range(times + 1):
        state, omega = team.state[0, 0], team.aux[0, 0, -4:].numpy()
        R = torch_rotation_matrix(state[QUATERNION]).numpy()
        own = np.array([0.0, 0.0, -nothing["J_r"] * (omega[0] + omega[1] - omega[2] - omega[3])])
        angular = R @ (J @ state[ANGULAR_VELOCITY].numpy() + own)
        held.append(np.concatenate((body.mass * R @ state[VELOCITY].numpy(), angular)))
        given.append(np.concatenate((R @ force + [0.0, 0.0, body.mass * GRAVITY], R @ moment)))
        team.step(model.action(torch.tensor([900.0, 300.0, 200.0, 100.0 + 5.0 * k])))
    given, gained = np.array(given), held[-1] - held[0]
    total = fine / 3 * (given[0] + given[-1] + 4 * given[1:-1:2].sum(axis=0) + 2 * given[2:-1:2].sum(axis=0))
    assert np.abs(gained[:3] - total[:3]).max() < 1e-7 * np.abs(total[:3]).max()
    assert np.abs(gained[3:] - total[3:]).max() < 2e-5 * np.abs(held[0][3:]).max()
    assert np.abs(own).max() > 0.3 * np.abs(held[-1][3:]).max()  # the rotors have their part


def test_a_steady_wind_is_nothing_to_the_flight(make_model):
    """Galilei: in a uniform wind a flight by its rotors is that in still air, carried along."""
    model = make_model("x500", DT, SUBSTEPS, **ROTORS)
    still, windy = Bench(model), Bench(model, air=WIND)
    wind = np.array([-8.0 * math.cos(math.radians(30.0)), -8.0 * math.sin(math.radians(30.0)), 0.0])
    for team, carried in ((still, 0.0 * wind), (windy, wind)):
        team.put((0.0, 0.0, -200.0))
        R = torch_rotation_matrix(team.state[0, 0, QUATERNION]).numpy()
        team.state[0, 0, VELOCITY] = torch.tensor(R.T @ (carried + [1.0, 2.0, 0.0]))
        team.aux[0, 0, -4:] = torch.tensor(model.allocation.hover)
    for k in range(15):
        action = [0.1 * math.sin(k), 0.05, 0.1 * math.cos(k), 0.1]
        still.step(action)
        windy.step(action)
    assert windy.position - still.position == pytest.approx(1.5 * wind, abs=1e-9)
    assert windy.state[..., 3:7].numpy() == pytest.approx(still.state[..., 3:7].numpy(), abs=1e-10)
    assert windy.fleet.reading("airspeed").item() == pytest.approx(still.fleet.reading("airspeed").item(), abs=1e-9)
    assert np.abs(still.euler).max() > 0.2


def test_it_begins_in_hover_over_ground_whatever_the_wind(x500):
    """Settled at rest, or on its way, it stays so: attitude, rotors and integrals are those of the wind."""
    for velocity, action in (((0.0, 0.0, 0.0), 0.0), ((4.0, 0.0, 0.0), 0.4)):
        team = Bench(x500, air=WIND).put((5.0, -3.0, -40.0), (0.0, 0.0, 1.0), velocity, settle=True)
        start, tilt = team.position.copy(), team.euler
        team.step((action, 0.0, 0.0, 0.0), 50)
        assert team.position - start == pytest.approx(
            5.0 * velocity[0] * np.array([math.cos(1), math.sin(1), 0]), abs=1e-6
        )
        assert team.euler == pytest.approx(tilt, abs=1e-6)
        assert np.abs(tilt[:2]).max() > 0.05


def test_in_a_wind_that_it_cannot_hold_it_begins_blown_away_but_sound(x500):
    team = Bench(x500, air=AirConfig(speed=45.0, profile="uniform")).put((0.0, 0.0, -60.0), settle=True)
    team.step((0.0,) * 4, 30)
    assert team.state.isfinite().all() and team.aux.isfinite().all()
    assert team.fleet.reading("outside_time").item() == pytest.approx(3.0)
    assert team.velocity[0] < -2.0


def test_short_steps_tend_to_the_right_hand_side(make_model):
    """In wind, near the water, under a load."""
    fine = 1e-8
    model, rng = make_model("x500", fine, 1, **ROTORS), np.random.default_rng(3)
    team = Bench(model, envs=8)
    state = team.state[:, 0]
    state[:] = torch.tensor(rng.uniform(-1, 1, state.shape))
    state[:, 2] = torch.tensor(rng.uniform(-0.5, -0.2, 8))
    state[:, 3] = 2.0
    state[:, 3:7] /= state[:, 3:7].norm(dim=1, keepdim=True)
    speeds, wind = rng.uniform(400, 900, (8, 4)), rng.uniform(-5, 5, (8, 3))
    team.aux[:, 0, -4:], team.wind[:] = torch.tensor(speeds), torch.tensor(wind)
    team.fleet.load[:] = torch.tensor(LOAD)
    before = state.numpy().copy()
    team.step(model.action(torch.tensor(speeds))[:, None])
    expected = model.rhs(before, speeds, wind=wind, load=LOAD)
    away = model.rhs(before - [0, 0, 100.0, *[0] * 10], speeds, wind=wind, load=LOAD)
    scale = np.abs(expected).max(axis=0)
    assert (np.abs((state.numpy() - before) / fine - expected) <= 2e-5 * scale + 2e-7).all()
    assert np.abs(expected - away)[:, 9].max() > 0.1  # the water is felt


# -- water below -------------------------------------------------------------------------------------------------------


def test_ground_effect_is_that_of_the_wave_below(x500, single_wave):
    """Above a crest and above a trough of 0.4 m the instrument is the formula at the height there."""
    a, length, height = 0.4, 60.0, 0.6
    for phase, rise in ((0.0, a), (math.pi, -a)):
        team = Bench(x500, sea=single_wave(length, a, phase=phase)).put((0.0, 0.0, -height), settle=True)
        team.step((0.0,) * 4)
        hubs = -team.position[2] - x500.p.arms[:, 2] - rise
        speeds = team.aux[0, 0, -4:].numpy()
        ours = ground_ratios(x500.p, hubs[None], 1.0, speeds)
        assert team.fleet.reading("ground_effect").item() == pytest.approx(ours.mean(), rel=3e-3)
        assert ours.mean() > (1.04 if rise > 0 else 1.0)


def test_ground_effect_fades_with_height_speed_and_at_an_edge(x500):
    p, hub = x500.p, x500.p.rotor.radius
    heights = hub * np.linspace(0.3, 20.0, 4000)[:, None] * np.ones(4)
    ratio = ground_ratios(p, heights, 1.0, 770.0)[:, 0]
    assert (np.diff(ratio) <= 1e-12).all() and np.abs(np.diff(ratio)).max() < 0.01  # no step anywhere
    assert ratio[heights[:, 0] > 16.0 * hub].max() == 1.0
    assert (np.diff(ratio[heights[:, 0] < 0.5 * hub]) == 0).all()  # held where the formula is not valid
    still, fast = (ground_ratios(p, np.full((1, 4), hub), 1.0, 770.0, speed)[0, 0] for speed in (0.0, x500.induced))
    induced2 = p.rotor.k_f * 770.0**2 / (2 * p.physical.rho * math.pi * hub**2)
    assert 1 - 1 / fast == pytest.approx((1 - 1 / still) * induced2 / (induced2 + x500.induced**2))
    part, none = (ground_ratios(p, np.full((1, 4), hub), w, 770.0)[0] for w in ([1.0, 1.0, 0.0, 0.0], 0.0))
    assert (none == 1.0).all()
    assert 1.0 < part[2] < part[0] < still  # a rotor beyond the edge feels the images of the others


# -- battery -----------------------------------------------------------------------------------------------------------

BATTERY = {"capacity_mah": 5000.0, "full": 16.8, "empty": 13.2, "nominal": 16.0, "resistance": 0.05, "efficiency": 0.75}


def test_a_battery_falls_under_load_and_holds_the_rotors(make_model):
    """At full speed V (V_0 - V) / R = P at the speed that V allows; charge goes with the current."""
    model = make_model("x500", DT, SUBSTEPS, battery=BATTERY, **ROTORS)
    team = Bench(model).put((0.0, 0.0, -50.0))
    team.step((1.0,) * 4, 10)
    used, taken = 1.0 - team.fleet.reading("charge").item(), []
    for _ in range(10):
        team.step((1.0,) * 4)
        V, P = team.fleet.reading("voltage").item(), team.fleet.reading("shaft_power").item() / 0.75
        taken.append(P / V)
    charge = team.fleet.reading("charge").item()
    V_0 = 13.2 + 3.6 * charge
    given = V * (V_0 - V) / 0.05
    assert given == pytest.approx(P, rel=1e-3)
    assert team.aux[0, 0, -1].item() == pytest.approx(1000.0 * V / 16.0, rel=1e-3)
    assert (1.0 - charge - used) * 18000.0 == pytest.approx(np.mean(taken), rel=1e-3)  # a second's
    assert 0.5 < V / 16.0 < 0.95
    team.fleet.reading("charge").zero_()
    team.step((1.0,) * 4, 10)
    assert team.fleet.reading("charge").item() == 0.0
    assert team.fleet.reading("voltage").item() < 13.2


# -- numbers of their own ----------------------------------------------------------------------------------------------


def others(model):
    """Another value for every number that varies: by factors from 1.002 up, and a small one where there is none."""
    factors = 1 + 0.002 * np.arange(1, len(model.varying) + 1)
    small = {"physical.Jxy": 5e-4, "physical.Jxz": 6e-4, "physical.Jyz": 7e-4, "rotor.k_flap": 3e-6, "rotor.k_h": 3e-3}
    return {k: v * x or small.get(k, 0.004 * x) for x, (k, v) in zip(factors, model.nominal.items(), strict=True)}


def fly(model, values=None, envs=1):
    """Four seconds of turns and climbs near the water through a gust, under a load; varied where there are `values`."""
    team = Bench(model, air=AIR, envs=envs).put((0.0, 0.0, -1.2), settle=True)
    if values is not None:
        team.fleet.set_numbers(values)
    team.fleet.load[:] = torch.tensor(LOAD)
    for k in range(40):
        team.step([0.4 * np.sin(0.5 * k), 0.3 * np.cos(0.3 * k), -0.1, 0.5 * np.cos(0.2 * k)])
    return team


@pytest.mark.slow
def test_varied_numbers_are_those_of_a_file(x500):
    """By the same controller, that of the drawing board; to rounding."""
    values = others(x500)
    own = Multirotor6DOF(x500.with_numbers(values), DT, SUBSTEPS, design=x500.params)
    ours, theirs = fly(x500, values), fly(own)
    assert torch.allclose(ours.state, theirs.state, rtol=0, atol=1e-8)
    assert torch.allclose(ours.aux, theirs.aux, rtol=0, atol=1e-6)


def test_every_number_does_something(x500):
    keys, envs = x500.varying, len(x500.varying) + 1
    values = {key: torch.full((envs, 1), value, dtype=torch.float64) for key, value in x500.nominal.items()}
    for k, (key, value) in enumerate(others(x500).items(), 1):
        values[key][k] = value
    state = fly(x500, values, envs=envs).state[:, 0]
    moved = (state[1:] - state[0]).abs().amax(dim=1)
    nothing = {key for key, far in zip(keys, moved.tolist(), strict=True) if not far > 1e-7}
    assert nothing == {"legs.stiffness", "legs.damping"}, "which count on a deck: test_contact.py"


def test_nan_in_one_aircraft_leaves_its_neighbours_bits(x500):
    healthy, sick = fly(x500, envs=3), Bench(x500, air=AIR, envs=3).put((0.0, 0.0, -1.2), settle=True)
    sick.state[1, 0, 8] = math.nan
    sick.fleet.load[:] = torch.tensor(LOAD)
    for k in range(40):
        sick.step([0.4 * np.sin(0.5 * k), 0.3 * np.cos(0.3 * k), -0.1, 0.5 * np.cos(0.2 * k)])
    assert torch.isnan(sick.state[1]).any()
    assert torch.equal(sick.state[[0, 2]], healthy.state[[0, 2]])


# -- turbulence, endings -----------------------------------------------------------------------------------------------


def test_it_holds_its_place_in_turbulence(x500):
    """Dryden at 20 m in 15 kt: 200 hover for 20 s; velocity's standard deviation well below the gusts'."""
    air = AirConfig(speed=7.72, turbulence="dryden")
    team = Bench(x500, air=air, envs=200).put((0.0, 0.0, -20.0), settle=True)
    speeds, met = [], []
    for k in range(200):
        team.step((0.0,) * 4)
        if k >= 50:
            speeds.append(team.fleet.velocity_n[:, 0].clone())
            met.append(torch.stack([team.fleet.reading(name)[:, 0] for name in x500.air], dim=-1))
    speeds, met = torch.stack(speeds), torch.stack(met)
    gusts = met.std(dim=(0, 1))
    assert (gusts > torch.tensor([0.6, 0.6, 0.4])).all()
    assert (speeds.std(dim=(0, 1)) < 0.35 * gusts).all()
    assert speeds.abs().max() < 2.0
    assert not team.fleet.reading("outside_time").any()


def endings_of(state, seconds=0.0):
    """What ends an x500 placed at `state`, after having been outside its model for so long."""
    team = {"vehicle": "x500", "count": 1}
    world = World(WorldConfig.model_validate({"sea": {"hs": 1e-3, "tp": 4.0, "realisations": 1}, "drones": team}), 1)
    fleet = world.teams["drones"]
    fleet.state[0, 0, :7] = torch.tensor(state)
    fleet.reading("outside_time").fill_(seconds)
    fleet.update()
    return {name for name, found in fleet.model.endings(fleet, world).items() if bool(found.all())}


def test_it_ends_in_the_water_feet_first_or_by_its_side(x500):
    level, side = (1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
    feet, half = x500.p.body.below, 0.5 * x500.size[0]
    assert endings_of((0.0, 0.0, -feet - 0.01, *level)) == set()
    assert endings_of((0.0, 0.0, -feet + 0.01, *level)) == {"ditched"}
    assert endings_of((0.0, 0.0, -half - 0.01, *side)) == set()
    assert endings_of((0.0, 0.0, -half + 0.01, *side)) == {"ditched"}
    assert endings_of((0.0, 0.0, -9.0, *level), seconds=3.2) == {"outside_model"}


@pytest.mark.parametrize(
    ("euler", "velocity"),
    [
        ((math.pi - 0.1, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 7.0)),
        ((0.0, 0.0, 0.0), (18.0, 0.0, 0.0)),
    ],
    ids=["upside down", "into its own wake", "too fast"],
)
def test_it_notes_where_the_model_does_not_hold(euler, velocity, make_model):
    model = make_model("x500", DT, SUBSTEPS, **ROTORS)
    team = Bench(model).put((0.0, 0.0, -300.0), euler, velocity)
    fine = Bench(model).put((0.0, 0.0, -300.0), velocity_b=(5.0, 0.0, 0.0))
    for bench in (team, fine):
        bench.aux[0, 0, -4:] = torch.tensor(model.allocation.hover)
        bench.step((0.0,) * 4)
    assert team.fleet.reading("outside_time").item() == pytest.approx(0.1)
    assert fine.fleet.reading("outside_time").item() == 0.0
    assert team.state[0, 0, POSITION].isfinite().all()
