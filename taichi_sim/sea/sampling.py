"""From spectra to components: the random draw of sea realisations (NumPy, float64, once per run).

The sea is a sum of systems (wind sea, swell), each with a density of its own. A system's band is cut into geometric
bins, one component each, which carries its bin's energy at a random place in the bin (jittered). Amplitudes are then
scaled by one factor per system so that sum a^2 / 2 = hs^2 / 16: the significant height of every realisation is exact,
and so is that of a sum of systems, because variances add: hs^2 = hs_1^2 + hs_2^2. A system that was measured
(measured/system.py) is cut and drawn in its own way, to the same end.

Random amplitudes. The sea is Gaussian: the amplitude of each component varies, too, by Rayleigh's law (Tucker,
Challenor & Carter 1984, Applied Ocean Research 6, 118), a = sigma sqrt(-2 ln U) with sigma^2 the energy of its bin.
Then the height of a realisation is a draw, exact in the mean of the variances alone, as that of a record at sea is;
with fixed amplitudes it is exact, but a few components never add up to the highest waves of the law (docs/seas.md).

The sea does not repeat in an episode. N equally spaced frequencies would: they share the divisor d_omega and come back
after 2 pi / d_omega, 33 s for 16 of them at tp 5 s. Jittered frequencies have no common divisor, so the surface is
almost periodic: it comes close to an earlier one only when all phases align again, which takes a time that grows
exponentially with the number of components that carry energy. In 256 realisations of the default sea the elevation's
autocorrelation never comes back above 0.88 within 600 s; with 32 components 0.74; 8 components are too few (0.98).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from taichi_sim.sea.measured import MeasuredSystem
from taichi_sim.sea.spectrum import Components, spreading, wavenumber

# Frequency band that is sampled, in multiples of the peak: holds 98-99 % of the variance; the rest is given
# back by scaling the amplitudes (the tail beyond 3 wp only adds steepness that hulls of metres do not feel).
BAND = (0.6, 3.0)
BIN_POINTS = 64  # of the midpoint rule inside a frequency bin
ANGLE_POINTS = 4097  # of the cumulative spreading


@dataclass(frozen=True)
class WaveSystem:
    """Waves of one origin, wind sea or swell, with a spectrum by formula."""

    density: Callable[[np.ndarray], np.ndarray]  # S(omega), m^2 s; only its shape counts
    hs: float  # significant wave height, m
    tp: float  # peak period, s
    direction: float  # mean, where the waves travel to, rad clockwise from north
    spreading_s: float  # exponent s of cos^2s
    components: int  # per realisation

    @cached_property
    def bins(self) -> np.ndarray:
        """Edges of the frequency bins, [components + 1], rad/s."""
        return 2 * math.pi / self.tp * np.geomspace(*BAND, self.components + 1)

    @cached_property
    def amplitudes(self) -> np.ndarray:
        """Amplitude of the component of each bin, m: each bin's share of the variance hs^2 / 16."""
        edges = self.bins
        inside = (np.arange(BIN_POINTS) + 0.5) / BIN_POINTS
        omega = edges[:-1, None] + inside * np.diff(edges)[:, None]
        energy = self.density(omega).mean(axis=1) * np.diff(edges)
        return self.hs * np.sqrt(energy / (8 * energy.sum()))

    @property
    def circular_deviation(self) -> float:
        """Of the directions, sqrt(2 (1 - r1)) with r1 = s / (s + 1), rad."""
        return math.sqrt(2 / (self.spreading_s + 1))

    def by_direction(self, angle: np.ndarray) -> np.ndarray:
        """Share of the energy by direction of travel, 1/rad, at angles (rad, clockwise from north)."""
        return spreading((angle - self.direction + math.pi) % (2 * math.pi) - math.pi, self.spreading_s)

    def draw(self, rng: np.random.Generator, seed: int, realisation: int, index: int) -> np.ndarray:
        """Frequency (rad/s), direction and phase (rad) [3, component] of a realisation, by its own generator `rng`.

        Frequencies are jittered in their bins; directions are a stratified draw from cos^2s, shuffled over frequencies.
        """
        del seed, realisation, index  # of what realisations share
        edges, n = self.bins, self.components
        omega = edges[:-1] + rng.random(n) * np.diff(edges)
        strata = (rng.permutation(n) + rng.random(n)) / n
        direction = self.direction + np.interp(strata, *_cumulative(self.spreading_s))
        return np.stack((omega, direction, rng.random(n) * 2 * math.pi))


System = WaveSystem | MeasuredSystem  # waves to draw components from


def realisation_seed(seed: int, realisation: int, system: int = 0) -> np.random.Generator:
    """The generator of one realisation of one system: depends on nothing else, so more seas keep the earlier ones.

    The first system's does not name it: a swell added to a wind sea leaves that as it was.
    """
    entropy = [seed, realisation, system] if system else [seed, realisation]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy)))


def sample_components(
    systems: Sequence[System], *, realisations: int, seed: int, depth: float | None = None
) -> Components:
    """Draw sea realisations whose significant height is exactly that of the systems together.

    Args:
        systems: their components stand one after the other along the last axis of the result.
        realisations: how many seas. seed: of the run. depth: m, None for deep water.
    """
    return draw_components([systems] * realisations, seed=seed, depth=depth)


def draw_components(
    systems: Sequence[Sequence[System]], *, seed: int, depth: float | None = None, random_amplitudes: bool = False
) -> Components:
    """The same, of realisations that each have `systems` of their own, of as many components.

    `random_amplitudes` are Rayleigh's: no realisation has exactly its height, but all together have.
    """
    each = [[_draw(system, n, r, seed) for n, system in enumerate(own)] for r, own in enumerate(systems)]
    omega, direction, phase, chance = np.stack([np.concatenate(own, axis=1) for own in each], axis=1)
    amplitude = np.stack([np.concatenate([system.amplitudes for system in own]) for own in systems])
    if random_amplitudes:
        amplitude = amplitude * np.sqrt(-np.log1p(-chance))
    return Components(amplitude, wavenumber(omega, depth), omega, direction, phase)


def _draw(system: System, index: int, realisation: int, seed: int) -> np.ndarray:
    """Frequency, direction and phase of a system's components in a realisation, and a chance in [0, 1) for a random
    amplitude [4, component].
    """
    rng = realisation_seed(seed, realisation, index)
    drawn = system.draw(rng, seed, realisation, index)
    return np.vstack((drawn, rng.random(system.components)))


@cache
def _cumulative(spreading_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Share of the energy below an angle from the mean direction, and the angles (rad)."""
    grid = np.linspace(-math.pi, math.pi, ANGLE_POINTS)
    cdf = np.concatenate(([0.0], np.cumsum(spreading((grid[1:] + grid[:-1]) / 2, spreading_s))))
    return cdf / cdf[-1], grid
