"""Realisations with different heights, periods and directions in one table.

Not every pair of height and period can exist. A drawn period is raised, for its realisation alone, until

    hs / (g tp^2 / 2 pi) <= 1/15   the steepest sea of DNV-RP-C205 (2010), sec. 3.5.4, for tp up to 8 s, and
    sum of k a < 0.98              with a margin to 1, where a Gerstner surface could loop.
"""

import math

import numpy as np

from taichi_sim.config import SeaConfig
from taichi_sim.conventions import GRAVITY
from taichi_sim.sea.sampling import draw_components
from taichi_sim.sea.sea import wave_systems
from taichi_sim.sea.spectrum import Components
from taichi_sim.sea.wind_sea import SeaSize

STEEPEST = 1 / 15  # significant steepness
ROOM = 0.98  # limit of the sum of k a; the surface could loop from 1 on
TRIES = 8  # attempts with longer periods; in deep water without swell the first one suffices


def shortest_period(hs: np.ndarray) -> np.ndarray:
    """Shortest peak period (s) of seas of significant height hs (m)."""
    return np.sqrt(2 * math.pi * hs / (GRAVITY * STEEPEST))


def varied_components(
    config: SeaConfig, hs: np.ndarray, tp: np.ndarray, direction_deg: np.ndarray, seed: int
) -> tuple[Components, np.ndarray]:
    """Draw components of realisations like `config`, each with its own wind sea; also return their periods.

    hs (m), tp (s) and direction_deg describe the wind seas, [realisation]. Periods too short for their height are
    raised. Realisation r depends on `seed`, its own numbers and r alone.
    """
    tp = np.maximum(tp, shortest_period(hs))
    for _ in range(TRIES):
        sizes = [SeaSize(float(height), float(period)) for height, period in zip(hs, tp, strict=True)]
        systems = [wave_systems(config, *each) for each in zip(sizes, map(float, direction_deg), strict=True)]
        random = config.amplitudes == "random"
        components = draw_components(systems, seed=seed, depth=config.depth, random_amplitudes=random)
        over = components.steepness(config.depth) / ROOM
        if not (over >= 1).any():
            break
        tp = np.where(over >= 1, tp * np.sqrt(over) * (1 + 1e-9), tp)
    return components, tp
