"""What one recorded episode holds. Frames: n is north-east-down, b is forward-right-down.

T control steps, V vehicles in a team (vehicle 0 leads), A actions, P points of a track, M obstacles.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Elevation = Callable[[Array, Array, float], Array]
"""(north, east, time_s) -> surface elevation, up, m. north and east share one shape, in m."""


class Body(NamedTuple):
    """The surface of a vehicle, closed, in b; its origin is the vehicle's reference point."""

    vertices_b: Array  # [N, 3] m
    triangles: NDArray[np.integer]  # [F, 3] corners, counter-clockwise seen from outside


class Airframe(NamedTuple):
    """What of an aircraft's shape its length, span and height do not tell."""

    chord: float  # of the wing, mean, m
    tail: bool  # or a flying wing


class Force(NamedTuple):
    """A force on each vehicle of a team, drawn as an arrow."""

    origin_b: tuple[float, float, float]  # m, where it attacks
    vector_b: Array  # [T, V, 3] N


class Signal(NamedTuple):
    """Numbers of each vehicle that share a plot. A plot shows rad in degrees."""

    names: tuple[str, ...]  # S lines
    unit: str  # SI; "" for a ratio
    values: Array  # [T, V, S]


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
    size_m: tuple[float, float, float]  # length; beam (wing span); height (hull depth, or to the fin's top), m
    wave_height: Array  # [T, V] m, surface elevation at the vehicle, up
    body: Body | None = None  # what is drawn; None: a boat or an aircraft of `size_m`
    airframe: Airframe | None = None  # of that aircraft; None: of ordinary proportions
    air_n: Array | None = None  # [T, V, 3] m/s, velocity of the air that an aircraft meets; None: not known
    forces: Mapping[str, Force] = field(default_factory=dict)  # by name
    signals: Mapping[str, Signal] = field(default_factory=dict)  # by the plot's name

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
            self._check(name, getattr(self, name), shape)
        if self.air_n is not None:
            self._check("air_n", self.air_n, (steps, vehicles, 3))
        for name, force in self.forces.items():
            self._check(f"force {name}", force.vector_b, (steps, vehicles, 3))
        for name, signal in self.signals.items():
            self._check(f"signal {name}", signal.values, (steps, vehicles, len(signal.names)))

    def _check(self, name: str, array: Array, shape: tuple[int, ...]) -> None:
        if array.shape != shape:
            raise ValueError(f"team {self.name}: {name} is {array.shape}, wanted {shape}")

    @property
    def vehicles(self) -> int:
        """V, the leader included."""
        return self.position_n.shape[1]

    @property
    def formation_radius_m(self) -> float:
        """Greatest distance of a slot from what it hangs on, the target or the leader; median over time, m."""
        hangs_on = (self.slot_n[:, :1], self.position_n[:, :1])
        spread = [np.linalg.norm(self.slot_n[:, 1:] - place, axis=-1) for place in hangs_on]
        return float(min(np.median(distance.max(axis=1, initial=0.0)) for distance in spread))


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
    current_n: Array | None = None  # [T, 2] north and east velocity of the water, m/s; None: still
    wind_n: Array | None = None  # [T, 3] velocity of the air 10 m above the sea (where it blows to), m/s; None: calm

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        if not self.teams:
            raise ValueError(f"episode {self.name}: no team")
        for key, team in self.teams.items():
            if key != team.name:
                raise ValueError(f"episode {self.name}: team {team.name} is filed under {key}")
            if len(team.position_n) != len(self.time_s):
                raise ValueError(f"team {key}: {len(team.position_n)} steps, the clock has {len(self.time_s)}")
        for name, flow, axes in (("current_n", self.current_n, 2), ("wind_n", self.wind_n, 3)):
            if flow is not None and flow.shape != (len(self.time_s), axes):
                raise ValueError(f"{name} is {flow.shape}, wanted {(len(self.time_s), axes)}")
        for event in self.events:
            if event.team not in self.teams or not 0 <= event.vehicle < self.teams[event.team].vehicles:
                raise ValueError(f"event {event.kind}: no vehicle {event.vehicle} in team {event.team}")

    @property
    def afloat(self) -> TeamTrack:
        """The team whose leader the sea patch follows: the USVs, or whoever is there."""
        return self.teams.get("usv", next(iter(self.teams.values())))
