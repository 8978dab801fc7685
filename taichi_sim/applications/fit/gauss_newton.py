"""The search of a fit: Gauss-Newton with Levenberg's damping, over windows that are simulated side by side.

The cost is the sum of squares of residuals over their standard deviations (Huber's weights beyond OUTLIER), plus those
of the priors. Derivatives are differences, simulated in the same batch. Unknowns of a single log are eliminated log by
log (Schur complement). Searches are generators that ask for simulations, so that several of them share a batch.
"""

from collections.abc import Generator, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from taichi_sim.applications.fit.log_table import HEADING, Array
from taichi_sim.applications.fit.sample_selection import Mask
from taichi_sim.applications.fit.windows import Window, WindowSimulator, lead_steps

OUTLIER = 2.5  # standard deviations beyond which a residual has less weight
ITERATIONS = 60
STATE_ROUNDS = 8  # iterations of the search for initial states alone, for each of GROWING
GROWING = (0.2, 0.5, 1.0)  # fitted fractions of a window
ENOUGH, ROUGHLY = 1e-5, 1e-3  # relative change of the cost that ends the search: over full windows, over short ones
DAMPING = 10.0  # damping of the first step over the precision of the priors
OF_STATES = 1e-4  # damping of states, currents and biases over their own precision
LONGEST = 0.3  # largest change of a number's logarithm in a step
DELTA = 1e-4  # step of differences: phi, and states in m, rad, m/s, rad/s
# prior standard deviations of what is a log's own: current (north, east; m/s), biases of heading (rad) and yaw rate
# (rad/s), and the delays of position, heading and yaw rate behind the commands (s); assumed
LOG_PRIOR = np.array([1.0, 1.0, np.radians(3.0), np.radians(1.0), 0.1, 0.1, 0.1])
CURRENT, BIASES, DELAYS = slice(0, 2), slice(2, 4), slice(4, 7)
DELAY_OF = [0, 0, 1, 2]  # the delay of each column of a motion
OWN = np.array([1.5, 1.5, 2.0, 2.0])  # of a log's own unknowns, those that a channel tells
LEVERAGE = 0.95  # largest leverage that is made up for
FAINT = 1e-6  # precision (m, rad, m/s, rad/s) that keeps a state finite of which no sample tells


class Request(NamedTuple):
    """Simulations that a search wants, as of `WindowSimulator.run`."""

    windows: list[Window]
    phi: Array
    current: Array
    state: Array


T = TypeVar("T")
Search = Generator[Request, Array, T]


def side_by_side(simulator: WindowSimulator, searches: Sequence[Search[T]]) -> list[T]:
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


class Problem:
    """Residuals of some windows, and the derivatives of the simulated motions.

    With `known`, the simulation uses these numbers and none is estimated: `phi` is empty.
    """

    def __init__(self, windows: Sequence[Window], interval: float, logs: int, known: Array | None = None):
        """Prepare the search over the `windows` of the logs, whose samples are `interval` s apart."""
        self.windows, self.logs, self.known, self.interval = list(windows), logs, known, interval
        self.measured = np.stack([w.motion[lead_steps(interval) :] for w in windows])  # [window, step + 1, 4]
        told = [np.ones(w.motion.shape, dtype=bool) if w.new is None else w.new for w in windows]
        self.new: Mask = np.stack([new[lead_steps(interval) :] for new in told])  # which of them count
        self.of = np.array([w.log for w in windows])
        self.spread = np.ones(4)  # factors of the deviations of the residuals by channel (residual_correlation.py)

    def _request(self, windows: list[Window], phis: Array, currents: Array, states: Array) -> Request:
        if self.known is not None:
            phis = np.tile(self.known, (len(windows), 1))
        return Request(windows, phis, currents, states)

    def residuals(self, phi: Array, extra: Array, state: Array) -> Search[Array]:
        """Residuals, measured minus simulated, [window, sample, 4]."""
        phis = np.tile(phi, (len(self.windows), 1))
        found = yield self._request(self.windows, phis, extra[self.of, CURRENT], state)
        return self.left(np.moveaxis(found, 1, 0), extra)

    def left(self, found: Array, extra: Array) -> Array:
        """Residuals of the motions `found` [window, sample, 4] by the simulator; 0 where a sample does not count."""
        left = self.measured - self.shown(found, extra)
        left[..., HEADING] = np.angle(np.exp(1j * left[..., HEADING]))
        return left * self.new

    def shown(self, found: Array, extra: Array) -> Array:
        """Motions `found` [.., window, sample, 4] as the instruments show them: late, and with their biases."""
        shown = delayed(found, extra[self.of, DELAYS] / self.interval)
        shown[..., 2:] += extra[self.of, BIASES][:, None]
        return shown

    def sigma(self, point: "Point", sigma: Array) -> Array:
        """Robust standard deviations of the errors by channel, times `spread`; `sigma`: a guess.

        An error of leverage h leaves the residual (1 - h) of itself, of variance 1 - h: first states take a good part
        of a slow sensor. Numbers, currents, biases and delays have theirs evenly over a channel.
        """
        rows = (point.slope[..., -6:] / sigma[:, None]).reshape(len(self.windows), -1, 6)
        leverage = (np.linalg.qr(rows)[0] ** 2).sum(axis=-1).reshape(point.left.shape)
        leverage += len(point.phi) / self.new.sum() + self.logs * OWN / self.new.sum(axis=(0, 1))
        each = np.abs(point.left) / np.sqrt(1.0 - np.minimum(leverage, LEVERAGE))
        middle = [np.median(each[..., c][self.new[..., c]]) for c in range(len(sigma))]
        return np.maximum(1.4826 * np.array(middle), 1e-6) * self.spread

    def rms(self, left: Array) -> Array:
        """Root mean squares of the residuals that count, by channel."""
        return np.sqrt((left**2).sum(axis=(0, 1)) / self.new.sum(axis=(0, 1)))

    def point(self, phi: Array, extra: Array, state: Array) -> "Search[Point]":
        """Residuals and their derivatives."""
        p, w = len(phi), len(self.windows)
        columns = p + 2 + 6
        envs = w * (1 + columns)
        phis, currents = np.tile(phi, (envs, 1)), np.tile(extra[self.of, CURRENT], (1 + columns, 1))
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
        shown, later = self.shown(found, extra), extra.copy()
        later[:, DELAYS] += DELTA
        slope = np.moveaxis((shown[1:] - shown[0]) / DELTA, 0, -1)
        own = np.zeros((*slope.shape[:-1], 5))
        own[..., 2, 0], own[..., 3, 1] = 1.0, 1.0
        late = (self.shown(found[0], later) - shown[0]) / DELTA
        for channel, delay in enumerate(DELAY_OF):
            own[..., channel, 2 + delay] = late[..., channel]
        slope = np.concatenate((slope[..., : p + 2], own, slope[..., p + 2 :]), axis=-1) * self.new[..., None]
        return Point(phi, extra, state, self.left(found[0], extra), slope, shown[0])


def delayed(motion: Array, late: Array) -> Array:
    """Motions [.., window, sample, 4] whose position, heading and yaw rate are `late` [window, 3], in samples.

    Between samples by cubics through the values and their central differences, beyond the ends by lines.
    """
    rise, last = np.gradient(motion, axis=-2), motion.shape[-2] - 1
    place = np.arange(last + 1)[None, :, None] - late[:, None, DELAY_OF]  # [window, sample, 4]
    inside = np.clip(place, 0.0, last)
    k = np.minimum(inside.astype(int), last - 1)
    f = inside - k
    index = np.broadcast_to(k, motion.shape)
    (a, b), (m, n) = ([np.take_along_axis(x, i, -2) for i in (index, index + 1)] for x in (motion, rise))
    curve = a + f * (m + f * (3 * (b - a) - 2 * m - n + f * (2 * (a - b) + m + n)))
    return curve + (place - inside) * np.where(place < 0, m, n)


def _weights(scaled: Array) -> Array:
    return np.sqrt(np.minimum(1.0, OUTLIER / np.maximum(np.abs(scaled), 1e-12)))


def huber(left: Array, sigma: Array) -> Array:
    """Huber's cost of each residual."""
    x = np.abs(left / sigma)
    least = np.minimum(x, OUTLIER)
    return least * (x - 0.5 * least)


def _cost(left: Array, sigma: Array, phi: Array, prior: Array, extra: Array) -> float:
    """Total cost of residuals and priors."""
    of_priors = ((phi / prior) ** 2).sum() + ((extra / LOG_PRIOR) ** 2).sum()
    return float(huber(left, sigma).sum() + 0.5 * of_priors)


class Point(NamedTuple):
    """A point of the search."""

    phi: Array
    extra: Array  # [log, 4]
    state: Array  # [window, 6]
    left: Array  # measured less simulated [window, sample, 4]; 0 where a sample does not count
    slope: Array  # d(simulated) [window, sample, 4, number + 7 + 6]
    shown: Array  # simulated, as the instruments would show it [window, sample, 4]


class SearchEnd(NamedTuple):
    """Where a search ended."""

    point: Point
    sigma: Array  # deviation of the residuals by channel
    rounds: int  # how often the normal equations were solved
    counts: Array  # number of independent samples by channel

    def log_likelihood(self, prior: Array) -> float:
        """Logarithm of the posterior, up to a constant, with the standard deviations `sigma` of the residuals."""
        return float(-self.counts @ np.log(self.sigma) - 0.5 * ((self.point.phi / prior) ** 2).sum())


class NormalEquations(NamedTuple):
    """Normal equations of the numbers at a point; unknowns of single logs are eliminated."""

    S: Array  # [number, number]
    g: Array  # [number]
    blocks: list  # for each log: its number, its windows, B, C, b
    of_log: dict[int, tuple[Array, Array]]  # S and g of each log alone, without priors


def normal_equations(
    problem: Problem, point: Point, prior: Array, sigma: Array, damping: float = 0.0
) -> NormalEquations:
    """Normal equations from the residuals and derivatives at a point."""
    p, e = len(point.phi), len(LOG_PRIOR)
    scaled = point.left / sigma
    weight = _weights(scaled)
    r, J = scaled * weight, point.slope * (weight / sigma)[..., None]
    S, g, blocks, of_log = np.diag(prior**-2.0), -point.phi / prior**2, [], {}
    for log in range(problem.logs):
        mine = np.flatnonzero(problem.of == log)
        if not len(mine):
            continue
        m = e + 6 * len(mine)
        A, B = np.zeros((p, p)), np.zeros((p, m))
        C, a, b = np.zeros((m, m)), np.zeros(p), np.zeros(m)
        C[:e, :e], b[:e] = np.diag(LOG_PRIOR**-2.0), -point.extra[log] / LOG_PRIOR**2
        C[e:, e:] = FAINT * np.eye(m - e)
        for k, w in enumerate(mine):
            j, own = J[w].reshape(-1, p + e + 6), np.r_[0:e, e + 6 * k : e + 6 * k + 6]
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
    return NormalEquations(S, g, blocks, of_log)


def search(
    problem: Problem, phi: Array, extra: Array, state: Array, prior: Array, sigma: Array, enough: float = ENOUGH
) -> "Search[SearchEnd]":  # fmt: skip
    """The best point; a change of the cost below `enough` ends the search."""
    point, damping, rounds = (yield from problem.point(phi, extra, state)), DAMPING, 0
    cost = _cost(point.left, sigma, phi, prior, extra)
    while rounds < ITERATIONS and damping < 1e10:
        rounds += 1
        normal = normal_equations(problem, point, prior, sigma, damping)
        move = np.linalg.solve(normal.S + damping * np.diag(prior**-2.0), normal.g)
        move *= min(1.0, LONGEST / np.abs(move).max(initial=1e-12))
        extra, state = point.extra.copy(), point.state.copy()
        for log, mine, B, C, b in normal.blocks:
            change = np.linalg.solve(C, b - B.T @ move)
            extra[log] += change[: len(LOG_PRIOR)]
            state[mine] += change[len(LOG_PRIOR) :].reshape(-1, 6)
        phi = point.phi + move
        left = yield from problem.residuals(phi, extra, state)
        new_cost = _cost(left, sigma, phi, prior, extra)
        if not np.isfinite(new_cost) or new_cost > cost:
            damping *= 10
            continue
        better, damping = cost - new_cost, max(0.1 * damping, 1e-9)
        point = yield from problem.point(phi, extra, state)
        sigma = problem.sigma(point, sigma)
        cost = _cost(point.left, sigma, point.phi, prior, extra)
        if better < enough * abs(new_cost):
            break
    return SearchEnd(point, sigma, rounds, problem.new.sum(axis=(0, 1)) / problem.spread**2)


def search_first_states(problem: Problem, phi: Array, extra: Array, state: Array, sigma: Array) -> Search[Point]:
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
            H += (damping[:, None, None] * H + FAINT) * np.eye(6)
            trial = point.state + np.linalg.solve(H, np.einsum("wni,wn->wi", J, r)[..., None]).squeeze(-1)
            left = yield from problem.residuals(phi, extra, trial)
            gain = (huber(point.left, sigma) - huber(left, sigma))[:, :n].sum(axis=(1, 2))
            better = gain > 0  # False if not finite
            damping = np.clip(damping * np.where(better, 0.1, 10.0), 1e-9, 1e9)
            point = yield from problem.point(phi, extra, np.where(better[:, None], trial, point.state))
            if np.where(better, gain < ENOUGH * left[0].size, damping > 1e6).all():
                break
        state = point.state
    return point
