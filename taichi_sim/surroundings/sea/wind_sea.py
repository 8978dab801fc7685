"""Height and period of a wind sea, from a sea state, from wind and fetch, or from a wind alone; sea states by number.

A fully developed sea (Pierson & Moskowitz 1964), with U at 19.5 m, has hs = 0.2092 U^2 / g and omega_p = 0.877 g / U.

A fetch-limited sea follows the laws of Hasselmann et al. (1973, JONSWAP) in Kitaigorodskii's scaling (also in Stewart
2008, Introduction to Physical Oceanography, sec. 16.4), with U10 at 10 m and x = g fetch / U10^2, E = g^2 m0 / U10^4,
f = f_p U10 / g:

    E = 1.6e-7 x,  f = 3.5 x^-0.33.

It is never larger or longer than the fully developed sea of the same wind, which these laws reach near x = 2e4.

The number of a sea state is a range of significant wave height: WMO Code Table 3700 (Manual on Codes, WMO-No. 306). A
limit belongs to the lower number: exactly 4 m is code 5.

Winds at two heights follow the neutral logarithmic profile U(z) = U10 (1 + sqrt(C_D) / kappa ln(z / 10 m)) with
C_D = 1.3e-3, so that U19.5 = 1.060 U10. (Stewart's eq. 16.29 prints 1.026 for this C_D, which the profile does not
give. With 1.060 the sea is hs = 0.235 U10^2 / g and f = 0.132, against 0.24 and 0.13 in Komen, Hasselmann &
Hasselmann 1984.)
"""

import math
from typing import NamedTuple

from taichi_sim.config import SeaConfig
from taichi_sim.config.sea import LONGEST, SHORTEST, SwellConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.surroundings.sea.measured import records_of
from taichi_sim.surroundings.sea.spectrum import CALM_PERIOD, pierson_moskowitz_hs_tp

JONSWAP_ENERGY = 1.6e-7  # E / x
JONSWAP_FREQUENCY, JONSWAP_FREQUENCY_POWER = 3.5, -0.33  # f = 3.5 x^-0.33

WIND_HEIGHT, PM_WIND_HEIGHT = 10.0, 19.5  # m; of wind_speed, and of the anemometers of Pierson & Moskowitz
DRAG_COEFFICIENT = 1.3e-3  # of the sea surface, at 10 m (Stewart 2008, sec. 16.4)
VON_KARMAN = 0.4
SWELL_STEEPNESS = 0.005  # of a swell without a period of its own; assumed: 8 s for 0.5 m
UPPER_HS = (0.0, 0.1, 0.5, 1.25, 2.5, 4.0, 6.0, 9.0, 14.0, math.inf)  # m, upper limits of codes 0 to 9


class SeaSize(NamedTuple):
    """Significant wave height hs (m) and peak period tp (s)."""

    hs: float
    tp: float


def wind_19_5(wind_speed: float) -> float:
    """Convert a wind speed (m/s) at 10 m to 19.5 m by the neutral logarithmic profile."""
    slope = math.sqrt(DRAG_COEFFICIENT) / VON_KARMAN
    return wind_speed * (1 + slope * math.log(PM_WIND_HEIGHT / WIND_HEIGHT))


def developed_sea(wind_speed: float) -> SeaSize:
    """Fully developed Pierson-Moskowitz sea under a wind (m/s) at 10 m."""
    return SeaSize(*pierson_moskowitz_hs_tp(wind_19_5(wind_speed)))


def developed_period(hs: float) -> float:
    """Peak period (s) of the fully developed sea of height hs (m, > 0); it grows as sqrt(hs)."""
    unit = SeaSize(*pierson_moskowitz_hs_tp(1.0))
    return unit.tp * math.sqrt(hs / unit.hs)


def _developed_or_calm(hs: float) -> float:
    return max(developed_period(hs), SHORTEST) if hs > 0 else CALM_PERIOD


def growing_sea(wind_speed: float, fetch: float, g: float = GRAVITY) -> SeaSize:
    """JONSWAP sea under a wind (m/s) at 10 m over a fetch (m), at most fully developed."""
    x = g * fetch / wind_speed**2
    hs = 4 * math.sqrt(JONSWAP_ENERGY * x) * wind_speed**2 / g
    tp = wind_speed / g / (JONSWAP_FREQUENCY * x**JONSWAP_FREQUENCY_POWER)
    limit = developed_sea(wind_speed)
    return SeaSize(min(hs, limit.hs), min(tp, limit.tp))


def sea_size(config: SeaConfig) -> SeaSize:
    """Height and period of the wind sea (without swell) of a configuration.

    For a measured sea they are those of its record, or the mean over its records. A wind too weak for gravity waves
    (below 0.14 m/s) gives a sea of less than a millimetre with their shortest period.
    """
    if config.measured:
        records = records_of(config)
        return SeaSize(*(sum(x) / len(records) for x in zip(*((r.hs, r.tp) for r in records), strict=True)))
    if config.sea_state is not None:
        hs = sum(sea_state_range(config.sea_state)) / 2
        return SeaSize(hs, _developed_or_calm(hs))
    if config.wind_speed is not None:
        wind, fetch = config.wind_speed, config.fetch
        hs, tp = developed_sea(wind) if fetch is None else growing_sea(wind, fetch)
        return SeaSize(hs, max(tp, SHORTEST))
    assert config.hs is not None  # SeaConfig ensures it
    return SeaSize(config.hs, _developed_or_calm(config.hs) if config.tp is None else config.tp)


def swell_size(config: SwellConfig) -> SeaSize:
    """Height and period of a swell; without a period, its steepness 2 pi hs / (g tp^2) is SWELL_STEEPNESS."""
    tp = config.tp or math.sqrt(2 * math.pi * config.hs / (GRAVITY * SWELL_STEEPNESS))
    return SeaSize(config.hs, min(max(tp, SHORTEST), LONGEST))


def sea_state_range(code: int) -> tuple[float, float]:
    """Smallest and largest significant wave height (m) of sea state `code`, 0 to 9; code 9 has no upper limit."""
    if code not in range(len(UPPER_HS)):
        raise ValueError(f"sea state {code!r}: allowed are 0 to {len(UPPER_HS) - 1}")
    return (UPPER_HS[code - 1] if code > 0 else 0.0), UPPER_HS[code]


def sea_state(hs: float) -> int:
    """Sea state number of a significant wave height (m)."""
    if not hs >= 0:
        raise ValueError(f"hs = {hs!r}: must be 0 m or more")
    return next(code for code, upper in enumerate(UPPER_HS) if hs <= upper)
