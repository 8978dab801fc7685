"""Motions in regular waves, by running them in time: what response amplitude operators are compared with.

Each environment holds the hull, free to move and at rest at first, in a regular wave so low that the response is
linear. When transients have died out, amplitudes and phases are fitted at the wave's frequency.
"""

import numpy as np

from taichi_sim.bench import Bench
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components, wavenumber

STEEPNESS = 2e-4  # k a of every wave, for single precision
GENTLE = 5e-5  # for double: a box turns by second-order moments while transients die out
SETTLED = 6.0  # time constants of the slowest decay until amplitudes are fitted: 0.2 % of a transient is left
FITTED_PERIODS = 12  # of the longest wave


def motions(
    model: Hull6Dof, omega: np.ndarray, heading: np.ndarray, slowest: float, steepness: float = GENTLE
) -> np.ndarray:
    """Complex amplitudes Z [row, 6] of x, y, z, roll, pitch, yaw per metre of wave amplitude, as Re(Z exp(-i omega t))
    beside a wave whose crest is at the origin at t = 0.

    omega [row] rad/s, heading [row] rad: where waves travel to, clockwise, over a hull that heads north; `slowest` is
    the time constant (s) of the slowest decay, `steepness` k a of the waves. The model's control step is the time
    between samples.
    """
    k = wavenumber(omega)
    amplitude = steepness / k
    columns = [v[:, None] for v in (amplitude, k, omega, heading, 0 * omega)]
    bench = Bench(model, sea=Sea(Components(*columns)), envs=len(omega)).put(settle=True)
    every, idle = model.dt * model.substeps, np.zeros(len(model.action_names))
    bench.step(idle, round(SETTLED * slowest / every))
    rows, times = [], []
    for _ in range(round(FITTED_PERIODS * 2 * np.pi / omega.min() / every)):
        bench.step(idle)
        motion = bench.read()
        rows.append(np.hstack([motion.position, motion.euler]))
        times.append(float(bench.time[0]))
    return _fitted(np.array(times), np.array(rows), omega) / amplitude[:, None]


def _fitted(t: np.ndarray, motion: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Least-squares amplitudes [row, 6] at omega [row] of motion [time, row, 6], beside a mean and a drift."""
    out = np.empty((len(omega), 6), dtype=np.complex128)
    ramp = (t - t.mean()) / np.ptp(t)
    for row, w in enumerate(omega):
        basis = np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t), ramp], axis=1)
        found = np.linalg.lstsq(basis, motion[:, row], rcond=None)[0]
        out[row] = found[0] + 1j * found[1]
    return out
