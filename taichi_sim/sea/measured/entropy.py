"""Distribution of wave directions from its first moments, which a buoy derives from its motion.

The moments are c_n = E[exp(i n theta)]; heave, pitch and roll give n = 1 and 2. The distribution of maximum entropy
(Lygre & Krogstad 1986, J. Physical Oceanography 16, 2052) is

    D(theta) = (1 - phi1 c1* - phi2 c2*) / (2 pi |1 - phi1 exp(-i theta) - phi2 exp(-2 i theta)|^2),
    phi1 = (c1 - c2 c1*) / (1 - |c1|^2),   phi2 = c2 - c1 phi1.

It is positive and has exactly the measured r1, alpha1, r2 and alpha2. Mean direction and spread are therefore those of
the buoy, and two crossing seas differ from one broad sea. (A cos^2s distribution from r1 ignores r2 and alpha2 and
always has one peak.) Its drawback: where the moments allow both, maximum entropy gives two close peaks instead of one
blunt peak (Benoit 1992).

Moments belong to a distribution only if |c1| <= 1 and |c2 - c1^2| <= 1 - |c1|^2. At this limit the distribution is two
spikes. Noise and rounding exceed the limit. c2 is then moved towards c1^2 until it is inside by the factor ROOM; the
phase of the difference is kept.
"""

import numpy as np

ROOM = 0.95  # largest fraction of the limits of the moments; above it, peaks are narrower than a buoy can resolve
ANGLES = 1440  # cells of a table of directions, 0.25 degrees each


def direction_grid() -> np.ndarray:
    """Middles of the cells of a table of directions, [ANGLES], rad, from -pi to pi."""
    return (np.arange(ANGLES) + 0.5) * (2 * np.pi / ANGLES) - np.pi


def possible(c1: np.ndarray, c2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moments c1, c2 [..] moved inside the limits of a distribution; the phase of c1 and that of c2 - c1^2 stay."""
    c1 = c1 / np.maximum(np.abs(c1) / ROOM, 1.0)
    limit = ROOM * (1 - np.abs(c1) ** 2)
    beyond = c2 - c1**2
    return c1, c1**2 + beyond / np.maximum(np.abs(beyond) / limit, 1.0)


def maximum_entropy(c1: np.ndarray, c2: np.ndarray) -> np.ndarray:
    """Directional density [f, ANGLES] (1/rad, on `direction_grid`) of the complex moments c1, c2 [f]."""
    c1, c2 = possible(np.asarray(c1, dtype=complex), np.asarray(c2, dtype=complex))
    phi1 = (c1 - c2 * c1.conj()) / (1 - np.abs(c1) ** 2)
    phi2 = c2 - c1 * phi1
    around = np.exp(-1j * direction_grid())
    power = np.abs(1 - phi1[:, None] * around - phi2[:, None] * around**2) ** 2
    return normalised(1 / power)


def narrowed(c1: np.ndarray) -> np.ndarray:
    """c2 of the cos^2s distribution that has the mean direction and r1 of c1 [..]; s = r1 / (1 - r1)."""
    r1 = np.minimum(np.abs(c1), ROOM)
    s = r1 / (1 - r1)
    return s * (s - 1) / ((s + 1) * (s + 2)) * np.exp(2j * np.angle(c1))


def normalised(density: np.ndarray) -> np.ndarray:
    """Scale each row of a table of directions [f, ANGLES] to an integral of 1."""
    return density / (density.sum(axis=1, keepdims=True) * (2 * np.pi / ANGLES))
