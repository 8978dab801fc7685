"""Assignment of conditions and vehicles' numbers to environments when episodes begin, and their values for critics."""

import torch
from torch import Tensor

from taichi_sim.air import Wind
from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.randomisation.conditions import TRUTH, Conditions, varied
from taichi_sim.randomisation.numbers import NumberDraws
from taichi_sim.sea.current import Current


class Variation:
    """Conditions of the realisations (conditions.py) and numbers of the vehicles (numbers.py) of every environment.

    Attributes:
        turbulence: factor of the turbulence intensity, [env]; None if it does not vary.
        truth: team -> [env, vehicle, n], in run precision, of order one: numbers, then conditions, as drawn for the
            episode. The columns are the same for any `variation`. Written in place.
        names: team -> names of these columns.
    """

    STATE = ("turbulence", "truth", "_draws")

    def __init__(self, config: WorldConfig, conditions: Conditions, num_envs: int, seed: int):
        """Take the configuration and seed of a world; call `add` for each of its teams."""
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
        """Include the vehicles of a team.

        Raises:
            ConfigError: for a range that its section must not have.
        """
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
