import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
import torch

from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import TURBULENCE, normal6
from taichi_sim.surroundings.air.turbulence import HIGHEST, LOWEST, STATES, gust_n
from tests.probes import dryden_gust, dryden_matrices, dryden_scales, dryden_step

pytestmark = pytest.mark.usefixtures("precision")
ROUNDING = {"f64": 1e-13, "f32": 1e-6}
KNOT = 1852 / 3600  # m/s
HEIGHTS, W20_KT = (20.0, 50.0, 100.0, 150.0), (15.0, 30.0, 45.0)
VEHICLES = 40_000  # at each height: a sampled variance has a relative error of sqrt(2 / 40000) = 0.7 %
AIRSPEED = 25.0  # m/s
FLIGHTS = 1000  # recorded over 628 s
SEED = 11


@ti.kernel
def _run(
    x: ti.types.ndarray(ndim=2), h: ti.types.ndarray(ndim=1), V: float, dt: float, seed: int, first: int, steps: int
):
    for i in range(x.shape[0]):
        s = ti.Vector([x[i, 0], x[i, 1], x[i, 2], x[i, 3], x[i, 4]])
        for n in range(steps):
            s = dryden_step(s, V, h[i], dt, normal6(seed, TURBULENCE, i, 0, first + n))
        for k in ti.static(range(STATES)):
            x[i, k] = s[k]


@ti.kernel
def _gusts(x: ti.types.ndarray(ndim=2), h: ti.types.ndarray(ndim=1), W20: float, out: ti.types.ndarray(ndim=2)):
    for i in range(x.shape[0]):
        g = dryden_gust(ti.Vector([x[i, 0], x[i, 1], x[i, 2], x[i, 3], x[i, 4]]), h[i], W20)
        for k in ti.static(range(3)):
            out[i, k] = g[k]


@ti.kernel
def _record(out: ti.types.ndarray(ndim=3), h: float, V: float, W20: float, dt: float, seed: int):
    for i in range(out.shape[0]):
        s = normal6(seed, TURBULENCE, i, 1, 0)
        x = ti.Vector([s[0], s[1], s[2], s[3], s[4]])
        for n in range(out.shape[2]):
            g = dryden_gust(x, h, W20)
            for k in ti.static(range(3)):
                out[i, k, n] = g[k]
            x = dryden_step(x, V, h, dt, normal6(seed, TURBULENCE, i, 0, n))


@ti.kernel
def _to_ned(gust: ti.types.ndarray(ndim=1), v: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
    for _ in range(1):
        g = gust_n(ti.Vector([gust[0], gust[1], gust[2]]), ti.Vector([v[0], v[1], v[2]]))
        for k in ti.static(range(3)):
            out[k] = g[k]


def _tensor(values):
    return torch.as_tensor(values, dtype=runtime.current().torch_dtype).contiguous()


def _gust(x, h, w20):
    """Gusts [n, 3] of states [n, 5], in double precision."""
    out = _tensor(np.zeros((len(x), 3)))
    _gusts(x, h, w20, out)
    return out.double()


class Flight:
    """Many vehicles, each with its own noise, at the heights `h` [n]."""

    def __init__(self, h):
        self.h, self.step = _tensor(h), 0
        self.x = _tensor(np.zeros((len(self.h), STATES)))

    def fly(self, V, dt, steps):
        _run(self.x, self.h, V, dt, SEED, self.step, steps)
        self.step += steps


@pytest.fixture(scope="module")
def flight(precision):
    """Vehicles at four heights, from still air: long steps until the start is forgotten, then short ones."""
    flight = Flight(np.repeat(HEIGHTS, VEHICLES))
    flight.fly(AIRSPEED, 5.0, 30)
    flight.fly(AIRSPEED, 0.02, 20)
    return flight


@pytest.fixture(scope="module")
def record(precision, reference):
    """Gusts [vehicle, 3, time] of one row of the tables; frequencies of the PSD table fall on whole periods."""
    row = _rows(reference, "dryden_psd_one_sided_rad_s.csv")[0]
    samples, duration = 4096, 200 * math.pi
    out = _tensor(np.zeros((FLIGHTS, 3, samples)))
    h, V, W20, dt = row["h_m"], row["V"], row["W20_kt"] * KNOT, duration / samples
    _record(out, h, V, W20, dt, SEED)
    return SimpleNamespace(gust=out, h=h, V=V, W20=W20, dt=dt)


def _rows(reference, name):
    """Rows of a table as dictionaries."""
    header, *lines = (reference / "dryden" / name).read_text().splitlines()
    return [dict(zip(header.split(","), map(float, line.split(",")), strict=True)) for line in lines]


def _standard_error(count):
    """Relative, of a variance."""
    return math.sqrt(2 / count)


def _grid():
    """Airspeeds, heights and steps from none to many time constants."""
    V, h = np.meshgrid((0.0, 1e-3, 5.0, 25.0, 60.0), (-3.0, 0.0, 3.0, 20.0, 150.0, 400.0))
    return V.ravel(), h.ravel()


@pytest.mark.parametrize("dt", [0.0, 1e-4, 0.02, 0.1, 1.0, 20.0, 1000.0])
def test_every_step_keeps_the_covariance(dt, precision):
    """P = F P F^T + N N^T with P the identity, whatever V, h and dt: Lyapunov's equation of the step."""
    F, N, _ = (m.double() for m in dryden_matrices(*_grid(), 10.0, dt))
    error = F @ F.mT + N @ N.mT - torch.eye(STATES, dtype=torch.float64)
    assert error.abs().max() < ROUNDING[precision]
    assert torch.equal(N, N.tril()) and (N.diagonal(dim1=1, dim2=2) >= 0).all()


@pytest.mark.parametrize(("first", "second"), [(0.02, 0.08), (0.1, 5.0), (3.0, 3.0)])
def test_two_steps_are_one(first, second, precision):
    """F(a + b) = F(b) F(a), and the noise of both together is that of the one."""
    V, h = _grid()
    (Fa, Na, _), (Fb, Nb, _), (F, N, _) = (dryden_matrices(V, h, 10.0, dt) for dt in (first, second, first + second))
    assert (Fb @ Fa - F).abs().max() < ROUNDING[precision]
    assert (Fb @ Na @ Na.mT @ Fb.mT + Nb @ Nb.mT - N @ N.mT).abs().max() < 2 * ROUNDING[precision]


def test_steps_solve_the_stochastic_equation(precision):
    """F = exp(A dt) and A + A^T = -B B^T, with the A and B of the docstring, by torch's matrix exponential."""
    V, h, dt = 25.0, 20.0, 0.3
    L = dryden_scales([h])[0][0].double()
    pair = torch.tensor([[-1.0, 0.0], [-2.0, -1.0]], dtype=torch.float64)
    one = torch.tensor([[-1.0]], dtype=torch.float64)
    A = torch.block_diag(one / L[0], pair / L[0], pair / L[1]) * V
    assert (dryden_matrices([V], [h], 1.0, dt)[0][0] - torch.linalg.matrix_exp(A * dt)).abs().max() < ROUNDING[
        precision
    ]
    B = torch.block_diag(torch.tensor([[2.0]]), torch.full((2, 2), 2.0), torch.full((2, 2), 2.0)).double()
    assert torch.allclose(-(pair + pair.mT), B[1:3, 1:3])  # sqrt 2 for both: one white noise drives the pair


def test_lengths_and_intensities_agree_with_the_table(reference, precision):
    for row in json.loads((reference / "dryden" / "dryden_parameters.json").read_text()):
        lengths, sigma = dryden_scales([row["h_m"]])
        bound = {"f64": 1e-9, "f32": 1e-6}[precision]
        assert lengths[0].tolist() == pytest.approx([row["Lu_m"], row["Lw_m"]], rel=bound)
        assert (sigma[0] * row["W20_ms"]).tolist() == pytest.approx([row["sigma_u"], row["sigma_w"]], rel=bound)


def test_the_model_ends_at_10_and_1000_feet(precision):
    """At 1000 ft L_u = L_w and sigma_u = sigma_w; beyond the ends it stays as it is there."""
    lengths, sigma = (v.double() for v in dryden_scales([-9.0, 0.0, LOWEST, HIGHEST, 2000.0]))
    assert torch.equal(lengths[0], lengths[2]) and torch.equal(lengths[1], lengths[2])
    assert torch.equal(lengths[4], lengths[3]) and torch.equal(sigma[0], sigma[2])
    assert lengths[3].tolist() == pytest.approx([HIGHEST, HIGHEST], rel=1e-6)
    assert sigma[3, 0] == pytest.approx(float(sigma[3, 1]), rel=1e-6)


def test_autocorrelation_agrees_with_the_table(reference, precision):
    """C F(tau) C^T, one step of the lag."""
    for row in _rows(reference, "dryden_autocorrelation.csv"):
        F, _, C = dryden_matrices([row["V"]], [row["h_m"]], row["W20_kt"] * KNOT, row["tau_s"])
        R = (C @ F @ C.mT)[0].diagonal()
        scale = row["W20_kt"] * KNOT * 0.1
        assert (
            np.abs(R.numpy() - [row["R_u"], row["R_v"], row["R_w"]]).max() / scale**2
            < {"f64": 1e-8, "f32": 3e-6}[precision]
        )


@pytest.mark.parametrize("w20_kt", W20_KT)
def test_sampled_intensities(flight, w20_kt):
    """Variances within 3 standard errors of sigma^2, of light, moderate and severe turbulence, at each height."""
    sigma = dryden_scales(HEIGHTS)[1].double() * w20_kt * KNOT
    gust = _gust(flight.x, flight.h, w20_kt * KNOT).reshape(len(HEIGHTS), VEHICLES, 3)
    variance = (gust**2).mean(dim=1)
    expected = torch.stack((sigma[:, 0], sigma[:, 0], sigma[:, 1]), dim=1) ** 2
    assert ((variance / expected - 1).abs() < 3 * _standard_error(VEHICLES)).all()
    assert (gust.mean(dim=1).abs() < 3 * expected.sqrt() / math.sqrt(VEHICLES)).all()


def test_sampled_ratio_of_intensities(flight):
    """sigma_u / sigma_w = (0.177 + 0.000823 h_ft)^-0.4 within 2 %."""
    gust = _gust(flight.x, flight.h, 15.0).reshape(len(HEIGHTS), VEHICLES, 3)
    rms = (gust**2).mean(dim=1).sqrt()
    expected = (0.177 + 0.000823 * np.array(HEIGHTS) / 0.3048) ** -0.4
    assert np.abs((rms[:, 0] / rms[:, 2]).numpy() / expected - 1).max() < 0.02


def test_states_are_independent_standard_normal(flight):
    covariance = (flight.x.double().T @ flight.x.double()) / len(flight.x)
    bound = 4.5 * _standard_error(len(flight.x))
    assert (covariance - torch.eye(STATES)).abs().max() < bound


@pytest.mark.parametrize(("dt", "steps"), [(0.02, 50), (0.1, 10), (1.0, 1)])
def test_sampled_autocorrelation_is_the_same_for_any_step(dt, steps, reference):
    """Over 1 s, by 50, 10 or 1 steps: within 3 standard errors, sqrt((1 + rho^2) / n) sigma^2, of the table."""
    row = next(r for r in _rows(reference, "dryden_autocorrelation.csv") if r["tau_s"] == 1.0)
    flight, w20 = Flight(np.full(VEHICLES, row["h_m"])), row["W20_kt"] * KNOT
    flight.fly(row["V"], 10.0, 20)
    before = _gust(flight.x, flight.h, w20)
    flight.fly(row["V"], dt, steps)
    after = _gust(flight.x, flight.h, w20)
    sigma = dryden_scales([row["h_m"]])[1][0].double() * w20
    variance = torch.stack((sigma[0], sigma[0], sigma[1])) ** 2
    rho = torch.tensor([row["R_u"], row["R_v"], row["R_w"]], dtype=torch.float64) / variance
    ours = (before * after).mean(dim=0) / variance
    assert ((ours - rho).abs() < 3 * ((1 + rho**2) / VEHICLES).sqrt()).all()


def test_sampled_spectrum(record, reference):
    """Periodogram (Hann) of all flights at the table's frequencies, each with a standard error of 1 / sqrt(flights)."""
    window = torch.hann_window(record.gust.shape[2], dtype=record.gust.dtype)
    spectrum = torch.fft.rfft(record.gust * window, dim=2).abs().double() ** 2
    one_sided = spectrum.mean(dim=0) * record.dt / math.pi / float((window**2).sum())
    rows = [r for r in _rows(reference, "dryden_psd_one_sided_rad_s.csv") if 0.1 <= r["omega"] <= 3]
    rows = [r for r in rows if r["W20_kt"] * KNOT == record.W20]
    assert len(rows) == 4
    for row in rows:
        ours = one_sided[:, round(row["omega"] * 100)].numpy()
        expected = np.array([row["Phi_u"], row["Phi_v"], row["Phi_w"]])
        assert np.abs(ours / expected - 1).max() < 3.5 / math.sqrt(FLIGHTS)


def test_sampling_error_of_a_300_s_flight(record, reference):
    """Variances measured over 300 s scatter as the table says; 1000 flights measure that scatter to 4 %."""
    row = _rows(reference, "dryden_discrete.csv")[0]
    measured = (record.gust[:, :, : round(300 / record.dt)] ** 2).double().mean(dim=2)
    scatter = measured.std(dim=0) / measured.mean(dim=0)
    assert scatter[0] == pytest.approx(row["rel_std_of_var_u_over_300s"], rel=0.12)
    assert scatter[2] == pytest.approx(row["rel_std_of_var_w_over_300s"], rel=0.12)


def test_a_change_of_airspeed_does_not_jump():
    """The step in which V goes from 15 to 40 m/s is as small as any other at 40 m/s: var = 2 (sigma^2 - R(dt))."""
    flight, dt, h, w20 = Flight(np.full(VEHICLES, 50.0)), 0.02, 50.0, 15.0
    flight.fly(15.0, 10.0, 20)
    before = _gust(flight.x, flight.h, w20)
    flight.fly(40.0, dt, 1)
    change = _gust(flight.x, flight.h, w20) - before
    F, _, C = (m[0].double() for m in dryden_matrices([40.0], [h], w20, dt))
    expected = 2 * (C @ (torch.eye(STATES) - F) @ C.mT).diagonal()
    assert (((change**2).mean(dim=0) / expected - 1).abs() < 4 * _standard_error(VEHICLES)).all()
    largest = (change.abs().max(dim=0).values / expected.sqrt()).max()
    assert largest < 7.5  # of 120 000 normal numbers from two draws of at most 5.8


def test_a_change_of_height_changes_the_gust_as_its_intensity():
    """At no airspeed nothing moves: only sigma_u(h) does, sigma_w does not."""
    flight = Flight(np.full(100, 20.0))
    flight.fly(25.0, 1.0, 20)
    low, state = _gust(flight.x, flight.h, 10.0), flight.x.clone()
    flight.h[:] = 100.0
    flight.fly(0.0, 0.1, 5)
    high = _gust(flight.x, flight.h, 10.0)
    sigma = dryden_scales([20.0, 100.0])[1].double()
    assert torch.equal(flight.x, state)
    assert torch.allclose(high[:, :2], low[:, :2] * sigma[1, 0] / sigma[0, 0], rtol=1e-5)
    assert torch.equal(high[:, 2], low[:, 2])


@pytest.mark.parametrize(
    ("v_air", "expected"),
    [
        ((20.0, 0.0, 3.0), (1.0, 2.0, 3.0)),  # flying north: u north, v east, w down
        ((0.0, 20.0, -3.0), (-2.0, 1.0, 3.0)),  # flying east: u east, v south
        ((-5.0, 0.0, 0.0), (-1.0, -2.0, 3.0)),
        ((0.0, 0.0, 9.0), (1.0, 2.0, 3.0)),  # no horizontal airspeed: north and east
    ],
)
def test_gusts_turn_with_the_flight(v_air, expected):
    out = _tensor(np.zeros(3))
    _to_ned(_tensor([1.0, 2.0, 3.0]), _tensor(v_air), out)
    assert out.tolist() == pytest.approx(expected, abs=1e-6)
