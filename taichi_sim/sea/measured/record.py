"""One measured sea state: energy by frequency and direction, and its statistics.

A buoy derives the first moments of the wave directions from its motion: c_n = E[exp(i n theta)]; heave, pitch and roll
give n = 1 and 2. The distribution of maximum entropy (Lygre & Krogstad 1986, J. Physical Oceanography 16, 2052) is

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

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_sim.sea.spectrum import CALM_PERIOD

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


JUMP = 1.2  # a larger ratio of successive frequency spacings is a change of band width


def band_edges(frequency: np.ndarray) -> np.ndarray:
    """Edges [f + 1] of the bands with the given middles [f], both in Hz; the outermost bands are symmetric.

    An edge lies halfway between two middles. Where the band width changes (NDBC: 0.005 to 0.01 to 0.02 Hz), it lies at
    half of each band's own width.
    """
    distance = np.diff(frequency)
    inner = (frequency[1:] + frequency[:-1]) / 2
    if distance.size > 2:
        before, here, after = distance[:-2], distance[1:-1], distance[2:]
        changes = (here > JUMP * before) & (after > JUMP * here)
        both = (frequency[1:-2] + before / 2 + frequency[2:-1] - after / 2) / 2
        inner[1:-1] = np.where(changes, both, inner[1:-1])
    first, last = frequency[0] - distance[0] / 2, frequency[-1] + distance[-1] / 2
    return np.concatenate(([max(first, frequency[0] / 2)], inner, [last]))


@dataclass(frozen=True, eq=False)
class WaveRecord:
    """A sea state, measured or modelled, at one place and time."""

    name: str  # place and time
    edges: np.ndarray  # [f + 1], edges of the bands, Hz
    density: np.ndarray  # [f], m^2/Hz, constant over a band
    spread: np.ndarray  # [f, ANGLES], 1/rad: distribution of each band over directions of travel

    @cached_property
    def energy(self) -> np.ndarray:
        """Variance of each band, [f], m^2."""
        return self.density * np.diff(self.edges)

    def moment(self, order: int) -> float:
        """m_n, the integral of f^n S(f) df, m^2 Hz^n, for n >= -1."""
        low, high = self.edges[:-1], self.edges[1:]
        part = np.log(high / low) if order == -1 else (high ** (order + 1) - low ** (order + 1)) / (order + 1)
        return float((self.density * part).sum())

    @property
    def calm(self) -> bool:
        """Whether there are no waves."""
        return not self.density.any()

    @property
    def hs(self) -> float:
        """Significant height 4 sqrt(m0), m."""
        return 4 * self.moment(0) ** 0.5

    @property
    def peak(self) -> int:
        """Index of the band with the largest density."""
        return int(self.density.argmax())

    @property
    def tp(self) -> float:
        """Peak period, s: that of the middle of the densest band."""
        return 2 / float(self.edges[self.peak] + self.edges[self.peak + 1]) if not self.calm else CALM_PERIOD

    @property
    def tm01(self) -> float:
        """Mean period m0 / m1, s."""
        return self.moment(0) / self.moment(1) if not self.calm else CALM_PERIOD

    @property
    def tm02(self) -> float:
        """Mean zero up-crossing period sqrt(m0 / m2), s (NDBC's APD)."""
        return (self.moment(0) / self.moment(2)) ** 0.5 if not self.calm else CALM_PERIOD

    @property
    def energy_period(self) -> float:
        """Energy period Tm-1,0 = m-1 / m0, s."""
        return self.moment(-1) / self.moment(0) if not self.calm else CALM_PERIOD

    @cached_property
    def c1(self) -> np.ndarray:
        """E[exp(i theta)] of each band, [f]: its modulus is r1, its angle the mean direction of travel."""
        return (self.spread * np.exp(1j * direction_grid())).mean(axis=1) * 2 * np.pi

    @property
    def c1_of_all(self) -> complex:
        """E[exp(i theta)] of all bands together, weighted by energy; 0 for a calm sea."""
        return complex((self.energy * self.c1).sum() / (self.energy.sum() or 1.0))

    @property
    def direction(self) -> float:
        """Mean direction of travel of all waves, rad clockwise from north."""
        return float(np.angle(self.c1_of_all))

    @property
    def peak_direction(self) -> float:
        """Mean direction of travel of the densest band, rad (NDBC's MWD plus pi)."""
        return float(np.angle(self.c1[self.peak]))

    @property
    def circular_deviation(self) -> float:
        """Circular standard deviation sqrt(2 (1 - r1)) of all waves, rad."""
        return (2 * (1 - abs(self.c1_of_all))) ** 0.5
