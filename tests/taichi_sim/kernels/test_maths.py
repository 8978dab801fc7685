import math

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels import fast_maths, rotation, runtime

pytestmark = pytest.mark.usefixtures("precision")
ROUNDING = {"f64": 1e-14, "f32": 5e-7}


@ti.kernel
def _sincos(x: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=2)):
    for i in x:
        out[i, 0], out[i, 1] = fast_maths.sin(x[i]), fast_maths.cos(x[i])
        out[i, 2], out[i, 3] = fast_maths.sincos(x[i])
        out[i, 4], out[i, 5] = fast_maths.sin_turns(x[i]), fast_maths.cos_turns(x[i])


@ti.kernel
def _decays(x: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=2)):
    for i in x:
        out[i, 0], out[i, 1], out[i, 2] = (
            fast_maths.exp_decay(x[i]),
            fast_maths.exp_near_one(x[i]),
            fast_maths.at_most(x[i], 1.0),
        )


@ti.kernel
def _advance(q: ti.types.ndarray(ndim=2), omega: ti.types.ndarray(ndim=2), dt: float, steps: int):
    for i in range(q.shape[0]):
        p = ti.Vector([q[i, 0], q[i, 1], q[i, 2], q[i, 3]])
        w = ti.Vector([omega[i, 0], omega[i, 1], omega[i, 2]])
        for _ in range(steps):
            p = rotation.quaternion_advance(p, w, dt)
        for k in ti.static(range(4)):
            q[i, k] = p[k]


@ti.kernel
def _from_euler(euler: ti.types.ndarray(ndim=2), q: ti.types.ndarray(ndim=2), R: ti.types.ndarray(ndim=3)):
    for i in range(q.shape[0]):
        p = rotation.quaternion_from_euler(euler[i, 0], euler[i, 1], euler[i, 2])
        m = rotation.rotation_matrix(p)
        for k in ti.static(range(4)):
            q[i, k] = p[k]
        for r, c in ti.static(ti.ndrange(3, 3)):
            R[i, r, c] = m[r, c]


def _zeros(*shape):
    return torch.zeros(shape, dtype=runtime.current().torch_dtype)


def _random_euler(n=200):
    low, high = torch.tensor([-math.pi, -1.5, -math.pi]), torch.tensor([math.pi, 1.5, math.pi])
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(1))
    return (low + (high - low) * u).to(runtime.current().torch_dtype)


def _quaternions(euler):
    return rotation.torch_quaternion_from_euler(*euler.unbind(-1))


def _decay(low, high):
    """x and the functions of `_decays` there, float64 [n] and [n, 3]."""
    x = torch.linspace(low, high, 20_001, dtype=torch.float64).to(runtime.current().torch_dtype)
    out = _zeros(len(x), 3)
    _decays(x, out)
    return x.double(), out.double()


class TestDecay:
    def test_near_the_surface_it_is_exact_to_a_share_of_its_value(self):
        x, out = _decay(-2.0, 8.0)
        assert (out[:, 0] * x.exp() - 1).abs().max() < 5e-4

    def test_far_below_nothing_is_left(self):
        x, out = _decay(8.0, 200.0)
        assert (out[:, 0] - (-x).exp()).abs().max() < 8e-6
        assert (out[:, 0] >= 0).all()

    def test_of_a_small_step(self):
        x, out = _decay(-0.3, 0.3)
        assert (out[:, 1] * x.exp() - 1).abs().max() < 3.1e-4
        x, out = _decay(-1.0, 1.0)
        assert (out[:, 1] * x.exp() - 1).abs().max() < 1.3e-2
        assert (_decay(-30.0, 30.0)[1][:, 1] > 0).all()

    def test_at_most(self):
        x, out = _decay(0.0, 2.0)
        assert torch.equal(out[:, 2], x.clamp(max=1.0))


@pytest.mark.parametrize(("largest", "bound"), [(math.pi, 1e-6), (100.0, 1e-6), (5000.0, 2e-6)])
def test_fast_sine_and_cosine(largest, bound):
    x = torch.linspace(-largest, largest, 200_001, dtype=torch.float64).to(runtime.current().torch_dtype)
    out = _zeros(x.numel(), 6)
    _sincos(x, out)
    turned = 2 * np.pi * (x.double() - x.double().round())  # of x as turns
    exact = [np.stack((np.sin(angle), np.cos(angle)), axis=1) for angle in (x.double(), turned)]
    assert np.abs(out.numpy() - np.hstack((exact[0], *exact))).max() < bound


def test_constant_rate_is_a_rotation_about_a_fixed_axis(precision):
    """q(t) = (cos wt/2, axis sin wt/2) q... for any step size: the exponential map is exact."""
    omega, dt, steps = torch.tensor([[0.3, -0.5, 0.8]], dtype=runtime.current().torch_dtype), 0.1, 50
    q = _zeros(1, 4)
    q[0, 0] = 1.0
    _advance(q, omega, dt, steps)
    rate = float(omega.double().norm())
    axis = omega[0].double().numpy() / rate
    half = rate * dt * steps / 2
    exact = np.concatenate(([np.cos(half)], np.sin(half) * axis))
    assert np.abs(q[0].numpy() - exact).max() < 20 * ROUNDING[precision]


def test_slow_turn_uses_the_series(precision):
    """The quotient sin(a/2)/a and its series meet; a turn of 1e-5 rad is not lost."""
    q = _zeros(1, 4)
    q[0, 0] = 1.0
    _advance(q, torch.tensor([[0.0, 0.0, 1e-3]], dtype=q.dtype), 0.01, 1)
    assert float(q[0, 3]) == pytest.approx(5e-6, rel=1e-6)


def test_advance_keeps_the_norm(precision):
    q = _quaternions(_random_euler())
    _advance(q, 20 * torch.sin(torch.arange(600.0, dtype=q.dtype)).reshape(200, 3), 0.02, 1000)
    assert (q.double().norm(dim=1) - 1).abs().max() < ROUNDING[precision]


def test_euler_round_trip(precision):
    euler = _random_euler()
    back = rotation.torch_euler_from_quaternion(_quaternions(euler))
    # asin loses digits near a pitch of 90 degrees by 1 / cos(pitch)
    error = (back - euler).abs().amax(dim=1) * torch.cos(euler[:, 1])
    assert float(error.max()) < 4 * ROUNDING[precision]


def test_kernel_and_torch_agree_and_are_orthonormal(precision):
    euler = _random_euler()
    q, R = _zeros(200, 4), _zeros(200, 3, 3)
    _from_euler(euler, q, R)
    assert (q - _quaternions(euler)).abs().max() < 2 * ROUNDING[precision]
    assert (R - rotation.torch_rotation_matrix(q)).abs().max() < 2 * ROUNDING[precision]
    eye = torch.eye(3, dtype=R.dtype)
    assert (R @ R.transpose(1, 2) - eye).abs().max() < 4 * ROUNDING[precision]
    assert (torch.linalg.det(R) - 1).abs().max() < 4 * ROUNDING[precision]


def test_axes_of_euler_angles():
    """Heading 90 degrees points the nose east; pitch up raises it; bank right lowers the right wing."""
    quarter, zero = torch.tensor(math.pi / 2), torch.tensor(0.0)
    forward, right = torch.tensor([1.0, 0, 0]), torch.tensor([0, 1.0, 0])

    def turned(phi, theta, psi, axis):
        return rotation.torch_rotation_matrix(rotation.torch_quaternion_from_euler(phi, theta, psi)) @ axis

    assert torch.allclose(turned(zero, zero, quarter, forward), torch.tensor([0, 1.0, 0]), atol=1e-6)
    assert torch.allclose(turned(zero, quarter, zero, forward), torch.tensor([0, 0, -1.0]), atol=1e-6)
    assert torch.allclose(turned(quarter, zero, zero, right), torch.tensor([0, 0, 1.0]), atol=1e-6)
