"""Numbers drawn from ranges: how a chance becomes a number, and those of a fleet's vehicles for each episode."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from taichi_sim.config import ConfigError, Range
from taichi_sim.fleet import Fleet

SIGMAS = 2.0  # of a normal distribution, from its middle to the ends of a range
TAIL = float(torch.special.ndtr(torch.tensor(-SIGMAS, dtype=torch.float64)))  # beyond one of them
STREAM = 0xF1  # keeps these random numbers apart from others of the same seed
BATCH = 4096  # vehicles drawn at once: what a model makes of their numbers costs little more than of one vehicle's
HALVINGS = 50  # of the way to a number that a vehicle file could not hold


def spread(chance: Tensor, low: Any, high: Any, normal: Tensor) -> Tensor:
    """Numbers between `low` and `high` for a `chance` uniform in [0, 1), float64: spread evenly, or, where `normal`
    (bool), normally about the middle, cut off at the ends, 2 standard deviations away. All broadcast.
    """
    bell = 0.5 + torch.special.ndtri(TAIL + (1 - 2 * TAIL) * chance) / (2 * SIGMAS)
    return low + (high - low) * torch.where(normal, bell.clamp(0.0, 1.0), chance)


class NumberDraws:
    """Draws new numbers for a fleet's vehicles when an episode begins; those without a range go back to the vehicle
    file's.

    Each range is checked with the other numbers as in the vehicle file. Mass, inertia and CG of one vehicle are drawn
    independently of each other, as their keys are; a hull's inertia follows its mass and CG (rigid_body.changed_mass),
    an aircraft's does not.

    Attributes:
        names: keys that have a range. told: [env, vehicle, name], run precision: how far each number is from that of
            the vehicle file, over that; over the range's end where that is 0. Written in place.
    """

    STATE = ("told",)
    SHARED = ("_batch", "_generator")

    def __init__(self, fleet: Fleet, ranges: Mapping[str, Range], variation: float, seed: int):
        """Draw for `fleet` from `ranges`, whose widths are multiplied by `variation`; at 0 nothing is drawn.

        Ends that only `variation` > 1 has brought beyond what the vehicle file could hold are moved back to it.

        Raises:
            ConfigError: for a key that does not vary, or a range with numbers that the vehicle file could not hold.
        """
        self.fleet, self.names = fleet, tuple(ranges)
        ends, scale = [], []
        for key, given in ranges.items():
            low, high = _held(fleet, key, given, 1.0)
            value = fleet.model.nominal[key]
            scale.append(value or max(abs(low), abs(high)) or 1.0)
            ends.append(_held(fleet, key, given, variation))
        options: dict[str, Any] = {"dtype": torch.float64, "device": fleet.state.device}
        low, high = torch.tensor(ends, **options).reshape(-1, 2).unbind(-1)
        self._low, self._high = low, high
        self._normal = torch.tensor(
            [given.distribution == "normal" for given in ranges.values()], dtype=torch.bool, device=fleet.state.device
        )
        self._nominal = torch.tensor([fleet.model.nominal[key] for key in ranges], **options)
        self._scale = torch.tensor(scale, **options)
        self._columns = [fleet.model.varying.index(key) for key in ranges]
        self._batch: tuple[Tensor, ...] | None = None
        self._generator = torch.Generator()  # on the CPU: the same numbers on every device
        self.told = fleet.state.new_zeros((*fleet.state.shape[:2], len(self.names)))
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
        """Draw further vehicles' numbers [row, ..]: the varied values, the model's own numbers, the normalised ones."""
        chance = torch.rand((rows, len(self.names)), generator=self._generator, dtype=torch.float64)
        values = spread(chance.to(self._low.device), self._low, self._high, self._normal)
        vary = self.fleet.nominal.repeat(rows, 1)
        vary[:, self._columns] = values
        told = (values - self._nominal) / self._scale
        return vary, self.fleet.model.numbers(vary).to(self.told), told.to(self.told)


def _held(fleet: Fleet, key: str, given: Range, variation: float) -> tuple[float, float]:
    """Ends of a range, moved to values that the vehicle file accepts."""
    place = f"{fleet.name}.vary.{key}"
    try:
        fleet.model.check_varies(key)
        nominal = fleet.model.nominal[key]
        ends = given.ends(nominal, variation)
    except ValueError as error:
        raise ConfigError(f"{place} = {given}: {error}") from None
    for end in ends:
        reason = fleet.refusal(key, end)
        if reason and variation <= 1.0:
            raise ConfigError(f"{place} = {given}: {end:g} cannot be: {reason}")
    low, high = (end if fleet.refusal(key, end) is None else _nearest(fleet, key, nominal, end) for end in ends)
    return low, high


def _nearest(fleet: Fleet, key: str, good: float, bad: float) -> float:
    """The accepted value nearest to `bad` between it and `good`, found by bisection."""
    for _ in range(HALVINGS):
        middle = (good + bad) / 2
        if fleet.refusal(key, middle) is None:
            good = middle
        else:
            bad = middle
    return good
