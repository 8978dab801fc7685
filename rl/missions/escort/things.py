"""The objects that an escort's observers can see: the vessel, moving and fixed obstacles."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.course.traffic import EAST, NORTH, RADIUS, V_EAST, V_NORTH
from rl.missions.escort.config import EscortScenario
from taichi_sim.fleet import Fleet

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort


def write_things(mission: "Escort", vessel: Fleet) -> Tensor:
    """Write vessel, moving and fixed obstacles into the picture's things, and the vessel into the mission's bodies.

    Returns the vessel's position [env, 2], NED, m.
    """
    place, velocity = vessel.position_n[:, 0, :2].clone(), vessel.velocity_n[:, 0, :2]
    table = mission.bodies.table
    table[:, : EAST + 1, 0], table[:, V_NORTH : V_EAST + 1, 0] = place, velocity
    if mission.traffic.present:
        table[..., 1:] = mission.traffic.table
    things = mission.picture.things
    n = table.shape[2]
    things[:, :n, 0], things[:, :n, 1] = table[:, NORTH], table[:, EAST]
    things[:, :n, 3], things[:, :n, 4], things[:, :n, 5] = table[:, V_NORTH], table[:, V_EAST], table[:, RADIUS]
    stands = mission.obstacles[mission.env_world]
    things[:, n:, :2], things[:, n:, 5] = stands[..., :2], stands[..., 2]
    if _on_waves(mission.config):
        inside = things[..., 0].abs() < mission.config.area  # absent obstacles are far away
        things[..., 2] = torch.where(inside, -mission.elevation(things[..., :2]), 0.0)
    boats = mission.boats
    if boats is not None:
        course = mission.vessel_velocity
        speed = course.norm(dim=-1)
        angle = torch.atan2(course[:, 1], course[:, 0])
        target = (place[:, 0], place[:, 1], 0 * speed, angle, angle.cos(), angle.sin(), 0 * speed, speed)
        boats.targets.table[:, 0] = torch.stack(target, dim=-1)
    return place


def _on_waves(config: EscortScenario) -> bool:
    """Whether cameras see objects at the height of the waves instead of mean sea level."""
    part = config.parts.get(config.escort.aircraft)
    return part is not None and part.camera.surface == "waves"
