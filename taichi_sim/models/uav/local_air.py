"""The air that an aircraft meets: mean wind at its height, Dryden turbulence, a discrete gust.

Turbulence is drawn at most `DRAWN_EVERY` apart, at equal times of a control step, whatever the physics step: each draw
is an exact step of its filter (air/turbulence.py), so that none of its variance is lost, and between draws it is linear
in time. The filter's coefficients, intensity and axes are those at the beginning of the control step. Over a substep
the air's velocity is held: mean wind and discrete gust as in its middle, turbulence at its mean. So flight is second
order in the substep, and fourth order in steady air.

Random numbers are counted by control step and draw through all episodes, so that no episode repeats another's. A
control step of N draws has N + 1 counts: one for each, and the last for the stationary state with which a flight
begins.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from dataclasses import dataclass

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.config import AirConfig
from taichi_sim.kernels.abreast import cast, taken1
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.kernels.random import TURBULENCE, normal6
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.air.turbulence import dryden_advance, dryden_filter, dryden_output, dryden_sigma, gust_n
from taichi_sim.surroundings.air.wind import Gust, Profile, gust_velocity, mean_wind_factor, wind_factor
from taichi_sim.surroundings.around_vehicles import Surroundings

DRAWN_EVERY = 0.02  # s, longest time between two draws of turbulence; assumed: half a metre of flight at 25 m/s
WHOLE = 1e-6  # of a draw: a rest below it is rounding


@dataclass(frozen=True)
class LocalAir:
    """The kinds of wind that a kernel is compiled for."""

    profile: Profile = "uniform"
    turbulent: bool = False
    gust: Gust | None = None
    uneven: bool = False  # turbulence differs in intensity between environments

    @property
    def gusty(self) -> bool:
        """Whether there is a discrete gust."""
        return self.gust is not None

    @property
    def steady(self) -> bool:
        """Whether an aircraft meets the same wind wherever and whenever it is."""
        return self.profile == "uniform" and not self.turbulent and not self.gusty


def local_air(air: Wind | None, uneven: bool = False) -> LocalAir:
    """The kinds of wind of a `Wind`; None stands for a steady, uniform one.

    `uneven`: the intensity of turbulence differs between environments.
    """
    config = AirConfig(profile="uniform") if air is None else air.config
    gust = None if config.gust is None else Gust.of(config.gust)
    turbulent = config.turbulence == "dryden"
    return LocalAir(config.profile, turbulent, gust, turbulent and uneven)


def draws(interval: float) -> int:
    """Number of draws of turbulence in a control step of `interval` (s)."""
    return max(1, math.ceil(interval / DRAWN_EVERY - WHOLE))


def wind_at(state: Tensor, around: Surroundings) -> Tensor:
    """Mean wind [n, vehicle, 3] (NED, m/s) at the heights of `state` [n, vehicle, 13]."""
    here = around.wind.to(state).unsqueeze(1).expand(*state.shape[:2], 3)
    if around.air is None:
        return here
    height = (-state[..., DOWN]).double().cpu().numpy()
    factor = wind_factor(around.air.profile, around.air.shear, height)
    return here * torch.from_numpy(factor).to(state).unsqueeze(-1)


@ti.func
def initial_turbulence(air: ti.template(), seed, clock, drawn: ti.template(), e, i):
    """State (5) of the turbulence around vehicle i of environment e, from its stationary distribution.

    A control step has `drawn` draws.
    """
    zero = 0.0 * cast(i, float)
    z = ti.Vector([zero, zero, zero, zero, zero, zero])
    if ti.static(air.turbulent):
        z = normal6(seed, TURBULENCE, e, i, clock * ti.static(drawn + 1) + drawn)
    return ti.Vector([z[0], z[1], z[2], z[3], z[4]])


@ti.func
def wind_at_20_feet(air: ti.template(), around: ti.template(), wind, e):
    """W20 (m/s), which sets the turbulence intensity in environment e; `wind` is the mean wind 10 m above the sea."""
    W20 = around.air[1] + around.air[2] * ti.sqrt(wind[0] * wind[0] + wind[1] * wind[1])
    if ti.static(air.uneven):
        W20 *= taken1(around.turbulence, e, 0)
    return W20


@ti.func
def turbulence_filter(air: ti.template(), Va, h, W20, dt: ti.template()):
    """Coefficients (12) for draws dt (s) apart: `dryden_filter`, then `dryden_sigma`; zeros without turbulence."""
    zero = Va * 0.0
    f = ti.Vector([zero] * 12)
    if ti.static(air.turbulent):
        step, sigma = dryden_filter(Va, h, dt), dryden_sigma(h, W20)
        for k in ti.static(range(10)):
            f[k] = step[k]
        f[10], f[11] = sigma[0], sigma[1]
    return f


@ti.func
def turbulence_now(air: ti.template(), x, f):
    """Gust (u, v, w; m/s) in the turbulence axes at the state x (5), with the coefficients f."""
    now = ti.Vector([0.0 * x[0], 0.0 * x[0], 0.0 * x[0]])
    if ti.static(air.turbulent):
        now = dryden_output(x, ti.Vector([f[10], f[11]]))
    return now


@ti.func
def turbulence_over(
    air: ti.template(), substeps: ti.template(), drawn: ti.template(), n, x, last, now, f, seed, clock, e, i,
):  # fmt: skip
    """Mean gust (u, v, w; m/s) over substep n of a control step of `substeps` substeps and `drawn` draws.

    Also returns what follows from the draws in it: the state x (5) at the latest one, and the gusts of the last two.
    `clock` numbers control steps through all episodes.
    """
    mean = 0.0 * now
    if ti.static(air.turbulent):
        # times in parts of a substep and of the interval between draws: each of either has a whole number of them
        begin, end = n * ti.static(drawn), (n + 1) * ti.static(drawn)
        for k in range(begin // ti.static(substeps), (end + ti.static(substeps - 1)) // ti.static(substeps)):
            drawn_at = k * ti.static(substeps)
            if drawn_at >= begin:
                x = dryden_advance(x, f, normal6(seed, TURBULENCE, e, i, clock * ti.static(drawn + 1) + k))
                last = now
                now = turbulence_now(air, x, f)
            low, high = ti.max(begin, drawn_at), ti.min(end, drawn_at + ti.static(substeps))
            middle = ti.cast(low + high - 2 * drawn_at, float) * ti.static(0.5 / substeps)
            mean += ti.cast(high - low, float) * ti.static(1.0 / drawn) * (last + middle * (now - last))
    return mean, x, last, now


@ti.func
def mean_wind(air: ti.template(), wind, shear, position):
    """Mean wind (NED, m/s) at `position` (NED, m); `wind` is the mean wind 10 m above the sea."""
    return wind * mean_wind_factor(air.profile, shear, -position[2])


@ti.func
def velocity_at(air: ti.template(), wind, shear, turbulence, v_air, position, time):
    """Velocity of the air (NED, m/s) at `position` (NED, m) and `time` (s): mean wind, turbulence and gust.

    `wind` is the mean wind 10 m above the sea. The `turbulence` (u, v, w; m/s) has its axes along v_air, the velocity
    (NED) through the mean wind.
    """
    total = mean_wind(air, wind, shear, position)
    if ti.static(air.turbulent):
        total += gust_n(turbulence, v_air)
    if ti.static(air.gusty):
        total += gust_velocity(air.gust, position, time)
    return total
