"""Steady flight, linear models and modes of fixed-wing aircraft."""

import json
import math

import numpy as np
import pytest

from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, QUATERNION, VELOCITY
from taichi_sim.models.uav.fixed_wing.airframe_arrays import rhs
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import Mode, TrimError, linear_modes, rk4_limit, trim

pytestmark = pytest.mark.usefixtures("f64")
DRAG = {"A_mavsim_verbatim_CDp0": {"C_D_p": 0.0, "C_D_delta_e": 0.0135}, "B_CDp0.043_CDde0": {}}
CASES = [
    ("aerosonde", 25.0, {}),
    ("aerosonde", 25.0, {"gamma": 0.1}),
    ("aerosonde", 22.0, {"gamma": -0.08, "turn_radius": 120.0}),
    ("aerosonde", 28.0, {"turn_rate": -0.3}),
    ("zagi", 12.0, {}),
    ("zagi", 13.0, {"gamma": 0.05, "turn_radius": -60.0}),
]


def aircraft(name, **sections):
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml")
    data.pop("model")
    return validate(FixedWingParams, data | {k: data[k] | v for k, v in sections.items()}, name)


@pytest.fixture(scope="module", params=DRAG)
def exact(request, reference):
    """A variant: its aircraft, and exact figures of an independent code."""
    data = json.loads((reference / "aerosonde" / "trim_and_modes_Va25.json").read_text())
    return aircraft("aerosonde", longitudinal=DRAG[request.param]), data[request.param]


def test_level_trim_of_an_independent_code(exact):
    p, table = exact
    found, given = trim(p, 25.0), table["trim"]
    for name in ("elevator", "aileron", "rudder", "throttle"):
        assert getattr(found, name) == pytest.approx(given[name], abs=1e-9)
    for name in ("alpha", "phi", "theta"):
        assert getattr(found, name) == pytest.approx(given[f"{name}_rad"], abs=1e-9)
    assert (found.thrust, found.torque) == pytest.approx((given["thrust_N"], given["prop_torque_Nm"]), rel=1e-9)


def test_linear_model_of_an_independent_code(exact):
    p, table = exact
    model = linear_modes(p, trim(p, 25.0))
    for name, ours in (("A_lon_u_w_q_theta", model.A_lon), ("B_lon_elev_thr", model.B_lon),
                       ("A_lat_v_p_r_phi", model.A_lat), ("B_lat_ail_rud", model.B_lat)):  # fmt: skip
        assert ours == pytest.approx(np.array(table[name]), abs=1e-6)
    for name in ("short_period", "phugoid", "dutch_roll"):
        mode, given = model.modes[name], table["modes"][name]
        assert mode.frequency == pytest.approx(given["wn"], rel=1e-3)
        assert mode.damping == pytest.approx(given["zeta"], rel=5e-3)
    assert model.modes["roll"].time_constant == pytest.approx(table["modes"]["roll"]["tau_s"], rel=1e-3)
    doubling = -model.modes["spiral"].time_constant * math.log(2)
    assert doubling == pytest.approx(table["modes"]["spiral"]["t_double_or_half_s"], rel=1e-3)


def ground_velocity(state):
    w, r = state[3], state[4:7]
    v = state[VELOCITY]
    return v + 2 * w * np.cross(r, v) + 2 * np.cross(r, np.cross(r, v))


@pytest.mark.parametrize(("name", "Va", "flight"), CASES)
def test_a_trim_is_steady_and_flies_what_was_asked(name, Va, flight):
    p = aircraft(name)
    found = trim(p, Va, **flight)
    d = rhs(p, found.state[None], found.controls[None])[0]
    assert np.abs(d[7:]).max() < 1e-10
    v_n = ground_velocity(found.state)
    assert np.linalg.norm(v_n) == pytest.approx(Va, rel=1e-12)
    assert -v_n[2] == pytest.approx(Va * math.sin(found.gamma), abs=1e-12)
    # it turns about the vertical: the world sees a rate straight down
    spun = ground_velocity(np.concatenate((found.state[:7], found.state[ANGULAR_VELOCITY])))
    assert spun == pytest.approx([0.0, 0.0, found.turn_rate], abs=1e-12)
    if "turn_radius" in flight:
        assert np.linalg.norm(v_n[:2]) / found.turn_rate == pytest.approx(flight["turn_radius"], rel=1e-12)
    assert (found.beta == 0) == (name == "aerosonde") or not found.turn_rate


def test_thrust_balances_drag_and_weight_in_a_straight_climb():
    """T cos(alpha) - D = m g sin(gamma), with D from the polar at the trim's angle of attack."""
    p = aircraft("aerosonde")
    lon, body = p.longitudinal, p.physical
    for gamma in (-0.1, 0.0, 0.12):
        found = trim(p, 24.0, gamma)
        C_L = lon.C_L_0 + lon.C_L_alpha * found.alpha
        drag = 0.5 * 1.2682 * 24.0**2 * 0.55 * (0.043 + C_L**2 / (math.pi * 0.9 * 2.8956**2 / 0.55))
        # the bank that holds the propeller's torque (< 0.1 deg) tilts the path's vertical by 1e-6
        climb = found.thrust * math.cos(found.alpha) - drag
        assert climb == pytest.approx(body.mass * GRAVITY * math.sin(gamma), abs=1e-4)


def test_coordinated_turn():
    """No side force: turn_rate (u cos(phi) cos(theta) + w sin(theta)) = g sin(phi) cos(theta)."""
    p = aircraft("aerosonde", lateral={"C_Y_delta_a": 0.0, "C_Y_delta_r": 0.0})
    found = trim(p, 25.0, turn_rate=0.2)
    u, _, w = found.state[VELOCITY]
    inward = 0.2 * (u + w * math.tan(found.theta) / math.cos(found.phi))
    assert math.tan(found.phi) == pytest.approx(inward / GRAVITY, rel=1e-10)


def test_wind_changes_only_the_velocity_over_the_ground():
    p, wind = aircraft("aerosonde"), np.array([3.0, -5.0, 0.5])
    still, windy = trim(p, 25.0, turn_radius=150.0), trim(p, 25.0, turn_radius=150.0, wind=wind)
    assert windy.controls == pytest.approx(still.controls) and windy.state[QUATERNION] == pytest.approx(
        still.state[QUATERNION]
    )
    assert ground_velocity(windy.state) - ground_velocity(still.state) == pytest.approx(wind, abs=1e-12)


@pytest.mark.parametrize(
    ("Va", "flight", "limit"),
    [
        (9.0, {}, "stall"),
        (12.0, {}, "elevator at its lower limit"),
        (45.0, {}, "throttle at its upper limit"),
        (25.0, {"gamma": 0.6}, "throttle at its upper limit"),
        (25.0, {"gamma": -0.6}, "throttle"),
        (16.0, {"turn_rate": 1.2}, "stall"),
    ],
)
def test_a_trim_that_is_not_names_what_stands_in_its_way(Va, flight, limit):
    with pytest.raises(TrimError, match=f"no steady flight at {Va:g} m/s.*{limit}"):
        trim(aircraft("aerosonde"), Va, **flight)


def test_contradictory_requests_are_refused():
    p = aircraft("aerosonde")
    with pytest.raises(ValueError, match="give one"):
        trim(p, 25.0, turn_radius=100.0, turn_rate=0.2)
    with pytest.raises(ValueError, match="must not be zero"):
        trim(p, 25.0, turn_radius=0.0)
    with pytest.raises(ValueError, match="must be positive"):
        trim(p, 0.0)


def test_limits_of_rk4():
    """2.785 on the negative real axis (Hairer & Wanner 1996, sec. IV.2), 2 sqrt(2) on the imaginary one."""
    assert rk4_limit(-4.0) * 4.0 == pytest.approx(2.7853, abs=2e-4)
    assert rk4_limit(complex(-1e-9, 5.0)) * 5.0 == pytest.approx(2 * math.sqrt(2), abs=2e-3)


def test_figures_of_a_mode():
    pair = Mode("pair", (complex(-3, 4), complex(-3, -4)))
    assert (pair.frequency, pair.damping, pair.oscillates) == (5.0, 0.6, True)
    assert pair.time_constant == pytest.approx(1 / 3)
    growing = Mode("real", (0.5 + 0j,))
    assert (growing.time_constant, growing.damping, growing.oscillates) == (-2.0, -1.0, False)
