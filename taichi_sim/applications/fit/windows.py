"""Windows of logs, and their simulation side by side under candidate numbers, currents and initial states."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import torch

from taichi_sim.applications.fit.log import Log
from taichi_sim.applications.fit.log_table import EAST, HEADING, NORTH, YAW_RATE, Array, LogError, held, held_means
from taichi_sim.applications.fit.sample_selection import SENSORS, Mask
from taichi_sim.bench import Bench
from taichi_sim.config import ConfigError
from taichi_sim.errors import named, refuse
from taichi_sim.kernels import conventions
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.vehicle import Vehicle

SECONDS = 6.0  # usual length of a window
SAMPLES = 12  # new samples of the slowest sensor that a usual window has
LEAD = 1.0  # s before a window, in which its actuators reach the commanded settings
STEP = 0.02  # s, longest physics step
EARLY = 0.05  # of an interval: a sample that comes this much after its step of the grid counts as of that step
WANTED = {"position": 3, "heading": 2, "yaw rate": 2}  # least number of new samples in a window

MIRRORED = 0.5  # rms deviation from the simulation of a log, mirrored, over that as it is, below which it is mirrored
TURNS = 0.02  # rad/s, least rms deviation of yaw rates for such a comparison
MOVES = 0.3  # m, least way for such a comparison
UNLIKE = 0.1  # rms deviation, over the motion itself, from which another meaning of the commands is looked for
CLOSER = 0.75  # ratio of rms deviations of all logs below which it is the right one
CLOSER_ONE = 0.6  # likewise of one log among others; of 160 sound logs the least is 0.64
FARTHER = 30.0  # ratio of measured and simulated ways, or yaw rates, beyond which they are in other units


class Window(NamedTuple):
    """A part of a log on the grid of steps, with LEAD before it."""

    log: int
    motion: Array  # [lead + step + 1, 4]
    actions: Array  # [lead + step, action]
    wind: Array | None = None  # [lead + step, 2]: velocity of the air to the north and east, m/s; None: calm
    new: Mask | None = None  # [lead + step + 1, 4]: which values of the motion count; None: all
    begin: float = 0.0  # s, time of the log after the lead


def windows_of(logs: Sequence[Log], seconds: float) -> list[Window]:
    """Consecutive windows of `seconds` in each part of each log."""
    found, short, first = [], False, logs[0].interval
    for number, log in enumerate(logs):
        if abs(log.interval - first) > 0.01 * first:
            raise LogError(f"{log.name}: an interval of {log.interval:g} s, {logs[0].name} has {first:g} s: resample")
        lead = lead_steps(first)
        steps = max(round(seconds / first), lead)
        for part in log.parts:
            t = log.t[part]
            grid = t[0] + first * np.arange(int((t[-1] - t[0]) / first + 1e-6) + 1)
            motion = np.stack([np.interp(grid, t, column) for column in log.motion[part].T], axis=1)
            step = np.clip(np.round((t - t[0]) / first).astype(int), 0, len(grid) - 1)
            new: Mask = np.zeros(motion.shape, dtype=bool)
            np.logical_or.at(new, step, log.new[part])
            near = np.where(np.abs(t - grid[step]) < EARLY * first, grid[step], t)
            actions = np.stack([held_means(near, a, grid, grid + first) for a in log.actions[part].T], axis=1)
            wind = None if log.wind is None else held(t, log.wind[part], grid + EARLY * first)
            whole = Window(number, motion, actions, wind, new)
            for k in range(lead, len(grid) - steps, steps + 1):  # no sample is used twice
                window = _cut(whole, k - lead, k + steps)._replace(begin=float(grid[k]))
                counted = new[k : k + steps + 1]
                if all(counted[:, SENSORS[name]].sum() >= n * len(SENSORS[name]) for name, n in WANTED.items()):
                    found.append(window)
                else:
                    short = True
    if not found:
        names = ", ".join(log.name for log in logs)
        few = ", ".join(f"{n} of {name}" for name, n in WANTED.items())
        why = "".join(f"; {log.name}: {note}" for log in logs for note in log.notes[:1])
        told = f"no window of {seconds:g} s has enough new samples ({few}): give a longer --window" if short else (
            f"no log has {seconds:g} s without a gap{why}: give a shorter --window"
        )  # fmt: skip
        raise LogError(f"{names}: {told}")
    return found


def window_seconds(logs: Sequence[Log]) -> float:
    """Usual length of a window, s: longer where a sensor is slow, as far as the logs have parts of that length.

    The first state of each window is estimated from its samples alone. With few of them its errors bias the numbers,
    for the dynamics are not linear in it.
    """
    slowest = max(float(np.median(np.diff(log.t[new]))) if new.sum() > 1 else 0.0 for log in logs for new in log.new.T)
    longest = max(log.t[part][-1] - log.t[part][0] for log in logs for part in log.parts)
    return max(SECONDS, min(SAMPLES * slowest, float(longest) - LEAD - 2 * logs[0].interval))


def lead_steps(interval: float) -> int:
    """Number of steps of `interval` (s) in LEAD."""
    return max(round(LEAD / interval), 1)


def cut(windows: Sequence[Window], lead: int, steps: int) -> list[Window]:
    """Windows of `steps` steps each, cut from longer ones."""
    return [_cut(w, k, k + lead + steps) for w in windows for k in range(0, len(w.actions) - lead - steps + 1, steps)]


def _cut(window: Window, first: int, last: int) -> Window:
    """The steps of a window from `first` until before `last`."""
    part, end = slice(first, last), slice(first, last + 1)
    wind, new = window.wind, window.new
    return window._replace(
        motion=window.motion[end],
        actions=window.actions[part],
        wind=None if wind is None else wind[part],
        new=None if new is None else new[end],
    )


def first_state(window: Window, interval: float) -> Array:
    """Initial north, east, heading, u, v, r, from parabolas through a second of data before and after the beginning."""
    lead = lead_steps(interval)
    t = interval * np.arange(-lead, lead + 1)
    _, (vn, ve, _, _), (north, east, psi, r) = np.polyfit(t, window.motion[: len(t)], 2)
    c, s = np.cos(psi), np.sin(psi)
    return np.array([north, east, psi, c * vn + s * ve, c * ve - s * vn, r])


def members(model: Vehicle, key: str) -> dict[str, float]:
    """Numbers that `key` names, with their values: one, or all of a section but zeros, which share a factor then."""
    inside = {name: model.nominal[name] for name in model.varying if name.startswith(f"{key}.")}
    if not inside:
        model.check_varies(key)
    found = {name: value for name, value in (inside or {key: model.nominal[key]}).items() if value != 0.0}
    refuse(ConfigError, (not found, f"{key} is 0 in the file: write a first guess there"))
    return found


class WindowSimulator:
    """Simulates windows side by side, with candidate numbers, currents and initial states."""

    def __init__(self, vehicle: str, keys: Sequence[str], interval: float, changes: Mapping | None = None):
        """Load a vehicle file whose `keys` vary."""
        substeps = max(1, int(np.ceil(interval / STEP - 1e-9)))
        model = load_vehicle(vehicle, interval / substeps, substeps, **dict(changes or {}))
        if not isinstance(model, Vessel):
            raise ConfigError(f"{vehicle}: only vessels can be fitted")
        with named(f"{vehicle}: ", ConfigError):
            self.members = [members(model, key) for key in keys]
        names = [name for of in self.members for name in of]
        twice = next((name for name in names if names.count(name) > 1), None)
        refuse(ConfigError, (twice, f"--numbers: names {twice} twice"))
        self.model, self.keys, self.interval = model, tuple(keys), interval
        self.nominal = np.array([of.get(key, 1.0) for key, of in zip(keys, self.members, strict=True)])  # 1: a factor
        self.benches: dict[int, Bench] = {}  # number of environments -> bench

    def run(self, windows: Sequence[Window], phi: Array, current: Array, state: Array) -> Array:
        """Simulated north, east (m), heading (rad), yaw rate (rad/s) [step + 1, env, 4].

        Args:
            windows: the window of each environment.
            phi: logarithms of the factors of the numbers, [env, number].
            current: [env, 2], m/s.
            state: initial states, [env, 6].
        """
        envs = len(windows)
        if envs not in self.benches:
            self.benches[envs] = Bench(self.model, envs=envs)
        b = self.benches[envs]
        like = b.state
        b.time.zero_()
        b.wind.zero_()
        b.current[:] = torch.as_tensor(current).to(like)
        place, euler, zero = np.zeros((3, envs, 1, 3))
        place[:, 0, :2], euler[:, 0, HEADING] = state[:, :2], state[:, HEADING]
        factors = torch.as_tensor(np.exp(phi))
        vary = b.fleet.nominal.expand(envs, 1, -1).clone()
        for k, of in enumerate(self.members):
            for name, value in of.items():
                vary[:, 0, self.model.varying.index(name)] = value * factors[:, k]
        b.fleet.give_numbers(vary, self.model.numbers(vary), torch.arange(envs))
        actions = torch.as_tensor(np.stack([w.actions for w in windows], axis=1)).to(like)
        lead = lead_steps(self.interval)
        steps = actions.shape[0] - lead
        calm = np.zeros((lead + steps, 2))
        wind = None  # velocity of the air [step, env, 2], m/s
        if any(w.wind is not None for w in windows):
            wind = torch.as_tensor(np.stack([calm if w.wind is None else w.wind for w in windows], axis=1))
        out = np.empty((steps + 1, envs, 4))
        _place(b, place, euler, zero, state)
        for k in range(lead + steps):
            if k == lead:  # the actuators have reached the commanded settings
                kept = b.aux.clone()
                _place(b, place, euler, zero, state)
                b.aux.copy_(kept)
                out[0] = _read(b, state[:, HEADING])
            if wind is not None:
                b.wind[:, :2] = wind[k]
            b.step(actions[k][:, None])
            if k >= lead:
                out[k - lead + 1] = _read(b, out[k - lead, :, HEADING])
        return out


def check_against(simulator: WindowSimulator, logs: Sequence[Log], windows: Sequence[Window], state: Array) -> None:
    """Compare windows, begun at the initial states `state` [window, 6], with their simulation by the file's numbers.

    A frame that is mirrored as a whole, or positions in other units, agree with themselves: only the commands tell.
    """
    n, lead = len(windows), lead_steps(simulator.interval)
    across = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0]) * state[:, [1, 0, 2, 3, 4, 5]]
    across[:, HEADING] = 0.5 * np.pi - state[:, HEADING]
    meanings = list(_other_meanings(windows, state, simulator.model.action_names))
    begin = np.concatenate((state, across, *(start for _, _, start in meanings)))
    together = [*windows, *windows, *(w for _, meant, _ in meanings for w in meant)]
    found = simulator.run(together, np.zeros((len(together), len(simulator.keys))), np.zeros((len(together), 2)), begin)
    squares = np.zeros(1 + len(meanings))  # of deviations from the commands and their other meanings, of all logs
    for number, log in enumerate(logs):
        mine = [k for k, w in enumerate(windows) if w.log == number]
        if not mine:
            continue
        measured = np.stack([windows[k].motion[lead:] for k in mine], axis=1)
        r, expected = (float(np.sqrt(np.mean(x[..., YAW_RATE] ** 2))) for x in (measured, found[:, mine]))
        rates, mirror = measured[..., YAW_RATE], [n + k for k in mine]
        as_it_is = np.sqrt(np.mean((rates - found[:, mine, YAW_RATE]) ** 2))
        mirrored = np.sqrt(np.mean((-rates - found[:, mirror, YAW_RATE]) ** 2))
        here, there = (x - x[0] for x in (measured, found[:, mine]))
        way, driven = (float(np.hypot(x[-1, :, NORTH], x[-1, :, EAST]).mean()) for x in (here, there))
        refuse(
            LogError,
            (expected > TURNS and not expected < FARTHER * r < FARTHER**2 * expected,
             f"{log.name}: the yaw rate is {r:.2g} rad/s rms where the commands give {expected:.2g}: are heading and "
             "yaw_rate in rad, heading_deg and yaw_rate_deg in degrees?"),
            (as_it_is > TURNS and mirrored < MIRRORED * as_it_is,
             f"{log.name}: the vessel turns against its commands: the log is mirrored (ENU: north and east exchanged, "
             "heading from east, yaw rate to port), or an action has the wrong sign"),
            (driven > MOVES and not driven < FARTHER * way < FARTHER**2 * driven,
             f"{log.name}: the vessel goes {way:.2g} m in a window where its commands drive it {driven:.2g} m: are "
             "north and east in m?"),
        )  # fmt: skip
        scale = [max(float(np.ptp(measured[..., c], axis=0).mean()), least)
                 for c, least in ((NORTH, MOVES), (EAST, MOVES), (YAW_RATE, TURNS))]  # fmt: skip
        apart = [
            float(np.mean(((found[:, first:][:, mine] - measured)[..., [NORTH, EAST, YAW_RATE]] / scale) ** 2))
            for first in (0, *range(2 * n, len(together), n))
        ]
        squares += len(mine) * np.array(apart)
        _refuse_meaning(log.name, np.array(apart), CLOSER_ONE, meanings)
    told = ", ".join(log.name for log in logs)
    _refuse_meaning(told, squares / max(n, 1), CLOSER, meanings)


def _refuse_meaning(who: str, squares: Array, closer: float, meanings: Sequence[tuple[str, object, object]]) -> None:
    """Refuse logs whose commands mean something else: mean squares of deviations from them, then from each meaning."""
    away, *meant = np.sqrt(squares)
    best = int(np.argmin(meant))
    if away > UNLIKE and meant[best] < closer * away:
        raise LogError(f"{who}: the vessel moves as if {meanings[best][0]}: it is {away / meant[best]:.1f} times "
                       "closer to that than to what the commands say. Leave out parts in which a current carries it "
                       "against its commands")  # fmt: skip


def _other_meanings(
    windows: Sequence[Window], state: Array, names: Sequence[str]
) -> Iterator[tuple[str, list[Window], Array]]:
    """What logs may mean instead: the words for it, the windows, and their initial states [window, 6]."""
    for k, name in enumerate(names):
        signs = np.where(np.arange(len(names)) == k, -1.0, 1.0)
        yield f"{name} had the other sign", [w._replace(actions=w.actions * signs) for w in windows], state
    for k, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[k, j]] = j, k
        told = f"{names[k]} and {names[j]} were exchanged"
        yield told, [w._replace(actions=w.actions[:, order]) for w in windows], state
    turned = np.array([1.0, 1.0, 1.0, -1.0, -1.0, 1.0]) * state + np.pi * (np.arange(6) == HEADING)
    yield "its heading were counted from the stern", list(windows), turned


def _place(b: Bench, place: Array, euler: Array, zero: Array, state: Array) -> None:
    b.put(place, euler, zero, settle=False)
    for column, k in ((conventions.SURGE, 3), (conventions.SWAY, 4), (conventions.YAW_RATE, 5)):
        b.state[:, 0, column] = torch.as_tensor(state[:, k]).to(b.state)
    b.fleet.update()


def _read(b: Bench, near: Array) -> Array:
    s = b.state[:, 0].double().numpy()
    w, x, y, z = s[:, conventions.QUATERNION].T
    psi = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    heading = near + np.angle(np.exp(1j * (psi - near)))
    return np.stack((s[:, NORTH], s[:, EAST], heading, s[:, conventions.YAW_RATE]), axis=1)
