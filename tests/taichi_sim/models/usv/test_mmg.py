"""The MMG model in the plane and on panels: closed forms and invariants.

Its manoeuvres against published ones are in test_trials.py.
"""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state
from taichi_sim.config import AirConfig, ConfigError
from taichi_sim.models.usv.mmg import DERIVATIVES

pytestmark = pytest.mark.usefixtures("f64")
NAME, DT = "kvlcc2", 0.05
SCALE = 45.7
VACUUM = {"frontal_area": 0.0, "lateral_area": 0.0}


def _state(u, v, r, psi=0.3):
    return pack_state([1.0, 2.0, 0.0, 0.0, 0.0, psi], [u, v, 0.0, 0.0, 0.0, r])


def _sail(model, bench, action, seconds, velocity=(1.0, 0.0, 0.0), envs=1, current=None, air=None):
    """The bench after `seconds` of `action`, and positions [step, env, 3] on the way."""
    team = bench(model, envs=envs, air=air)
    if current is not None:
        team.current[:] = torch.as_tensor(np.array(current))
    team.put((0.0, 0.0, 0.0), (0.0, 0.0, 0.3), velocity)
    places = []
    for _ in range(round(seconds / model.dt)):
        team.step(action)
        places.append(team.read().position)
    return team, np.array(places)


@pytest.mark.parametrize(("name", "rudder", "n", "u"), [("turn_35", 35.0, 10.0, 1.0), ("turn_-20", -20.0, 12.0, 1.179)])
def test_an_independent_code_turns_alike(name, rudder, n, u, make_model, bench, columns):
    """Without x_G and wake, which that code has in another form, and with the resistance that it was given."""
    table = columns(f"kvlcc2/{name}.csv")
    model = make_model(NAME, DT, 1, x_G=0.0, hull={"R_0": 0.022}, propeller={"w_P0": 0.0, "C_1": 0.0, "n_ahead": 12.0},
                       windage=VACUUM)  # fmt: skip
    team = bench(model).put(velocity_b=(u, 0.0, 0.0))
    team.aux[..., 7], team.aux[..., 8] = n, math.radians(rudder)
    found = [np.zeros(6)]
    for _ in table.t[1:]:
        motion = team.step((n / 12.0, rudder / 35.0), 40).read()
        found.append(np.concatenate((motion.position[0, :2], motion.euler[0, 2:], motion.nu[0, [0, 1, 5]])))
    found, psi = np.array(found), table.psi[1:]
    assert np.abs(found[1:, [0, 1]] - np.stack((table.x, table.y), 1)[1:]).max() < 1e-5  # m, after 120 s
    assert np.abs(np.angle(np.exp(1j * (found[1:, 2] - psi)))).max() < 1e-6
    assert np.abs(found[1:, 3:] - np.stack((table.u, table.v, table.r), 1)[1:]).max() < 1e-6


@pytest.mark.usefixtures("anything_goes")
def test_without_loads_a_hull_keeps_its_energy(make_model):
    """Of equal added mass ahead and abeam: what differs between them is the Munk moment, a part of N_v."""
    hull = dict.fromkeys(DERIVATIVES, 0.0) | {"R_0": 1e-12, "m_x": 0.1, "m_y": 0.1}
    rudder = {"area": 1e-12}
    propeller = {"k_0": 1e-9, "k_1": 0.0, "k_2": 0.0, "n_ahead": 1e-3}
    model = make_model(NAME, DT, 1, hull=hull, rudder=rudder, propeller=propeller, windage=VACUUM)
    p, rng = model.constants, np.random.default_rng(1)
    for u, v, r in rng.uniform(-1, 1, (20, 3)):
        rate = model.rhs(_state(u, v, r), [0.0, 0.2])[0]
        M = np.array([[p.m11, 0, 0], [0, p.m22, p.m23], [0, p.m23, p.m33]])
        assert np.array([u, v, r]) @ M @ rate[[7, 8, 12]] == pytest.approx(0.0, abs=1e-8 * p.m22)


@pytest.mark.slow
def test_a_ship_of_another_scale_moves_alike(make_model, bench):
    """By Froude: lengths as the scale, speeds and times as its root, whatever the density."""
    small = make_model(NAME, DT, 1, windage=VACUUM)
    p, k, root = small.params, SCALE, math.sqrt(SCALE)
    sizes = {key: k * getattr(p, key) for key in ("length", "beam", "draft", "height", "x_G", "gyration")}
    large = make_model(
        NAME, DT * root, 1, **sizes, density=1025.0, displacement=k**3 * p.displacement,
        propeller={"diameter": k * p.propeller.diameter, "n_ahead": p.propeller.n_ahead / root,
                   "n_astern": p.propeller.n_astern / root, "rate": p.propeller.rate / k},
        rudder={"area": k**2 * p.rudder.area, "span": k * p.rudder.span, "rate_deg": p.rudder.rate_deg / root},
        windage=VACUUM,
    )  # fmt: skip
    for action in ((1.0, 1.0), (-1.0, -0.4)):
        _, model_scale = _sail(small, bench, action, 40.0)
        _, full_scale = _sail(large, bench, action, 40.0 * root, (root, 0.0, 0.0))
        assert full_scale / k == pytest.approx(model_scale, abs=1e-7)
        assert np.ptp(model_scale[:, 0, 1]) > 1.0


def test_a_symmetric_ship_turns_alike_to_both_sides(make_model, bench):
    alike = {"gamma_R_positive": 0.5, "gamma_R_negative": 0.5}
    model = make_model(NAME, DT, 1, propeller={"C_2_positive": 1.3, "C_2_negative": 1.3}, rudder=alike)
    _, places = _sail(model, bench, np.array([[[1.0, 1.0]], [[1.0, -1.0]]]), 60.0, envs=2)
    ahead, right = np.array([math.cos(0.3), math.sin(0.3), 0.0]), np.array([-math.sin(0.3), math.cos(0.3), 0.0])
    assert places[:, 0] @ ahead == pytest.approx(places[:, 1] @ ahead, abs=1e-9)
    assert places[:, 0] @ right == pytest.approx(-places[:, 1] @ right, abs=1e-9)
    assert (places[-1, 0] @ right) > 7.0


def test_water_that_moves_carries_the_ship_along(make_model, bench):
    """And air that moves with it is still air to it."""
    model, V = make_model(NAME, DT, 1), np.array([0.4, -0.3])
    ground = model.rhs(_state(1.0, -0.2, 0.1), [8.0, 0.3], wind=[-V[0], -V[1], 0.0])
    c, s = math.cos(0.3), math.sin(0.3)
    u_c, v_c = c * V[0] + s * V[1], c * V[1] - s * V[0]
    moved = model.rhs(_state(1.0 + u_c, -0.2 + v_c, 0.1), [8.0, 0.3], current=V)
    assert moved[0, [7, 8]] - ground[0, [7, 8]] == pytest.approx([0.1 * v_c, -0.1 * u_c])  # nu_c turns in b
    _, still = _sail(model, bench, (0.8, 0.5), 30.0)
    _, carried = _sail(
        model, bench, (0.8, 0.5), 30.0, (1.0 + u_c, v_c, 0.0), current=[V], air=AirConfig(
            speed=0.5, direction_deg=math.degrees(math.atan2(0.3, -0.4)), profile="uniform"))  # fmt: skip
    t = DT * np.arange(1, len(still) + 1)[:, None, None]
    assert carried[..., :2] - still[..., :2] == pytest.approx(np.broadcast_to(V * t, still[..., :2].shape), abs=1e-9)


def test_a_straight_run_has_the_speed_of_its_closed_form(make_model, bench):
    model = make_model(NAME, 0.25, 1, windage=VACUUM)
    n = model.params.propeller.n_ahead
    assert model.limits.speeds[2] == pytest.approx(1.179, abs=1e-5)
    assert model.params.revolutions(model.params.steady_speed(0.6 * n)) == pytest.approx(0.6 * n)
    team, _ = _sail(model, bench, (0.6, 0.0), 1000.0)
    assert team.read().nu[0, 0] == pytest.approx(model.params.steady_speed(0.6 * n), rel=1e-5)
    assert team.read().nu[0, [1, 5]] == pytest.approx(0.0, abs=1e-12)


def test_rudder_and_shaft_follow_by_rate_and_lag(make_model, bench):
    model = make_model(NAME, DT, 1)
    p = model.params
    team = bench(model).put()
    team.step((1.0, 1.0), 20)
    assert team.aux[0, 0, 7].item() == pytest.approx(p.propeller.rate)
    assert team.aux[0, 0, 8].item() == pytest.approx(math.radians(p.rudder.rate_deg))
    team.step((1.0, 1.0), 400)
    assert team.aux[0, 0, [7, 8]].numpy() == pytest.approx([p.propeller.n_ahead, model.helm_max])
    lagged = make_model(
        NAME, DT, 1, propeller={"time_constant": 2.0, "rate": 1e3}, rudder={"time_constant": 1.5, "rate_deg": 1e3}
    )
    team = bench(lagged).put().step((0.5, -0.5), 60)
    wanted = [0.5 * p.propeller.n_ahead * (1 - math.exp(-3 / 2.0)), -0.5 * model.helm_max * (1 - math.exp(-3 / 1.5))]
    assert team.aux[0, 0, [7, 8]].numpy() == pytest.approx(wanted)


def test_short_steps_tend_to_the_right_hand_side(make_model, bench):
    rng, envs = np.random.default_rng(6), 12
    model = make_model(NAME, 1e-8, 1)
    team = bench(model, envs=envs, air=AirConfig(speed=3.0, profile="uniform"))
    controls, action = rng.uniform(-8, 8, (envs, 2)) * (1.0, 0.05), rng.uniform(-1, 1, (envs, 1, 2))
    load, current = rng.uniform(-20, 20, (envs, 6)), rng.uniform(-1, 1, (envs, 2))
    team.current[:], team.fleet.load[:, 0] = torch.from_numpy(current), torch.from_numpy(load)
    nu = rng.uniform(-1, 1, (envs, 6)) * (1, 1, 0, 0, 0, 1)
    team.state[:, 0] = torch.from_numpy(pack_state(rng.uniform(-1, 1, (envs, 6)) * (1, 1, 0, 0, 0, 1), nu))
    model.reset_aux(team.aux, team.state, team.around)
    team.aux[:, 0, 7:9] = torch.from_numpy(controls)
    before = team.state[:, 0].numpy().copy()
    expected = model.rhs(before, controls, current, [-3.0, 0.0, 0.0], load)
    after = team.step(action).state[:, 0].numpy()
    assert ((after - before) / 1e-8)[:, [0, 1, 7, 8, 12]] == pytest.approx(
        expected[:, [0, 1, 7, 8, 12]], rel=1e-4, abs=2e-6
    )


def test_it_stops_without_a_jump_and_drags_against_any_motion(make_model):
    """Loads are continuous through rest, and astern as ahead the hull's work is a loss."""
    model = make_model(NAME, DT, 1)
    for direction in np.linspace(-math.pi, math.pi, 73):
        u, v = math.cos(direction), math.sin(direction)
        slow, fast = (model.rhs(_state(k * u, k * v, 0.0), [0.0, 0.0])[0, [7, 8, 12]] for k in (1e-4, 1.0))
        assert np.abs(slow).max() < 1e-6
        assert u * fast[0] < 0 or abs(math.degrees(direction)) % 180 > 60
    near = [model.rhs(_state(0.3, -0.2, 0.05), [n, 0.4])[0] for n in (-1e-9, 1e-9)]
    assert near[0] == pytest.approx(near[1], abs=1e-9)


def _varied(model, bench, envs=1, vary=None):
    """Final states [env, 13] after turns to both sides in wind, ahead and astern."""
    team = bench(model, envs=envs, air=AirConfig(speed=4.0, direction_deg=70.0)).put(velocity_b=(0.8, 0.0, 0.0))
    for key, values in (vary or {}).items():
        team.fleet.set_numbers({key: values})
    for action in ((0.9, 0.6), (0.7, -1.0), (-0.5, 0.3)):
        team.step(action, 60)
    return team.state[:, 0].numpy().copy()


@pytest.mark.slow
def test_an_environment_is_what_a_vehicle_file_of_its_numbers_is(make_model, bench):
    """And each number does something: environment k has number k changed, the last has them all changed."""
    lags = {"propeller": {"time_constant": 0.4, "rate": 3.0}, "rudder": {"time_constant": 0.3}}
    model = make_model(NAME, 0.1, 1, **lags, windage={"frontal_area": 0.5, "lateral_area": 2.0})
    keys, n = model.varying, len(model.varying)
    factors = dict(zip(keys, np.linspace(1.01, 1.2, n), strict=True))
    changed = {key: factors[key] * value for key, value in model.nominal.items()}
    vary = {}
    for k, key in enumerate(keys):
        vary[key] = torch.full((n + 2, 1), model.nominal[key], dtype=torch.float64)
        vary[key][[k + 1, -1]] = changed[key]
    states = _varied(model, bench, n + 2, vary)
    other = type(model)(model.with_numbers(changed), model.dt, 1)
    assert states[0] == pytest.approx(_varied(model, bench)[0], abs=1e-9)
    assert states[-1] == pytest.approx(_varied(other, bench)[0], abs=1e-9)
    moved = np.abs(states[1:-1] - states[0]).max(axis=1)
    assert not [key for key, by in zip(keys, moved, strict=True) if by < 1e-6]


def test_numbers_that_cannot_be_are_refused(make_model):
    for section, values, told in (
        ("propeller", {"diameter": 0.5}, "must be at most rudder.span"),
        ("rudder", {"rate_deg": 0.0}, "rudder.rate_deg"),
        ("hull", {"R_0": -0.02}, "hull.R_0"),
        ("propeller", {"count": 3}, "propeller.count"),
    ):
        with pytest.raises(ConfigError, match=told):
            make_model(NAME, DT, 1, **{section: values})


# -- in six degrees of freedom --------------------------------------------------------------------------------------

SIX = "kvlcc2_6dof"


def _on_panels(make_model, propeller=None, rudder=None):
    """The ship on panels, with all forces and its centre of gravity at the waterline: nothing heels or trims it."""
    parts = {"hull": {"z": 0.0}, "propeller": {"z": 0.0, **(propeller or {})}, "rudder": {"z": 0.0, **(rudder or {})}}
    return make_model(SIX, 0.02, 1, rigid_body={"cg": [0.25, 0.0, 0.0]}, mmg=parts)


def test_on_panels_its_loads_are_those_in_the_plane(make_model):
    """Of two propellers and rudders, which lie in the centreline here."""
    rng, count = np.random.default_rng(4), {"count": 2}
    plane = make_model(NAME, 0.02, 1, density=1025.0, propeller=count, rudder=count)
    panels = _on_panels(make_model, propeller=count, rudder=count)
    assert panels.limits.speeds[2] == pytest.approx(plane.limits.speeds[2])
    for _ in range(16):
        nu, (n, delta) = rng.uniform(-1, 1, 3) * (1.2, 0.4, 0.1), rng.uniform(-1, 1, 2) * (10.0, 0.6)
        level = pack_state([0.0, 0.0, 0.0, 0.0, 0.0, 0.3], [nu[0], nu[1], 0.0, 0.0, 0.0, nu[2]])
        found = panels.rhs(level, [n, n, delta], current=[0.2, -0.1])[0, [7, 8, 12]]
        assert found == pytest.approx(plane.rhs(level, [n, delta], current=[0.2, -0.1])[0, [7, 8, 12]], abs=1e-5)


@pytest.mark.slow
def test_on_panels_it_turns_as_in_the_plane(make_model, bench):
    """In calm water, as far as the second-order step allows, and its shaft and rudder follow alike."""
    action, found = np.array([[[1.0, 1.0]], [[0.6, -0.4]]]), []
    for model in (make_model(NAME, 0.02, 1, density=1025.0), _on_panels(make_model)):
        team = bench(model, envs=2).put((0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (1.179, 0.0, 0.0), settle=True)
        motion = team.step(action, 1000).read()
        controls = [team.fleet.reading(name)[:, 0].numpy() for name in ("propeller", "rudder", "thrust")]
        found.append((motion.position[:, :2], motion.nu[:, [0, 1, 5]], np.array(controls)))
    for there, here, within in zip(*found, (1e-3, 1e-4, 1e-3), strict=True):
        assert here == pytest.approx(there, abs=within)
    assert np.hypot(*found[0][0].T).min() > 14.0  # m


@pytest.mark.slow
def test_a_mirrored_ship_with_two_propellers_and_rudders_moves_mirrored(make_model, bench):
    """Also by its propellers alone; and a ship heels outwards in a turn."""
    side = {"C_2_positive": 1.3, "C_2_negative": 1.3, "count": 2, "y": 0.2, "diameter": 0.15}
    blades = {"gamma_R_positive": 0.5, "gamma_R_negative": 0.5, "count": 2, "y": 0.2}
    model = make_model(SIX, 0.04, 1, mmg={"propeller": side, "rudder": blades})
    assert model.action_names == ("propeller_left", "propeller_right", "rudder")
    action = np.array([[[0.9, 0.3, 0.7]], [[0.3, 0.9, -0.7]], [[1.0, 0.2, 0.0]]])
    team = bench(model, envs=3).put((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.8, 0.0, 0.0), settle=True)
    motion = team.step(action, 500).read()
    assert motion.position[0] * (1, -1, 1) == pytest.approx(motion.position[1], abs=1e-9)
    assert motion.euler[0] * (-1, 1, -1) == pytest.approx(motion.euler[1], abs=1e-9)
    assert motion.nu[0] * (1, -1, 1, -1, 1, -1) == pytest.approx(motion.nu[1], abs=1e-9)
    assert motion.euler[0, 0] < -1e-3 and motion.euler[0, 2] > 0.3  # to port in a turn to starboard
    assert motion.euler[2, 2] > 3e-3  # the left propeller pushes the bow to starboard


@pytest.mark.slow
def test_on_panels_an_environment_is_what_a_vehicle_file_of_its_numbers_is(make_model, bench):
    model = make_model(SIX, 0.05, 1)
    keys = [key for key in model.varying if key.startswith("mmg.")]
    changed = {key: 1.1 * model.nominal[key] for key in keys}
    vary = {key: torch.tensor([[model.nominal[key]], [changed[key]]], dtype=torch.float64) for key in keys}
    states = _varied(model, bench, 2, vary)
    other = type(model)(model.with_numbers(changed), model.dt, 1)
    assert states[0] == pytest.approx(_varied(model, bench)[0], abs=1e-9)
    assert states[1] == pytest.approx(_varied(other, bench)[0], abs=1e-9)
    assert np.abs(states[1] - states[0]).max() > 1e-3


@pytest.mark.parametrize(("changes", "told"), [
    ({"actions": "wrench"}, 'with \\[mmg\\] write actions = "propeller_rudder"'),
    ({"hydrodynamics": {"quadratic": [5.0, 0.0, 0.0, 0.0, 0.0, 9.0]}}, r"quadratic\[0\], quadratic\[5\]: must be 0"),
    ({"hydrodynamics": {"cross_flow_length": 7.0}}, "cross_flow_length: must be 0"),
    ({"mmg": {"rudder": {"y": 0.3}}}, "rudder.y = 0.3 is the distance of two"),
    ({"mmg": {"propeller": {"diameter": 0.5}}}, "must be at most rudder.span"),
    ({"mmg": {"rudder": {"flap": 0.3}}}, "mmg.rudder.flap"),
    ({"actuators": {"bow": {"position": [3.0, 0.0, 0.3], "thrust_max": 9.0, "thrust_min": -9.0, "lag": 1.0}}},
     "give either \\[mmg\\]"),
])  # fmt: skip
def test_propellers_and_rudders_that_cannot_be_on_panels_are_refused(changes, told, make_model):
    with pytest.raises(ConfigError, match=told):
        make_model(SIX, 0.02, 1, **changes)
