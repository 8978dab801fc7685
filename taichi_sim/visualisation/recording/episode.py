"""The data of one recorded episode. Frames: n is north-east-down, b is forward-right-down.

Sizes: T control steps, V vehicles in a team (vehicle 0 leads a formation), A actions, P points of a track, M obstacles.
Data of a mission are optional; what is missing is neither drawn nor plotted.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import HEADING
from taichi_sim.visualisation.recording.east_north_up import Array, euler
from taichi_sim.visualisation.recording.overlays import Note, Overlay, Plot
from taichi_sim.visualisation.recording.palette import ALARM, GOOD, Colour, Livery, liveries

COMPANY_LENGTHS = 20.0  # vehicle lengths: without a formation, a view includes vehicles this close to the first
RESERVED = {"track", "checkpoints", "obstacles", "events", "overlay", "wind", "area"}  # no team may have these names
Medium = Literal["water", "air"]
Elevation = Callable[[Array, Array, float], Array]
"""(north, east, time_s) -> surface elevation, up, m. north and east share one shape, in m."""
Waves = Callable[[float], Array]
"""time_s -> [6, component] of the sea then, as `Sea.waves_at` has it."""


class Body(NamedTuple):
    """The closed surface of a vehicle in b; its origin is the vehicle's reference point."""

    vertices_b: Array  # [N, 3] m
    triangles: NDArray[np.integer]  # [F, 3] corners, counter-clockwise seen from outside


class Airframe(NamedTuple):
    """Details of an aircraft's shape beyond length, span and height."""

    chord: float  # mean chord of the wing, m
    tail: bool  # False: a flying wing


class Platform(NamedTuple):
    """A deck on which others land: a level rectangle in b."""

    centre_b: tuple[float, float, float]  # centre of its upper face, m
    half_m: tuple[float, float]  # half length and half width, m


class Force(NamedTuple):
    """A force on each vehicle of a team, drawn as an arrow."""

    origin_b: tuple[float, float, float]  # m, point of attack
    vector_b: Array  # [T, V, 3] N


class Signal(NamedTuple):
    """Quantities of each vehicle that share a plot; a plot shows rad in degrees."""

    names: tuple[str, ...]  # S names of lines
    unit: str  # SI; "" for a ratio
    values: Array  # [T, V, S]


@dataclass(frozen=True)
class TeamTrack:
    """One team over one episode."""

    name: str  # shown in titles
    medium: Medium  # "water": boats, "air": aircraft
    position_n: Array  # [T, V, 3] m, of the body's reference point
    quaternion_nb: Array  # [T, V, 4] (w, x, y, z), body to world
    velocity_n: Array  # [T, V, 3] m/s, over ground
    size_m: tuple[float, float, float]  # length; beam (wing span); height (hull depth, or to the fin's top), m
    wave_height: Array  # [T, V] m, surface elevation at the vehicle, up
    angular_velocity_b: Array | None = None  # [T, V, 3] rad/s, about forward, right, down; None: not recorded
    action: Array | None = None  # [T, V, A] actions taken
    action_names: tuple[str, ...] = ()  # A names
    target_n: Array | None = None  # [T, 3] m, the target that vehicle 0 follows
    target_course: Array | None = None  # [T] rad, clockwise from north
    slot_n: Array | None = None  # [T, V, 3] m, each vehicle's place in the formation; the leader's is the target
    error_m: Array | None = None  # [T, V] m, position error as the mission defines it
    reward: Array | None = None  # [T, V] per step
    measured: Array | None = None  # [T, V, M] what the mission's judge shows over time
    measured_names: tuple[str, ...] = ()  # M labels with units
    ending: NDArray[np.object_] | None = None  # [T, V] name of what ends the vehicle's episode now, or None
    scale: Array | None = None  # [V], length over `size_m`'s of vehicles that differ from it
    body: Body | None = None  # drawn surface; None: a boat or an aircraft of `size_m`
    airframe: Airframe | None = None  # for an aircraft; None: default proportions
    deck: Platform | None = None  # for a boat on which others land
    air_n: Array | None = None  # [T, V, 3] m/s, velocity of the air that an aircraft meets; None: not known
    forces: Mapping[str, Force] = field(default_factory=dict)  # by name
    signals: Mapping[str, Signal] = field(default_factory=dict)  # by the plot's name

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        if self.name in RESERVED:
            raise ValueError(f"team {self.name}: a recording has that name for something else")
        steps, vehicles = self.position_n.shape[:2]
        for name, shape in {
            "position_n": (steps, vehicles, 3),
            "quaternion_nb": (steps, vehicles, 4),
            "velocity_n": (steps, vehicles, 3),
            "wave_height": (steps, vehicles),
            "angular_velocity_b": (steps, vehicles, 3),
            "action": (steps, vehicles, len(self.action_names)),
            "target_n": (steps, 3),
            "target_course": (steps,),
            "slot_n": (steps, vehicles, 3),
            "error_m": (steps, vehicles),
            "reward": (steps, vehicles),
            "measured": (steps, vehicles, len(self.measured_names)),
            "ending": (steps, vehicles),
            "air_n": (steps, vehicles, 3),
            "scale": (vehicles,),
        }.items():
            array = getattr(self, name)
            if array is not None:
                self._check(name, array, shape)
        for name, force in self.forces.items():
            self._check(f"force {name}", force.vector_b, (steps, vehicles, 3))
        for name, signal in self.signals.items():
            self._check(f"signal {name}", signal.values, (steps, vehicles, len(signal.names)))

    def _check(self, name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
        if array.shape != shape:
            raise ValueError(f"team {self.name}: {name} is {array.shape}, wanted {shape}")

    @property
    def on_water(self) -> bool:
        """Whether the team's vehicles are boats."""
        return self.medium == "water"

    @property
    def vehicles(self) -> int:
        """Number of vehicles V, the leader included."""
        return self.position_n.shape[1]

    def vehicle_name(self, vehicle: int) -> str:
        """Name of a vehicle for readers; only a formation has a leader."""
        team = self.name.upper()
        if self.slot_n is not None:
            return f"{team} leader" if vehicle == 0 else f"{team} {vehicle}"
        return team if self.vehicles == 1 else f"{team} {vehicle}"

    def scale_of(self, vehicle: int) -> float:
        """Length of a vehicle over that of `size_m`."""
        return 1.0 if self.scale is None else float(self.scale[vehicle])

    @property
    def places_n(self) -> Array:
        """Positions [T, V, 3] of the slots, or of the vehicles if there are no slots, m."""
        return self.position_n if self.slot_n is None else self.slot_n

    @property
    def course(self) -> Array:
        """Course [T] of the team's target, or the heading of vehicle 0 if there is none, rad."""
        return euler(self.quaternion_nb[:, 0])[HEADING] if self.target_course is None else self.target_course

    @property
    def company(self) -> NDArray[np.bool_]:
        """Mask [V] of the vehicles that a view of the team includes; without a formation some may be far away."""
        apart = np.linalg.norm(self.position_n - self.position_n[:, :1], axis=-1)
        reach = COMPANY_LENGTHS * max(self.size_m[:2])
        return np.ones(self.vehicles, dtype=bool) if self.slot_n is not None else np.median(apart, axis=0) <= reach

    @property
    def formation_radius_m(self) -> float:
        """Largest distance of a slot from the target or the leader, median over time, m.

        Without a formation: largest distance of a vehicle of the company from vehicle 0.
        """
        places = self.places_n[:, self.company]
        hangs_on = (places[:, :1], self.position_n[:, :1])
        spread = [np.linalg.norm(places[:, 1:] - place, axis=-1) for place in hangs_on]
        return float(min(np.median(distance.max(axis=1, initial=0.0)) for distance in spread))


@dataclass(frozen=True)
class Event:
    """An event of one vehicle of a team."""

    time_s: float
    team: str
    vehicle: int
    kind: str  # collision, capsized, lost, stall, ...
    text: str
    goal: bool = False  # what the vehicle was to do; else something went wrong

    @property
    def colour(self) -> Colour:
        """Colour of its marks."""
        return GOOD if self.goal else ALARM


@dataclass(frozen=True)
class Scene:
    """The static objects of an episode."""

    area_m: float | None = None  # side of the square, centred at the origin, m; None: the open sea
    tracks_n: Mapping[str, Array] = field(default_factory=dict)  # team -> [P, 3] m, the path its target follows
    checkpoints_n: Array = field(default_factory=lambda: np.zeros((0, 2)))  # [C, 2] north, east, m
    obstacles: Array = field(default_factory=lambda: np.zeros((0, 4)))  # [M, 4] north, east, radius, height (up), m
    overview: tuple[str, float] | None = None  # team and radius (m) around it that the overview shows


@dataclass(frozen=True)
class Episode:
    """One episode of all teams on one clock."""

    name: str
    time_s: Array  # [T] s, rising
    teams: dict[str, TeamTrack]
    elevation: Elevation
    scene: Scene = field(default_factory=Scene)
    config_text: str = ""  # shown as Markdown
    events: tuple[Event, ...] = ()
    overlays: tuple[Overlay, ...] = ()  # drawn and plotted by the mission, besides the vehicles
    current_n: Array | None = None  # [T, 2] north and east velocity of the water, m/s; None: still
    wind_n: Array | None = None  # [T, 3] velocity of the air 10 m above the sea, m/s; None: calm
    waves: Waves | None = None  # components of `elevation`; None: unknown, or no waves
    like: "Episode | None" = None  # for a part of an episode: the episode that sets scales and layout
    ghost: "Episode | None" = None  # the same episode under another controller; its vehicles are drawn pale
    conditions: Mapping[str, Any] = field(default_factory=dict)  # key -> a number, or one of each vehicle

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
        for name in self.scene.tracks_n:
            if name not in self.teams:
                raise ValueError(f"episode {self.name}: a track for {name}, and no such team")
        drawn = [overlay for overlay in self.overlays if not isinstance(overlay, Note)]
        for overlay in drawn:
            overlay.check(len(self.time_s))
        if len({(isinstance(overlay, Plot), overlay.name) for overlay in drawn}) < len(drawn):
            raise ValueError(f"episode {self.name}: two overlays of one name")
        for event in self.events:
            if event.team not in self.teams or not 0 <= event.vehicle < self.teams[event.team].vehicles:
                raise ValueError(f"event {event.kind}: no vehicle {event.vehicle} in team {event.team}")

    @property
    def whole(self) -> "Episode":
        """The episode that sets scales, grids and layout: `like` for a part, otherwise this episode."""
        return self.like or self

    @property
    def afloat(self) -> TeamTrack:
        """The team whose first vehicle the sea patch follows: the first team on water, or the first team."""
        teams = list(self.teams.values())
        return next((team for team in teams if team.on_water), teams[0])

    @property
    def liveries(self) -> dict[str, Livery]:
        """The colours of each team."""
        return liveries({name: team.medium for name, team in self.teams.items()})
