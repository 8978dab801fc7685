"""A pinhole camera in the world frame n (north-east-down), and functions that place one.

The rows of `axes` are the right, down and forward unit vectors of the picture in n. `focal` is the focal length in
heights of the picture: an object of height s at distance d is s / d * focal pictures high. A pixel's centre is at half
numbers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
DOWN_N = np.array([0.0, 0.0, 1.0])
HAZE_M = 3500.0
AWAY = 2  # column of the distance ahead in a camera's axes
LEVEL = 1e-6  # sine of the angle to the vertical below which a direction has no heading


class FilmCamera(NamedTuple):
    """Position and orientation of a pinhole camera."""

    eye_n: Array  # [3] m
    axes: Array  # [3, 3] rows right, down, forward, in n
    focal: float  # focal length, in picture heights
    haze_m: float = HAZE_M  # distance at which half of what is seen is haze

    def pixels(self, place_n: Array, size: tuple[int, int]) -> Array:
        """Column and row (px) and distance ahead (m) [..., 3] of points [..., 3] in a picture of `size` (width,
        height).

        Column and row mean nothing where the distance is not above 0.
        """
        seen = (np.asarray(place_n, dtype=np.float64) - self.eye_n) @ self.axes.T
        ahead = np.where(seen[..., AWAY:] > 0.0, seen[..., AWAY:], 1.0)
        spot = np.array(size) / 2 + self.focal * size[1] * seen[..., :AWAY] / ahead
        return np.concatenate([spot, seen[..., AWAY:]], axis=-1)


def look(eye_n: Array, forward_n: Array, focal: float) -> FilmCamera:
    """A camera at `eye_n` that looks along `forward_n`, without roll; straight down, north is up."""
    forward = np.asarray(forward_n, dtype=np.float64) / np.linalg.norm(forward_n)
    right = np.cross(DOWN_N, forward)
    length = float(np.linalg.norm(right))
    right = right / length if length > LEVEL else np.array([0.0, 1.0, 0.0])
    return FilmCamera(np.asarray(eye_n, dtype=np.float64), np.stack([right, np.cross(forward, right), forward]), focal)


def look_at(eye_n: Array, target_n: Array, focal: float) -> FilmCamera:
    """A camera at `eye_n` with `target_n` in the centre."""
    return look(eye_n, np.asarray(target_n, dtype=np.float64) - np.asarray(eye_n, dtype=np.float64), focal)


def heading(course: float, pitch: float) -> Array:
    """[3] direction in n along `course` (rad, clockwise from north), `pitch` (rad) below level."""
    return np.array([np.cos(pitch) * np.cos(course), np.cos(pitch) * np.sin(course), np.sin(pitch)])


def eye_that_holds(places_n: Array, forward_n: Array, focal: float, aspect: float, filled: float) -> Array:
    """The nearest point [3] from which a camera that looks along `forward_n` sees all of `places_n` [N, 3].

    Args:
        places_n: the points.
        forward_n: direction of view.
        focal: focal length.
        aspect: width over height of the picture.
        filled: share of its sides that the points may take.
    """
    axes = look(np.zeros(3), forward_n, focal).axes
    seen = np.asarray(places_n, dtype=np.float64) @ axes.T
    across, ahead = [], []
    for axis, half in ((0, 0.5 * aspect), (1, 0.5)):
        reach = filled * half / focal  # tangent of half the angle that the points may take
        more, less = (float(np.max(sign * seen[:, axis] - reach * seen[:, AWAY])) for sign in (1.0, -1.0))
        across.append(0.5 * (more - less))
        ahead.append(-0.5 * (more + less) / reach)
    return np.array([*across, min(ahead)]) @ axes
