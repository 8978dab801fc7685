"""`hull_6dof` in waves: it rides long ones, keeps their symmetry, and answers regular ones as boundary elements say."""

import numpy as np
import pytest
import torch

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.kernels.rotation import torch_euler_from_quaternion
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("f64")

COMPONENTS = 3  # of every sea here, so that a hull compiles once
STILL = [-1.0, 0.0]
MIRROR = torch.tensor(
    [1.0, -1, 1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1], dtype=torch.float64
)  # of a state, port for starboard


@pytest.fixture(scope="module")
def otter(constant_model):
    return constant_model("otter")


@pytest.fixture(scope="module")
def barge(constant_model):
    return constant_model("barge")


def waves(amplitude, omega, direction, phase=0.0):
    """Deep water: arrays [sea, up to 3 components]; the rest are calm."""
    rows = np.broadcast_arrays(amplitude, omega, direction, phase)
    missing = COMPONENTS - rows[0].shape[1]
    a, omega, direction, phase = (np.pad(r, ((0, 0), (0, missing)), mode="edge") for r in rows)
    a[:, COMPONENTS - missing :] = 0.0
    return Sea(Components(a, omega**2 / GRAVITY, omega, direction, phase))


def run(team, steps, action=STILL):
    """Time [step] (s), states [step, env, 13] and roll, pitch, yaw [step, env, 3]."""
    states = []
    for _ in range(steps):
        states.append(team.step(action).state[:, 0].clone())
    states = torch.stack(states)
    return (
        team.model.dt * np.arange(1, steps + 1),
        states.numpy(),
        torch_euler_from_quaternion(states[..., 3:7]).numpy(),
    )


def at_frequency(time, signal, omega):
    """Complex amplitude A [env] of signals [time, env] that go as Re(A exp(-i omega t)), besides mean and drift."""
    result = []
    for x, w in zip(signal.T, omega, strict=True):
        basis = np.stack([np.cos(w * time), np.sin(w * time), np.ones_like(time), time], axis=1)
        result.append(np.linalg.lstsq(basis, x, rcond=None)[0][:2] @ [1, 1j])
    return np.array(result)


@pytest.mark.parametrize("name", ["otter", pytest.param("barge", marks=pytest.mark.slow)])
def test_long_waves_lift_and_tilt_the_hull_as_they_do_the_surface(name, bench, request):
    """Sixty hull lengths: heave over elevation, pitch over slope ahead, roll over slope abeam are 1, in phase."""
    model = request.getfixturevalue(name)
    k = 2 * np.pi / (60 * model.params.length)
    omega, a = np.sqrt(GRAVITY * k), 0.05
    team = bench(model, waves(a, np.full((4, 1), omega), np.array([[np.pi], [0.0], [np.pi / 2], [-np.pi / 2]])), envs=4)
    rest = model.geometry.hydrostatics.equilibrium[0]
    team.state[:, 0, 2] = rest - a
    time, state, angle = run(team, round(3 * 2 * np.pi / omega / model.dt))
    late = time > 2 * np.pi / omega
    fit = lambda x: at_frequency(time[late], x[late], [omega] * 4)  # noqa: E731
    heave, roll, pitch = -fit(state[..., 2]) / a, fit(angle[..., 0]) / (k * a), fit(angle[..., 1]) / (k * a)
    assert heave == pytest.approx(np.ones(4), abs=0.02)
    M, G = model.params.M_rb + model.params.M_a, model.geometry.hydrostatics.stiffness()
    lively = 1 / (1 - omega**2 * M[3, 3] / G[1, 1])  # of the barge's roll of 3 s in waves of 12 s: 6 %
    # zeta = a cos(k s - omega t) along its direction s: its slope is Re(i k a exp(-i omega t)) along s
    assert pitch[:2] == pytest.approx([-1j, 1j], abs=0.02)  # bow up where the surface rises ahead
    assert roll[2:] == pytest.approx([-1j * lively, 1j * lively], abs=0.04)  # to port where it rises to starboard
    assert np.abs(pitch[2:]).max() < 0.02 and np.abs(roll[:2]).max() < 1e-5


def test_mirrored_seas_and_wind_make_mirrored_motion(otter, bench):
    rng = np.random.default_rng(7)
    a, omega, direction, phase = rng.uniform([[0.02]] * 4, [[0.06], [3.0], [1.5], [6.0]], (4, 3))
    omega, sides = 1.5 + omega / 2, np.array([[1.0], [-1.0]])
    team = bench(
        otter, waves(np.stack([a, a]), np.stack([omega, omega]), sides * direction, np.stack([phase, phase])), envs=2
    )
    team.state[0, 0, 7:] = torch.tensor([1.0, 0.2, 0.0, 0.1, 0.0, 0.2])
    team.state[1] = team.state[0] * MIRROR
    team.wind[:] = torch.tensor([[4.0, 3.0, 0.0], [4.0, -3.0, 0.0]])
    team.current[:] = torch.tensor([[0.2, 0.3], [0.2, -0.3]])
    team.step([[[0.4, 0.3]], [[0.4, -0.3]]], 750)
    port, starboard = team.state[:, 0]
    assert port.abs()[[1, 8, 10, 12]].min() > 1e-3  # it moves
    assert port.numpy() == pytest.approx((starboard * MIRROR).numpy(), abs=1e-5)


@pytest.mark.parametrize("name", ["otter", "barge"])
def test_head_and_following_seas_do_not_turn_a_symmetric_hull(name, bench, request):
    model = request.getfixturevalue(name)
    team = bench(model, waves(0.1, np.array([[1.8, 2.4, 3.0]] * 2), np.array([[np.pi], [0.0]])), envs=2)
    _, state, angle = run(team, 500, [0.2, 0.0])
    assert np.abs(angle[..., 1]).max() > 0.05 and np.abs(state[-1, :, 0]).min() > 1.0
    assert np.abs(state[..., [1, 8, 10, 12]]).max() < 1e-6
    assert np.abs(angle[..., [0, 2]]).max() < 1e-6


def test_heave_and_pitch_of_the_barge_agree_with_boundary_elements(barge, bench, columns):
    """Amplitudes and heave's phase in regular head waves, against a panel code with frequency-dependent coefficients.

    The model has constant added mass and damping, and diffraction by relative motion: 20 % below resonance and 30 % in
    it, as that approximation allows. Waves well shorter than twice the hull are left out: nothing moves in them.
    """
    table = columns("hydrostatics/box_4x2x0.5_rao.csv")
    chosen = (table.heading_deg == 180) & (table.omega < 3.5)
    omega, a = table.omega[chosen], 0.005
    team = bench(barge, waves(a, omega[:, None], np.pi), envs=len(omega))
    time, state, angle = run(team, 4000)
    late = time > 50.0
    heave = np.conj(-at_frequency(time[late], state[late, :, 2], omega)) / a
    pitch = at_frequency(time[late], angle[late, :, 1], omega) / a
    M, G = barge.params.M_rb + barge.params.M_a, barge.geometry.hydrostatics.stiffness()
    for rao, reference, mode in ((heave, table.heave_abs, 2), (pitch, table.pitch_abs, 4)):
        natural = np.sqrt(G[mode - 2, mode - 2] / M[mode, mode])
        below = omega < 0.9 * natural
        ratio = np.abs(rao) / reference[chosen]
        assert ratio[below] == pytest.approx(np.ones(below.sum()), abs=0.2)
        assert ratio[~below] == pytest.approx(np.ones((~below).sum()), abs=0.3)


@pytest.fixture(scope="module")
def catamaran(constant_model):
    """2 m long, tubes of 0.25 m; its pitch resonates in waves of 0.56 of its length."""
    mass = RHO_SEA * 4 * 0.25 * (0.015 + np.pi / 8 * 0.25)  # of two tubes 0.14 m deep
    return constant_model(
        "wamv", length=2.0, beam=1.05, height=0.6, collision_radius=1.1, thrusters=None, windage={"frontal_area": 0.0},
        rigid_body={"mass": mass, "cg": [0.0, 0.0, -0.1], "gyration": [0.4, 0.5, 0.55]},
        hydrodynamics={
            "added_mass": [6.0, 93.0, 105.0, 17.0, 30.0, 28.0],
            "linear": [30.0, 150.0, 600.0, 80.0, 80.0, 60.0],
            "quadratic": [0.0] * 6,
        },
        hull={"y": 0.4, "freeboard": 0.2, "stations": [[x, 0.25, 0.14] for x in np.linspace(-1, 1, 11).tolist()]},
    )  # fmt: skip


def wetted(panels, pieces=30):
    """Points [n, 3] and area vectors [n, 3] out of the hull of small pieces below the design waterline."""
    s, t = np.meshgrid(*[(2 * np.arange(pieces) + 1) / pieces - 1] * 2)
    s, t = s[..., None], t[..., None]
    centre, along, up, twist, out = (
        v[:, None, None] for v in (panels.centre, panels.along, panels.up, panels.twist, panels.area)
    )
    area = np.cross(along + t * twist, up + s * twist) * (2 / pieces) ** 2
    area *= np.sign((area * out).sum(-1, keepdims=True))
    point = (centre + s * along + t * up + s * t * twist).reshape(-1, 3)
    below = point[:, 2] > 0
    return point[below], area.reshape(-1, 3)[below]


def pitch_in_head_seas(model, omega):
    """Pitch [wave] per wave amplitude (rad/m) of the linear hull at rest, by integrals over all its surface.

    (-i omega M + D + i G / omega) nu = F + M_a nu_o' + D nu_o in waves Re exp(-i(k x + omega t)): pressure on panels
    below the waterline, and the orbital motion nu_o at the draft averaged over a waterplane of one beam.
    """
    p, g = model.params, model.geometry
    M, D, G = p.M_rb + p.M_a, np.diag(p.hydrodynamics.linear), np.zeros((6, 6))
    G[2:5, 2:5] = g.hydrostatics.stiffness()
    point, area = wetted(g.panels)
    result = []
    for w in omega:
        k = w**2 / GRAVITY
        x = k * p.length / 2
        mean, slope = np.sin(x) / x, 3 * (np.sin(x) - x * np.cos(x)) / x**3
        pressure = RHO_SEA * GRAVITY * np.exp(-k * point[:, 2] - 1j * k * point[:, 0])
        force = -pressure[:, None] * area
        F = np.concatenate([force.sum(0), np.cross(point, force).sum(0)])
        nu_o = w * np.exp(-k * g.panels.draft) * np.array([-mean, 0, 1j * mean, 0, -k * slope, 0])
        nu = np.linalg.solve(-1j * w * M + D + 1j * G / w, F - 1j * w * p.M_a @ nu_o + D @ nu_o)
        result.append(nu[4] / (-1j * w))
    return np.array(result)


@pytest.mark.slow
def test_pitch_of_a_catamaran_in_waves_shorter_than_it(catamaran, bench):
    """At and about its resonance in head seas, against the linear hull: 15 %. It is 1.7 times as large where hulls do
    not feel the pitch of waves shorter than 0.78 of their length.
    """
    M, G = catamaran.params.M_rb + catamaran.params.M_a, catamaran.geometry.hydrostatics.stiffness()
    omega = np.array([0.96, 1.0, 1.04]) * np.sqrt(G[2, 2] / M[4, 4])
    assert 0.5 < 2 * np.pi * GRAVITY / omega.max() ** 2 / catamaran.params.length < 0.6
    a = 2e-4 * GRAVITY / omega**2
    team = bench(catamaran, waves(a[:, None], omega[:, None], np.pi), envs=3)
    team.state[:, 0, 2] = catamaran.geometry.hydrostatics.equilibrium[0]
    time, _, angle = run(team, 700)
    late = time > 9.0
    pitch = at_frequency(time[late], angle[late, :, 1], omega) / a
    assert np.abs(pitch) == pytest.approx(np.abs(pitch_in_head_seas(catamaran, omega)), rel=0.15)
