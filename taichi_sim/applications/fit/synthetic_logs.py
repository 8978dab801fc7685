"""Synthetic logs of a vessel with known numbers, for testing a fit: random commands, a current, instrument errors."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from taichi_sim.applications.fit.log_table import HEADING
from taichi_sim.applications.fit.windows import Window, WindowSimulator, lead_steps

INTERVAL = 0.1  # s
HELD = (2.0, 6.0)  # s, range of times for which a command is held
NOISE = np.array([0.1, 0.1, np.radians(0.5), np.radians(0.2)])  # GNSS (m), compass and gyro (rad, rad/s); assumed
BIAS = np.radians([1.0, 0.1])  # standard deviations of the biases of compass and gyro; assumed
CURRENT = 0.3  # m/s, largest current; assumed


def write_logs(
    vehicle: str, factors: Mapping[str, float], folder: Path, *, count: int = 10, seconds: float = 60.0, seed: int = 0,
    changes: Mapping | None = None, commands: np.ndarray | None = None,
) -> list[Path]:  # fmt: skip
    """Write `count` logs of a vehicle file whose numbers are multiplied by `factors`; return their paths.

    `changes` are changed keys of the file (load_vehicle). All logs take the `commands` [sample, action] every INTERVAL,
    by default random ones for `seconds`.
    """
    if commands is not None:
        seconds = len(commands) * INTERVAL
    rng, simulator = np.random.default_rng(seed), WindowSimulator(vehicle, tuple(factors), INTERVAL, changes)
    names, steps, lead = simulator.model.action_names, round(seconds / INTERVAL), lead_steps(INTERVAL)
    windows = []
    for log in range(count):
        actions = np.zeros((lead + steps, len(names)))
        k = 0
        while k < lead + steps:
            n = round(rng.uniform(*HELD) / INTERVAL)
            actions[k : k + n] = rng.uniform(-1.0, 1.0, len(names))
            k += n
        if commands is not None:
            actions[:lead], actions[lead:] = commands[0], commands
        windows.append(Window(log, np.zeros((lead + steps + 1, 4)), actions))
    way, speed = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, CURRENT, count)
    state = np.zeros((count, 6))
    state[:, HEADING] = rng.uniform(-np.pi, np.pi, count)
    phi = np.tile(np.log(list(factors.values())), (count, 1))
    motion = simulator.run(windows, phi, np.stack((speed * np.cos(way), speed * np.sin(way)), axis=1), state)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for log in range(count):
        told = motion[:-1, log] + rng.normal(size=(steps, 4)) * NOISE
        told[:, 2:] += rng.normal(size=2) * BIAS
        files.append(folder / f"log{log}.csv")
        with files[-1].open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(("t", "north", "east", "heading", "yaw_rate", *names))
            for k in range(steps):
                row = (*told[k], *windows[log].actions[lead + k])
                table.writerow((f"{k * INTERVAL:.3f}", *(f"{x:.6f}" for x in row)))
    return files
