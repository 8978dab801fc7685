"""Overlays of a mission, drawn and plotted beside the vehicles: lanes, contacts, safety domains, risks.

Every geometric overlay holds arrays [F, N, ...] of N items in F frames. F is T, one frame for each step of the episode,
or 1 for what does not move. An item with NaN is not drawn in that frame, so N is the largest number of items. Positions
are m in the world frame n (north, east, down); only draw_overlays.py converts them.

An overlay's name is its place in the viewer's tree, for instance "contacts/range": under `world/overlay` in 3D,
`map/overlay` on the map, `plots/overlay` in the plots. Items of one kind and one look belong into one overlay; names
must be unique.

The radius of lines, points and arrows is in m if positive, and in points of the screen, whatever the distance, if
negative.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from taichi_sim.visualisation.recording.east_north_up import Array
from taichi_sim.visualisation.recording.palette import Colour

Where = Literal["world", "map", "both"]


@dataclass(frozen=True, kw_only=True)
class Overlay3D:
    """Attributes common to all overlays in space."""

    name: str
    colour: Colour
    labels: tuple[str, ...] = ()  # N constant labels, or none
    where: Where = "both"
    on_water: bool = False  # in 3D, `down` counts from just above the waves instead of from mean sea level

    shapes: ClassVar[Mapping[str, tuple[int | None, ...]]] = {}
    """Name of each array -> its shape after [F, N]; None stands for any size."""

    def check(self, steps: int) -> None:
        """Refuse arrays that do not fit an episode of `steps` steps, or whose N differ."""
        count: int | None = len(self.labels) or None
        for key, shape in self.shapes.items():
            array: Array = getattr(self, key)
            fits = array.ndim == 2 + len(shape) and len(array) in (1, steps) and count in (None, array.shape[1])
            if not fits or any(size not in (None, n) for size, n in zip(shape, array.shape[2:], strict=True)):
                raise ValueError(
                    f"overlay {self.name}: {key} is {array.shape}, wanted (1 or {steps}, {count or 'N'}, "
                    f"{', '.join('any' if size is None else str(size) for size in shape)})"
                )
            count = array.shape[1]


@dataclass(frozen=True, kw_only=True)
class Lines(Overlay3D):
    """N line strips of P points each; points with NaN are left out."""

    points_n: Array  # [F, N, P, 3] m
    radius: float = -1.2

    shapes = {"points_n": (None, 3)}


@dataclass(frozen=True, kw_only=True)
class Points(Overlay3D):
    """N points."""

    position_n: Array  # [F, N, 3] m
    radius: float = -4.0

    shapes = {"position_n": (3,)}


@dataclass(frozen=True, kw_only=True)
class Cylinders(Overlay3D):
    """N upright cylinders."""

    position_n: Array  # [F, N, 3] m, the middle
    size_m: Array  # [F, N, 2] radius and height, m

    shapes = {"position_n": (3,), "size_m": (2,)}


@dataclass(frozen=True, kw_only=True)
class Ellipsoids(Overlay3D):
    """N upright ellipsoids, such as a ship's domain or an uncertainty: wireframes in 3D, ellipses on the map."""

    position_n: Array  # [F, N, 3] m, the middle
    half_axes_m: Array  # [F, N, 3] m: along the heading, to its right, vertical
    heading: Array  # [F, N] rad, clockwise from north

    shapes = {"position_n": (3,), "half_axes_m": (3,), "heading": ()}


@dataclass(frozen=True, kw_only=True)
class Arrows(Overlay3D):
    """N arrows, such as velocities or forces; the mission scales them to a visible length and names the scale."""

    origin_n: Array  # [F, N, 3] m
    vector_n: Array  # [F, N, 3] m, as drawn
    radius: float = -1.5

    shapes = {"origin_n": (3,), "vector_n": (3,)}


@dataclass(frozen=True, kw_only=True)
class Plot:
    """K lines over the episode, in a plot of their own."""

    name: str
    unit: str  # SI; "" for a ratio; rad is shown in degrees
    lines: tuple[str, ...]  # K names
    values: Array  # [T, K]
    colours: tuple[Colour, ...] = ()  # K, or none

    def check(self, steps: int) -> None:
        """Refuse arrays that do not fit an episode of `steps` steps."""
        wanted = (steps, len(self.lines))
        if self.values.shape != wanted or len(self.colours) not in (0, len(self.lines)):
            raise ValueError(
                f"overlay {self.name}: values is {self.values.shape}, wanted {wanted}, and {len(self.colours)} colours"
            )


@dataclass(frozen=True, kw_only=True)
class Note:
    """A line in the log of events that belongs to no vehicle."""

    time_s: float
    text: str
    level: Literal["INFO", "WARN", "ERROR"] = "INFO"


Overlay = Lines | Points | Cylinders | Ellipsoids | Arrows | Plot | Note


def entity_name(overlay: Overlay3D | Plot) -> str:
    """An overlay's place in the viewer's tree, under `world`, `map` or `plots`."""
    return f"overlay/{overlay.name.replace(' ', '_')}"
