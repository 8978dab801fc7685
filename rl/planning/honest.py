"""An honest planner: it knows what the vehicles know, and plans in a world built from that.

The model (`Mission.imagined`) has nominal craft, the mean wind and current, calm water, exact sensors, and only what
has been sensed: `Mission.believe` writes into it what the vehicles of a team measure now. What a plan commands is flown
by the controller on measured states. A user could run it on a boat.
"""

from typing import Any

import torch
from torch import Tensor

from rl.mission import ControllerError
from rl.planning.planner import Planner
from taichi_sim.kernels import runtime


class HonestPlanner(Planner):
    """Plans for one team by what its vehicles know; see the module."""

    def bind(self, team: Any) -> None:
        """See `Planner.bind`."""
        if self._mission is not team.mission:
            self._believed: Any = None
        super().bind(team)

    def renew(self, team: Any) -> None:
        """See `Planner.renew`."""
        with torch.inference_mode(False), torch.no_grad(), runtime.torch_at_rest():
            self.bind(team)
            self._model(team).notice(team)
        super().renew(team)

    def _view(self, team: Any) -> Any:
        """The team as its vehicles know it."""
        return team.known

    def _fork(self, team: Any, envs: Tensor, copies: int) -> Any:
        """The model: so many copies of what the vehicles of each environment believe."""
        model = self._model(team)
        model.believe(team)
        return self._copied(model, envs, copies)

    def _model(self, team: Any) -> Any:
        """The model of all environments.

        Raises:
            ControllerError: if the mission has no way to build it.
        """
        mission = team.mission
        if self._believed is None:
            self._believed = mission.imagined(team)
            if self._believed is None:
                raise ControllerError(
                    f"{type(mission).__name__} has no way to build what {team.name} knows (Mission.imagined, "
                    "rl/mission.py): there is no honest planner for it; --controller oracle plans by the truth"
                )
            for other in self._believed.teams.values():
                _ = other.controller  # made now: its memory is state
        return self._believed


def write_obstacles_as_bodies(table: Tensor, position: Tensor, seen: Tensor) -> None:
    """Write sensed obstacles into a table of bodies [env, 8, body] (rl/course/obstacles.py), from its first column on.

    Args:
        position: [env, vehicle, 2 or more] of the vehicles that sensed them, as they know it, m, NED.
        seen: [env, vehicle, k, 9] obstacles as a `Sensor` has them (rl/perception/sensors.py).
    """
    from rl.course.obstacles import AWAY, BOTTOM, CARRIED, EAST, NORTH, RADIUS, TOP, V_EAST, V_NORTH
    from rl.perception.sensors import Obstacle

    away = seen[..., Obstacle.LEVEL, None] + seen[..., Obstacle.RADIUS, None]
    place = position[:, :, None, :2] + away * seen[..., Obstacle.NORTH : Obstacle.DOWN]
    north, east = torch.where(seen[..., Obstacle.NUMBER, None] >= 0, place, AWAY).unbind(-1)
    bodies = seen.shape[1] * seen.shape[2]
    rows = {NORTH: north, EAST: east, RADIUS: seen[..., Obstacle.RADIUS]}
    rows |= {V_NORTH: seen[..., Obstacle.V_NORTH], V_EAST: seen[..., Obstacle.V_EAST]}
    table[:, BOTTOM, :bodies], table[:, TOP, :bodies], table[:, CARRIED, :bodies] = -AWAY, AWAY, 0.0
    for row, values in rows.items():
        table[:, row, :bodies] = values.flatten(1)
