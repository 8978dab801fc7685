"""Random draw of wave components from spectra (NumPy, float64, once per run).

The sea is a sum of systems (wind sea, swell), each with its own density. The band of a system is divided into geometric
bins with one component each. The component has the energy of its bin and a random frequency in it (jitter). Amplitudes
are then scaled by one factor per system so that sum a^2 / 2 = hs^2 / 16. The significant height of every realisation is
therefore exact. So is that of a sum of systems, because variances add: hs^2 = hs_1^2 + hs_2^2. A measured system
(measured/wave_record.py) has its own bins and draw, with the same result.

Random amplitudes: in a Gaussian sea, the amplitude of each component also varies, by Rayleigh's distribution (Tucker,
Challenor & Carter 1984, Applied Ocean Research 6, 118), a = sigma sqrt(-2 ln U) with sigma^2 the energy of its bin. The
height of a realisation is then random, like that of a record at sea, and exact only in the mean of the variances. With
fixed amplitudes it is exact, but a few components never add up to the highest waves of a Gaussian sea (docs/seas.md).

The sea does not repeat within an episode. N equally spaced frequencies would: they share the divisor d_omega, and the
sea repeats after 2 pi / d_omega, 33 s for 16 components at tp 5 s. Jittered frequencies have no common divisor, so the
surface is almost periodic: it comes close to an earlier one only when all phases align again. The time until then grows
exponentially with the number of components that have energy. In 256 realisations of the default sea the autocorrelation
of the elevation never exceeds 0.88 again within 600 s; with 32 components, 0.74. 8 components are too few (0.98).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from taichi_sim.surroundings.sea.measured import MeasuredSystem
from taichi_sim.surroundings.sea.spectrum import Components, spreading, wavenumber

# Sampled frequency band, in multiples of the peak frequency. It holds 98-99 % of the variance; the scaling of the
# amplitudes restores the rest. The tail above 3 wp only adds steepness, which hulls of metres do not feel.
BAND = (0.6, 3.0)
BIN_POINTS = 64  # points of the midpoint rule inside a frequency bin
ANGLE_POINTS = 4097  # points of the cumulative spreading


@dataclass(frozen=True)
class WaveSystem:
    """Waves of one origin, wind sea or swell, with a spectrum given by a formula."""

    density: Callable[[np.ndarray], np.ndarray]  # S(omega), m^2 s; only its shape matters
    hs: float  # significant wave height, m
    tp: float  # peak period, s
    direction: float  # mean direction of travel, rad clockwise from north
    spreading_s: float  # exponent s of cos^2s
    components: int  # per realisation

    @cached_property
    def bins(self) -> np.ndarray:
        """Edges of the frequency bins, [components + 1], rad/s."""
        return 2 * math.pi / self.tp * np.geomspace(*BAND, self.components + 1)

    @cached_property
    def amplitudes(self) -> np.ndarray:
        """Amplitude of the component of each bin, m, from the bin's share of the variance hs^2 / 16."""
        edges = self.bins
        inside = (np.arange(BIN_POINTS) + 0.5) / BIN_POINTS
        omega = edges[:-1, None] + inside * np.diff(edges)[:, None]
        energy = self.density(omega).mean(axis=1) * np.diff(edges)
        return self.hs * np.sqrt(energy / (8 * energy.sum()))

    @property
    def circular_deviation(self) -> float:
        """Circular standard deviation of the directions, sqrt(2 (1 - r1)) with r1 = s / (s + 1), rad."""
        return math.sqrt(2 / (self.spreading_s + 1))

    def by_direction(self, angle: np.ndarray) -> np.ndarray:
        """Share of the energy per angle (1/rad) at directions of travel (rad, clockwise from north)."""
        return spreading((angle - self.direction + math.pi) % (2 * math.pi) - math.pi, self.spreading_s)

    def draw(self, rng: np.random.Generator, seed: int, realisation: int, index: int) -> np.ndarray:
        """Draw frequency (rad/s), direction and phase (rad), [3, component], of a realisation with its own generator
        `rng`.

        Frequencies are jittered in their bins. Directions are a stratified draw from cos^2s, shuffled over the
        frequencies.
        """
        del seed, realisation, index  # only measured systems use them
        edges, n = self.bins, self.components
        omega = edges[:-1] + rng.random(n) * np.diff(edges)
        strata = (rng.permutation(n) + rng.random(n)) / n
        direction = self.direction + np.interp(strata, *_cumulative(self.spreading_s))
        return np.stack((omega, direction, rng.random(n) * 2 * math.pi))


System = WaveSystem | MeasuredSystem


def realisation_seed(seed: int, realisation: int, system: int = 0) -> np.random.Generator:
    """Random generator of one system in one realisation.

    It depends on nothing else, so more realisations keep the earlier ones. The first system (0) leaves the seed as it
    is, so a swell added to a wind sea does not change the wind sea.
    """
    entropy = [seed, realisation, system] if system else [seed, realisation]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))


def draw_components(
    systems: Sequence[Sequence[System]], *, seed: int, depth: float | None = None, random_amplitudes: bool = False
) -> Components:
    """Draw sea realisations that each have their own `systems`, all with the same number of components.

    With `random_amplitudes` (Rayleigh) a realisation does not have exactly its height; the mean variance of all is
    exact.
    """
    each = [[_draw(system, n, r, seed) for n, system in enumerate(own)] for r, own in enumerate(systems)]
    omega, direction, phase, chance = np.stack([np.concatenate(own, axis=1) for own in each], axis=1)
    amplitude = np.stack([np.concatenate([system.amplitudes for system in own]) for own in systems])
    if random_amplitudes:
        amplitude = amplitude * np.sqrt(-np.log1p(-chance))
    return Components(amplitude, wavenumber(omega, depth), omega, direction, phase)


def _draw(system: System, index: int, realisation: int, seed: int) -> np.ndarray:
    """Frequency, direction, phase, and a number in [0, 1) for a random amplitude, of each component, [4, component]."""
    rng = realisation_seed(seed, realisation, index)
    drawn = system.draw(rng, seed, realisation, index)
    return np.vstack((drawn, rng.random(system.components)))


@cache
def _cumulative(spreading_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of the energy below an angle from the mean direction, and these angles (rad)."""
    grid = np.linspace(-math.pi, math.pi, ANGLE_POINTS)
    cdf = np.concatenate(([0.0], np.cumsum(spreading((grid[1:] + grid[:-1]) / 2, spreading_s))))
    return cdf / cdf[-1], grid
