"""Estimates numbers of a vehicle by simulation error: least squares over windows of logs, all simulated side by side.

Estimated are the numbers, the initial state of each window (position, heading, u, v, r), and for each log the current
and the biases of compass and gyro. The numbers are theta_k = theta0_k exp(phi_k), with the prior phi_k ~ N(0, prior_k).

The search (gauss_newton.py) goes over short windows first, because the first guess may be bad. It starts from the
file's numbers and from the best of many candidates that are drawn from the priors and all simulated at once. Starts
that end at different numbers go on to the full windows, and the most likely one is kept.

The intervals are those of the linearised posterior (Fisher information and priors): they hold for white measurement
errors and a correct model. Numbers that the data do not determine keep the file's value and the interval of their
prior; all others are the most likely ones given that.
"""

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.fit.gauss_newton import (
    CURRENT,
    DELAYS,
    LOG_PRIOR,
    ROUGHLY,
    NormalEquations,
    Point,
    Problem,
    Request,
    Search,
    SearchEnd,
    huber,
    normal_equations,
    search,
    search_first_states,
    side_by_side,
)  # fmt: skip
from taichi_sim.applications.fit.log import Log
from taichi_sim.applications.fit.log_table import CHANNELS, Array, LogError
from taichi_sim.applications.fit.residual_correlation import spreads
from taichi_sim.applications.fit.windows import (
    Window,
    WindowSimulator,
    check_against,
    cut,
    first_state,
    lead_steps,
    window_seconds,
    windows_of,
)
from taichi_sim.config import ConfigError
from taichi_sim.kernels import runtime

SHORT = 0.5  # length of the windows that are fitted first, over the full length
LEAST = 10  # least number of samples in a window
SIGMA = np.array([0.5, 0.5, np.radians(1.0), np.radians(1.0)])  # initial deviations of the four channels
KNOWN = 0.7  # a number is determined by the data if its deviation is below this fraction of the prior's
ODD = 4.0  # standard deviations from which a log counts as inconsistent with the others
HELD_OUT = 5  # every fifth window is not fitted
STARTS = 4  # searches, from the file's numbers and from the best candidates
CANDIDATES = 32  # draws from the priors for each further start
SPREAD = 0.25  # largest deviation of the logarithm of a drawn number: beyond it, many vessels make no sense
SAME = 0.1  # fractions of the priors' deviations within which two starts end at the same numbers
LOST = 3.0  # a search this much less likely (logarithm) than the best one ended in a local minimum
ANEW = 3  # how often windows are begun anew
COSTLY, GAIN = 1.25, 1.0  # cost over that of most windows, from which they are; what must be gained
UNLIKE = 3.0  # rms residual of a window over that of most, from which something happened to it
LEAST_WINDOWS, SOME = 5, 0.1  # least number of windows for that, and the largest share that is left out
AGAIN = 1.1  # widening of a channel's deviation from which the search goes on with it
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
    surprise: Array  # how far the logarithms are from the file's, over the prior's deviation
    correlation: Array  # [number, number]
    sigma: Array  # deviation of the residuals by channel: m, m, rad, rad/s
    spread: Array  # factors by which dependent residuals widen it, by channel
    currents: Array  # [log, 2] m/s
    delays: Array  # [log, 3] s: of position, heading and yaw rate behind the commands
    delay_deviations: Array  # [log, 3] s
    left_out: list[str]  # windows whose residuals are unlike those of all others
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


def _odd(normal: NormalEquations, prior: Array) -> dict[int, Array]:
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


def _candidates(problem: Problem, state: Array, prior: Array, sigma: Array, count: int) -> Search[list[Array]]:
    """The best `count` of many numbers drawn from the priors, all simulated at once."""
    rng, w, n = np.random.default_rng(0), len(problem.windows), count * CANDIDATES
    drawn = rng.normal(size=(n, len(prior))) * np.minimum(prior, SPREAD)
    found = yield Request(
        problem.windows * n, np.repeat(drawn, w, axis=0), np.zeros((n * w, 2)), np.tile(state, (n, 1))
    )
    each = np.moveaxis(found, 1, 0).reshape(n, w, -1, 4)
    cost = np.array([huber(problem.left(one, np.zeros((problem.logs, len(LOG_PRIOR)))), sigma).sum() for one in each])
    return list(drawn[np.argsort(np.where(np.isfinite(cost), cost, np.inf))[:count]])


def _distinct(found: Sequence[SearchEnd], prior: Array) -> list[SearchEnd]:
    """Keep one of each group of searches that ended at the same numbers, the likeliest ones first."""
    kept: list[SearchEnd] = []
    for one in sorted(found, key=lambda f: -f.log_likelihood(prior)):
        if all(np.abs((one.point.phi - other.point.phi) / prior).max() > SAME for other in kept):
            kept.append(one)
    return kept


def _searched(
    simulator: WindowSimulator, used: list[Window], logs: Sequence[Log], prior: Array, seconds: float, starts: int
) -> tuple[Problem, list[SearchEnd]]:  # fmt: skip
    """Search from several starts; return the problem of the full windows, and the ends found, the likeliest first."""
    interval, lead = simulator.interval, lead_steps(simulator.interval)
    problem = Problem(used, interval, len(logs))
    share = SHORT if SHORT * problem.new.sum(axis=1).mean(axis=0).min() >= LEAST else 1.0  # a slow sensor: as they are
    short = cut(used, lead, max(round(share * seconds / interval), lead, LEAST))
    state = np.array([first_state(w, interval) for w in short])
    check_against(simulator, logs, short, state)
    begin, extra = Problem(short, interval, len(logs)), np.zeros((len(logs), len(LOG_PRIOR)))
    guesses = [np.zeros(len(prior))]  # the file's numbers
    if starts > 1:
        [drawn] = side_by_side(simulator, [_candidates(begin, state, prior, SIGMA, starts - 1)])
        guesses += drawn
    first = side_by_side(simulator, [search(begin, phi, extra, state, prior, SIGMA, enough=ROUGHLY) for phi in guesses])
    each = len(short) // len(used)
    apart = _distinct(first, prior)
    go_on = [search(problem, f.point.phi, f.point.extra, f.point.state[::each], prior, f.sigma) for f in apart]
    full = side_by_side(simulator, go_on)
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
    """Test the numbers on a log that was not fitted: estimate only its current, biases and first states."""
    windows = windows_of([log], seconds)
    nobody, found = np.zeros(0), []
    begin = np.array([first_state(w, simulator.interval) for w in windows])
    for known in (np.zeros(len(numbers)), numbers):
        problem = Problem(windows, simulator.interval, 1, known)
        [end] = side_by_side(simulator, [search(problem, nobody, np.zeros((1, len(LOG_PRIOR))), begin, nobody, sigma)])
        found.append((problem, end.point))
    by_file, by_fit = (problem.rms(point.left) for problem, point in found)
    problem, fitted = found[1]
    tracks = _tracks(problem, fitted, found[0][1], number)
    return Tested(log, found[1][1].extra[0, CURRENT], by_file, by_fit, tracks)


def _tracks(
    problem: Problem, fitted: Point, file: Point | None = None, number: int | None = None
) -> list[SimulatedWindow]:
    """The windows of a problem, of log `number` or their own, with NaN where a sample does not count."""
    measured = np.where(problem.new, problem.measured, np.nan)
    return [
        SimulatedWindow(w.log if number is None else number, measured[k], fitted.shown[k], file and file.shown[k])
        for k, w in enumerate(problem.windows)
    ]


def _settled(simulator: WindowSimulator, problem: Problem, end: SearchEnd, prior: Array) -> SearchEnd:
    """The end of a search whose windows of a high cost are begun anew from the data, as long as this helps.

    The first state of a window may end in a local minimum, where few samples tell of it.
    """
    for _ in range(ANEW):
        cost = huber(end.point.left, end.sigma).sum(axis=(1, 2)) / problem.new.sum(axis=(1, 2))
        which = np.flatnonzero(cost > COSTLY * np.median(cost))
        if not len(which):
            break
        part = Problem([problem.windows[k] for k in which], problem.interval, problem.logs)
        begin = np.array([first_state(w, problem.interval) for w in part.windows])
        of = search_first_states(part, end.point.phi, end.point.extra, begin, end.sigma)
        [anew] = side_by_side(simulator, [of])
        better = huber(anew.left, end.sigma).sum(axis=(1, 2)) < cost[which] * part.new.sum(axis=(1, 2)) - GAIN
        if not better.any():
            break
        state = end.point.state.copy()
        state[which[better]] = anew.state[better]
        further = search(problem, end.point.phi, end.point.extra, state, prior, end.sigma)
        [after] = side_by_side(simulator, [further])
        end = after._replace(rounds=after.rounds + end.rounds)
    return end


def _unlike(problem: Problem, end: SearchEnd, logs: Sequence[Log], seconds: float) -> dict[int, str]:
    """Windows whose residuals are UNLIKE times those of most: number -> a line; none if the numbers may be to blame."""
    count = np.maximum(problem.new.sum(axis=1), 1)
    size = np.sqrt(((end.point.left / end.sigma) ** 2).sum(axis=1) / count)
    times = size / np.median(size, axis=0)
    wild = np.flatnonzero((times > UNLIKE).any(axis=1))
    if len(size) < LEAST_WINDOWS or len(wild) > max(1, SOME * len(size)):
        return {}
    found = {}
    for k in wild:
        window, c = problem.windows[k], int(np.argmax(times[k]))
        if 2 * np.sum(problem.of[wild] == window.log) <= np.sum(problem.of == window.log):
            found[int(k)] = (f"{logs[window.log].name}: {window.begin:g} to {window.begin + seconds:g} s: residuals of "
                             f"{CHANNELS[c]} are {times[k, c]:.1f} times the others': not fitted")  # fmt: skip
    return found


def fit(
    vehicle: str,
    logs: Sequence[Log],
    priors: Mapping[str, float],
    *,
    seconds: float | None = None,
    starts: int = STARTS,
    tests: Sequence[Log] = (),
    changes: Mapping | None = None,
) -> Fit:
    """Fit numbers of a vehicle file to logs.

    Args:
        vehicle: a file or a name, which holds the first guess.
        logs: logs from `read_log`.
        priors: key -> prior standard deviation of the number's logarithm.
        seconds: length of a window; None: the usual one (window_seconds).
        starts: number of searches: one from the file's numbers, the others from draws of the priors.
        tests: logs that are simulated by the fitted numbers, but not fitted.
        changes: changed keys of the vehicle file (load_vehicle).
    """
    if runtime.current().precision != "f64":
        raise ConfigError("a fit needs double precision: runtime.init(precision='f64')")
    keys, prior = tuple(priors), np.array(list(priors.values()))
    simulator = WindowSimulator(vehicle, keys, logs[0].interval, changes)
    seconds = window_seconds(logs) if seconds is None else seconds
    for test in tests:  # what is wrong with them is told before the search
        if test.interval != logs[0].interval:
            windows_of([logs[0], test], seconds)
        windows_of([test], seconds)
    windows = windows_of(logs, seconds)
    held = windows[HELD_OUT - 1 :: HELD_OUT]
    used = [w for k, w in enumerate(windows) if k % HELD_OUT != HELD_OUT - 1]
    interval, lead = logs[0].interval, lead_steps(logs[0].interval)
    samples = sum(w.motion[lead:].size if w.new is None else int(w.new[lead:].sum()) for w in used)
    unknown = len(keys) + 6 * len(used) + len(LOG_PRIOR) * len(logs)
    if samples < 2 * unknown:
        raise LogError(f"{samples} measured values for {unknown} unknowns: give longer logs, or fewer --numbers")
    clock = time.perf_counter()
    problem, ends = _searched(simulator, used, logs, prior, seconds, starts)
    end = _settled(simulator, problem, ends[0], prior)
    took, unlike = time.perf_counter() - clock, _unlike(problem, end, logs, seconds)
    if unlike:
        kept = [k for k in range(len(used)) if k not in unlike]
        used, problem = [used[k] for k in kept], Problem([used[k] for k in kept], interval, len(logs))
        [end] = side_by_side(simulator, [search(problem, *end.point[:2], end.point.state[kept], prior, end.sigma)])
    normal = normal_equations(problem, end.point, prior, end.sigma)
    problem.spread = spreads(problem, end.point, normal, end.sigma)
    if problem.spread.max() > AGAIN:
        [end] = side_by_side(simulator, [search(problem, *end.point[:3], prior, end.sigma * problem.spread)])
    point, sigma, rounds, _ = end._replace(sigma=problem.sigma(end.point, end.sigma))
    best = ends[0].log_likelihood(prior)
    others = [Start(f.point.phi, best - f.log_likelihood(prior)) for f in _distinct(ends, prior)]
    normal = normal_equations(problem, point, prior, sigma)
    extra = point.extra
    covariance: Array = np.linalg.inv(normal.S).astype(np.float64)
    deviation, nominal = np.sqrt(np.diag(covariance)), simulator.nominal
    told = deviation < KNOWN * prior
    phi = _given_the_rest(point.phi, covariance, told)
    half = 1.96 * np.where(told, deviation, prior)
    low, high = np.sort(nominal * np.exp(phi + half * np.array([[-1.0], [1.0]])), axis=0)
    before = after = float("nan")
    tracks = _tracks(problem, point)
    held = [w for w in held if w.log in {u.log for u in used}]
    if held:  # the current and the biases of a log are known by now
        other = Problem(held, interval, len(logs))
        begin = np.array([first_state(w, interval) for w in held])
        both = [search_first_states(other, numbers, extra, begin, sigma) for numbers in (np.zeros(len(keys)), phi)]
        by_file, by_fit = side_by_side(simulator, both)
        noise = sigma / problem.spread
        before, after = (float(np.sqrt(((x.left / noise) ** 2).sum() / other.new.sum())) for x in (by_file, by_fit))
        tracks += _tracks(other, by_fit, by_file)
    return Fit(
        keys, nominal, nominal * np.exp(phi), low, high, told, phi / prior, covariance / np.outer(deviation, deviation),
        sigma / problem.spread, problem.spread, extra[:, CURRENT], extra[:, DELAYS],
        _delay_deviations(normal, len(logs)), list(unlike.values()), before, after, rounds, _odd(normal, prior), tracks,
        _directions(normal.S, prior), others, starts, took,
        [_tested(simulator, log, phi, sigma, seconds, len(logs) + k) for k, log in enumerate(tests)],
    )  # fmt: skip


def _delay_deviations(normal: NormalEquations, logs: int) -> Array:
    """Standard deviations of the delays [log, 3], s, from the whole normal equations."""
    found, among = np.full((logs, 3), np.inf), np.linalg.inv(normal.S)
    for log, _, B, C, _ in normal.blocks:
        inverse = np.linalg.inv(C)[DELAYS]
        across = inverse @ B.T
        found[log] = np.sqrt(np.diag(inverse[:, DELAYS] + across @ among @ across.T))
    return found


def _given_the_rest(phi: Array, covariance: Array, told: NDArray[np.bool_]) -> Array:
    """The most likely logarithms, with those that the data do not determine held at 0, the file's values."""
    if told.all() or not told.any():
        return phi * told
    kept = np.where(told, phi, 0.0)
    across, among = covariance[np.ix_(told, ~told)], covariance[np.ix_(~told, ~told)]
    kept[told] -= across @ np.linalg.solve(among, phi[~told])
    return kept
