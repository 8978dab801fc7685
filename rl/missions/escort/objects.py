"""Objects that the observers of an escort can see: the vessel, other moving bodies, obstacles."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.course.traffic import EAST, NORTH, RADIUS, V_EAST, V_NORTH
from rl.missions.escort.config import EscortScenario
from rl.perception.columns import Object
from taichi_sim.fleet import Fleet

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

COPIED = (
    (Object.NORTH, NORTH), (Object.EAST, EAST), (Object.V_NORTH, V_NORTH), (Object.V_EAST, V_EAST),
    (Object.RADIUS, RADIUS),
)  # fmt: skip
"""Columns of an object, and the rows of a body that they are copied from."""


def write_objects(mission: "Escort", vessel: Fleet) -> Tensor:
    """Write the fleet `vessel` into the bodies of `mission`, and bodies and obstacles into the objects of its tracking.

    Returns the vessel's place [env, 2], NED, m.
    """
    place, velocity = vessel.position_n[:, 0, :2].clone(), vessel.velocity_n[:, 0, :2]
    table = mission.bodies.table
    table[:, : EAST + 1, 0], table[:, V_NORTH : V_EAST + 1, 0] = place, velocity
    if mission.traffic.present:
        table[..., 1:] = mission.traffic.table
    objects = mission.tracking.objects
    n = table.shape[2]
    for column, row in COPIED:
        objects[:, :n, column] = table[:, row]
    stands = mission.obstacles[mission.env_world]
    objects[:, n:, :2], objects[:, n:, Object.RADIUS] = stands[..., :2], stands[..., 2]
    if _on_waves(mission.config):
        inside = objects[..., Object.NORTH].abs() < mission.config.area  # obstacles that a world has not are far away
        objects[..., Object.DOWN] = torch.where(inside, -mission.elevation(objects[..., :2]), 0.0)
    boats = mission.boats
    if boats is not None:
        course = mission.vessel_velocity
        speed = course.norm(dim=-1)
        angle = torch.atan2(course[:, 1], course[:, 0])
        target = (place[:, 0], place[:, 1], 0 * speed, angle, angle.cos(), angle.sin(), 0 * speed, speed)
        boats.target.table[:, 0] = torch.stack(target, dim=-1)
    return place


def _on_waves(config: EscortScenario) -> bool:
    """Whether cameras see objects at the height of the waves, not of the mean sea level."""
    part = config.parts.get(config.escort.aircraft)
    return part is not None and part.camera.surface == "waves"
