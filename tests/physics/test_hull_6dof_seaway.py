"""`hull_6dof` in waves: it rides long ones, keeps their symmetry, and answers regular ones as boundary elements say."""

import numpy as np
import pytest
import torch

from taichi_sim.conventions import GRAVITY
from taichi_sim.maths.rotation import torch_euler_from_quaternion
from taichi_sim.sea import Sea
from taichi_sim.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("f64")

COMPONENTS = 3  # of every sea here, so that a hull compiles once
STILL = [-1.0, 0.0]
MIRROR = torch.tensor(
    [1.0, -1, 1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1], dtype=torch.float64
)  # of a state, port for starboard


@pytest.fixture(scope="module")
def otter(make_model):
    return make_model("otter")


@pytest.fixture(scope="module")
def barge(make_model):
    return make_model("barge")


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


@pytest.mark.parametrize("name", ["otter", "barge"])
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
