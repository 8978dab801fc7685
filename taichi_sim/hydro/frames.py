"""From the boundary-element frame (x forward, y to port, z up) to the vehicle's (forward-right-down), and back.

The two differ by half a turn about x, so modes 2, 3, 5 and 6 (sway, heave, pitch, yaw) and the heading change sign.
"""

import numpy as np

TURN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # of a load or motion
TURN_HORIZONTAL = np.array([1.0, -1.0, -1.0])  # of surge, sway and yaw


def turned_matrix(matrix):
    """A, B or C [..., 6, 6] in the other frame."""
    return matrix * TURN[:, None] * TURN


def turned_load(load):
    """Load [..., 6] in the other frame."""
    return load * TURN


def cos_sin(degrees):
    """Cosine and sine of angles (deg), exact zeros at the quadrants."""
    angle = np.deg2rad(degrees)
    return tuple(np.where(np.abs(v) < 1e-15, 0.0, v) for v in (np.cos(angle), np.sin(angle)))
