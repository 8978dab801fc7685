"""Estimates numbers of a vehicle by simulation error: least squares over windows of logs, all simulated side by side.

Estimated are the numbers, the initial state of each window (position, heading, u, v, r), and for each log the current
and the biases of compass and gyro. The numbers are theta_k = theta0_k exp(phi_k), with the prior phi_k ~ N(0, prior_k).
The cost is the sum of squares of residuals over their standard deviations (Huber's weights beyond OUTLIER), plus those
of the priors. The search is Gauss-Newton with Levenberg's damping; derivatives are differences, simulated in the same
batch. Unknowns of a single log are eliminated log by log (Schur complement). Short windows come first, because the
first guess may be bad.

The search starts from the file's numbers and from the best of many candidates that are drawn from the priors and all
simulated at once. Starts that end at different numbers go on to the full windows, and the most likely one is kept.

The intervals are those of the linearised posterior (Fisher information and priors): they hold for white measurement
errors and a correct model. Numbers that the data do not determine keep the file's value and the interval of their
prior; all others are the most likely ones given that.
"""

import time
from collections.abc import Generator, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.fit.log import Log
from taichi_sim.fit.table import Array, LogError
from taichi_sim.fit.windows import Window, WindowSimulator, check_against, cut, first_state, lead_steps, windows_of
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
STARTS = 4  # searches, from the file's numbers and from the best candidates
CANDIDATES = 32  # draws from the priors for each further start
SPREAD = 0.25  # largest deviation of the logarithm of a drawn number: beyond it, many vessels make no sense
SAME = 0.1  # fractions of the priors' deviations within which two starts end at the same numbers
LOST = 3.0  # a search this much less likely (logarithm) than the best one ended in a local minimum
LISTED = 0.35  # least component of a number in a direction that is reported


class SimulatedWindow(NamedTuple):
    """A window as measured, by the fitted numbers and, if it was held out, by the file's; begun at its own first state.

    Motions are [sample, 4]: north, east (m), heading (rad), yaw rate (rad/s), as the instruments would show them.
    """

    log: int
    measured: Array
    fitted: Array
    by_file: Array | None


class Start(NamedTuple):
    """Where one search ended."""

    phi: Array  # logarithms of the factors of the numbers
    worse: float  # how much less likely than the best one: difference of the logarithms of the likelihoods


class Tested(NamedTuple):
    """A log that was not fitted, simulated in windows by the fitted numbers and by the file's."""

    log: Log
    current: Array  # [2] m/s, estimated from this log by the fitted numbers
    by_file: Array  # rms of the residuals of north, east (m), heading (rad), yaw rate (rad/s)
    by_fit: Array
    tracks: list[SimulatedWindow]


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
    unknown: list[Array]  # joint changes of the logarithms of several numbers that the data do not tell
    starts: list[Start]  # places at which searches ended, the kept one first
    asked: int  # number of searches
    seconds: float  # what the search from the starts took
    tests: list[Tested]


class _Request(NamedTuple):
    """Simulations that a search wants, as of `WindowSimulator.run`."""

    windows: list[Window]
    phi: Array
    current: Array
    state: Array


T = TypeVar("T")
_Search = Generator[_Request, Array, T]


def _side_by_side(simulator: WindowSimulator, searches: Sequence[_Search[T]]) -> list[T]:
    """Results of searches whose simulations run in one batch as long as they go on."""
    results: dict[int, T] = {}
    requests = {k: next(search) for k, search in enumerate(searches)}
    while requests:
        all_of = list(requests.values())
        found = simulator.run(
            [w for r in all_of for w in r.windows],
            np.concatenate([r.phi for r in all_of]),
            np.concatenate([r.current for r in all_of]),
            np.concatenate([r.state for r in all_of]),
        )
        first, going = 0, requests
        requests = {}
        for k, request in going.items():
            mine = found[:, first : first + len(request.windows)]
            first += len(request.windows)
            try:
                requests[k] = searches[k].send(mine)
            except StopIteration as end:
                results[k] = end.value
    return [results[k] for k in range(len(searches))]


class _Problem:
    """Residuals of some windows and their derivatives.

    With `known`, the numbers are these and not estimated: the unknown ones (`phi`) are none.
    """

    def __init__(self, windows: Sequence[Window], interval: float, logs: int, known: Array | None = None):
        self.windows, self.logs, self.known = list(windows), logs, known
        self.measured = np.stack([w.motion[lead_steps(interval) :] for w in windows])  # [window, step + 1, 4]
        self.of = np.array([w.log for w in windows])

    def _request(self, windows: list[Window], phis: Array, currents: Array, states: Array) -> _Request:
        if self.known is not None:
            phis = np.tile(self.known, (len(windows), 1))
        return _Request(windows, phis, currents, states)

    def residuals(self, phi: Array, extra: Array, state: Array) -> _Search[Array]:
        """Residuals, measured minus simulated, [window, sample, 4]."""
        phis = np.tile(phi, (len(self.windows), 1))
        found = yield self._request(self.windows, phis, extra[self.of, :2], state)
        return self.left(np.moveaxis(found, 1, 0), extra)

    def left(self, found: Array, extra: Array) -> Array:
        base = found.copy()
        base[..., 2:] += extra[self.of, 2:][:, None]
        left = self.measured - base
        left[..., 2] = np.angle(np.exp(1j * left[..., 2]))
        return left

    def point(self, phi: Array, extra: Array, state: Array) -> "_Search[_Point]":
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
        found = yield self._request(self.windows * (1 + columns), phis, currents, states)
        found = np.moveaxis(found, 1, 0).reshape(1 + columns, w, -1, 4)
        slope = np.moveaxis((found[1:] - found[0]) / DELTA, 0, -1)
        bias = np.zeros((*slope.shape[:-1], 2))
        bias[..., 2, 0], bias[..., 3, 1] = 1.0, 1.0
        slope = np.concatenate((slope[..., : p + 2], bias, slope[..., p + 2 :]), axis=-1)
        return _Point(phi, extra, state, self.left(found[0], extra), slope)


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


class _Found(NamedTuple):
    """Where a search ended."""

    point: _Point
    sigma: Array  # deviation of the residuals by channel
    rounds: int  # how often the normal equations were solved

    def log_likelihood(self, prior: Array) -> float:
        """Logarithm of the posterior, but for a constant: its deviations are those of the residuals."""
        each = self.point.left[..., 0].size
        return float(-each * np.log(self.sigma).sum() - 0.5 * ((self.point.phi / prior) ** 2).sum())


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
) -> "_Search[_Found]":  # fmt: skip
    """The best point; a change of the cost below `enough` ends the search."""
    point, damping, rounds = (yield from problem.point(phi, extra, state)), DAMPING, 0
    cost = _cost(point.left, sigma, phi, prior, extra)
    while rounds < ITERATIONS and damping < 1e10:
        rounds += 1
        normal = _normal(problem, point, prior, sigma, damping)
        move = np.linalg.solve(normal.S + damping * np.diag(prior**-2.0), normal.g)
        move *= min(1.0, LONGEST / np.abs(move).max(initial=1e-12))
        extra, state = point.extra.copy(), point.state.copy()
        for log, mine, B, C, b in normal.blocks:
            change = np.linalg.solve(C, b - B.T @ move)
            extra[log] += change[:4]
            state[mine] += change[4:].reshape(-1, 6)
        phi = point.phi + move
        left = yield from problem.residuals(phi, extra, state)
        new_cost = _cost(left, sigma, phi, prior, extra)
        if not np.isfinite(new_cost) or new_cost > cost:
            damping *= 10
            continue
        better, damping = cost - new_cost, max(0.1 * damping, 1e-9)
        point = yield from problem.point(phi, extra, state)
        sigma = np.maximum(1.4826 * np.median(np.abs(point.left), axis=(0, 1)), 1e-6)
        cost = _cost(point.left, sigma, point.phi, prior, extra)
        if better < enough * abs(new_cost):
            break
    return _Found(point, sigma, rounds)


def _first_states(problem: _Problem, phi: Array, extra: Array, state: Array, sigma: Array) -> _Search[_Point]:
    """The best point for the initial states of windows alone, each window by itself.

    The beginning of a window is fitted first, because over all of it a vessel that is unstable on its course may turn
    to either side.
    """
    samples = problem.measured.shape[1]
    for share in GROWING:
        n = max(round(share * samples), 2)
        point, damping = (yield from problem.point(phi, extra, state)), np.full(len(state), 1e-3)
        for _ in range(STATE_ROUNDS):
            weight = _weights(point.left[:, :n] / sigma)
            r = (point.left[:, :n] / sigma * weight).reshape(len(state), -1)
            J = (point.slope[:, :n, :, -6:] * (weight / sigma)[..., None]).reshape(*r.shape, 6)
            H = np.einsum("wni,wnj->wij", J, J)
            H += damping[:, None, None] * H * np.eye(6)
            trial = point.state + np.linalg.solve(H, np.einsum("wni,wn->wi", J, r)[..., None])[..., 0]
            left = yield from problem.residuals(phi, extra, trial)
            gain = (_huber(point.left, sigma) - _huber(left, sigma))[:, :n].sum(axis=(1, 2))
            better = gain > 0  # False if not finite
            damping = np.clip(damping * np.where(better, 0.1, 10.0), 1e-9, 1e9)
            point = yield from problem.point(phi, extra, np.where(better[:, None], trial, point.state))
            if np.where(better, gain < ENOUGH * left[0].size, damping > 1e6).all():
                break
        state = point.state
    return point


def _candidates(problem: _Problem, state: Array, prior: Array, sigma: Array, count: int) -> _Search[list[Array]]:
    """The best `count` of many numbers drawn from the priors, all simulated at once."""
    rng, w, n = np.random.default_rng(0), len(problem.windows), count * CANDIDATES
    drawn = rng.normal(size=(n, len(prior))) * np.minimum(prior, SPREAD)
    found = yield _Request(
        problem.windows * n, np.repeat(drawn, w, axis=0), np.zeros((n * w, 2)), np.tile(state, (n, 1))
    )
    each = np.moveaxis(found, 1, 0).reshape(n, w, -1, 4)
    cost = np.array([_huber(problem.left(one, np.zeros((problem.logs, 4))), sigma).sum() for one in each])
    return list(drawn[np.argsort(np.where(np.isfinite(cost), cost, np.inf))[:count]])


def _distinct(found: Sequence[_Found], prior: Array) -> list[_Found]:
    """One of each group of searches that ended at the same numbers, the likeliest ones first."""
    kept: list[_Found] = []
    for one in sorted(found, key=lambda f: -f.log_likelihood(prior)):
        if all(np.abs((one.point.phi - other.point.phi) / prior).max() > SAME for other in kept):
            kept.append(one)
    return kept


def _searched(
    simulator: WindowSimulator, used: list[Window], logs: Sequence[Log], prior: Array, seconds: float, starts: int
) -> tuple[_Problem, list[_Found]]:  # fmt: skip
    """The problem of the full windows, and where searches from several starts ended in it, the likeliest first."""
    interval, lead = simulator.interval, lead_steps(simulator.interval)
    short = cut(used, lead, max(round(SHORT * seconds / interval), lead, LEAST))
    state = np.array([first_state(w, interval) for w in short])
    check_against(simulator, logs, short, state)
    begin, extra = _Problem(short, interval, len(logs)), np.zeros((len(logs), 4))
    guesses = [np.zeros(len(prior))]  # the file's numbers
    if starts > 1:
        [drawn] = _side_by_side(simulator, [_candidates(begin, state, prior, SIGMA, starts - 1)])
        guesses += drawn
    first = _side_by_side(
        simulator, [_solve(begin, phi, extra, state, prior, SIGMA, enough=ROUGHLY) for phi in guesses]
    )
    problem, each = _Problem(used, interval, len(logs)), len(short) // len(used)
    apart = _distinct(first, prior)
    full = _side_by_side(
        simulator,
        [_solve(problem, f.point.phi, f.point.extra, f.point.state[::each], prior, f.sigma) for f in apart],
    )
    full = [f._replace(rounds=f.rounds + before.rounds) for f, before in zip(full, apart, strict=True)]
    return problem, sorted(full, key=lambda f: -f.log_likelihood(prior))


def _directions(S: Array, prior: Array) -> list[Array]:
    """Joint changes of several logarithms, one prior deviation long, that the data determine no better than the priors.

    They are eigenvectors of the information of the data in units of the priors: along one of them the deviation is
    1 / sqrt(1 + lambda) of the prior's.
    """
    inside = prior[:, None] * S * prior - np.eye(len(prior))
    strength, vectors = np.linalg.eigh(inside)
    weak = vectors[:, 1 / np.sqrt(1 + np.maximum(strength, 0.0)) >= KNOWN].T
    return [prior * v * np.sign(v[np.argmax(np.abs(v))]) for v in weak if (np.abs(v) > LISTED).sum() > 1]


def _tested(simulator: WindowSimulator, log: Log, numbers: Array, sigma: Array, seconds: float, number: int) -> Tested:
    """A log that was not fitted: its current, biases and first states are estimated, the numbers are not."""
    windows = windows_of([log], seconds)
    nobody, found = np.zeros(0), []
    begin = np.array([first_state(w, simulator.interval) for w in windows])
    for known in (np.zeros(len(numbers)), numbers):
        problem = _Problem(windows, simulator.interval, 1, known)
        [end] = _side_by_side(simulator, [_solve(problem, nobody, np.zeros((1, 4)), begin, nobody, sigma)])
        found.append(end.point)
    by_file, by_fit = (np.sqrt(np.mean(p.left**2, axis=(0, 1))) for p in found)
    tracks = [
        SimulatedWindow(number, m, m - fitted, m - file)
        for m, file, fitted in zip(problem.measured, found[0].left, found[1].left, strict=True)
    ]
    return Tested(log, found[1].extra[0, :2], by_file, by_fit, tracks)


def fit(
    vehicle: str,
    logs: Sequence[Log],
    priors: Mapping[str, float],
    *,
    seconds: float = 6.0,
    starts: int = STARTS,
    tests: Sequence[Log] = (),
    changes: Mapping | None = None,
) -> Fit:
    """Fit numbers of a vehicle file to logs.

    Args:
        vehicle: a file or a name, which holds the first guess.
        logs: logs from `read_log`.
        priors: key -> prior standard deviation of the number's logarithm.
        seconds: length of a window.
        starts: number of searches: one from the file's numbers, the others from draws of the priors.
        tests: logs that are simulated by the fitted numbers, but not fitted.
        changes: changed keys of the vehicle file (load_vehicle).

    Raises:
        ConfigError: for a vehicle or a key that cannot be fitted.
        LogError: for logs with too few data.
    """
    if runtime.current().precision != "f64":
        raise ConfigError("a fit needs double precision: runtime.init(precision='f64')")
    keys, prior = tuple(priors), np.array(list(priors.values()))
    simulator = WindowSimulator(vehicle, keys, logs[0].interval, changes)
    for test in tests:  # what is wrong with them is told before the search
        if test.interval != logs[0].interval:
            windows_of([logs[0], test], seconds)
        windows_of([test], seconds)
    windows = windows_of(logs, seconds)
    held = [w for k, w in enumerate(windows) if len(windows) >= HELD_OUT and k % HELD_OUT == HELD_OUT - 1]
    used = [w for k, w in enumerate(windows) if not (len(windows) >= HELD_OUT and k % HELD_OUT == HELD_OUT - 1)]
    interval, lead = logs[0].interval, lead_steps(logs[0].interval)
    samples, unknown = sum(w.motion[lead:].size for w in used), len(keys) + 6 * len(used) + 4 * len(logs)
    if samples < 2 * unknown:
        raise LogError(f"{samples} measured values for {unknown} unknowns: give longer logs, or fewer --numbers")
    clock = time.perf_counter()
    problem, ends = _searched(simulator, used, logs, prior, seconds, starts)
    took, (point, sigma, rounds) = time.perf_counter() - clock, ends[0]
    others = [
        Start(f.point.phi, ends[0].log_likelihood(prior) - f.log_likelihood(prior)) for f in _distinct(ends, prior)
    ]
    normal = _normal(problem, point, prior, sigma)
    if _odd(normal, prior):
        # a local minimum of an initial state looks like this too: fit each again, keep the better one
        begin = np.array([first_state(w, interval) for w in used])
        [anew] = _side_by_side(simulator, [_first_states(problem, point.phi, point.extra, begin, sigma)])
        cost, cost_anew = (_huber(x.left, sigma).sum(axis=(1, 2)) for x in (point, anew))
        state = np.where((cost_anew < cost)[:, None], anew.state, point.state)
        [(point, sigma, again)] = _side_by_side(
            simulator, [_solve(problem, point.phi, point.extra, state, prior, sigma)]
        )
        normal, rounds = _normal(problem, point, prior, sigma), rounds + again
    extra = point.extra
    covariance = np.linalg.inv(normal.S) * samples / (samples - unknown)  # sigma is that of the residuals, not of noise
    deviation, nominal = np.sqrt(np.diag(covariance)), simulator.nominal
    told = deviation < KNOWN * prior
    phi = _given_the_rest(point.phi, covariance, told)
    half = 1.96 * np.where(told, deviation, prior)
    low, high = np.sort(nominal * np.exp(phi + half * np.array([[-1.0], [1.0]])), axis=0)
    before = after = float("nan")
    tracks = [
        SimulatedWindow(w.log, m, m - left, None) for w, m, left in zip(used, problem.measured, point.left, strict=True)
    ]
    if held := [
        w for w in held if w.log in {u.log for u in used}
    ]:  # the current and the biases of a log are known by now
        other = _Problem(held, interval, len(logs))
        begin = np.array([first_state(w, interval) for w in held])
        left = [
            point.left
            for point in _side_by_side(
                simulator,
                [_first_states(other, numbers, extra, begin, sigma) for numbers in (np.zeros(len(keys)), phi)],
            )
        ]
        before, after = (float(np.sqrt(np.mean((x / sigma) ** 2))) for x in left)
        tracks += [
            SimulatedWindow(w.log, m, m - b, m - a) for w, m, a, b in zip(held, other.measured, *left, strict=True)
        ]
    return Fit(
        keys, nominal, nominal * np.exp(phi), low, high, told, covariance / np.outer(deviation, deviation), sigma,
        extra[:, :2], before, after, rounds, _odd(normal, prior), tracks, _directions(normal.S, prior), others, starts,
        took, [_tested(simulator, log, phi, sigma, seconds, len(logs) + k) for k, log in enumerate(tests)],
    )  # fmt: skip


def _given_the_rest(phi: Array, covariance: Array, told: NDArray[np.bool_]) -> Array:
    """The most likely logarithms if those that the data do not tell stay at 0, the file's values."""
    if told.all() or not told.any():
        return phi * told
    kept = np.where(told, phi, 0.0)
    across, among = covariance[np.ix_(told, ~told)], covariance[np.ix_(~told, ~told)]
    kept[told] -= across @ np.linalg.solve(among, phi[~told])
    return kept
