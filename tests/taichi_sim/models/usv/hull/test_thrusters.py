"""Thrusters of a hull by name: what each does, and how they share a wanted wrench.

The barge with two azimuth thrusters aft and two tunnels forward; wrenches are read off the right-hand side.
"""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state
from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.thruster_set import components, pseudo_inverse, reach

pytestmark = pytest.mark.usefixtures("f64")

AZIMUTH = {"thrust_max": 300.0, "thrust_min": -150.0, "n_max": 80.0, "turn_rate_deg": 30.0, "lag": 0.4}
TUNNEL = {"direction_deg": 90.0, "thrust_max": 180.0, "thrust_min": -120.0, "lag": 0.1}
SET = {
    "port": {"position": [-1.8, -0.6, 0.4], **AZIMUTH},
    "starboard": {"position": [-1.8, 0.6, 0.4], **AZIMUTH},
    "bow_1": {"position": [1.4, 0.0, 0.3], **TUNNEL},
    "bow_2": {"position": [1.8, 0.0, 0.3], **TUNNEL, "thrust_max": 90.0, "thrust_min": -90.0},
}
PLANE = [0, 1, 5]


LIMITED = SET | {"starboard": SET["starboard"] | {"range_deg": [-100.0, 170.0]}}
ENVS = 40  # of all that share a kernel


def barge(actions="units", actuators=LIMITED):
    water = {"radiation": "constant"}
    return load_vehicle("barge", 0.02, 5, actions=actions, thrusters=None, actuators=actuators, hydrodynamics=water)


def made(team):
    """X, Y, N [env, 3] of the thrusters, from what each says that it pushes."""
    total = np.zeros((team.fleet.num_envs, 3))
    for (x, y, _), (ahead, right, _) in team.model.thrusters.arrows.values():
        X, Y = (0.0 if name is None else column(team, name) for name in (ahead, right))
        total += np.stack(np.broadcast_arrays(X, Y, x * Y - y * X), axis=-1)
    return total


def settled(model, bench, actions):
    """A team after actions [n, action] have been held for 20 s, the first of them in what environments are left."""
    held = torch.as_tensor(np.array(actions)[[k if k < len(actions) else 0 for k in range(ENVS)]])
    return bench(model, envs=ENVS).step(held[:, None], 200)


def controls(team):
    """[env, control]"""
    return np.stack([column(team, name) for name in team.model.control_names], axis=-1)


def as_wrench(model, actions):
    """X, Y, N [n, 3] of actions."""
    return np.where(actions > 0, actions * model.wrench_max, -actions * np.array(model.wrench_min))


def column(team, name):
    return team.fleet.reading(name)[:, 0].numpy()


# -- one thruster -------------------------------------------------------------------------------------------------


def test_each_pushes_where_it_points(bench):
    """[T c, T s, 0, -z T s, z T c, x T s - y T c] of every unit at both ends of its speed, turned to an angle: M nu_dot
    of the hull at rest, and what the unit says of itself.
    """
    model = barge()
    assert model.action_names == ("port", "starboard", "bow_1", "bow_2", "port_angle", "starboard_angle")
    cases = [(k, share, turned) for k in range(4) for share, turned in ((1.0, 0.3), (-1.0, -0.8))]
    actions, expected = np.zeros((len(cases), 6)), []
    for action, (k, share, turned) in zip(actions, cases, strict=True):
        unit, (low, high) = list(LIMITED.values())[k], list(LIMITED.values())[k].get("range_deg", (-180.0, 180.0))
        action[k], action[4:] = share, turned
        thrust = unit["thrust_max"] if share > 0 else unit["thrust_min"]
        angle = math.radians(unit.get("direction_deg", low + 0.5 * (turned + 1) * (high - low)))
        (x, y, z), X, Y = unit["position"], thrust * math.cos(angle), thrust * math.sin(angle)
        expected.append([X, Y, 0.0, -z * Y, z * X, x * Y - y * X])
    team = settled(model, bench, actions)
    rest = pack_state(np.zeros((ENVS, 6)))
    gained = model.rhs(rest, controls(team)) - model.rhs(rest, np.zeros((ENVS, 6)))
    load = (gained[:, 7:] @ (model.params.M_rb + model.params.M_a))[: len(cases)]
    assert load == pytest.approx(np.array(expected), rel=1e-9, abs=1e-6)
    assert made(team)[: len(cases)] == pytest.approx(np.array(expected)[:, PLANE], rel=1e-9, abs=1e-6)


def test_a_speed_follows_by_its_own_lag(bench):
    team = bench(barge(), envs=ENVS)
    for step in range(1, 9):
        team.step([0.5, -1.0, 1.0, 0.0, 0.0, 0.0])
        aft, bow = (-math.expm1(-0.1 * step / lag) for lag in (0.4, 0.1))
        assert column(team, "shaft_port") == pytest.approx(0.5 * 80.0 * aft, rel=1e-12)
        assert column(team, "shaft_starboard") == pytest.approx(-80.0 * aft, rel=1e-12)
        assert column(team, "shaft_bow_1") == pytest.approx(bow, rel=1e-12)  # a share: no n_max is given
        assert column(team, "thrust_bow_1") == pytest.approx(180.0 * bow**2, rel=1e-12)


def test_one_that_turns_takes_its_time_and_the_shorter_way(bench):
    """All round: 170 degrees and back to -170 through 180. Within -100 and 170 degrees: the only way there is."""
    team = bench(barge(), envs=ENVS)
    for step in range(1, 71):  # 30 deg/s: 170 degrees in 5.67 s
        team.step([0.0, 0.0, 0.0, 0.0, 170 / 180, 1.0])
        for name in ("angle_port", "angle_starboard"):
            assert column(team, name) == pytest.approx(math.radians(min(3.0 * step, 170.0)), rel=1e-9)
    expected = {4: (-178.0, 158.0), 10: (-170.0, 140.0), 100: (-170.0, -100.0)}
    for step in range(1, 101):
        team.step([0.0, 0.0, 0.0, 0.0, -170 / 180, -1.0])
        if step in expected:
            found = np.degrees([column(team, name)[0] for name in ("angle_port", "angle_starboard")])
            assert found == pytest.approx(expected[step], rel=1e-9), step


def test_gains_and_lags_vary_by_name():
    """What kernels work with is that of a vehicle file of those numbers."""
    model = barge()
    for values in ({"actuators.port.gain": 0.5}, {"actuators.bow_2.lag": 1.0, "actuators.bow_1.gain": 0.0}):
        row = torch.tensor(list((model.nominal | values).values()), dtype=torch.float64)
        other = type(model)(model.with_numbers(values), model.dt, model.substeps).constants
        assert model.numbers(row).numpy() == pytest.approx(np.array(other), rel=1e-12) and other != model.constants


@pytest.mark.slow
def test_two_propellers_are_two_units_that_push_ahead(bench):
    """The Otter's motion in a turn is the same either way of writing them; [thrusters] takes the new actions too."""
    pair = load_vehicle("otter", 0.02, 5, actions="left_right")
    t = pair.params.thrusters
    each = {"thrust_max": t.thrust_max, "thrust_min": t.thrust_min, "n_max": t.n_max, "n_min": t.n_min, "lag": t.lag}
    units = {"left": {"position": t.left, **each}, "right": {"position": t.right, **each}}
    models = pair, load_vehicle("otter", 0.02, 5, actions="units", thrusters=None, actuators=units)
    models += (load_vehicle("otter", 0.02, 5, actions="units"),)
    states = [bench(model).step([0.9, -0.4], 100).state[0, 0].numpy() for model in models]
    assert states[1] == pytest.approx(states[0], abs=1e-9) and (states[2] == states[0]).all()
    assert models[1].aux_names == models[0].aux_names and models[1].limits == models[0].limits
    wrench = load_vehicle("otter", 0.02, 5, actions="wrench")
    assert wrench.wrench_max == pytest.approx([2 * t.thrust_max, 0.0, -2 * 0.395 * t.thrust_min])  # astern is the less


# -- all of them ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_wrench_is_made_as_it_is_asked_for(bench):
    """Any that the set can make, to rounding, once the azimuth thrusters have turned."""
    model, rng = barge("wrench", SET), np.random.default_rng(3)
    actions = rng.uniform(-0.45, 0.45, (ENVS, 3))
    assert made(settled(model, bench, actions)) == pytest.approx(as_wrench(model, actions), rel=1e-9, abs=1e-6)


@pytest.mark.slow
def test_more_than_they_can_make_is_less_of_the_same_direction(bench):
    """Where a corner of the box of actions is too much, some unit is at its limit; the most of each alone is made."""
    model = barge("wrench", SET)
    corners = np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).reshape(3, -1).T
    corners = corners[np.abs(corners).sum(axis=1) > 0].astype(float)
    team, most = settled(model, bench, corners), np.array(model.wrench_max)
    found, wanted = made(team)[: len(corners)], as_wrench(model, corners)
    share = np.einsum("nj,nj->n", found / most, wanted / most) / np.square(wanted / most).sum(axis=1)
    assert found == pytest.approx(share[:, None] * wanted, rel=1e-9, abs=1e-6)
    alone = np.abs(corners).sum(axis=1) == 1
    assert share[alone] == pytest.approx(1.0, rel=1e-9) and (share <= 1 + 1e-9).all() and share.min() < 0.7
    speeds = np.abs(controls(team)[: len(corners), :4] / [80.0, 80.0, 1.0, 1.0]).max(axis=1)
    assert speeds[share < 1 - 1e-9] == pytest.approx(1.0, rel=1e-9) and (speeds <= 1 + 1e-9).all()


def test_the_work_is_shared_by_what_each_can_do():
    """Of all ways to make a wrench, the least sum of squared shares of the greatest thrusts: f / f_max^2 = B^T l."""
    thrusters = barge("wrench", SET).thrusters.thrusters
    share, B = pseudo_inverse(thrusters), reach(thrusters)
    most = np.array([thrusters[k].thrust_max for k, _ in components(thrusters)])
    assert B @ share == pytest.approx(np.eye(3), abs=1e-12)
    weighted = share / most[:, None] ** 2
    assert B.T @ np.linalg.lstsq(B.T, weighted, rcond=None)[0] == pytest.approx(weighted, abs=1e-12 * weighted.max())


@pytest.mark.slow
def test_one_that_turns_half_round_pushes_the_other_way(bench):
    """In a range of 180 degrees with thrust either way every direction is made, and no angle leaves the range."""
    half = {name: unit | ({"range_deg": [-90.0, 90.0]} if "port" in name or "star" in name else {})
            for name, unit in SET.items()}  # fmt: skip
    model, rng = barge("wrench", half), np.random.default_rng(4)
    actions = rng.uniform(-0.35, 0.35, (ENVS, 3))
    team = settled(model, bench, actions)
    assert made(team) == pytest.approx(as_wrench(model, actions), rel=1e-9, abs=1e-6)
    assert np.abs(controls(team)[:, 4:]).max() <= math.pi / 2 + 1e-12 and controls(team)[:, 0].min() < -1.0


def test_while_it_turns_it_never_pushes_the_wrong_way(bench):
    """From full ahead to full astern: the push ahead falls to nothing, with the lag of 0.4 s, before one astern."""
    model = barge("wrench", SET)
    team = bench(model, envs=ENVS).step([1.0, 0.0, 0.0], 50)
    assert column(team, "ahead_port") == pytest.approx(300.0, rel=1e-4)
    for step in range(100):
        team.step([-1.0, 0.0, 0.0])
        assert column(team, "ahead_port").max() < (300.0 if step < 30 else 1.0)
    assert column(team, "ahead_port") == pytest.approx(model.wrench_min[0] / 2, rel=1e-4)
    power = model.power(team.fleet)[0, 0].item()
    pushed = sum(float(column(team, f"ahead_{name}")[0]) for name in ("port", "starboard"))
    assert power == pytest.approx(pushed * float(team.state[0, 0, 7]), rel=1e-3) and abs(power) > 0


def test_arrows_of_a_recording():
    """Where each pushes from, and the columns that say how much ahead and to starboard."""
    forces = barge().forces
    assert forces["thrust_port"] == ((-1.8, -0.6, 0.4), ("ahead_port", "starboard_port", None))
    assert forces["thrust_bow_2"] == ((1.8, 0.0, 0.3), (None, "thrust_bow_2", None))


# -- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"actions": "surge_yaw"}, ('actions = "surge_yaw"', "[thrusters]", '"wrench"')),
        ({"thrusters": {"left": [0, -0.5, 0]}}, ("thrusters",)),
        ({"actuators": {"bow": {**SET["bow_1"], "position": [2.3, 0, 0]}}}, ("actuators.bow.position", "2.2 m")),
        ({"actuators": {"bow": {**SET["bow_1"], "range_deg": [-9.0, 9.0]}}}, ("actuators.bow", "turn_rate_deg")),
        ({"actuators": {"bow": {**SET["bow_1"], "trust_max": 2.0}}}, ("bow.trust_max", "thrust_max")),
        ({"actuators": {f"t{k}": SET["bow_1"] for k in range(9)}}, ("actuators", "8")),
        (
            {"actions": "wrench", "actuators": {"aft": {**SET["port"], "range_deg": [-35.0, 35.0]}}},
            ("actuators.aft", "range_deg", '"units"'),
        ),
    ],
)
def test_what_is_no_thruster_is_refused_by_name(change, words):
    given = {"actions": "units", "thrusters": None, "actuators": SET} | change
    with pytest.raises(ConfigError) as caught:
        load_vehicle("barge", 0.02, **given)
    for word in words:
        assert word in str(caught.value), f"{word!r} is not in: {caught.value}"


def test_named_thrusters_in_the_section_of_two_propellers_are_told_where_to_go(tmp_path):
    with pytest.raises(ConfigError, match=r"\[actuators.bow\]"):
        load_vehicle("barge", 0.02, thrusters={"bow": SET["bow_1"]})
