"""Assigns conditions and vehicles' numbers to environments when episodes begin, and normalises them for critics."""

import torch
from torch import Tensor

from taichi_sim.air import Wind
from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.randomisation.conditions import TOLD, Conditions, varied
from taichi_sim.randomisation.numbers import NumberDraws
from taichi_sim.sea.current import Current


class Variation:
    """Conditions of the realisations (conditions.py) and numbers of the vehicles (numbers.py), and who has which.

    Attributes:
        turbulence: [env], factor of the turbulence's intensity; None where it does not vary.
        truth: team -> [env, vehicle, n], run precision, of order one: numbers and conditions as drawn for the episode,
            in this order, as many whatever the `variation`. Written in place. names: team -> n names.
    """

    STATE = ("turbulence", "truth", "_draws")

    def __init__(self, config: WorldConfig, conditions: Conditions, num_envs: int, seed: int):
        """Take a world's configuration and seed; call `add` for each of its teams."""
        run = runtime.current()
        self.config, self.seed = config, seed
        self.turbulence: Tensor | None = None
        self._keys, self._tables = varied(config), conditions.tables()
        if "air.turbulence" in self._keys:
            self.turbulence = torch.ones(num_envs, dtype=run.torch_dtype, device=run.device)
        self.truth: dict[str, Tensor] = {}
        self.names: dict[str, tuple[str, ...]] = {}
        self._draws: dict[str, NumberDraws] = {}

    def add(self, fleet: Fleet) -> None:
        """Also draw numbers for the vehicles of a team.

        Raises:
            ConfigError: for a range that its section must not have.
        """
        ranges = self.config.teams[fleet.name].vary
        self._draws[fleet.name] = draws = NumberDraws(fleet, ranges, self.config.variation, self.seed)
        self.names[fleet.name] = (*draws.names, *TOLD)
        self.truth[fleet.name] = fleet.state.new_zeros((*fleet.state.shape[:2], len(self.names[fleet.name])))

    def begin(self, envs: Tensor, seas: Tensor, current: Current, wind: Wind) -> None:
        """Assign environments `envs` [n], on realisations `seas` [n], their conditions, and vehicles their numbers.

        `current` and `wind` get their means; their slow variations are still to be drawn about these.
        """
        self.set_conditions(envs, seas, current, wind)
        for name, draws in self._draws.items():
            draws.draw(envs)
            self.truth[name][envs, :, : len(draws.names)] = draws.told[envs]

    def set_conditions(self, envs: Tensor, seas: Tensor, current: Current, wind: Wind) -> None:
        """Assign conditions only, not numbers of vehicles."""
        if self._keys & {"sea.current.speed", "sea.current.direction_deg"}:
            current.set_mean(envs, self._tables.current[seas])
        if self._keys & {"air.speed", "air.direction_deg"}:
            wind.set_mean(envs, self._tables.wind[seas])
        if self.turbulence is not None:
            self.turbulence[envs] = self._tables.turbulence[seas]
        for truth in self.truth.values():
            truth[envs, :, -len(TOLD) :] = self._tables.told[seas].unsqueeze(1)

    def reseed(self, seed: int) -> None:
        """Make numbers of vehicles that are drawn later depend on `seed` alone; conditions stay."""
        for draws in self._draws.values():
            draws.reseed(seed)
