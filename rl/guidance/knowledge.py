"""Knowledge of a team, true or measured: the input of classical controllers and policies."""

from typing import Protocol

from torch import Tensor

from rl.guidance.geometry import SlotErrors, Target
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby
from taichi_sim.fleet import Fleet


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
        """Errors of the vehicles from their slots, as of the last step (geometry.py)."""
        ...

    @property
    def target(self) -> Target:
        """The target that the team tracks (geometry.py)."""
        ...

    @property
    def slot_table(self) -> Tensor:
        """[env, vehicle, 6] offsets of the slots, their rates and goals (geometry.py)."""
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
