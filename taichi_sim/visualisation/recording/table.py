"""The motion of vehicles as columns of a table, as `taichi-sim export` and `evaluate --export` write it.

A recording holds the columns of each vehicle beside its pose, and the episode's conditions as JSON.
"""

import re

import numpy as np
from numpy.typing import NDArray

from taichi_sim.visualisation.recording.east_north_up import euler, into_body
from taichi_sim.visualisation.recording.episode import TeamTrack

TABLE, CONDITIONS = "table", "conditions"  # names in a recording: of the columns, and of what holds the conditions
MOTION = ("north (m)", "east (m)", "down (m)", "roll (rad)", "pitch (rad)", "heading (rad)", "surge (m/s)",
          "sway (m/s)", "heave (m/s)", "roll rate (rad/s)", "pitch rate (rad/s)", "yaw rate (rad/s)")  # fmt: skip
REWARD, ENDING = "reward", "ending"


def column(label: str) -> str:
    """The name of a column: `yaw_rate_rad_s` of the label `yaw rate (rad/s)`."""
    return re.sub(r"\W+", "_", label).strip("_")


def numbers_of(team: TeamTrack) -> dict[str, NDArray[np.float32]]:
    """Numbers [T, V] of a team by column; what is not recorded is missing."""
    velocity_b = into_body(np.roll(team.quaternion_nb, -1, -1), team.velocity_n)
    parts = [team.position_n, np.stack(euler(team.quaternion_nb), -1), velocity_b]
    parts += [] if team.angular_velocity_b is None else [team.angular_velocity_b]
    labels, values = list(MOTION), np.concatenate(parts, -1)
    found = dict(zip(labels[: values.shape[-1]], np.moveaxis(values, -1, 0), strict=True))
    for before, names, of in (("action ", team.action_names, team.action), ("", team.measured_names, team.measured)):
        found |= {} if of is None else {before + name: of[..., k] for k, name in enumerate(names)}
    found |= {} if team.reward is None else {REWARD: team.reward}
    return {column(label): np.ascontiguousarray(of, np.float32) for label, of in found.items()}
