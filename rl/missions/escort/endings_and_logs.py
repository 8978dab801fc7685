"""Endings and logs that boats and aircraft of the escort have in common."""

from torch import Tensor

from rl.missions.escort.config import EscortScenario
from rl.missions.escort.tracking import SharedTracking
from rl.perception.sensors import Sensor
from rl.perception.sightings import Sighting
from rl.step import Endings
from taichi_sim.fleet import Fleet

LOGGED = ("error_m", "arrived", "seen", "collisions_per_hour")


def margins_of(fleet: Fleet, sensor: Sensor, config: EscortScenario) -> dict[str, Tensor]:
    """To contact with an obstacle, the vessel or a team mate, and to the edge of the area, m, [env, vehicle] each."""
    place = fleet.position_n[..., :2]
    return {"collided": sensor.gap, "left": config.area / 2 - place.abs().amax(-1)}


def log_of(
    distance: Tensor, tracking: SharedTracking, ended: Endings, arrived: Tensor, config: EscortScenario
) -> dict[str, Tensor]:
    """Errors now, shares of episodes that have `arrived` (bool [env]) and whose vessel somebody saw, collisions.

    distance: m [env, vehicle], from where each vehicle should be.
    """
    hours = distance.numel() * config.decision_interval / 3600
    sees = tracking.sightings[..., 0, Sighting.VARIANCE] > 0
    return {
        "error_m": distance.mean(),
        "arrived": arrived.float().mean(),
        "seen": sees.any(-1).float().mean(),
        "collisions_per_hour": ended["collided"].sum() / hours,
    }
