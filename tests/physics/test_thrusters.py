"""Thrusters of a hull by name: what each does, and how they share a wanted wrench.

The barge with two azimuth thrusters aft and two tunnels forward; wrenches are read off the right-hand side.
"""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state
from taichi_sim.config import ConfigError
from taichi_sim.usv.hull.allocation import components, pseudo_inverse, reach
from taichi_sim.vehicles import load_vehicle

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


def barge(actions="units", actuators=SET, **changes):
    return load_vehicle("barge", 0.02, 5, actions=actions, thrusters=None, actuators=actuators, **changes)


def made(model, controls):
    """Load (N, N m, about CO) [n, 6] of the thrusters at rest, from the accelerations that it gives."""
    controls = np.atleast_2d(controls)
    rest = pack_state(np.zeros((len(controls), 6)))
    gained = model.rhs(rest, controls) - model.rhs(rest, 0 * controls)
    return gained[:, 7:] @ (model.params.M_rb + model.params.M_a)


def settled(model, bench, actions):
    """Controls [n, control] after actions [n, action] have been held for 20 s."""
    team = bench(model, envs=len(actions)).step(torch.as_tensor(np.array(actions))[:, None], 200)
    return torch.stack([team.fleet.reading(name)[:, 0] for name in model.control_names], -1).numpy()


def column(team, name):
    return team.fleet.reading(name)[:, 0].numpy()


# -- one thruster -------------------------------------------------------------------------------------------------


def test_each_pushes_where_it_points(bench):
    """[T c, T s, 0, -z T s, z T c, x T s - y T c] for every unit at both ends of its speed, turned to an angle."""
    model = barge()
    assert model.action_names == ("port", "starboard", "bow_1", "bow_2", "port_angle", "starboard_angle")
    for k, (name, unit) in enumerate(SET.items()):
        for share, turned in ((1.0, 0.3), (-1.0, -0.8)):
            action = np.zeros(6)
            action[k], action[4:] = share, turned
            controls = settled(model, bench, [action])
            thrust = unit["thrust_max"] if share > 0 else unit["thrust_min"]
            angle = math.radians(unit.get("direction_deg", turned * 180.0))
            (x, y, z), c, s = unit["position"], math.cos(angle), math.sin(angle)
            expected = thrust * np.array([c, s, 0.0, -z * s, z * c, x * s - y * c])
            assert made(model, controls)[0] == pytest.approx(expected, rel=1e-9, abs=1e-7), name


def test_a_speed_follows_by_its_own_lag(bench):
    team = bench(barge())
    for step in range(1, 9):
        team.step([0.5, -1.0, 1.0, 0.0, 0.0, 0.0])
        aft, bow = (-math.expm1(-0.1 * step / lag) for lag in (0.4, 0.1))
        assert column(team, "shaft_port") == pytest.approx(0.5 * 80.0 * aft, rel=1e-12)
        assert column(team, "shaft_starboard") == pytest.approx(-80.0 * aft, rel=1e-12)
        assert column(team, "shaft_bow_1") == pytest.approx(bow, rel=1e-12)  # a share: no n_max is given
        assert column(team, "thrust_bow_1") == pytest.approx(180.0 * bow**2, rel=1e-12)


def test_one_that_turns_takes_its_time_and_the_shorter_way(bench):
    """All round: 170 degrees and back to -170 through 180. Within -100 and 170 degrees: the only way there is."""
    limited = {**SET, "starboard": {**SET["starboard"], "range_deg": [-100.0, 170.0]}}
    team = bench(barge(actuators=limited))
    for step in range(1, 71):  # 30 deg/s: 170 degrees in 5.67 s
        team.step([0.0, 0.0, 0.0, 0.0, 170 / 180, 1.0])
        for name in ("angle_port", "angle_starboard"):
            assert column(team, name) == pytest.approx(math.radians(min(3.0 * step, 170.0)), rel=1e-9)
    expected = {4: ([178.0], [158.0]), 10: ([-170.0], [140.0]), 100: ([-170.0], [-100.0])}
    for step in range(1, 101):
        team.step([0.0, 0.0, 0.0, 0.0, -170 / 180, -1.0])
        if step == 4:
            expected[4] = ([-178.0], [158.0])
        if step in expected:
            for name, degrees in zip(("angle_port", "angle_starboard"), expected[step], strict=True):
                assert np.degrees(column(team, name)) == pytest.approx(degrees, rel=1e-9), (step, name)


def test_gains_and_lags_vary_by_name(bench):
    """A unit at half its thrust, and one that is slower, in an environment of its own; commands do not know."""
    model, team = barge(), bench(barge(), envs=2)
    assert {"actuators.port.gain", "actuators.bow_2.lag"} <= set(model.varying)
    team.fleet.set_numbers({"actuators.port.gain": [[1.0], [0.5]], "actuators.bow_2.lag": [[0.1], [1.0]]})
    team.step([1.0, 1.0, 1.0, 1.0, 0.0, 0.0], 10)
    for name in ("port", "starboard"):
        whole, other = column(team, f"thrust_{name}")
        assert other == pytest.approx(whole * (0.5 if name == "port" else 1.0), rel=1e-12)
    assert column(team, "shaft_bow_2") == pytest.approx([-math.expm1(-10.0), -math.expm1(-1.0)], rel=1e-12)


def test_two_propellers_are_two_units_that_push_ahead(bench):
    """The Otter's motion in a turn is the same either way of writing them; and [thrusters] takes the new actions too."""
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


def test_a_wrench_is_made_as_it_is_asked_for(bench):
    """Any that the set can make, to rounding, once the azimuth thrusters have turned."""
    model, rng = barge("wrench"), np.random.default_rng(3)
    actions = rng.uniform(-0.45, 0.45, (40, 3))
    most, least = np.array(model.wrench_max), np.array(model.wrench_min)
    found = made(model, settled(model, bench, actions))[:, PLANE]
    assert found == pytest.approx(np.where(actions > 0, actions * most, -actions * least), rel=1e-9, abs=1e-6)
    assert most == pytest.approx([600.0, 420.0, 828.0], rel=0.5) and (least < -100.0).all()


def test_more_than_they_can_make_is_less_of_the_same_direction(bench):
    """At a corner of the box of actions some unit is at its limit, and none beyond; the greatest of each alone is made."""
    model = barge("wrench")
    most, least = np.array(model.wrench_max), np.array(model.wrench_min)
    corners = np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).reshape(3, -1).T
    corners = corners[np.abs(corners).sum(axis=1) > 0].astype(float)
    controls = settled(model, bench, corners)
    found = made(model, controls)[:, PLANE]
    wanted = np.where(corners > 0, corners * most, -corners * least)
    share = np.einsum("nj,nj->n", found / most, wanted / most) / np.square(wanted / most).sum(axis=1)
    assert found == pytest.approx(share[:, None] * wanted, rel=1e-9, abs=1e-6)
    alone = np.abs(corners).sum(axis=1) == 1
    assert share[alone] == pytest.approx(1.0, rel=1e-9) and (share <= 1 + 1e-9).all() and share.min() < 0.7
    speeds = np.abs(controls[:, :4] / [80.0, 80.0, 1.0, 1.0]).max(axis=1)
    assert speeds[share < 1 - 1e-9] == pytest.approx(1.0, rel=1e-9) and (speeds <= 1 + 1e-9).all()


def test_the_work_is_shared_by_what_each_can_do():
    """Of all ways to make a wrench, the least sum of squared shares of the greatest thrust: f / f_max^2 = B^T lambda."""
    units = barge("wrench").units
    share, B = pseudo_inverse(units), reach(units)
    most = np.array([units[k].thrust_max for k, _ in components(units)])
    assert B @ share == pytest.approx(np.eye(3), abs=1e-12)
    weighted = share / most[:, None] ** 2
    assert B.T @ np.linalg.lstsq(B.T, weighted, rcond=None)[0] == pytest.approx(weighted, abs=1e-12 * weighted.max())


def test_one_that_turns_half_round_pushes_the_other_way(bench):
    """Range 180 degrees and thrust either way: every direction is made, and no angle leaves the range."""
    half = {name: unit | ({"range_deg": [-90.0, 90.0]} if "port" in name or "star" in name else {})
            for name, unit in SET.items()}  # fmt: skip
    model, rng = barge("wrench", half), np.random.default_rng(4)
    actions = rng.uniform(-0.35, 0.35, (40, 3))
    controls = settled(model, bench, actions)
    most, least = np.array(model.wrench_max), np.array(model.wrench_min)
    wanted = np.where(actions > 0, actions * most, -actions * least)
    assert made(model, controls)[:, PLANE] == pytest.approx(wanted, rel=1e-9, abs=1e-6)
    assert np.abs(controls[:, 4:]).max() <= math.pi / 2 + 1e-12 and controls[:, 0].min() < -1.0


def test_while_it_turns_it_never_pushes_the_wrong_way(bench):
    """From full ahead to full astern: the push ahead falls to nothing, and none is to the side that is not asked for."""
    model = barge("wrench")
    team = bench(model).step([1.0, 0.0, 0.0], 50)
    assert column(team, "ahead_port") == pytest.approx(300.0, rel=1e-4)
    for step in range(100):
        team.step([-1.0, 0.0, 0.0])
        if step > 30:  # lags of 0.4 s
            assert column(team, "ahead_port") < 1.0
    assert column(team, "ahead_port") == pytest.approx(model.wrench_min[0] / 2, rel=1e-4)
    power = model.power(team.fleet)[0, 0].item()
    pushed = sum(float(column(team, f"ahead_{name}")[0]) for name in ("port", "starboard"))
    assert power == pytest.approx(pushed * float(team.state[0, 0, 7]), rel=1e-3) and power > 0


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
