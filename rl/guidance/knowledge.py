"""Knowledge of a team, true or measured: the input of classical controllers and policies."""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import taichi as ti
from torch import Tensor

from rl.guidance.targets_and_errors import SlotErrors, Target
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of
from taichi_sim.kernels.runtime import array1, array3, array4

KnownPack = ti.types.argpack(
    state=array3, derived=array3, table=array3, target=array3, obstacles=array4, mates=array4, numbers=array1
)
"""Tensors of a `Knowledge`, and the numbers of a `TeamKernel`."""


class Knowledge(Protocol):
    """Knowledge of the vehicles of one team; every tensor is [env, vehicle, ...].

    A team is its own ground truth (`Team` with these attributes). Where a scenario has sensors or radio, `Team.known`
    is another object, which holds what the vehicles measure and hear.
    """

    @property
    def fleet(self) -> Fleet | Readings:
        """State of the vehicles: the truth, or what their instruments measure (rl/perception/instruments.py)."""
        ...

    @property
    def now(self) -> SlotErrors:
        """Errors of the vehicles from their slots, as of the last step (targets_and_errors.py)."""
        ...

    @property
    def target(self) -> Target:
        """The target that the team tracks (targets_and_errors.py)."""
        ...

    @property
    def slot_table(self) -> Tensor:
        """[env, vehicle, 6] offsets of the slots, their rates and goals (targets_and_errors.py)."""
        ...

    @property
    def sensor(self) -> Nearby:
        """Obstacles and team mates near each vehicle (rl/perception/sensors.py)."""
        ...

    @property
    def radio(self) -> Radio | None:
        """The radio by which followers know their leader; None: they know it exactly."""
        ...

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        ...

    @property
    def axes(self) -> int:
        """Components of a velocity command: 2 of vessels (level), 3 of aircraft."""
        ...

    @property
    def radius(self) -> float:
        """Collision radius of a vehicle, m."""
        ...


class KnownForm(NamedTuple):
    """Compile-time parameters of a `TeamKernel`."""

    axes: int  # of velocities
    obstacles: int  # sensed by each vehicle
    mates: int
    stops: bool  # the vehicle can stop
    about: bool  # slots are offsets from the target, not from the leader


class TeamKernel:
    """A kernel that decides for each vehicle of a team by what the team knows.

    Its arguments are the tensor that it writes [env, vehicle, n], tensors that each call gives, a `KnownPack`, the
    struct of its numbers (`values_at`), and a `KnownForm`.
    """

    def __init__(self, kernel: Callable[..., object], numbers: Mapping[str, float], few: int = runtime.SMALL):
        """Take a kernel; "radius", that of a vehicle (m), joins its `numbers`. `few`: see `runtime.Launcher`."""
        self._launch, self._numbers = runtime.Launcher(kernel, plain=True, few=few), numbers
        self._team: Knowledge | None = None

    def __call__(self, team: Knowledge, out: Tensor | int, *given: Tensor) -> Tensor:
        """What the kernel writes for `team`: into `out`, or into a fresh tensor of that many columns."""
        fleet, sensor = team.fleet, team.sensor
        if self._team is not team:
            self._team, limits = team, fleet.model.limits
            self._known = runtime.Packed(
                KnownPack, state=fleet.state, derived=fleet.derived, table=team.now.table, target=team.target.table,
                obstacles=sensor.obstacles, mates=sensor.team_mates,
                numbers=fleet.state.new_tensor([*self._numbers.values(), team.radius]),
            )  # fmt: skip
            self._form = KnownForm(team.axes, sensor.num_obstacles, sensor.num_mates, limits.stops, team.now.about)
        if isinstance(out, int):
            out = fleet.state.new_empty((fleet.num_envs, fleet.count, out))
        kind = struct_of((*self._numbers, "radius"), runtime.current().precision)
        self._launch.once(out, *(x.contiguous() for x in given), self._known(), kind, self._form)
        return out
