"""Station keeping: a boat keeps place and heading in waves, wind and current, then goes alongside a quay.

An episode begins near the place, at the origin. After `station.hold` the place moves to the berth, without a jump in
speed: with tau the time since then over T = pi / 2 distance / speed, the way is (1 - cos(pi tau)) / 2 of the whole, and
the heading turns likewise. The quay is a straight line, whose side the boat lies along in the end, either way round. It
shelters from nothing, and a hull that touches it has collided.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from rl.guidance.targets_and_errors import wrap
from rl.mission import Frame, Mission
from rl.missions.station.config import StationScenario
from rl.missions.station.judge import StationJudge
from rl.missions.station.team import Boat, Slot
from taichi_sim.visualisation.recording.episode import Scene
from taichi_sim.visualisation.recording.overlays import Lines

SEEN_FROM_AFAR = 25.0  # m about the boat, in recordings
QUAY = 30.0  # m of it that recordings show, either way


class Station(Mission[StationScenario, Boat]):
    """One boat, its place, and a quay; see the module.

    Attributes:
        slot: where the boat is to be now. quay: [env, 1, 2] its bearing from the origin (rad), and its distance (m).
        begun, way: [env, 1, 3] the place as the episode begins, and from there to the berth; north, east, heading.
    """

    Config, Team, Judge = StationScenario, Boat, StationJudge

    def make_teams(self, names: Sequence[str]) -> dict[str, Boat]:
        """Make room for places, then the boat."""
        room = self.world.teams[names[0]].state.new_zeros((self.num_envs, 1, 3))
        self.begun, self.way = (self.remember(room.clone()) for _ in range(2))
        self.quay = self.remember(room[..., :2].clone())
        return super().make_teams(names)

    @property
    def slot(self) -> Slot:
        """Where the boat is to be."""
        s = self.config.station
        whole = math.pi / 2 * self.way[..., :2].norm(dim=-1, keepdim=True).clamp(min=1e-3) / s.speed  # s
        passed = self.steps.view(-1, 1, 1) * self.config.decision_interval - s.hold
        angle, moves = math.pi * (passed / whole).clamp(0.0, 1.0), (passed > 0) & (passed < whole)
        once, pace = torch.where(moves, 0.5, 0.0), math.pi / whole
        place = self.begun + 0.5 * (1 - angle.cos()) * self.way
        return Slot(place, once * pace * angle.sin() * self.way, once * pace.square() * angle.cos() * self.way)

    def begin(self, envs: Tensor) -> None:
        """Draw heading, quay and start."""
        s, n = self.config.station, len(envs)
        heading, bearing, away, side, off, toward, turned = torch.rand((7, n), generator=self.generator).to(self.way)
        heading, bearing = 2 * math.pi * heading, 2 * math.pi * bearing
        distance = s.distance[0] + (s.distance[1] - s.distance[0]) * away
        along = bearing + torch.where(side < 0.5, 0.5, -0.5) * math.pi
        name, team = next(iter(self.teams.items()))
        none = torch.zeros_like(heading)
        self.begun[envs, 0] = torch.stack((none, none, heading), dim=-1)
        self.way[envs, 0] = torch.stack(
            (distance * bearing.cos(), distance * bearing.sin(), wrap(along - heading)), dim=-1
        )
        self.quay[envs, 0] = torch.stack((bearing, distance + team.fleet.model.size[1] / 2 + s.clear), dim=-1)
        off, toward = s.start * off.sqrt(), 2 * math.pi * toward
        start = torch.stack((off * toward.cos(), off * toward.sin()), dim=-1).unsqueeze(1)
        heading = heading + math.radians(s.start_deg) * (2 * turned - 1)
        self.place(name, envs, start, heading.unsqueeze(1))

    def frame(self, env: int) -> Frame:
        """The place, and the quay."""
        place = self.slot.place[env].clone()
        place[:, 2] = 0.0
        ((bearing, away),) = self.quay[env].tolist()
        c, s = math.cos(bearing), math.sin(bearing)
        ends = [[[[away * c - t * s, away * s + t * c, -1.0] for t in (-QUAY, QUAY)]]]
        quay = Lines(name="quay", colour=(160, 150, 140), points_n=torch.tensor(ends).numpy(), radius=-3.0)
        rows = {name: {"slot_n": place, "error_m": team.distance[env]} for name, team in self.teams.items()}
        return Frame(rows, (quay,))

    def scene(self, env: int) -> Scene:
        """The surroundings of the boat."""
        return Scene(overview=(next(iter(self.teams)), SEEN_FROM_AFAR))


MISSION = Station
