"""What differs between environments when episodes begin: conditions of their realisation, numbers of their vehicles."""

from collections.abc import Mapping

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor

from taichi_sim.config import ConfigError, Range, WorldConfig
from taichi_sim.config.plausible import judge
from taichi_sim.errors import named
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.randomisation.conditions import TRUTH, Conditions, spread, varied
from taichi_sim.state.memory import Remembers
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.sea.current import Current
from taichi_sim.vehicle import edge

STREAM = 0xF1  # separates these random numbers from others of the same seed
BATCH = 4096  # vehicles drawn at once; their derived numbers cost little more than those of one vehicle
HALVINGS = 50  # steps of the bisection for the nearest number that a vehicle file accepts


class NumberDraws(Remembers):
    """Draws new numbers for a fleet's vehicles when an episode begins; numbers without a range stay as in the file.

    Each range is checked together with the other numbers of the vehicle file. Mass, inertia and CG of a vehicle are
    drawn independently of each other. A hull's inertia follows its mass and CG (rigid_body.changed_mass); an aircraft's
    does not.

    Attributes:
        names: keys that have a range.
        told: [env, vehicle, name] relative deviation of each number from that of the vehicle file, in run precision.
            If the file's number is 0, the deviation is divided by the range's larger end instead. Written in place.
    """

    def __init__(self, fleet: Fleet, ranges: Mapping[str, Range], variation: float, seed: int):
        """Draw for `fleet` from `ranges`, whose widths are multiplied by `variation`; at 0 nothing is drawn.

        If only `variation` > 1 makes a range exceed what the vehicle file accepts, its ends are moved to the nearest
        accepted values.
        """
        self.fleet, self.names = fleet, tuple(ranges)
        ends, scale = [], []
        for key, given in ranges.items():
            held = _held(fleet, key, given, 1.0)
            scale.append(fleet.model.nominal[key] or max(map(abs, held)) or 1.0)
            ends.append(held if variation == 1.0 else _held(fleet, key, given, variation))
        device = fleet.state.device
        low, high = torch.tensor(ends, dtype=torch.float64, device=device).reshape(-1, 2).unbind(-1)
        self._low, self._high = low, high
        self._normal = torch.tensor(
            [given.distribution == "normal" for given in ranges.values()], dtype=torch.bool, device=device
        )
        nominal = [fleet.model.nominal[key] for key in ranges]
        self._nominal = torch.tensor(nominal, dtype=torch.float64, device=device)
        self._scale = torch.tensor(scale, dtype=torch.float64, device=device)
        self._columns = [fleet.model.varying.index(key) for key in ranges]
        self._batch: tuple[Tensor, ...] | None = self.share(None)
        self._generator = self.share(torch.Generator())  # on the CPU, so that every device has the same numbers
        self.told = self.remember(fleet.state.new_zeros((*fleet.state.shape[:2], len(self.names))))
        self.drawn = bool(ranges) and variation > 0
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` and the fleet's name alone."""
        entropy = [seed, STREAM, *self.fleet.name.encode()]
        self._generator.manual_seed(int(np.random.SeedSequence(entropy).generate_state(1)[0]))
        self._batch = None

    def draw(self, envs: Tensor) -> None:
        """Draw new numbers for the vehicles of environments `envs` [n], if anything varies."""
        if not self.drawn:
            return
        rows = len(envs) * self.fleet.count
        if self._batch is None or rows > len(self._batch[0]):
            self._batch = self._make(max(rows, BATCH))
        shape = (len(envs), self.fleet.count, -1)
        vary, numbers, told = (table[:rows].view(shape) for table in self._batch)
        self._batch = tuple(table[rows:] for table in self._batch)
        self.fleet.give_numbers(vary, numbers, envs)
        self.told[envs] = told

    def _make(self, rows: int) -> tuple[Tensor, Tensor, Tensor]:
        """Draw numbers of `rows` more vehicles, [row, ..]: varied values, the model's own, relative deviations."""
        chance = torch.rand((rows, len(self.names)), generator=self._generator, dtype=torch.float64)
        values = spread(chance.to(self._low.device), self._low, self._high, self._normal)
        vary = self.fleet.nominal.repeat(rows, 1)
        vary[:, self._columns] = values
        told = (values - self._nominal) / self._scale
        return vary, self.fleet.model.numbers(vary).to(self.told), told.to(self.told)


def _held(fleet: Fleet, key: str, given: Range, variation: float) -> tuple[float, float]:
    """Ends of a range, moved to values that the vehicle file accepts."""
    place = f"{fleet.name}.vary.{key}"
    with named(f"{place} = {given}: ", ConfigError, ValueError):
        fleet.model.check_varies(key)
        nominal = fleet.model.nominal[key]
        ends = given.ends(nominal, variation)
    held = []
    for end in ends:
        reason = fleet.refusal(key, end)
        if reason and variation <= 1.0:
            raise ConfigError(f"{place} = {given}: {end:g} cannot be: {reason}")
        if not reason and isinstance(varied := fleet.model.with_numbers({key: end}), BaseModel):
            judge(varied, f"{place} = {given}")
        held.append(edge(nominal, end, lambda x: fleet.refusal(key, x) is None, HALVINGS) if reason else end)
    return held[0], held[1]


class Variation(Remembers):
    """Conditions of the realisations (conditions.py) and numbers of the vehicles of every environment.

    Attributes:
        turbulence: factor of the turbulence intensity, [env]; None if it does not vary.
        truth: team -> [env, vehicle, n], in run precision, of order one: numbers, then conditions, as drawn for the
            episode. The columns are the same for any `variation`. Written in place.
        names: team -> names of these columns.
    """

    def __init__(self, config: WorldConfig, conditions: Conditions, num_envs: int, seed: int):
        """Take the configuration and seed of a world; call `add` for each of its teams."""
        run = runtime.current()
        self.config, self.seed = config, seed
        self.turbulence: Tensor | None = self.remember(None)
        self._keys, self._tables = varied(config), conditions.tables()
        if "air.turbulence" in self._keys:
            self.turbulence = torch.ones(num_envs, dtype=run.torch_dtype, device=run.device)
        self.truth: dict[str, Tensor] = self.remember({})
        self.names: dict[str, tuple[str, ...]] = {}
        self._draws: dict[str, NumberDraws] = self.remember({})

    def add(self, fleet: Fleet) -> None:
        """Include the vehicles of a team."""
        ranges = self.config.teams[fleet.name].vary
        self._draws[fleet.name] = draws = NumberDraws(fleet, ranges, self.config.variation, self.seed)
        self.names[fleet.name] = (*draws.names, *TRUTH)
        self.truth[fleet.name] = fleet.state.new_zeros((*fleet.state.shape[:2], len(self.names[fleet.name])))

    def begin(self, envs: Tensor, seas: Tensor, current: Current, wind: Wind) -> None:
        """Assign conditions to environments `envs` [n] on realisations `seas` [n], and draw their vehicles' numbers.

        The means of `current` and `wind` are set; the caller draws the slow variations about them.
        """
        self.set_conditions(envs, seas, current, wind)
        for name, draws in self._draws.items():
            draws.draw(envs)
            self.truth[name][envs, :, : len(draws.names)] = draws.told[envs]

    def set_conditions(self, envs: Tensor, seas: Tensor, current: Current, wind: Wind) -> None:
        """Assign conditions only, not the vehicles' numbers."""
        if self._keys & {"sea.current.speed", "sea.current.direction_deg"}:
            current.set_mean(envs, self._tables.current[seas])
        if self._keys & {"air.speed", "air.direction_deg"}:
            wind.set_mean(envs, self._tables.wind[seas])
        if self.turbulence is not None:
            self.turbulence[envs] = self._tables.turbulence[seas]
        for truth in self.truth.values():
            truth[envs, :, -len(TRUTH) :] = self._tables.truth[seas].unsqueeze(1)

    def reseed(self, seed: int) -> None:
        """Make numbers of vehicles that are drawn later depend on `seed` alone; conditions stay."""
        for draws in self._draws.values():
            draws.reseed(seed)
