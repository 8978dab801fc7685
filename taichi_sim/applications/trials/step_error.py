"""The error of a vehicle's motion, as a function of the physics step (docs/step.md).

The vehicle moves under random actions, new every `INTERVAL`: a vessel in a developed sea of its size, in wind; an
aircraft in Dryden turbulence. Everything random is the same at every step, and the motion at a much shorter step counts
as exact. The error of each of the six velocities u, v, w, p, q, r is the root mean square of the difference over their
standard deviation; the error of the motion is the root mean square of the six.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.trials.results import TrialError
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, ConfigError, SeaConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.catalogue import Changes, load_vehicle
from taichi_sim.vehicle import Vehicle

Array = NDArray[np.float64]
INTERVAL = 0.2  # s, actions are held this long
LENGTHS = 20.0  # wave length of the spectrum's peak over the length of a vessel
LONGEST_PERIOD = 14.0  # s, of the peak
STEEPNESS = 0.0224  # hs over the wave length of the peak, of a developed sea (Pierson & Moskowitz 1964)
COMPONENTS = 24
WIND = 8.0  # m/s, at 10 m, over a vessel
WIND_SHARE = 0.4  # wind over cruising airspeed, around an aircraft
WIND_FROM = 60.0  # deg
HEIGHT = 40.0  # m, of an aircraft above the sea
LIVELY = 1e-6  # least deviation of a velocity that counts, m/s, rad/s
ONE_PERCENT = 0.01


@dataclass(frozen=True)
class StepSetting:
    """What is measured."""

    vehicle: str
    seconds: float = 20.0
    envs: int = 16  # realisations of the sea, the turbulence and the actions, side by side
    seed: int = 1
    changes: Changes = field(default_factory=dict)  # of the vehicle file
    calm: bool = False  # neither waves nor wind


class StepError(NamedTuple):
    """Errors at one step."""

    dt: float  # s
    total: float  # of the motion, 1
    parts: Array  # of u, v, w, p, q, r
    position: float  # mean distance at the end, m


def surroundings_of(model: Vehicle) -> tuple[SeaConfig | None, AirConfig]:
    """Sea and air of the measurement."""
    if model.medium == "air":
        speed = WIND_SHARE * model.limits.speeds[1]
        return None, AirConfig(speed=speed, direction_deg=WIND_FROM, turbulence="dryden")
    wave = LENGTHS * model.size[0]
    tp = min(math.sqrt(math.tau * wave / GRAVITY), LONGEST_PERIOD)
    hs = STEEPNESS * GRAVITY * tp**2 / math.tau
    return SeaConfig(hs=hs, tp=tp, components=COMPONENTS), AirConfig(speed=WIND, direction_deg=WIND_FROM)


def motion(setting: StepSetting, dt: float) -> Array:
    """Velocities u, v, w, p, q, r and position of each realisation at the end of each action [n, env, 9]."""
    model = load_vehicle(setting.vehicle, dt, round(INTERVAL / dt), **setting.changes)
    sea, air = (None, None) if setting.calm else surroundings_of(model)
    bench = Bench(model, sea=sea, air=air, envs=setting.envs, seed=setting.seed)
    draw, flies = np.random.default_rng(setting.seed), model.medium == "air"
    ahead = model.limits.speeds[1] if flies else 0.0
    bench.put((0.0, 0.0, -HEIGHT if flies else 0.0), velocity_b=(ahead, 0.0, 0.0), settle=True)
    found = []
    for _ in range(round(setting.seconds / INTERVAL)):
        bench.step(draw.uniform(-1.0, 1.0, (setting.envs, 1, len(model.action_names))))
        now = bench.read()
        found.append(np.concatenate((now.nu, now.position), axis=1))
    return np.array(found)


def errors(setting: StepSetting, steps: Sequence[float], fine: float) -> list[StepError]:
    """Errors at `steps` (s), each a whole part of INTERVAL, against the step `fine` (s); without steps that the model
    refuses.
    """
    return errors_of(partial(motion, setting), steps, fine, setting.vehicle)


def errors_of(moved: Callable[[float], Array], steps: Sequence[float], fine: float, name: str) -> list[StepError]:
    """Errors of any simulator, whose `motion` with a step (s) is `moved`; see `errors`."""
    exact = moved(fine)
    deviation = exact[..., :6].std(axis=(0, 1))
    lively = deviation > LIVELY
    if not lively.any():
        raise TrialError(f"{name}: it does not move under random actions, so no step has an error")
    found = []
    for dt in steps:
        try:
            off = moved(dt) - exact
        except ConfigError:
            continue
        parts = np.zeros(6)
        parts[lively] = np.sqrt((off[..., :6] ** 2).mean(axis=(0, 1)))[lively] / deviation[lively]
        total = float(np.sqrt((parts[lively] ** 2).mean()))
        found.append(StepError(dt, total, parts, float(np.linalg.norm(off[-1, :, 6:], axis=1).mean())))
    return found


def step_for(found: Sequence[StepError], error: float = ONE_PERCENT) -> float:
    """The step (s) at which the motion errs by `error`, by a power law between the two measured steps beside it; the
    longest measured step, if its error is smaller; NaN, if that of the shortest is larger.
    """
    last = None
    for now in found:
        if not now.total <= error:
            if last is None:
                return math.nan
            share = math.log(error / last.total) / math.log(now.total / last.total) if math.isfinite(now.total) else 0.0
            return last.dt * (now.dt / last.dt) ** share
        last = now
    return last.dt if last else math.nan
