"""A basin for trials: vessels side by side, each with its own helm, and events timed between steps.

A helmsman acts at the instant at which the heading reaches a mark. If that instant lies within a step, a second model
with the same numbers repeats the step in FINE parts, and the command changes between two of these.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from taichi_sim.applications.trials.results import Array, TrialError
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, ConfigError, SeaConfig
from taichi_sim.kernels import conventions as at
from taichi_sim.models.catalogue import Changes, load_vehicle
from taichi_sim.models.usv.vessel_base import Vessel

Due = Callable[[Array], NDArray[np.bool_]]
Act = Callable[[NDArray[np.bool_], float], Array]
FINE = 256  # parts of a step that contains an event
COARSE = 0.014  # step over sqrt(L), s / sqrt(m): 0.02 s for a hull of 2 m; it only bounds the error between events
ALMOST = 1e-3  # the same, accepted after the longest approach
STEADY = 1e-6  # relative change of speed per ship length of travel, below which an approach ends
LONGEST = 600.0  # longest phase of a trial, in `slowness`
SHIP_HELM = np.radians(35.0)  # rudder angle that stands for full helm of a vessel without rudders
RUN_UP = 5.0  # shortest approach that is towed or in waves, in `slowness`
COURSE_GAIN, RATE_GAIN = 2.0, 1.0  # helmsman in wind and waves: gains of course (1/rad) and of r L / U; assumed


@dataclass(frozen=True)
class Setting:
    """Conditions of a trial."""

    vehicle: str | Path  # a file or a name
    changes: Changes  # changed keys of the vehicle file (load_vehicle)
    sea: SeaConfig | None = None  # with the current; None: calm
    air: AirConfig | None = None  # None: calm
    runs: int = 1  # number of realisations of the sea
    heading: float = 0.0  # of the approach, rad, for wind and waves
    ahead: float = 1.0  # share of full thrust
    helm: float = 1.0  # share of full helm
    speed: float | None = None  # of the approach, m/s, held as by a towing carriage; None: the vessel's own
    dt: float | None = None  # step, s; None: it follows from the length
    seed: int = 1  # of the realisations

    @property
    def calm(self) -> bool:
        """Whether there are no waves, wind or current."""
        return self.sea is None and self.air is None


class Track(NamedTuple):
    """Motion over time, [sample] or [sample, env]: SI, rad. Headings continue through full turns."""

    t: Array
    north: Array
    east: Array
    roll: Array
    heading: Array
    u: Array  # velocity over ground, in b
    v: Array
    r: Array  # rate of the heading
    helm: Array  # rudder angle, rad, or the share of full helm times 35 degrees

    def of(self, env: int) -> "Track":
        """The track of one environment."""
        return Track(self.t, *(column[:, env] for column in self[1:]))

    @property
    def speed(self) -> Array:
        """Speed over ground, m/s."""
        return np.hypot(self.u, self.v)


def vessel_of(setting: Setting) -> Vessel:
    """The model, with a step that suits its length."""
    first = load_vehicle(setting.vehicle, 1e-3, 1, **setting.changes)
    if not isinstance(first, Vessel):
        raise TrialError(f"{setting.vehicle}: it is not a vessel")
    if setting.dt is not None:
        return _model(setting, setting.dt)
    dt = float(f"{COARSE * np.sqrt(first.size[0]):.1e}")
    while True:
        try:
            return _model(setting, dt)
        except ConfigError:
            dt *= 0.5
            if dt < 1e-3:
                raise


def _model(setting: Setting, dt: float) -> Vessel:
    found = load_vehicle(setting.vehicle, dt, 1, **setting.changes)
    assert isinstance(found, Vessel)
    return found


class Basin:
    """`cases` x `setting.runs` vessels of one model; environment case * runs + run has realisation `run`."""

    def __init__(self, setting: Setting, cases: int):
        """Make the vessels, at rest."""
        self.setting, self.model = setting, vessel_of(setting)
        self.envs, self.cases = cases * setting.runs, cases
        self.bench = self._bench(self.model)
        self._asked = np.full((2, self.envs), np.nan)
        self._actions = torch.zeros(0)
        self._fine: Bench | None = None
        self.length = self.model.size[0]  # m
        # length over the speed at a Froude number of 0.1, s: it bounds the phases of a trial
        self.slowness = self.length / (0.1 * np.sqrt(at.GRAVITY * self.length))
        self.time, self._heading = 0.0, np.zeros(self.envs)  # s since the beginning of the trial; rad
        if self.model.steer(0.0, 0.0) is None:
            raise TrialError(
                f"{setting.vehicle}: its model does not say how it is steered ({type(self.model).__name__}.steer); a "
                'hull of single thrusters is steered with actions = "wrench"'
            )

    def _bench(self, model: Vessel) -> Bench:
        given = self.setting
        sea = None if given.sea is None else given.sea.model_copy(update={"realisations": given.runs})
        return Bench(model, sea=sea, air=given.air, envs=self.envs, seed=given.seed)

    @property
    def longest(self) -> float:
        """Longest duration of a phase, s."""
        return LONGEST * self.slowness

    def spread(self, values: ArrayLike) -> Array:
        """Values [case], repeated for every environment."""
        return np.repeat(np.asarray(values, dtype=np.float64), self.setting.runs)

    def lie(self, speed: float = 0.0) -> None:
        """Place all vessels at the origin, with `speed` (m/s) ahead through the water."""
        heading = 0.0 if self.setting.calm else self.setting.heading
        self.bench.put((0.0, 0.0, 0.0), (0.0, 0.0, heading), (speed, 0.0, 0.0), settle=True)
        self.begin()

    def begin(self) -> None:
        """Count time and positions from here."""
        self.time = 0.0
        self.bench.state[..., :2] = 0.0
        self._heading = self._raw()

    def step(self, ahead: Array, helm: Array) -> None:
        """Step all vessels with these commands [env]."""
        self._advance(self.bench, ahead, helm)
        self.time += self.model.dt

    def _advance(self, bench: Bench, ahead: Array, helm: Array) -> None:
        if not (np.array_equal(ahead, self._asked[0]) and np.array_equal(helm, self._asked[1])):
            actions = self.model.steer(ahead, helm)
            assert actions is not None
            full = np.broadcast_to(actions, (self.envs, actions.shape[-1]))
            self._actions = torch.tensor(full[:, None], dtype=bench.state.dtype, device=bench.state.device)
            self._asked = ahead.copy(), helm.copy()
        bench.step(self._actions)

    def step_to(self, ahead: Array, helm: Array, due: Due, act: Act) -> Array:
        """Step all vessels; commands may change within the step. Return the helm [env] after it.

        `due(heading)` says for each environment whether its helm is to change at this heading (rad). `act(which, time)`
        gives the helm of all environments after it has changed in `which` at that time (s).
        """
        parts = _parts(self.bench)
        before, when = [x.clone() for x in parts], self.bench.time.clone()
        began, heading = self.time, self._heading.copy()
        self.step(ahead, helm)
        if not due(self.headings()).any():
            return helm
        if self._fine is None:
            self._fine = self._bench(_model(self.setting, self.model.dt / FINE))
        fine, targets = self._fine, _parts(self._fine)
        for target, value in zip(targets, before, strict=True):
            target.copy_(value)
        fine.time.copy_(when)
        fine.refresh()
        self._heading = heading
        for k in range(FINE):
            self._advance(fine, ahead, helm)
            if (which := due(self._follow(fine))).any():
                helm = act(which, began + (k + 1) * self.model.dt / FINE)
        for target, value in zip(parts, targets, strict=True):
            target.copy_(value)
        return helm

    def _raw(self, bench: Bench | None = None) -> Array:
        w, x, y, z = (bench or self.bench).state[:, 0, at.QUATERNION].double().cpu().numpy().T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))

    def _follow(self, bench: Bench | None = None) -> Array:
        change = self._raw(bench) - self._heading
        self._heading = self._heading + change - 2 * np.pi * np.round(change / (2 * np.pi))
        return self._heading

    def headings(self) -> Array:
        """Headings [env], rad, continued through full turns."""
        return self._follow()

    def sample(self, helm: Array) -> tuple[Array, ...]:
        """The present row of a track."""
        s = self.bench.state[:, 0].double().cpu().numpy()
        w, x, y, z = s[:, at.QUATERNION].T
        up, across, ahead = 1 - 2 * (x * x + y * y), 2 * (y * z + w * x), 2 * (x * z - w * y)  # last row of R_nb
        rate = (s[:, at.PITCH_RATE] * across + s[:, at.YAW_RATE] * up) / (1 - ahead * ahead)
        angle = helm * (self.model.helm_max or SHIP_HELM)
        if "rudder" in self.model.aux_names:
            angle = self.bench.fleet.reading("rudder")[:, 0].double().cpu().numpy()
        place, speed = (s[:, at.NORTH], s[:, at.EAST]), (s[:, at.SURGE], s[:, at.SWAY])
        return tuple(map(np.copy, (*place, np.arctan2(across, up), self.headings(), *speed, rate, angle)))

    def approach(self, ahead: Array | None = None) -> Array:
        """Sail a steady straight run, after which the trial begins; return speeds ahead over ground [env], m/s.

        In calm water the vessel is kept on its course as by rails, because an unstable vessel has no other straight
        run. In wind and waves a helmsman keeps the course.
        """
        setting, state = self.setting, self.bench.state
        ahead = np.full(self.envs, setting.ahead) if ahead is None else ahead
        top = self.model.limits.speeds[2]
        given = setting.speed
        first = (top if np.isfinite(top) else 0.0) * min(max(float(np.abs(ahead).max()), 0.1), 1.0)
        self.lie(first if given is None else given)
        steps = max(int(round(self.slowness / 10 / self.model.dt)), 1)
        last, helm, change = np.full(self.envs, np.inf), np.zeros(self.envs), np.inf
        for _ in range(int(self.longest / (steps * self.model.dt))):
            for _ in range(steps):
                if not setting.calm:
                    off = self.headings() - setting.heading
                    turning = state[:, 0, at.YAW_RATE].double().cpu().numpy()
                    rate = turning * self.length / np.maximum(last_speed(state), 1e-3)
                    helm = np.clip(-COURSE_GAIN * off - RATE_GAIN * rate, -1.0, 1.0)
                self.step(ahead, helm)
                if setting.calm:  # nothing but a straight run north stays: no heading, roll, rates of them, or sway
                    state[..., [at.EAST, at.QX, at.QZ, at.SWAY, at.ROLL_RATE, at.YAW_RATE]] = 0.0
                    q = state[..., at.QUATERNION]
                    q /= q.norm(dim=-1, keepdim=True)
                if given is not None:
                    state[..., at.SURGE] = given
            speed = last_speed(state)
            travelled = steps * self.model.dt * np.maximum(np.abs(speed), 1e-9) / self.length
            change, last = float(np.max(np.abs(speed - last) / (np.abs(speed) * travelled + 1e-12))), speed
            settled = change <= STEADY
            if given is not None or not setting.calm:  # only shafts, heave and pitch can become steady
                settled &= self.time > RUN_UP * self.slowness
                settled |= self.time > 4 * RUN_UP * self.slowness
            if settled:
                break
        else:
            if change > ALMOST:
                raise TrialError(f"{setting.vehicle}: a straight run does not become steady in {self.time:.0f} s")
        if not np.all(speed > 1e-6):
            raise TrialError(f"{setting.vehicle}: ahead = {setting.ahead:g} does not move it: a trial needs speed")
        if setting.calm:
            state[..., 0:2] = 0.0
        self.begin()
        self.bench.fleet.update()
        return speed


def _parts(bench: Bench) -> tuple[torch.Tensor, ...]:
    """All that a step of a bench changes, but for its time."""
    return bench.state, bench.fleet.aux, bench.fleet.surface, bench.fleet.derived


def last_speed(state: torch.Tensor) -> Array:
    """Speeds ahead over ground [env], m/s."""
    return state[:, 0, at.SURGE].double().cpu().numpy().copy()
