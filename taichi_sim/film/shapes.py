"""Primitives of a picture: painted triangles and straight pieces of lines; positions in n (north-east-down), m."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Solids(NamedTuple):
    """Painted triangles, one colour and one normal each."""

    corners_n: NDArray[np.floating]  # [F, 3, 3] m
    normals_n: NDArray[np.floating]  # [F, 3] unit, outward; zero: emits light, visible from both sides
    colours: NDArray[np.uint8]  # [F, 3]


class Strokes(NamedTuple):
    """Straight pieces of lines; one of length zero is a square dot."""

    ends_n: NDArray[np.floating]  # [S, 2, 3] m
    colours: NDArray[np.uint8]  # [S, 3]
    width_px: NDArray[np.floating]  # [S]
    lift_m: NDArray[np.floating]  # [S] waves up to this height do not hide what lies on the mean level of the sea


NO_SOLIDS = Solids(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
NO_STROKES = Strokes(np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0))
