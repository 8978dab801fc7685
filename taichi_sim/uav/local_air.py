"""The air that an aircraft meets: mean wind at its height, Dryden turbulence, a discrete gust.

Turbulence takes one exact step of its filter (air/turbulence.py) per substep, so that none of its variance is lost. The
filter's coefficients, intensity and axes are those at the beginning of the control step. The air's velocity is held
over a substep: mean wind and turbulence as at its beginning, a discrete gust as in its middle. Flight through a gust is
therefore second order in the substep, and motion in steady air fourth order. Halving the substep removes three quarters
of the error; a gust held from the beginning of the substep would come half a substep late.

Random numbers are counted by control step and substep through all episodes, so that no episode repeats another's. A
control step of S substeps has S + 1 counts: one for each substep, and the last for the stationary state with which a
flight begins.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from dataclasses import dataclass

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.air import Wind
from taichi_sim.air.turbulence import dryden_advance, dryden_filter, dryden_output, dryden_sigma, gust_n
from taichi_sim.air.wind import Gust, Profile, gust_velocity, mean_wind_factor, wind_factor
from taichi_sim.config import AirConfig
from taichi_sim.conventions import DOWN
from taichi_sim.kernels.abreast import cast, taken1
from taichi_sim.kernels.random import TURBULENCE, normal6
from taichi_sim.surroundings import Surroundings


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


def wind_at(state: Tensor, around: Surroundings) -> Tensor:
    """Mean wind [n, vehicle, 3] (NED, m/s) at the heights of `state` [n, vehicle, 13]."""
    here = around.wind.to(state).unsqueeze(1).expand(*state.shape[:2], 3)
    if around.air is None:
        return here
    height = (-state[..., DOWN]).double().cpu().numpy()
    factor = wind_factor(around.air.profile, around.air.shear, height)
    return here * torch.from_numpy(factor).to(state).unsqueeze(-1)


@ti.func
def initial_turbulence(air: ti.template(), seed, clock, substeps: ti.template(), e, i):
    """State (5) of the turbulence around vehicle i of environment e, from its stationary distribution."""
    zero = 0.0 * cast(i, float)
    z = ti.Vector([zero, zero, zero, zero, zero, zero])
    if ti.static(air.turbulent):
        z = normal6(seed, TURBULENCE, e, i, clock * ti.static(substeps + 1) + substeps)
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
    """Coefficients (12) of a substep dt (s): `dryden_filter`, then `dryden_sigma`; zeros without turbulence."""
    zero = Va * 0.0
    f = ti.Vector([zero] * 12)
    if ti.static(air.turbulent):
        step, sigma = dryden_filter(Va, h, dt), dryden_sigma(h, W20)
        for k in ti.static(range(10)):
            f[k] = step[k]
        f[10], f[11] = sigma[0], sigma[1]
    return f


@ti.func
def turbulence_step(air: ti.template(), x, f, seed, count, e, i):
    """State (5) of the turbulence one substep later; `count` numbers substeps through all episodes."""
    new = x
    if ti.static(air.turbulent):
        new = dryden_advance(x, f, normal6(seed, TURBULENCE, e, i, count))
    return new


@ti.func
def mean_wind(air: ti.template(), wind, shear, position):
    """Mean wind (NED, m/s) at `position` (NED, m); `wind` is the mean wind 10 m above the sea."""
    return wind * mean_wind_factor(air.profile, shear, -position[2])


@ti.func
def velocity_at(air: ti.template(), wind, shear, x, f, v_air, position, time):
    """Velocity of the air (NED, m/s) at `position` (NED, m) and `time` (s): mean wind, turbulence and gust.

    `wind` is the mean wind 10 m above the sea. The turbulence, in state x with coefficients f, has its axes along
    v_air, the velocity (NED) through the mean wind.
    """
    total = mean_wind(air, wind, shear, position)
    if ti.static(air.turbulent):
        total += gust_n(dryden_output(x, ti.Vector([f[10], f[11]])), v_air)
    if ti.static(air.gusty):
        total += gust_velocity(air.gust, position, time)
    return total


@ti.func
def gust_ahead(air: ti.template(), position, v_n, time, dt: ti.template()):
    """Change of the discrete gust (NED, m/s) from now to the middle of a substep dt (s).

    The aircraft is at `position` (NED, m) at `time` (s) and moves over ground with v_n (NED, m/s).
    """
    ahead, half = v_n * 0.0, 0.5 * dt
    if ti.static(air.gusty):
        there = ti.Vector([position[0] + half * v_n[0], position[1] + half * v_n[1]])
        ahead = gust_velocity(air.gust, there, time + half) - gust_velocity(air.gust, position, time)
    return ahead
