"""Time of drawing a picture of boats in waves, with several views."""

import statistics
import time

import torch

from rl.adapters.render import Pictures
from rl.missions import load_scenario, make_mission

SIZE = (640, 480)
SCENARIOS = {
    "paper": ("track.worlds=4", "sea.realisations=4"),
    "otter": ("sea.realisations=4",),
    "escort": ("escort.worlds=4", "sea.realisations=4"),
}


def measure_pictures(*, seconds: float, repetitions: int) -> dict[str, float]:
    """Median milliseconds for a picture of one environment, 640x480 px, by scenario."""
    found = {}
    for name, overrides in SCENARIOS.items():
        mission = make_mission(load_scenario(name, overrides), 1, seed=1)
        pictures, times = Pictures(mission, SIZE), []
        still = {team: torch.zeros_like(of.action) for team, of in mission.teams.items()}
        pictures.draw()
        start = time.perf_counter()
        while len(times) < repetitions or time.perf_counter() - start < seconds:
            mission.step(still)
            pictures.keep()
            begin = time.perf_counter()
            pictures.draw()
            times.append(1000 * (time.perf_counter() - begin))
        found[name] = statistics.median(times)
    return found
