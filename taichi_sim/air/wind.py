"""Mean wind: its speed by Beaufort's scale or over time (series.py), its slow variation, and its profile over height.

Neutral profiles U(h) = U10 f(h), one number, the shear s, in each:

    log      f = 1 + s ln(h / 10 m),  s = 1 / ln(10 m / z0)    (surface layer; Stull 1988, sec. 9.7)
    power    f = (h / 10 m)^s,        s = 1/7 over land (Touma 1977), 0.11 over sea (Hsu, Meindl & Gilhousen 1994)
    uniform  f = 1

The sea's roughness grows with the wind, z0 = alpha u*^2 / g (Charnock 1955), u* = kappa U10 / ln(10 m / z0), with alpha
0.011 on the open sea (Smith 1988), 0.0144 on the whole (Garratt 1977), 0.0185 near the coast (Wu 1980).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Literal

import numpy as np
import taichi as ti
import torch

from taichi_sim.air.exponential import exp
from taichi_sim.config import AirConfig
from taichi_sim.config.series import Series, mean_of, read_series
from taichi_sim.conventions import GRAVITY
from taichi_sim.kernels import runtime
from taichi_sim.kernels.gauss_markov import SlowVariation
from taichi_sim.kernels.random import log

Profile = Literal["log", "power", "uniform"]

REFERENCE_HEIGHT = 10.0  # m, of the wind in configurations
TWENTY_FEET = 6.096  # m, of MIL-F-8785C's W20
LOWEST_HEIGHT = 0.1  # m; below it, and so in a trough, the wind is that of this height
VON_KARMAN = 0.40
CALM = 0.3  # m/s, end of Beaufort 0: the sea is no smoother than in this wind
CHARNOCK_ITERATIONS = 100  # each leaves less than a quarter of the error

# lowest and highest speed at 10 m, m/s, of Beaufort 0 to 12; 12 has no highest (WMO-No. 306, Code Table 1100)
BEAUFORT = (
    (0.0, 0.2), (0.3, 1.5), (1.6, 3.3), (3.4, 5.4), (5.5, 7.9), (8.0, 10.7), (10.8, 13.8), (13.9, 17.1),
    (17.2, 20.7), (20.8, 24.4), (24.5, 28.4), (28.5, 32.6), (32.7, 32.7),
)  # fmt: skip
FASTEST = 60.0  # m/s, of a series
STREAM = 0xA1  # keeps the wind's random numbers apart from others of the same seed


def beaufort_speed(force: int) -> float:
    """Middle of the wind speeds (m/s) at 10 m of a Beaufort force; the lowest of force 12.

    Raises:
        ValueError: for a force outside 0..12.
    """
    if force not in range(len(BEAUFORT)):
        raise ValueError(f"beaufort = {force!r}: allowed are 0 to {len(BEAUFORT) - 1}")
    return sum(BEAUFORT[force]) / 2


def charnock_roughness(speed: float, alpha: float, g: float = GRAVITY, kappa: float = VON_KARMAN) -> float:
    """Roughness z0 (m) of a sea under the wind `speed` (m/s) at 10 m, in equilibrium with it."""
    z0 = alpha * (kappa * max(speed, CALM)) ** 2 / g / 100
    for _ in range(CHARNOCK_ITERATIONS):
        u_star = kappa * max(speed, CALM) / math.log(REFERENCE_HEIGHT / z0)
        z0 = alpha * u_star**2 / g
    return z0


def wind_shear(config: AirConfig) -> float:
    """The number s of the profile of a configuration."""
    if config.profile == "log":
        z0 = config.roughness or charnock_roughness(wind_speed(config), config.charnock)
        return log_shear(z0)
    return config.exponent if config.profile == "power" else 0.0


def log_shear(z0: float) -> float:
    """s of the log profile over a roughness z0 (m)."""
    return 1 / math.log(REFERENCE_HEIGHT / z0)


def wind_speed(config: AirConfig) -> float:
    """Mean wind speed (m/s) at 10 m of a configuration; for a wind over time, the speed of its mean velocity."""
    return mean_wind(config)[0]


def mean_wind(config: AirConfig) -> tuple[float, float]:
    """Mean speed (m/s, at 10 m) and direction (deg, blows from) of a configuration; of a wind over time, its mean's.

    The roughness of the sea, and the sea that follows the wind, are those of this wind.

    Raises:
        ConfigError: for a series that cannot be read.
    """
    if config.series is not None:
        return mean_of(config.series, blows_from=True)
    return _steady_speed(config), config.direction_deg


def _steady_speed(config: AirConfig) -> float:
    if config.beaufort is not None:
        return beaufort_speed(config.beaufort)
    return config.speed or 0.0


def wind_factor(profile: Profile, shear: float, height) -> np.ndarray:
    """Mean wind at `height` (m above the mean sea, any shape) over that at 10 m; not negative."""
    x = np.log(np.maximum(np.asarray(height, dtype=np.float64), LOWEST_HEIGHT) / REFERENCE_HEIGHT)
    return np.exp(shear * x) if profile == "power" else np.maximum(1 + shear * x, 0.0)


@ti.func
def mean_wind_factor(profile: ti.template(), shear, h):
    """`wind_factor` in kernels, at the height h (m above the mean sea)."""
    factor = h * 0.0 + 1.0
    if ti.static(profile != "uniform"):
        x = log(ti.max(h, LOWEST_HEIGHT) * ti.static(1 / REFERENCE_HEIGHT))
        if ti.static(profile == "power"):
            factor = exp(shear * x)
        else:
            factor = ti.max(1.0 + shear * x, 0.0)
    return factor


class Wind:
    """The wind of every environment.

    The slow variation of each horizontal component is a first-order Gauss-Markov process (kernels/gauss_markov.py).

    Attributes:
        velocity: [env, 3], of the air 10 m above the sea, NED, m/s (where it blows to), run precision; written in
            place, never replaced.
        profile, shear: of the mean wind over height, what `mean_wind_factor` takes.
        w20_factor: wind at 20 ft over that at 10 m.
    """

    STATE = ("velocity", "_mean", "_variation")

    def __init__(self, config: AirConfig | None, num_envs: int, seed: int):
        """Draw the wind of each environment; config None is calm."""
        run = runtime.current()
        self.config = config or AirConfig()
        self.profile: Profile = self.config.profile
        self.shear = wind_shear(self.config)
        self.w20_factor = self.speed_factor(TWENTY_FEET)
        speed, direction_deg = mean_wind(self.config)
        start, file = math.radians(direction_deg), self.config.series
        self._series = Series(*read_series(file, blows_from=True, fastest=FASTEST)) if file else None
        mean = [-speed * math.cos(start), -speed * math.sin(start), 0.0]
        self._mean = torch.tensor(mean, dtype=run.torch_dtype, device=run.device).repeat(num_envs, 1)
        self.velocity = self._mean.clone()
        std, time_constant = self.config.std, self.config.time_constant
        self._variation = SlowVariation(num_envs, std, time_constant, seed=seed, stream=STREAM)
        everywhere = torch.arange(num_envs, device=run.device)
        self.follow(everywhere, torch.zeros(num_envs, dtype=torch.float64, device=run.device))
        self.reset(everywhere)

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Numbers of the wind for kernels: the profile's shear, and W20 of the turbulence as a fixed part (m/s) and a
        factor of the mean wind at 10 m.
        """
        fixed = self.config.turbulence_w20
        return self.shear, fixed or 0.0, self.w20_factor if fixed is None else 0.0

    def speed_factor(self, height: float) -> float:
        """Mean wind at `height` (m above the mean sea) over that at 10 m."""
        return float(wind_factor(self.profile, self.shear, height))

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        self._variation.reseed(seed)

    def set_mean(self, envs: torch.Tensor, mean: torch.Tensor) -> None:
        """Set the mean winds of environments `envs` [n] to `mean` [n, 3] (NED, m/s); the slow variation stays.

        The profile over height and the turbulence's W20 over the mean wind stay those of the configuration.
        """
        self._mean[envs] = mean
        self._blow(envs)

    def follow(self, envs: torch.Tensor, time: torch.Tensor) -> None:
        """Set the mean winds of `envs` [n] to those at their times [n] (float64, s); does nothing for a steady wind."""
        if self._series is not None:
            self.set_mean(envs, torch.nn.functional.pad(self._series.at(time), (0, 1)))

    def reset(self, envs: torch.Tensor) -> None:
        """Draw the wind of environments `envs` (indices [n], int64) anew from its stationary distribution."""
        self._variation.begin(envs)
        self._blow(envs)

    def advance(self, dt: float) -> None:
        """Step the slow variation by dt (s), exactly; does nothing for a steady wind."""
        if self._variation.varies:
            self._variation.advance(dt)
            torch.add(self._mean[:, :2], self._variation.value, out=self.velocity[:, :2])

    def _blow(self, envs: torch.Tensor) -> None:
        """Set `velocity` of environments `envs` [n] to mean wind plus slow variation."""
        self.velocity[envs, 2] = self._mean[envs, 2]
        self.velocity[envs, :2] = self._mean[envs, :2] + self._variation.value[envs]
