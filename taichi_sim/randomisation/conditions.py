"""Conditions of a realisation: size and direction of its sea, its mean wind and its mean current.

Each realisation r has its own value of every condition that `[vary]` names (config/vary.py). It is drawn once, from the
world's seed and r alone, so more realisations keep the earlier ones. An environment that uses a realisation has all of
its conditions. All other conditions are nominal: those of the scenario.

Conditions depend on one another:

- A drawn height without a drawn period keeps the nominal steepness: tp grows as sqrt(hs).
- A drawn sea state lies between WMO codes. Its height is interpolated between the middles of the codes' ranges, and its
  period is that of the developed sea.
- A sea that follows the wind takes the wind of its own realisation. Swell stays the same.
- With a measured sea and `record = "all"`, a realisation takes height, period and direction from its own record.
- The period of a drawn sea that cannot exist is raised until it can (sea/sea.py).
- A range of directions is at most the whole circle. If a scenario's range exceeds the limits of a condition
  (`CONDITIONS`), it is refused. If only `variation` > 1 makes it exceed them, its ends are moved to the limits.
- The wind's profile over height, its roughness and the ratio of W20 to the mean wind are those of the nominal wind. The
  slow variations of wind and current are about the realisation's own means. A wind or current given over time counts by
  its mean.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from taichi_sim.config import ConfigError, CurrentConfig, SeaConfig, WorldConfig
from taichi_sim.config.series import mean_of
from taichi_sim.config.vary import CONDITIONS, SIZE
from taichi_sim.errors import named
from taichi_sim.kernels import runtime
from taichi_sim.surroundings.air.wind import mean_wind
from taichi_sim.surroundings.sea.measured import records_of
from taichi_sim.surroundings.sea.sampling import realisation_seed
from taichi_sim.surroundings.sea.sea import Sea, varied_components
from taichi_sim.surroundings.sea.spectrum import CALM_PERIOD
from taichi_sim.surroundings.sea.wind_sea import SeaSize, developed_period, sea_size, sea_state_range

STREAM = 0xD0  # separates these random numbers from those of the waves of the same seed
SIGMAS = 2.0  # standard deviations of a normal distribution from the middle to either end of a range
TAIL = float(torch.special.ndtr(torch.tensor(-SIGMAS, dtype=torch.float64)))  # probability beyond one end
CIRCLE = 360.0  # deg
STATES = np.arange(7.0)
MIDDLES = np.array([sum(sea_state_range(code)) / 2 for code in range(7)])  # m
Values = Mapping[str, np.ndarray]  # key of `CONDITIONS` -> [realisation]
UNIT_PERIOD, UNIT_WIND = 10.0, 10.0  # s, m/s; units of the columns of `truth`


def spread(chance: Tensor, low: Tensor | float, high: Tensor | float, normal: Tensor) -> Tensor:
    """Map a `chance`, uniform in [0, 1), to numbers between `low` and `high`, float64; all arguments broadcast.

    The numbers are uniform or, where `normal` (bool), normal about the middle and cut off at the ends, which lie 2
    standard deviations away.
    """
    bell = 0.5 + torch.special.ndtri(TAIL + (1 - 2 * TAIL) * chance) / (2 * SIGMAS)
    return low + (high - low) * torch.where(normal, bell.clamp(0.0, 1.0), chance)


class Conditions(NamedTuple):
    """Wave height, period, direction, wind and current of each realisation, float64 [realisation]."""

    hs: np.ndarray  # of the wind sea, m
    tp: np.ndarray  # of the wind sea, s
    wave_direction_deg: np.ndarray  # travels to
    current_speed: np.ndarray  # m/s
    current_direction_deg: np.ndarray  # flows to
    wind_speed: np.ndarray  # 10 m above the sea, m/s
    wind_direction_deg: np.ndarray  # blows from
    turbulence: np.ndarray  # intensity over that of the scenario

    def tables(self) -> "Tables":
        """Convert the conditions to tensors, for kernels and critics."""
        run, waves = runtime.current(), np.deg2rad(self.wave_direction_deg)
        current = _vector(self.current_speed, self.current_direction_deg)
        wind = -_vector(self.wind_speed, self.wind_direction_deg)
        sea = self.hs, self.tp / UNIT_PERIOD, np.cos(waves), np.sin(waves)
        truth = np.column_stack((*sea, current, wind / UNIT_WIND, self.turbulence))
        tables = current, np.pad(wind, ((0, 0), (0, 1))), self.turbulence, truth
        return Tables(*(torch.as_tensor(x, dtype=run.torch_dtype, device=run.device) for x in tables))


class Tables(NamedTuple):
    """Conditions of each realisation, as tensors of the run's precision."""

    current: torch.Tensor  # [sea, 2], mean velocity of the water at the surface, north and east, m/s
    wind: torch.Tensor  # [sea, 3], mean velocity of the air 10 m above the sea, NED, m/s
    turbulence: torch.Tensor  # [sea], factor of the turbulence intensity
    truth: torch.Tensor  # [sea, TRUTH], all conditions, scaled to order one


TRUTH = (
    "sea.hs", "sea.tp", "sea.direction.cos", "sea.direction.sin", "sea.current.north", "sea.current.east",
    "air.north", "air.east", "air.turbulence",
)  # fmt: skip
"""Names of the columns of `Tables.truth`. Units: hs m, tp 10 s, current m/s, wind 10 m/s (where it blows to), others 1.
The wave direction is where waves travel to."""


def realise(config: WorldConfig, seed: int) -> tuple[Sea, Conditions]:
    """Draw the sea realisations of a world, and the conditions of each."""
    found = _drawn(config, seed)
    if not (varied(config) & {*SIZE, "sea.direction_deg"}) and not (config.sea.follows_wind and _windy(config)):
        return Sea.from_config(resolved_sea(config), seed), found
    sea = resolved_sea(config)
    components, tp = varied_components(sea, found.hs, found.tp, found.wave_direction_deg, seed)
    return Sea(components, sea.depth), found._replace(tp=tp)


def varied(config: WorldConfig) -> set[str]:
    """Keys of the conditions that differ between realisations."""
    return set(config.vary) if config.variation > 0 else set()


def _windy(config: WorldConfig) -> bool:
    return bool(varied(config) & {"air.speed", "air.direction_deg"})


def bounds(config: WorldConfig, key: str) -> tuple[float, float]:
    """Lowest and highest value of a condition; the nominal value twice if it does not vary."""
    return _bounds(config, key, nominal_conditions(config)[key])


def nominal_conditions(config: WorldConfig) -> dict[str, float]:
    """Nominal conditions of a scenario, by the keys of `CONDITIONS`."""
    sea, current = resolved_sea(config), config.sea.current or CurrentConfig()
    size, (speed, blows_from) = sea_size(sea), mean_wind(config.air)
    flow = mean_of(current.series) if current.series else (current.speed, current.direction_deg)
    return {
        "sea.hs": size.hs,
        "sea.tp": size.tp,
        "sea.sea_state": float(np.interp(size.hs, MIDDLES, STATES)),
        "sea.direction_deg": _directions(sea)[0],
        "sea.current.speed": flow[0],
        "sea.current.direction_deg": flow[1],
        "air.speed": speed,
        "air.direction_deg": blows_from,
        "air.turbulence": 1.0,
    }


def resolved_sea(config: WorldConfig, wind: tuple[float, float] | None = None) -> SeaConfig:
    """Sea configuration of a scenario; if the sea follows the wind, with the wind's numbers filled in.

    `wind` is the speed (m/s) and direction (deg, blows from); default: the scenario's own wind.
    """
    sea = config.sea
    if not sea.follows_wind:
        return sea
    speed, direction_deg = wind or mean_wind(config.air)
    size = {"wind_speed": speed} if speed > 0 else {"hs": 0.0, "tp": CALM_PERIOD, "fetch": None}
    return sea.model_copy(update=size | {"follows_wind": False, "direction_deg": direction_deg + 180.0})


def _drawn(config: WorldConfig, seed: int) -> Conditions:
    """Draw the conditions of each realisation; periods that are too short for their height are not raised yet."""
    nominal, varying, n = nominal_conditions(config), varied(config), config.sea.realisations
    values = {key: np.full(n, value) for key, value in nominal.items()}
    ends = {key: _bounds(config, key, nominal[key]) for key in config.vary}
    if varying:  # each key has its own column, so its numbers do not depend on which other keys vary
        chance = np.array([realisation_seed(seed, r, STREAM).random(len(CONDITIONS)) for r in range(n)])
        for column, key in enumerate(CONDITIONS):
            if key in varying:
                normal = torch.tensor(config.vary[key].distribution == "normal")
                values[key] = spread(torch.from_numpy(chance[:, column]), *ends[key], normal).numpy()
    values |= _sizes(config, nominal, values)
    if config.sea.measured:
        records = records_of(config.sea)
        turn = np.arange(n) % len(records)
        values |= {"sea.hs": np.array([r.hs for r in records])[turn], "sea.tp": np.array([r.tp for r in records])[turn],
                   "sea.direction_deg": np.array(_directions(config.sea))[turn]}  # fmt: skip
    return Conditions(*(values[key] for key in CONDITIONS if key != "sea.sea_state"))


def _sizes(config: WorldConfig, nominal: Mapping[str, float], values: Values) -> dict[str, np.ndarray]:
    """Height, period and direction of each realisation's waves, derived from the drawn `values`."""
    varying, least = varied(config), CONDITIONS["sea.tp"][0]
    if config.sea.follows_wind and _windy(config):
        winds = zip(values["air.speed"], values["air.direction_deg"], strict=True)
        seas = [resolved_sea(config, (float(speed), float(direction))) for speed, direction in winds]
        sizes, directions = [sea_size(sea) for sea in seas], [sea.direction_deg for sea in seas]
    elif "sea.sea_state" in varying:
        sizes = [_developed(hs, least) for hs in np.interp(values["sea.sea_state"], STATES, MIDDLES)]
        directions = values["sea.direction_deg"]
    elif "sea.hs" in varying and "sea.tp" not in varying:
        hs, tp = nominal["sea.hs"], nominal["sea.tp"]
        sizes = [SeaSize(x, tp * math.sqrt(x / hs)) if hs > 0 else _developed(x, least) for x in values["sea.hs"]]
        directions = values["sea.direction_deg"]
    else:
        return {}
    hs, tp = np.array(sizes).T
    tp = np.clip(tp, *CONDITIONS["sea.tp"])
    return {"sea.hs": hs, "sea.tp": tp, "sea.direction_deg": np.asarray(directions)}


def _directions(sea: SeaConfig) -> list[float]:
    """Directions of travel of the waves, deg: that of the configuration, or those of the records in turn."""
    return [math.degrees(r.direction) for r in records_of(sea)] if sea.measured else [sea.direction_deg]


def _developed(hs: float, least: float) -> SeaSize:
    return SeaSize(hs, developed_period(hs) if hs > 0 else least)


def _bounds(config: WorldConfig, key: str, nominal: float) -> tuple[float, float]:
    if key not in config.vary:
        return nominal, nominal
    given, (least, most) = config.vary[key], CONDITIONS[key]
    with named(f"vary.{key}: ", ConfigError, ValueError):
        low, high = given.ends(nominal)
    if not least <= low <= high <= most:
        raise ConfigError(
            f"vary.{key} = {given}: goes from {low:g} to {high:g}, allowed are {least:g} to {most:g} "
            f"(the scenario's own is {nominal:g})"
        )
    low, high = (min(max(end, least), most) for end in given.ends(nominal, config.variation))
    if key.endswith("direction_deg") and high - low > CIRCLE:
        middle = (low + high) / 2
        low, high = middle - CIRCLE / 2, middle + CIRCLE / 2
    return low, high


def _vector(speed: np.ndarray, direction_deg: np.ndarray) -> np.ndarray:
    """North and east components [.., 2] of a speed and a direction."""
    angle = np.deg2rad(direction_deg)
    return np.stack((speed * np.cos(angle), speed * np.sin(angle)), axis=-1)
