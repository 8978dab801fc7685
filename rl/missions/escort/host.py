"""What the escort's teams, scouts, drawings and figures have in common: the vessel, what is around, the tracking."""

from typing import Protocol

from torch import Tensor

from rl.guidance.course.obstacles import Bodies
from rl.missions.escort.config import EscortScenario
from rl.team import Host


class EscortHost(Host, Protocol):
    """What the mission shares; tensors are live.

    Attributes:
        obstacles: [world, n, 4] as sensors take them. bodies: moving bodies, the vessel first; traffic: the others.
        env_world: int64 [env]. hs: [env] significant wave height, m. vessel_place, vessel_velocity: [env, 2] NED, m,
            m/s. arrived: bool [env], the leading boat has been at the vessel.
    """

    obstacles: Tensor
    bodies: Bodies
    traffic: Bodies
    env_world: Tensor
    hs: Tensor
    vessel_place: Tensor
    vessel_velocity: Tensor
    arrived: Tensor

    @property
    def config(self) -> EscortScenario:
        """The scenario."""
        ...

    def elevation(self, points: Tensor) -> Tensor:
        """Elevation of the sea (m, up) now at points [env, n, 2]."""
        ...

    def boats_result(self) -> Tensor:
        """How near the boats are to their slots, [env], 1 at best; 0 without boats."""
        ...
