"""Forces and moments of fixed-wing aircraft: published figures, limits, symmetry."""

import json

import numpy as np
import pytest
import taichi as ti

from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY
from taichi_sim.models.uav.fixed_wing import airframe
from taichi_sim.models.uav.fixed_wing.airframe_arrays import lift_curve, loads, stall_angles
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams


def aircraft(name, **sections):
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml")
    data.pop("model")
    return validate(FixedWingParams, data | {k: data[k] | v for k, v in sections.items()}, name)


@pytest.fixture(scope="module")
def aerosonde(f64):
    return aircraft("aerosonde")


@pytest.fixture(scope="module")
def published(f64):
    return aircraft("aerosonde", longitudinal={"C_D_p": 0.0, "C_D_delta_e": 0.0135})


@pytest.fixture(scope="module")
def printed(reference):
    data = json.loads((reference / "aerosonde" / "published_checks_chap3_chap4.json").read_text())
    return {row["name"]: row for row in data["chap4"]}


def test_printed_thrust_and_torque(published, printed):
    row = printed["prop"]
    T, Q = loads(published, [row["Va"], 0.0, 0.0], 0.0, [0.0, 0.0, 0.0, row["throttle"]])[0, 6:]
    assert pytest.approx((row["T"], row["Q"]), rel=1e-12) == (T, Q)


def test_a_propeller_by_bernoullis_law_takes_torque_by_the_square_of_the_throttle(f64):
    """None at rest, the whole k_T_p k_Omega^2 at full throttle, a quarter of it at half."""
    p = aircraft("zagi", propeller={"k_T_p": 2e-6, "k_Omega": 500.0})
    throttles = np.array([0.0, 0.5, 1.0])
    controls = np.zeros((3, 4))
    controls[:, 3] = throttles
    Q = loads(p, np.broadcast_to([12.0, 0.0, 0.0], (3, 3)), 0.0, controls)[:, 7]
    assert pytest.approx([0.0, 0.125, 0.5]) == Q


def test_printed_forces_and_moments(published, printed):
    row = printed["case1"]
    weight = [0.0, 0.0, published.physical.mass * GRAVITY, 0.0, 0.0, 0.0]
    found = loads(published, row["state"][3:6], row["state"][10:], row["delta"])[0, :6] + weight
    assert found == pytest.approx(row["fm"], rel=1e-12)


def test_printed_forces_and_moments_in_a_gust(published, printed):
    state, gust = np.array(printed["case2"]["state"]), printed["case_gust"]["gust_body"]
    e0, e1, e2, e3 = state[6:10]
    down = np.array([2 * (e1 * e3 - e0 * e2), 2 * (e2 * e3 + e0 * e1), 1 - 2 * (e1 * e1 + e2 * e2)])
    found = loads(published, state[3:6] - gust, state[10:], printed["case2"]["delta"])[0, :6]
    found[:3] += published.physical.mass * GRAVITY * down
    assert found == pytest.approx(printed["case_gust"]["fm_with_book_beta"], rel=1e-6)


# -- the stall ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["aerosonde", "zagi"])
def test_a_stalled_wing_lifts_like_a_plate(f64, name):
    """Ten widths of the blend beyond alpha0: 2 sign(alpha) sin^2 cos, to e^-10 and less of the linear lift."""
    p = aircraft(name)
    beyond = p.longitudinal.alpha0 + 10 / p.longitudinal.M_blend
    alpha = np.linspace(beyond, 1.5, 30)
    for sign in (1.0, -1.0):
        plate = 2 * sign * np.sin(alpha) ** 2 * np.cos(alpha)
        assert np.abs(lift_curve(p, sign * alpha) - plate).max() < 10 * np.exp(-10)


def test_lift_falls_beyond_the_stall_angle(aerosonde):
    negative, positive = stall_angles(aerosonde)
    for stall, sign in ((negative, -1), (positive, 1)):
        C_L = sign * lift_curve(aerosonde, stall + sign * np.linspace(0.0, 0.1, 50))
        assert np.all(np.diff(C_L) < 0) and C_L[-1] < 0.5 * C_L[0]
    assert negative < -0.3 and 0.3 < positive < aerosonde.longitudinal.alpha0


def test_below_the_stall_lift_is_linear(aerosonde):
    """To the blend's weight at 0.17 rad, exp(-50 (0.47 - 0.17)) = 3e-7."""
    alpha = np.linspace(-0.17, 0.17, 20)
    assert lift_curve(aerosonde, alpha) == pytest.approx(0.23 + 5.61 * alpha, abs=1e-6)


def test_half_way_into_the_stall_the_blend_is_half(aerosonde):
    lon = aerosonde.longitudinal
    half = 0.5 * (lon.C_L_0 + lon.C_L_alpha * lon.alpha0) + np.sin(lon.alpha0) ** 2 * np.cos(lon.alpha0)
    assert lift_curve(aerosonde, [lon.alpha0])[0] == pytest.approx(half, rel=1e-9)


# -- symmetry ----------------------------------------------------------------------------------------------------


def test_a_mirrored_flight_has_mirrored_derivatives(f64):
    """In the plane of symmetry, of the aircraft with a propeller that has no torque; loads from outside included."""
    whole = aircraft("aerosonde")
    p = whole.model_copy(update={"propeller": aircraft("zagi").propeller})
    model = FixedWing6DOF(p, 0.02, 1, design=whole)
    rng = np.random.default_rng(3)
    state = rng.normal(size=(50, 13))
    state[:, 3:7] /= np.linalg.norm(state[:, 3:7], axis=1, keepdims=True)
    state[:, 7] += 20
    controls, wind, load = rng.uniform(-0.4, 0.4, (50, 4)), rng.normal(size=(50, 3)), rng.normal(size=(50, 6))
    of_vector, of_axial = np.array([1, -1, 1]), np.array([-1, 1, -1])
    mirror = np.concatenate((of_vector, [1], of_axial, of_vector, of_axial))
    given = (mirror * state, controls * [1, -1, -1, 1])
    ours = model.rhs(*given, wind=wind * of_vector, load=load * np.concatenate((of_vector, of_axial)))
    assert np.abs(ours - mirror * model.rhs(state, controls, wind=wind, load=load)).max() < 1e-12
    assert np.abs(ours[:, ANGULAR_VELOCITY]).max() > 1


# -- polynomials of f32 ------------------------------------------------------------------------------------------


def test_polynomials_of_single_precision():
    runtime.init(precision="f32", threads=1)
    _check_atan2()
    _check_blend()


def _check_atan2():
    @ti.kernel
    def kernel(y: ti.types.ndarray(), x: ti.types.ndarray(), out: ti.types.ndarray()):
        for n in range(y.shape[0]):
            out[n] = airframe.atan2(y[n], x[n])

    rng = np.random.default_rng(1)
    exact = np.concatenate((rng.uniform(-np.pi, np.pi, 20000), np.geomspace(1e-6, 1.0, 1000)))
    length = rng.uniform(0.1, 50.0, len(exact))
    y, x = (length * np.sin(exact)).astype(np.float32), (length * np.cos(exact)).astype(np.float32)
    out = np.empty_like(y)
    kernel(y, x, out)
    truth = np.arctan2(y.astype(np.float64), x.astype(np.float64))
    assert np.abs(out - truth).max() < 6e-7
    assert np.abs(out[-1000:] / truth[-1000:] - 1).max() < 5e-7
    edges = [np.array(v, np.float32) for v in ([0.0, 0.0, 1.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0, -1.0])]
    kernel(*edges, out[:5])
    assert out[:5] == pytest.approx([0.0, 0.0, np.pi / 2, -np.pi / 2, np.pi], abs=1e-6)


def _check_blend():
    M, alpha0 = 50.0, 0.47

    @ti.kernel
    def kernel(alpha: ti.types.ndarray(), out: ti.types.ndarray()):
        for n in range(alpha.shape[0]):
            out[n] = airframe.stall_blend(M, alpha0, alpha[n])

    alpha = np.linspace(-np.pi, np.pi, 4001).astype(np.float32)
    out = np.empty_like(alpha)
    kernel(alpha, out)
    a = np.exp(-M * (alpha.astype(np.float64) - alpha0))
    b = np.exp(M * (alpha.astype(np.float64) + alpha0))
    book = (1 + a + b) / ((1 + a) * (1 + b))
    assert np.abs(out - book).max() < 3e-6
