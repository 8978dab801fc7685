"""Estimates numbers of a vehicle by simulation error: least squares over windows of logs, all simulated side by side.

Estimated are the numbers, the initial state of each window (position, heading, u, v, r), and for each log the current
and the biases of compass and gyro. The numbers are theta_k = theta0_k exp(phi_k), with the prior phi_k ~ N(0, prior_k).
The cost is the sum of squares of residuals over their standard deviations (Huber's weights beyond OUTLIER), plus those
of the priors. The search is Gauss-Newton with Levenberg's damping; derivatives are differences, simulated in the same
batch. Unknowns of a single log are eliminated log by log (Schur complement). Short windows come first, because the
first guess may be bad.

The intervals are those of the linearised posterior (Fisher information and priors): they hold for white measurement
errors and a correct model.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.fit.log import Array, Log, LogError
from taichi_sim.fit.windows import Window, WindowSimulator, cut, first_state, lead_steps, windows_of
from taichi_sim.kernels import runtime

OUTLIER = 2.5  # standard deviations beyond which a residual has less weight
ITERATIONS = 60
STATE_ROUNDS = 8  # iterations of the search for initial states alone, for each of GROWING
GROWING = (0.2, 0.5, 1.0)  # fitted fractions of a window
SHORT = 0.5  # length of the windows that are fitted first, over the full length
LEAST = 10  # least number of samples in a window
ENOUGH, ROUGHLY = 1e-5, 1e-3  # relative change of the cost that ends the search: over full windows, over short ones
DAMPING = 10.0  # damping of the first step over the precision of the priors
OF_STATES = 1e-4  # damping of states, currents and biases over their own precision
LONGEST = 0.3  # largest change of a number's logarithm in a step
DELTA = 1e-4  # step of differences: phi, and states in m, rad, m/s, rad/s
# prior standard deviations of a log's current (north, east; m/s), heading bias (rad) and yaw rate bias (rad/s)
LOG_PRIOR = np.array([1.0, 1.0, np.radians(3.0), np.radians(1.0)])
SIGMA = np.array([0.5, 0.5, np.radians(1.0), np.radians(1.0)])  # initial deviations of the four channels
KNOWN = 0.7  # a number is determined by the data if its deviation is below this fraction of the prior's
ODD = 4.0  # standard deviations from which a log counts as inconsistent with the others
HELD_OUT = 5  # every fifth window is not fitted


class SimulatedWindow(NamedTuple):
    """A window as measured, by the fitted numbers and, if it was held out, by the file's; begun at its own first state.

    Motions are [sample, 4]: north, east (m), heading (rad), yaw rate (rad/s), as the instruments would show them.
    """

    log: int
    measured: Array
    fitted: Array
    by_file: Array | None


class Fit(NamedTuple):
    """Result of a fit."""

    keys: tuple[str, ...]
    nominal: Array  # numbers of the vehicle file
    values: Array
    low: Array  # bounds of the 95 % intervals
    high: Array
    told: NDArray[np.bool_]  # whether the data determine the number, rather than the prior
    correlation: Array  # [number, number]
    sigma: Array  # deviation of the residuals by channel: m, m, rad, rad/s
    currents: Array  # [log, 2] m/s
    before: float  # rms of the weighted residuals of the held-out windows with the file's numbers
    after: float  # the same with the fitted numbers
    iterations: int
    odd: dict[int, Array]  # inconsistent logs -> changes of the logarithms that they would make
    tracks: list[SimulatedWindow]


class _Problem:
    """Residuals of some windows and their derivatives."""

    def __init__(self, simulator: WindowSimulator, windows: Sequence[Window], logs: int):
        self.simulator, self.windows, self.logs = simulator, list(windows), logs
        self.measured = np.stack([w.motion[lead_steps(simulator.interval) :] for w in windows])  # [window, step + 1, 4]
        self.of = np.array([w.log for w in windows])

    def residuals(self, phi: Array, extra: Array, state: Array) -> Array:
        """Residuals, measured minus simulated, [window, sample, 4]."""
        w = len(self.windows)
        found = self.simulator.run(self.windows, np.tile(phi, (w, 1)), extra[self.of, :2], state)
        return self._left(np.moveaxis(found, 1, 0), extra)

    def _left(self, found: Array, extra: Array) -> Array:
        base = found.copy()
        base[..., 2:] += extra[self.of, 2:][:, None]
        left = self.measured - base
        left[..., 2] = np.angle(np.exp(1j * left[..., 2]))
        return left

    def point(self, phi: Array, extra: Array, state: Array) -> "_Point":
        """Residuals and their derivatives."""
        p, w = len(phi), len(self.windows)
        columns = p + 2 + 6
        envs = w * (1 + columns)
        phis, currents = np.tile(phi, (envs, 1)), np.tile(extra[self.of, :2], (1 + columns, 1))
        states = np.tile(state, (1 + columns, 1))
        for k in range(columns):
            part = slice(w * (k + 1), w * (k + 2))
            if k < p:
                phis[part, k] += DELTA
            elif k < p + 2:
                currents[part, k - p] += DELTA
            else:
                states[part, k - p - 2] += DELTA
        found = self.simulator.run(self.windows * (1 + columns), phis, currents, states)
        found = np.moveaxis(found, 1, 0).reshape(1 + columns, w, -1, 4)
        slope = np.moveaxis((found[1:] - found[0]) / DELTA, 0, -1)
        bias = np.zeros((*slope.shape[:-1], 2))
        bias[..., 2, 0], bias[..., 3, 1] = 1.0, 1.0
        slope = np.concatenate((slope[..., : p + 2], bias, slope[..., p + 2 :]), axis=-1)
        return _Point(phi, extra, state, self._left(found[0], extra), slope)


def _weights(scaled: Array) -> Array:
    return np.sqrt(np.minimum(1.0, OUTLIER / np.maximum(np.abs(scaled), 1e-12)))


def _huber(left: Array, sigma: Array) -> Array:
    """Huber's cost of each residual."""
    x = np.abs(left / sigma)
    least = np.minimum(x, OUTLIER)
    return least * (x - 0.5 * least)


def _cost(left: Array, sigma: Array, phi: Array, prior: Array, extra: Array) -> float:
    """Total cost of residuals and priors."""
    of_priors = ((phi / prior) ** 2).sum() + ((extra / LOG_PRIOR) ** 2).sum()
    return float(_huber(left, sigma).sum() + 0.5 * of_priors)


class _Point(NamedTuple):
    """A point of the search."""

    phi: Array
    extra: Array  # [log, 4]
    state: Array  # [window, 6]
    left: Array  # measured less simulated [window, sample, 4]
    slope: Array  # d(simulated) [window, sample, 4, number + 4 + 6]


class _Normal(NamedTuple):
    """Normal equations of the numbers at a point; unknowns of single logs are eliminated."""

    S: Array  # [number, number]
    g: Array  # [number]
    blocks: list  # for each log: its number, its windows, B, C, b
    of_log: dict[int, tuple[Array, Array]]  # S and g of each log alone, without priors


def _normal(problem: _Problem, point: _Point, prior: Array, sigma: Array, damping: float = 0.0) -> _Normal:
    """Normal equations from the residuals and derivatives at a point."""
    p = len(point.phi)
    scaled = point.left / sigma
    weight = _weights(scaled)
    r, J = scaled * weight, point.slope * (weight / sigma)[..., None]
    S, g, blocks, of_log = np.diag(prior**-2.0), -point.phi / prior**2, [], {}
    for log in range(problem.logs):
        mine = np.flatnonzero(problem.of == log)
        if not len(mine):
            continue
        m = 4 + 6 * len(mine)
        A, B = np.zeros((p, p)), np.zeros((p, m))
        C, a, b = np.zeros((m, m)), np.zeros(p), np.zeros(m)
        C[:4, :4], b[:4] = np.diag(LOG_PRIOR**-2.0), -point.extra[log] / LOG_PRIOR**2
        for k, w in enumerate(mine):
            j, own = J[w].reshape(-1, p + 10), np.r_[0:4, 4 + 6 * k : 10 + 6 * k]
            residual, theta, rest = r[w].ravel(), j[:, :p], j[:, p:]
            A += theta.T @ theta
            B[:, own] += theta.T @ rest
            C[np.ix_(own, own)] += rest.T @ rest
            a += theta.T @ residual
            b[own] += rest.T @ residual
        C += OF_STATES * damping * np.diag(np.diag(C))
        half = np.linalg.solve(C, np.column_stack((B.T, b)))
        of_log[log] = A - B @ half[:, :p], a - B @ half[:, p]
        S, g = S + of_log[log][0], g + of_log[log][1]
        blocks.append((log, mine, B, C, b))
    return _Normal(S, g, blocks, of_log)


def _odd(normal: _Normal, prior: Array) -> dict[int, Array]:
    """Logs that would change the numbers significantly: log -> changes of the logarithms of the numbers.

    If all logs are of one boat, each log's part of the gradient at the best point has the covariance S of that log.
    This is the score test (Rao 1948); its statistic is chi-squared with one degree of freedom per number.
    """
    p, found = len(prior), {}
    limit = p * (1 - 2 / (9 * p) + ODD * np.sqrt(2 / (9 * p))) ** 3  # Wilson & Hilferty (1931)
    for log, (S, g) in normal.of_log.items():
        change = np.linalg.solve(S + np.diag(prior**-2.0), g)
        if len(normal.of_log) > 1 and float(change @ g) > limit:
            found[log] = change
    return found


def _solve(
    problem: _Problem, phi: Array, extra: Array, state: Array, prior: Array, sigma: Array, enough: float = ENOUGH
):  # fmt: skip
    """The best point, the deviations of the residuals there, and how often the normal equations were solved.

    A change of the cost below `enough` ends the search.
    """
    point, damping, rounds = problem.point(phi, extra, state), DAMPING, 0
    cost = _cost(point.left, sigma, phi, prior, extra)
    while rounds < ITERATIONS and damping < 1e10:
        rounds += 1
        normal = _normal(problem, point, prior, sigma, damping)
        move = np.linalg.solve(normal.S + damping * np.diag(prior**-2.0), normal.g)
        move *= min(1.0, LONGEST / max(np.abs(move).max(), 1e-12))
        extra, state = point.extra.copy(), point.state.copy()
        for log, mine, B, C, b in normal.blocks:
            change = np.linalg.solve(C, b - B.T @ move)
            extra[log] += change[:4]
            state[mine] += change[4:].reshape(-1, 6)
        phi = point.phi + move
        new_cost = _cost(problem.residuals(phi, extra, state), sigma, phi, prior, extra)
        if not np.isfinite(new_cost) or new_cost > cost:
            damping *= 10
            continue
        better, point, damping = cost - new_cost, problem.point(phi, extra, state), max(0.1 * damping, 1e-9)
        sigma = np.maximum(1.4826 * np.median(np.abs(point.left), axis=(0, 1)), 1e-6)
        cost = _cost(point.left, sigma, point.phi, prior, extra)
        if better < enough * abs(new_cost):
            break
    return point, sigma, rounds


def _first_states(problem: _Problem, phi: Array, extra: Array, state: Array, sigma: Array) -> _Point:
    """The best point for the initial states of windows alone, each window by itself.

    The beginning of a window is fitted first, because over all of it a vessel that is unstable on its course may turn
    to either side.
    """
    samples = problem.measured.shape[1]
    for share in GROWING:
        n = max(round(share * samples), 2)
        point, damping = problem.point(phi, extra, state), np.full(len(state), 1e-3)
        for _ in range(STATE_ROUNDS):
            weight = _weights(point.left[:, :n] / sigma)
            r = (point.left[:, :n] / sigma * weight).reshape(len(state), -1)
            J = (point.slope[:, :n, :, -6:] * (weight / sigma)[..., None]).reshape(*r.shape, 6)
            H = np.einsum("wni,wnj->wij", J, J)
            H += damping[:, None, None] * H * np.eye(6)
            trial = point.state + np.linalg.solve(H, np.einsum("wni,wn->wi", J, r)[..., None])[..., 0]
            left = problem.residuals(phi, extra, trial)
            gain = (_huber(point.left, sigma) - _huber(left, sigma))[:, :n].sum(axis=(1, 2))
            better = gain > 0  # False if not finite
            damping = np.clip(damping * np.where(better, 0.1, 10.0), 1e-9, 1e9)
            point = problem.point(phi, extra, np.where(better[:, None], trial, point.state))
            if np.where(better, gain < ENOUGH * left[0].size, damping > 1e6).all():
                break
        state = point.state
    return point


def fit(
    vehicle: str,
    logs: Sequence[Log],
    priors: Mapping[str, float],
    *,
    seconds: float = 6.0,
    changes: Mapping | None = None,
) -> Fit:
    """Fit numbers of a vehicle file to logs.

    Args:
        vehicle: a file or a name, which holds the first guess.
        logs: logs from `read_log`.
        priors: key -> prior standard deviation of the number's logarithm.
        seconds: length of a window.
        changes: changed keys of the vehicle file (load_vehicle).

    Raises:
        ConfigError: for a vehicle or a key that cannot be fitted.
        LogError: for logs with too few data.
    """
    if runtime.current().precision != "f64":
        raise ConfigError("a fit needs double precision: runtime.init(precision='f64')")
    keys, prior = tuple(priors), np.array(list(priors.values()))
    simulator = WindowSimulator(vehicle, keys, logs[0].interval, changes)
    windows = windows_of(logs, seconds)
    held = [w for k, w in enumerate(windows) if len(windows) >= HELD_OUT and k % HELD_OUT == HELD_OUT - 1]
    used = [w for k, w in enumerate(windows) if not (len(windows) >= HELD_OUT and k % HELD_OUT == HELD_OUT - 1)]
    interval, lead = logs[0].interval, lead_steps(logs[0].interval)
    samples, unknown = sum(w.motion[lead:].size for w in used), len(keys) + 6 * len(used) + 4 * len(logs)
    if samples < 2 * unknown:
        raise LogError(f"{samples} measured values for {unknown} unknowns: give longer logs, or fewer --numbers")
    phi, extra, sigma = np.zeros(len(keys)), np.zeros((len(logs), 4)), SIGMA
    short = cut(used, lead, max(round(SHORT * seconds / interval), lead, LEAST))
    state = np.array([first_state(w, interval) for w in short])
    point, sigma, rounds = _solve(
        _Problem(simulator, short, len(logs)), phi, extra, state, prior, sigma, enough=ROUGHLY
    )
    problem, each = _Problem(simulator, used, len(logs)), len(short) // len(used)
    point, sigma, more = _solve(problem, point.phi, point.extra, point.state[::each], prior, sigma)
    normal = _normal(problem, point, prior, sigma)
    if _odd(
        normal, prior
    ):  # a local minimum of an initial state looks like this too: fit each again, keep the better one
        begin = np.array([first_state(w, interval) for w in used])
        anew = _first_states(problem, point.phi, point.extra, begin, sigma)
        cost, cost_anew = (_huber(x.left, sigma).sum(axis=(1, 2)) for x in (point, anew))
        state = np.where((cost_anew < cost)[:, None], anew.state, point.state)
        point, sigma, again = _solve(problem, point.phi, point.extra, state, prior, sigma)
        normal, more = _normal(problem, point, prior, sigma), more + again
    phi, extra = point.phi, point.extra
    covariance = np.linalg.inv(normal.S) * samples / (samples - unknown)  # sigma is that of the residuals, not of noise
    deviation, nominal = np.sqrt(np.diag(covariance)), simulator.nominal
    values = nominal * np.exp(phi)
    ends = np.sort(nominal * np.exp(phi + 1.96 * np.array([[-1.0], [1.0]]) * deviation), axis=0)
    before = after = float("nan")
    tracks = [
        SimulatedWindow(w.log, m, m - left, None) for w, m, left in zip(used, problem.measured, point.left, strict=True)
    ]
    if held := [
        w for w in held if w.log in {u.log for u in used}
    ]:  # the current and the biases of a log are known by now
        other = _Problem(simulator, held, len(logs))
        begin = np.array([first_state(w, interval) for w in held])
        left = [_first_states(other, numbers, extra, begin, sigma).left for numbers in (np.zeros(len(keys)), phi)]
        before, after = (float(np.sqrt(np.mean((x / sigma) ** 2))) for x in left)
        tracks += [
            SimulatedWindow(w.log, m, m - b, m - a) for w, m, a, b in zip(held, other.measured, *left, strict=True)
        ]
    correlation = covariance / np.outer(deviation, deviation)
    told, low, high = deviation < KNOWN * prior, ends[0], ends[1]
    return Fit(
        keys, nominal, values, low, high, told, correlation, sigma, extra[:, :2], before, after, rounds + more,
        _odd(normal, prior), tracks,
    )  # fmt: skip
