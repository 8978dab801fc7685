"""Mean wind: its speed (by Beaufort force or a time series), its slow variation and its profile over height. Gusts.

The profiles are neutral, U(h) = U10 f(h). Each has one parameter, the shear s:

    log      f = 1 + s ln(h / 10 m),  s = 1 / ln(10 m / z0)    (surface layer; Stull 1988, sec. 9.7)
    power    f = (h / 10 m)^s,        s = 1/7 over land (Touma 1977), 0.11 over sea (Hsu, Meindl & Gilhousen 1994)
    uniform  f = 1

The roughness of the sea grows with the wind: z0 = alpha u*^2 / g (Charnock 1955) with u* = kappa U10 / ln(10 m / z0).
alpha is 0.011 on the open sea (Smith 1988), 0.0144 on average (Garratt 1977) and 0.0185 near the coast (Wu 1980).

Gusts have the one-minus-cosine form. U is the amplitude (a vector), H the length from zero to the peak:

    pulse (14 CFR 25.341(a)(2)):     U/2 (1 - cos(pi s / H)) for 0 <= s <= 2H, else 0
    ramp (MIL-F-8785C, 3.7.1.3):     U/2 (1 - cos(pi s / H)) for 0 <= s <= H, then U

s is how far the aircraft has penetrated the gust: a distance (m) or a time (s). H has the same unit.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Literal, NamedTuple

import numpy as np
import taichi as ti
import torch

from taichi_sim.config import AirConfig, GustConfig
from taichi_sim.config.series import Series, mean_of, read_series
from taichi_sim.kernels import fast_maths, runtime
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.fast_maths import exp
from taichi_sim.kernels.random import SlowVariation, log
from taichi_sim.state.memory import Remembers

Shape = Literal["pulse", "ramp"]
Profile = Literal["log", "power", "uniform"]
REFERENCE_HEIGHT = 10.0  # m; configurations give the wind at this height
TWENTY_FEET = 6.096  # m; height of W20 in MIL-F-8785C
LOWEST_HEIGHT = 0.1  # m; lower down, as in a wave trough, the wind is that at this height
VON_KARMAN = 0.40
CALM = 0.3  # m/s, end of Beaufort 0; a weaker wind does not make the sea smoother
CHARNOCK_ITERATIONS = 100  # each iteration reduces the error to less than a quarter
# Lowest and highest speed (m/s) at 10 m of Beaufort 0 to 12; force 12 has no highest (WMO-No. 306, Code Table 1100)
BEAUFORT = (
    (0.0, 0.2), (0.3, 1.5), (1.6, 3.3), (3.4, 5.4), (5.5, 7.9), (8.0, 10.7), (10.8, 13.8), (13.9, 17.1),
    (17.2, 20.7), (20.8, 24.4), (24.5, 28.4), (28.5, 32.6), (32.7, 32.7),
)  # fmt: skip
STREAM = 0xA1  # separates the wind's random numbers from others of the same seed


class Gust(NamedTuple):
    """A gust reduced to numbers: s = rate t + north x + east y - offset, in units of H; the peak is at s = 1.

    Attributes:
        amplitude: NED, m/s.
        rate: 1/s.
        north, east: 1/m.
    """

    amplitude: tuple[float, float, float]
    shape: Shape
    rate: float
    north: float
    east: float
    offset: float

    @classmethod
    def of(cls, config: GustConfig) -> "Gust":
        """Convert the gust of a configuration."""
        if config.start_time is not None and config.rise_time is not None:
            rate, offset = 1 / config.rise_time, config.start_time / config.rise_time
            return cls(config.amplitude, config.shape, rate, 0.0, 0.0, offset)
        assert config.length is not None and config.direction_deg is not None  # GustConfig ensures it
        assert config.start_north is not None and config.start_east is not None
        direction = math.radians(config.direction_deg)
        north, east = math.cos(direction) / config.length, math.sin(direction) / config.length
        offset = north * config.start_north + east * config.start_east
        return cls(config.amplitude, config.shape, 0.0, north, east, offset)


@ti.func
def one_minus_cosine(shape: ti.template(), s):
    """Fraction of the amplitude, 0 to 1, at s (in units of H)."""
    end = ti.static(2.0 if shape == "pulse" else 1.0)
    half = ti.min(ti.max(s, 0.0), end) * ti.static(0.5 * math.pi)  # in [0, pi]; (1 - cos 2x) / 2 = sin^2 x
    sine = fast_maths.sin(half)
    return sine * sine


@ti.func
def gust_velocity(gust: ti.template(), position, time):
    """Air velocity (NED, m/s) of a `Gust` at a position (NED, m) and a time (s)."""
    s = gust.rate * time + gust.north * position[0] + gust.east * position[1] - gust.offset
    factor = one_minus_cosine(gust.shape, s)
    a = ti.static(gust.amplitude)
    return ti.Vector([factor * a[0], factor * a[1], factor * a[2]])


def beaufort_speed(force: int) -> float:
    """Middle of the range of wind speeds (m/s, at 10 m) of a Beaufort force; for force 12 the lower end."""
    if force not in range(len(BEAUFORT)):
        raise ValueError(f"beaufort = {force!r}: allowed are 0 to {len(BEAUFORT) - 1}")
    return sum(BEAUFORT[force]) / 2


def charnock_roughness(speed: float, alpha: float, g: float = GRAVITY, kappa: float = VON_KARMAN) -> float:
    """Roughness z0 (m) of a sea in equilibrium with a wind of `speed` (m/s) at 10 m."""
    z0 = alpha * (kappa * max(speed, CALM)) ** 2 / g / 100
    for _ in range(CHARNOCK_ITERATIONS):
        u_star = kappa * max(speed, CALM) / math.log(REFERENCE_HEIGHT / z0)
        z0 = alpha * u_star**2 / g
    return z0


def wind_shear(config: AirConfig) -> float:
    """Shear s of the wind profile of a configuration."""
    if config.profile == "log":
        z0 = config.roughness or charnock_roughness(wind_speed(config), config.charnock)
        return log_shear(z0)
    return config.exponent if config.profile == "power" else 0.0


def log_shear(z0: float) -> float:
    """Shear s of the log profile over a roughness z0 (m)."""
    return 1 / math.log(REFERENCE_HEIGHT / z0)


def wind_speed(config: AirConfig) -> float:
    """Mean wind speed (m/s) at 10 m of a configuration; for a time series, the speed of its mean velocity."""
    return mean_wind(config)[0]


def mean_wind(config: AirConfig) -> tuple[float, float]:
    """Return the mean speed (m/s, at 10 m) and direction (deg, blows from) of a configuration.

    For a time series they are those of its mean velocity. This wind sets the roughness of the sea, and the size of a
    sea that follows the wind.
    """
    if config.series is not None:
        return mean_of(config.series, blows_from=True)
    speed = config.speed or 0.0 if config.beaufort is None else beaufort_speed(config.beaufort)
    return speed, config.direction_deg


def wind_factor(profile: Profile, shear: float, height) -> np.ndarray:
    """Ratio, not negative, of the mean wind at `height` (m above mean sea level, any shape) to that at 10 m."""
    x = np.log(np.maximum(np.asarray(height, dtype=np.float64), LOWEST_HEIGHT) / REFERENCE_HEIGHT)
    return np.exp(shear * x) if profile == "power" else np.maximum(1 + shear * x, 0.0)


@ti.func
def mean_wind_factor(profile: ti.template(), shear, h):
    """The function `wind_factor` for kernels; h is the height (m) above mean sea level."""
    factor = h * 0.0 + 1.0
    if ti.static(profile != "uniform"):
        x = log(ti.max(h, LOWEST_HEIGHT) * ti.static(1 / REFERENCE_HEIGHT))
        if ti.static(profile == "power"):
            factor = exp(shear * x)
        else:
            factor = ti.max(1.0 + shear * x, 0.0)
    return factor


class Wind(Remembers):
    """Wind of every environment.

    The slow variation of each horizontal component is a first-order Gauss-Markov process (kernels/random.py).

    Attributes:
        velocity: velocity of the air 10 m above the sea, [env, 3], NED, m/s (where it blows to), in run precision. It
            is written in place and never replaced.
        profile, shear: profile of the mean wind over height, as `mean_wind_factor` takes it.
        w20_factor: ratio of the wind at 20 ft to that at 10 m.
    """

    def __init__(self, config: AirConfig | None, num_envs: int, seed: int):
        """Draw the wind of each environment; without a `config` it is calm."""
        run = runtime.current()
        self.config = config or AirConfig()
        self.profile: Profile = self.config.profile
        self.shear = wind_shear(self.config)
        self.w20_factor = self.speed_factor(TWENTY_FEET)
        speed, direction_deg = mean_wind(self.config)
        start, file = math.radians(direction_deg), self.config.series
        self._series = Series(*read_series(file, blows_from=True)) if file else None
        mean = [-speed * math.cos(start), -speed * math.sin(start), 0.0]
        self._mean = self.remember(torch.tensor(mean, dtype=run.torch_dtype, device=run.device).repeat(num_envs, 1))
        self.velocity = self.remember(self._mean.clone())
        std, time_constant = self.config.std, self.config.time_constant
        self._variation = self.remember(SlowVariation(num_envs, std, time_constant, seed=seed, stream=STREAM))
        everywhere = torch.arange(num_envs, device=run.device)
        self.follow(everywhere, torch.zeros(num_envs, dtype=torch.float64, device=run.device))
        self.reset(everywhere)

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Parameters for kernels: (shear, fixed W20, factor).

        The turbulence has W20 = fixed W20 (m/s) + factor times the mean wind at 10 m.
        """
        fixed = self.config.turbulence_w20
        return self.shear, fixed or 0.0, self.w20_factor if fixed is None else 0.0

    def speed_factor(self, height: float) -> float:
        """Ratio of the mean wind at `height` (m above mean sea level) to that at 10 m."""
        return float(wind_factor(self.profile, self.shear, height))

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        self._variation.reseed(seed)

    @property
    def mean(self) -> torch.Tensor:
        """Mean wind [env, 3], `velocity` without the slow variation."""
        return self._mean

    def set_mean(self, envs: torch.Tensor, mean: torch.Tensor) -> None:
        """Set the mean wind of environments `envs` [n] to `mean` [n, 3] (NED, m/s); the slow variation stays.

        The profile over height, and the ratio of W20 to the mean wind, stay those of the configuration.
        """
        self._mean[envs] = mean
        self._blow(envs)

    def follow(self, envs: torch.Tensor, time: torch.Tensor) -> None:
        """Set the mean wind of `envs` [n] from the series at their times [n] (float64, s); a steady wind stays."""
        if self._series is not None:
            self.set_mean(envs, torch.nn.functional.pad(self._series.at(time), (0, 1)))

    def reset(self, envs: torch.Tensor) -> None:
        """Draw the wind of environments `envs` (indices [n], int64) anew from its stationary distribution."""
        self._variation.begin(envs)
        self._blow(envs)

    def advance(self, dt: float) -> None:
        """Advance the slow variation by dt (s), exactly; a steady wind stays."""
        if self._variation.varies:
            self._variation.advance(dt)
            torch.add(self._mean[:, :2], self._variation.value, out=self.velocity[:, :2])

    def _blow(self, envs: torch.Tensor) -> None:
        """Set `velocity` of environments `envs` [n] to mean wind plus slow variation."""
        self.velocity[envs, 2] = self._mean[envs, 2]
        self.velocity[envs, :2] = self._mean[envs, :2] + self._variation.value[envs]
