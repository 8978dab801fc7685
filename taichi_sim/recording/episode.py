"""What one recorded episode holds. Frames: n is north-east-down, b is forward-right-down.

T control steps, V vehicles in a team (vehicle 0 leads), A actions, P points of a track, M obstacles.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Elevation = Callable[[Array, Array, float], Array]
"""(north, east, time_s) -> surface elevation, up, m. north and east share one shape, in m."""


@dataclass(frozen=True)
class TeamTrack:
    """One team over one episode."""

    name: str  # "usv" or "uav": chooses the body that is drawn
    position_n: Array  # [T, V, 3] m, of the body's reference point
    quaternion_nb: Array  # [T, V, 4] (w, x, y, z), body to world
    velocity_n: Array  # [T, V, 3] m/s, over ground
    target_n: Array  # [T, 3] m, what the leader follows
    target_course: Array  # [T] rad, clockwise from north
    slot_n: Array  # [T, V, 3] m, each vehicle's place in the formation; the leader's is the target
    error_m: Array  # [T, V] m, distance of a vehicle from its slot, as the task defines it
    reward: Array  # [T, V] per step
    action: Array  # [T, V, A] as the policy gave it
    action_names: tuple[str, ...]  # A names
    size_m: tuple[
        float, float, float
    ]  # m: length; beam (wing span); height (hull depth, or to the fin's top)
    wave_height: Array  # [T, V] m, surface elevation at the vehicle, up

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        steps, vehicles = self.position_n.shape[:2]
        for name, shape in {
            "position_n": (steps, vehicles, 3),
            "quaternion_nb": (steps, vehicles, 4),
            "velocity_n": (steps, vehicles, 3),
            "target_n": (steps, 3),
            "target_course": (steps,),
            "slot_n": (steps, vehicles, 3),
            "error_m": (steps, vehicles),
            "reward": (steps, vehicles),
            "action": (steps, vehicles, len(self.action_names)),
            "wave_height": (steps, vehicles),
        }.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"team {self.name}: {name} is {getattr(self, name).shape}, wanted {shape}")

    @property
    def vehicles(self) -> int:
        """V, the leader included."""
        return self.position_n.shape[1]

    @property
    def formation_radius_m(self) -> float:
        """Greatest distance of a slot from the leader's slot, median over time, m."""
        spread = np.linalg.norm(self.slot_n - self.slot_n[:, :1], axis=-1)
        return float(np.median(spread.max(axis=1)))


@dataclass(frozen=True)
class Event:
    """Something that happened to one vehicle."""

    time_s: float
    team: str
    vehicle: int
    kind: str  # collision, capsized, lost, stall, ...
    text: str


@dataclass(frozen=True)
class Scene:
    """What stands still."""

    area_m: float  # side of the square, centred at the origin, m
    tracks_n: dict[str, Array]  # team -> [P, 3] m, the path its target follows
    checkpoints_n: Array  # [C, 2] north, east, m
    obstacles: Array  # [M, 4] north, east, radius, height above mean sea level, m


@dataclass(frozen=True)
class Episode:
    """One episode of every team on one clock."""

    name: str
    time_s: Array  # [T] s, rising
    teams: dict[str, TeamTrack]
    scene: Scene
    elevation: Elevation
    config_text: str  # shown as it stands, as markdown
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        if not self.teams:
            raise ValueError(f"episode {self.name}: no team")
        for key, team in self.teams.items():
            if key != team.name:
                raise ValueError(f"episode {self.name}: team {team.name} is filed under {key}")
            if len(team.position_n) != len(self.time_s):
                raise ValueError(
                    f"team {key}: {len(team.position_n)} steps, the clock has {len(self.time_s)}"
                )
        for event in self.events:
            if event.team not in self.teams or not 0 <= event.vehicle < self.teams[event.team].vehicles:
                raise ValueError(f"event {event.kind}: no vehicle {event.vehicle} in team {event.team}")

    @property
    def afloat(self) -> TeamTrack:
        """The team whose leader the sea patch follows: the USVs, or whoever is there."""
        return self.teams.get("usv", next(iter(self.teams.values())))
