"""What classical controllers act by: a team as a mission lets it be known."""

from typing import Any, Protocol

from rl.guidance.geometry import Geometry
from rl.guidance.targets import Target


class Knowledge(Protocol):
    """A team, as it is or as its vehicles know it; everything is [env, vehicle, ...].

    Attributes:
        fleet: the vehicles (taichi_sim/fleet.py), or what their instruments say (rl/perception/instruments.py).
        now: errors from their slots (geometry.py). target: what their leader tracks; targets: its table (targets.py).
        sensor: obstacles and team mates near them (rl/perception/sensors.py, contacts.py).
        mission: its `steps` [env], decisions since the episode began.
        axes: of their velocities, 2 of vessels or 3. radius: of a vehicle, m.
    """

    fleet: Any
    mission: Any
    now: Geometry
    target: Target
    targets: Any
    sensor: Any
    axes: int
    radius: float
