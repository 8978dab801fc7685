"""Environments that have diverged: something in them is not finite any more, or beyond what numbers can describe.

They are put to rest at once, before anybody measures them: what is not finite becomes what environment 0 had when the
mission was made, so that all that is measured, paid and observed stays finite. The episode ends as `diverged` for all
their vehicles. What has not shown itself by the end of an episode is put to rest before the next one begins.
"""

import math
import warnings

import torch
from torch import Tensor

from taichi_sim.errors import UserError
from taichi_sim.state.memory import Remembers
from taichi_sim.state.snapshot import Entry, Stateful, restored, walk
from taichi_sim.world import World

MANY, PARTS = 128, 16
HUGE = 1e15  # beyond it a number is as good as not finite: its square would overflow soon; assumed


class NotFiniteError(UserError, FloatingPointError):
    """A mission computes numbers that are not finite, though all that it remembers is."""


class Divergence(Remembers):
    """Puts environments of one mission to rest.

    Attributes:
        envs: bool [env], those put to rest since the last step ended.
    """

    def __init__(self, mission: Stateful, world: World, steps: Tensor):
        """Keep the numbers of environment 0 of a `mission` whose first episode has begun in `world`.

        `steps` int64 [env] are the decisions since an episode began.
        """
        self._mission, self._world, self._steps = mission, world, steps
        self.envs = self.remember(torch.zeros_like(steps, dtype=torch.bool))
        self._found = walk(mission)
        self._rest = self.scratch({entry.path: entry.value[0].clone() for entry in self._numbers()})
        self._shown = [entry for entry in self._numbers() if bool(fine(self._rest[entry.path]).all())]
        self._told: set[str] = set()
        self._turn = self.scratch(0)

    def _numbers(self) -> list[Entry]:
        """What is remembered as floats of each environment."""
        return [
            entry
            for entry in self._found.entries
            if entry.of_env and isinstance(value := entry.value, Tensor) and value.is_floating_point()
            and len(value) == self._mission.num_envs and value[0].numel()
        ]  # fmt: skip

    def rest(self, envs: Tensor, cause: str) -> None:
        """Put environments `envs`, bool [env], to rest, and end their episodes; a warning tells each `cause` once."""
        mended, rows = torch.zeros_like(envs), envs.nonzero().flatten()
        mended[rows] = self._mend(rows)
        if bool((wrong := envs & ~mended & ~self.envs & (self._steps <= 1)).any()):
            raise NotFiniteError(
                f"{cause} in environments {wrong.nonzero().flatten().tolist()[:5]} as an episode begins, though the "
                f"state of all vehicles is: the fault is in what {type(self._mission).__name__} computes"
            )
        if cause not in self._told:
            self._told.add(cause)
            text = f"{cause} in environment {int(envs.nonzero()[0])}: its episode ends as diverged"
            warnings.warn(f"{text} (docs/troubleshooting.md; told once)", RuntimeWarning, stacklevel=2)
        self.envs = self.envs | envs

    def gone(self) -> dict[str, Tensor]:
        """Put environments to rest whose vehicles have diverged; flags [env, vehicle] of these vehicles, by team."""
        found = {name: fleet.diverged() for name, fleet in self._world.teams.items()}
        gone = {name: flags for name, flags in found.items() if flags is not None}
        for name, flags in gone.items():
            self._world.teams[name].state[flags] = math.nan  # the whole state is put to rest, not a part of it
            self.rest(flags.any(1), f"the state of a vehicle of {name!r} is not finite or beyond its limits")
        return gone

    def begin(self, envs: Tensor) -> None:
        """Put to rest what is not finite in environments `envs` [n] whose next episode is about to begin.

        Where there are more than `MANY` environments, some of which end in every step, each call looks at a share of
        what is remembered, in turn: all of it takes a twentieth of a step.
        """
        parts = PARTS if self._mission.num_envs > MANY else 1
        self._turn = (self._turn + 1) % parts
        rows = [entry.value.index_select(0, envs).flatten() for entry in self._shown[self._turn :: parts]]
        if not rows:
            return
        low, high = (float(end) for end in torch.cat(rows).aminmax())  # NaN if one is
        if not (low >= -HUGE and high <= HUGE):
            self._mend(envs)

    def _mend(self, envs: Tensor) -> Tensor:
        """Replace what is not finite, or huge, in environments `envs` [n]; return in which, bool [n]."""
        self._found = walk(self._mission)  # controllers and loads may have been made since
        mended = torch.zeros(len(envs), dtype=torch.bool, device=envs.device)
        for entry in self._numbers():
            value, rest = entry.value, self._rest.get(entry.path)
            rows = value.index_select(0, envs)
            if rest is None or rest.shape != rows.shape[1:]:
                rest = torch.zeros_like(rows[0])
            if not bool((kept := fine(rows)).all()):
                if 0 in value.stride():  # an expanded tensor cannot be written in part
                    entry.put(value := value.clone())
                value[envs] = torch.where(kept, rows, rest)
                mended |= ~kept.reshape(len(envs), -1).all(1)
        restored(self._found)
        for fleet in self._world.teams.values():
            fleet.update(envs)
        return mended


def fine(values: Tensor) -> Tensor:
    """Where values are finite and not `HUGE`."""
    return values.abs() <= HUGE
