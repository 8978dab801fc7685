"""A distribution of wave directions from its first moments, as a buoy's motion gives them.

With c_n = E[exp(i n theta)], of which heave, pitch and roll know n = 1 and 2, the distribution of largest entropy
(Lygre & Krogstad 1986, J. Physical Oceanography 16, 2052) is

    D(theta) = (1 - phi1 c1* - phi2 c2*) / (2 pi |1 - phi1 exp(-i theta) - phi2 exp(-2 i theta)|^2),
    phi1 = (c1 - c2 c1*) / (1 - |c1|^2),   phi2 = c2 - c1 phi1.

It is positive and has exactly these moments: r1, alpha1, r2 and alpha2 as measured, so mean direction and spread are
what the buoy says, and a sea that crosses another is told from a broad one. cos^2s through r1 knows neither r2 nor
alpha2 and has one peak always. The price: where the moments allow it, maximum entropy likes two near peaks to one that
is blunt (Benoit 1992).

Moments are those of some distribution only if |c1| <= 1 and |c2 - c1^2| <= 1 - |c1|^2; on that limit it is two spikes.
Noise and rounding go beyond: c2 is moved towards c1^2 (the phase of the difference kept) until it is inside by ROOM.
"""

import numpy as np

ROOM = 0.95  # of the limits of the moments, at most: beyond, peaks are narrower than a buoy could see
ANGLES = 1440  # of a table of directions, 0.25 degrees each


def direction_grid() -> np.ndarray:
    """Middles of the cells of a table of directions [ANGLES], rad, from -pi to pi."""
    return (np.arange(ANGLES) + 0.5) * (2 * np.pi / ANGLES) - np.pi


def possible(c1: np.ndarray, c2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The moments nearest in direction to c1, c2 [..] that a distribution can have, with some room."""
    c1 = c1 / np.maximum(np.abs(c1) / ROOM, 1.0)
    limit = ROOM * (1 - np.abs(c1) ** 2)
    beyond = c2 - c1**2
    return c1, c1**2 + beyond / np.maximum(np.abs(beyond) / limit, 1.0)


def maximum_entropy(c1: np.ndarray, c2: np.ndarray) -> np.ndarray:
    """Density by direction [f, ANGLES] (1/rad, on `direction_grid`) of the complex moments c1, c2 [f]."""
    c1, c2 = possible(np.asarray(c1, dtype=complex), np.asarray(c2, dtype=complex))
    phi1 = (c1 - c2 * c1.conj()) / (1 - np.abs(c1) ** 2)
    phi2 = c2 - c1 * phi1
    around = np.exp(-1j * direction_grid())
    power = np.abs(1 - phi1[:, None] * around - phi2[:, None] * around**2) ** 2
    return normalised(1 / power)


def narrowed(c1: np.ndarray) -> np.ndarray:
    """c2 of the cos^2s distribution with the mean direction and r1 of c1 [..], s = r1 / (1 - r1)."""
    r1 = np.minimum(np.abs(c1), ROOM)
    s = r1 / (1 - r1)
    return s * (s - 1) / ((s + 1) * (s + 2)) * np.exp(2j * np.angle(c1))


def normalised(density: np.ndarray) -> np.ndarray:
    """A table of directions [f, ANGLES] with an integral of 1 each."""
    return density / (density.sum(axis=1, keepdims=True) * (2 * np.pi / ANGLES))
