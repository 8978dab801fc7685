"""Scripted scouts, which send sightings to the boats while the team of aircraft does not take part.

There are as many as the scenario has aircraft. Each is a point that flies level at cruising speed along the field of
orbit.py about the true vessel, starting above the boats. It has a gimballed camera that looks at the vessel, and a
radio. Its instruments have no errors; its camera has finite pixels, and the radio has its range, delay and loss.
"""

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.guidance.geometry import to_starboard
from rl.missions.escort.tracking import ObserverGroup, SharedTracking, SpiralSearch
from rl.perception.instruments import InstrumentsConfig
from rl.perception.sightings import Camera
from taichi_sim.conventions import DOWN, QUATERNION, STATE_SIZE
from taichi_sim.fleet import Views
from taichi_sim.kernels.rotation import DERIVED_SIZE, HEADING_COS, HEADING_SIN, ROTATION, VELOCITY_N

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

SPEED = 25.0  # m/s; assumed


def scout_observers(mission: "Escort", name: str, first: int) -> ObserverGroup:
    """Scouts in the place of the aircraft of team `name` as observers, numbered from `first` on."""
    section, like = mission.config.parts[name], mission.hs
    rows = mission.num_envs, section.count
    views = Views(
        None,  # pyright: ignore[reportArgumentType] (there is no model: nothing is simulated)
        like.new_zeros((*rows, STATE_SIZE)), like.new_zeros((*rows, DERIVED_SIZE)), like.new_zeros((*rows, 1)),
    )  # fmt: skip
    views.state[..., QUATERNION.start] = 1.0
    return ObserverGroup(first, views, views, SpiralSearch(section.orbit.radius, SPEED, section.orbit.radius))


class Scouts:
    """Scripted aircraft in the place of a team of them."""

    STATE = ("views", "camera")

    def __init__(self, mission: "Escort", name: str, tracking: SharedTracking):
        """Make as many as team `name` has vehicles, which are among the observers of `tracking`."""
        section, like = mission.config.parts[name], mission.hs
        self.mission, self.name, self.section, self.orbit = mission, name, section, section.orbit
        group = tracking.groups[name]
        self.views = group.own
        camera = section.camera.model_copy(update={"mount": "gimbal"})
        self.camera = Camera(
            camera, InstrumentsConfig(), tracking.sightings, tracking.objects, mission.hs, self.views, self.views,
            first=group.first, vehicles=mission.config.first_number(name),
        )  # fmt: skip
        steps = torch.arange(section.count, device=like.device, dtype=like.dtype)
        self._height = self.orbit.height + self.orbit.height_step * steps

    def begin(self, envs: Tensor, place: Tensor) -> None:
        """Begin episodes in environments `envs` [n], with scouts near `place` [n, 2] (m)."""
        state = self.views.state
        turn = 2 * math.pi / self.section.count * torch.arange(self.section.count, device=state.device)
        about = 20.0 * torch.stack((turn.cos(), turn.sin()), dim=-1)
        row = state[envs]
        row[..., :2] = place.unsqueeze(1).to(row) + about.to(row)
        row[..., DOWN] = -self._height
        state[envs] = row

    def measure(self, which: Tensor) -> None:
        """Fly on in environments [env] int32 that are 1."""
        state, derived = self.views.state, self.views.derived
        R, sigma, dt = self.orbit.radius, self.orbit.turn, self.mission.config.decision_interval
        x = state[..., :2] - self.mission.vessel_place.unsqueeze(1)
        r = x.norm(dim=-1, keepdim=True).clamp(min=1.0)
        e = x / r
        d = (-(r * r - R * R) * e + 2 * sigma * r * R * to_starboard(e)) / (r * r + R * R)
        step = (which == 1).to(d).view(-1, 1, 1)
        state[..., :2] += SPEED * dt * step * d
        c, s = d.unbind(-1)
        zero, one = torch.zeros_like(c), torch.ones_like(c)
        derived[..., ROTATION] = torch.stack((c, -s, zero, s, c, zero, zero, zero, one), dim=-1)
        derived[..., VELOCITY_N] = torch.cat((SPEED * d, torch.zeros_like(r)), dim=-1)
        derived[..., HEADING_COS], derived[..., HEADING_SIN] = c, s
        self.camera.aim(self.mission.vessel_place.unsqueeze(1).expand_as(x))

    def look(self, which: Tensor, rows: int) -> None:
        """Look at the vessel, in environments [env] int32 that are not 0, `rows` of them."""
        self.camera.see(which, rows, self.mission.noise.table)
