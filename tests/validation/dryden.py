"""Checks of taichi_sim.surroundings.air: Dryden turbulence, through the matrices of the kernels' own step, and the mean
wind."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import re

import numpy as np
import taichi as ti
import torch

from taichi_sim.kernels import runtime
from taichi_sim.surroundings.air.turbulence import LOWEST, STATES
from taichi_sim.surroundings.air.wind import TWENTY_FEET, log_shear, mean_wind_factor
from tests.probes import dryden_matrices, dryden_scales
from tests.validation.case import Case
from tests.validation.tables import TableError, numbers, read_csv, read_json, records

KNOT = 1852 / 3600  # m/s
METRES = {"ft": 0.3048, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
QUADRATURE_NODES = 64
NUMBER = r"\d+(?:\.\d+)?"
ROWS = {"u": 0, "v": 1, "w": 2}


def parameters(case: Case) -> None:
    """dryden_parameters*.json: lengths and intensities at a height and a wind at 20 ft."""
    rows = records({"rows": read_json(case.path)}, "rows")
    lengths, sigma = (v.double().cpu().numpy() for v in dryden_scales(numbers(rows, "h_m")))
    w20 = numbers(rows, "W20_kt") * KNOT
    ours = {"W20_ms": w20}
    for axis, column in (("u", 0), ("v", 0), ("w", 1)):
        ours |= {f"L{axis}_m": lengths[:, column], f"sigma_{axis}": sigma[:, column] * w20}
    for key, values in ours.items():
        if any(key in row for row in rows):
            case.elementwise(key, values, numbers(rows, key))


def autocorrelation(case: Case) -> None:
    """dryden_autocorrelation*.csv: C F C^T of one step as long as the lag."""
    table = read_csv(case.path)
    ours = np.empty((3, len(table)))
    rows = zip(table["V"], table["h_m"], table["W20_kt"] * KNOT, table["tau_s"], strict=True)
    for i, (V, h, w20, lag) in enumerate(rows):
        F, _, C = _step(V, h, w20, lag)
        ours[:, i] = np.diag(C @ F @ C.T)
    case.columns(case.relative, table, {f"R_{axis}": ours[row] for axis, row in ROWS.items()})


def spectrum(case: Case) -> None:
    """dryden_psd_one_sided_rad_s*.csv: spectra of the stochastic equation that our steps solve."""
    table = read_csv(case.path)
    rows = zip(table["V"], table["h_m"], table["W20_kt"] * KNOT, table["omega"], strict=True)
    ours = np.array([Filter(V, h, w20).spectrum(omega) for V, h, w20, omega in rows])
    case.columns(case.elementwise, table, {f"Phi_{axis}": ours[:, row] for axis, row in ROWS.items()})


def discrete(case: Case) -> None:
    """dryden_discrete*.csv: coefficients of u's step, variances below Nyquist's frequency, scatter of variances.

    The step is in the names (var_u_below_nyquist_dt0.02), and so is the time of the scatter (..._over_300s).
    """
    table = read_csv(case.path)
    steps = {float(m[1]) for name in table.header if (m := re.search(rf"_dt({NUMBER})$", name))}
    if len(steps) != 1:
        raise TableError(f"one step dt is needed in the names of the columns, there are {sorted(steps)}")
    dt = steps.pop()
    rows = zip(table["V"], table["h_m"], table["W20_kt"] * KNOT, strict=True)
    figures = [_discrete_row(table.header, dt, *row) for row in rows]
    case.columns(case.elementwise, table, {name: np.array([f[name] for f in figures]) for name in figures[0]})


def _discrete_row(header: tuple[str, ...], dt: float, V: float, h: float, w20: float) -> dict[str, float]:
    F, N, C = _step(V, h, w20, dt)
    known = Filter(V, h, w20)
    ours = {}
    for name in header:
        if re.fullmatch(rf"AR1_phi_u(_dt{NUMBER})?", name):
            ours[name] = F[0, 0]
        elif re.fullmatch(rf"AR1_noise_std_u(_dt{NUMBER})?", name):
            ours[name] = C[0, 0] * N[0, 0]
        elif found := re.fullmatch(rf"var_([uvw])(_below_nyquist_dt{NUMBER})?", name):
            ours[name] = known.integral(ROWS[found[1]], 1, np.pi / dt)
        elif found := re.fullmatch(r"sigma_([uvw])\^2", name):
            ours[name] = known.variance[ROWS[found[1]]]
        elif found := re.fullmatch(rf"rel_std_of_var_([uvw])_over_({NUMBER})s", name):
            row, time = ROWS[found[1]], float(found[2])
            # var of the mean of u^2 over T: 4 / T of the integral of R^2 from 0, pi / 2 of that of Phi^2 (Parseval)
            ours[name] = np.sqrt(2 * np.pi * known.integral(row, 2) / time) / known.variance[row]
    return {name: float(value) for name, value in ours.items()}


def _step(V: float, h: float, w20: float, dt: float) -> tuple[np.ndarray, ...]:
    """F, N [5, 5] and C [3, 5] of the kernels' step, float64."""
    return tuple(m[0].double().cpu().numpy() for m in dryden_matrices([V], [h], w20, dt))


class Filter:
    """The linear stochastic equation dx = A x dt + noise, gust = C x, that a step F, N is the exact solution of.

    A is the logarithm of F over dt, which is block-wise lower triangular with equal diagonals in a block; the
    strength of the noise follows from the covariance P that the step keeps, P = F P F^T + N N^T.
    """

    def __init__(self, V: float, h: float, w20: float):
        """Probe the kernels with a step of one time constant of w."""
        self.time_constant = dt = max(h, LOWEST) / V
        F, N, self.C = _step(V, h, w20, dt)
        diagonal = np.diag(F)
        self.A = np.diag(np.log(diagonal)) / dt
        for low in (2, 4):
            self.A[low, low - 1] = F[low, low - 1] / diagonal[low] / dt
        eye = np.eye(STATES**2)
        P = np.linalg.solve(eye - np.kron(F, F), (N @ N.T).ravel()).reshape(STATES, STATES)
        self.Q = -(self.A @ P + P @ self.A.T)
        self.variance = np.diag(self.C @ P @ self.C.T)

    def spectrum(self, omega: float) -> np.ndarray:
        """One-sided spectra (per rad/s) [3] of u, v, w at omega (rad/s)."""
        G = self.C @ np.linalg.inv(1j * omega * np.eye(STATES) - self.A)
        return np.diag(G @ self.Q @ G.conj().T).real / np.pi

    def integral(self, row: int, power: int, end: float = np.inf) -> float:
        """Integral of one spectrum to a power from 0 to `end` (rad/s), by Gauss and Legendre in atan(T omega)."""
        T = -1 / self.A[(0, 1, 3)[row], (0, 1, 3)[row]]
        nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_NODES)
        half = np.arctan(T * end) / 2
        tangent = np.tan(half * (nodes + 1))
        values = np.array([self.spectrum(t / T)[row] ** power for t in tangent])
        return float(np.sum(weights * half * values * (1 + tangent**2)) / T)


@ti.kernel
def _factor(profile: ti.template(), shear: float, h: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
    for i in h:
        out[i] = mean_wind_factor(profile, shear, h[i])


def mean_wind(case: Case) -> None:
    """mean_wind_profiles*.csv: wind at heights from that at 20 ft; roughness or exponent are in the columns' names."""
    table = read_csv(case.path)
    run = runtime.current()
    height = torch.tensor([*table["z_m"], TWENTY_FEET], dtype=run.torch_dtype, device=run.device)
    ours = {}
    for name in table.header:
        if kind := _profile(name):
            factor = torch.zeros_like(height)
            _factor(*kind, height, factor)
            values = factor.double().cpu().numpy()
            ours[name] = table["W20_kt"] * KNOT * values[:-1] / values[-1]
    if not ours:
        raise TableError(f"no column names z0=... or power_law_...; there are {', '.join(table.header)}")
    case.columns(case.elementwise, table, ours)


def _profile(name: str) -> tuple[str, float] | None:
    """Profile and shear of a column, for example "log_z0=0.2mm" or "power_law_0.11"."""
    if found := re.search(rf"z0=({NUMBER})(ft|mm|cm|m)$", name):
        return "log", log_shear(float(found[1]) * METRES[found[2]])
    if found := re.search(rf"power_law_({NUMBER})$", name):
        return "power", float(found[1])
    return None
