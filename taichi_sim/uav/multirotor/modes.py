"""Small motions about steady flight: the linear model, its modes, and the longest stable step of RK4."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from taichi_sim.uav.fixed_wing.modes import Mode, StableStep, jacobian, level_attitude, rk4_limit
from taichi_sim.uav.fixed_wing.trim import in_body
from taichi_sim.uav.multirotor.equations import rhs
from taichi_sim.uav.multirotor.params import MultirotorParams
from taichi_sim.uav.multirotor.trim import MultirotorTrim

STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta")
PLANES = {"pitch": ("u", "q", "theta"), "roll": ("v", "p", "phi"), "heave": ("w",), "yaw": ("r",)}
SLOWEST = 1e-9  # 1/s: a smaller eigenvalue is zero within rounding


@dataclass(frozen=True)
class MultirotorLinearModel:
    """x' = A x + B omega about a trim, rotors held at their speeds; x = STATES (m/s, rad/s, rad), omega in rad/s."""

    A: np.ndarray  # [8, 8]
    B: np.ndarray  # [8, rotor]
    modes: tuple[Mode, ...]  # named for the motion that dominates the eigenvector (PLANES), fast ones first

    def block(self, states: tuple[str, ...]) -> np.ndarray:
        """The part of A for the given states alone."""
        at = [STATES.index(name) for name in states]
        return self.A[np.ix_(at, at)]


def linear_modes(craft: MultirotorParams, trim: MultirotorTrim) -> MultirotorLinearModel:
    """The linear model about `trim` in still air, by central differences."""
    R_b = level_attitude(np.array([trim.phi]), np.array([trim.theta]))
    v = _in_body(trim.velocity_air, trim.heading, R_b)
    x = np.concatenate((v, np.zeros(3), [trim.phi, trim.theta], trim.omega))
    J = jacobian(partial(rhs, craft), x).T
    A = J[:, : len(STATES)]
    return MultirotorLinearModel(A, J[:, len(STATES) :], _modes(A))


def _in_body(velocity_n: np.ndarray, heading: float, q: np.ndarray) -> np.ndarray:
    """A velocity (n), turned by -heading, in the axes of attitude q [1, 4], whose heading is zero."""
    c, s = np.cos(heading), np.sin(heading)
    level = np.array([c * velocity_n[0] + s * velocity_n[1], c * velocity_n[1] - s * velocity_n[0], velocity_n[2]])
    return in_body(level, q[0])


def _modes(A: np.ndarray) -> tuple[Mode, ...]:
    """One mode for each real eigenvalue and each conjugate pair."""
    values, vectors = np.linalg.eig(A)
    found = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        if value.imag < 0:
            continue  # its conjugate stands for both
        share = {name: sum(abs(vector[STATES.index(s)]) ** 2 for s in states) for name, states in PLANES.items()}
        pair = (value, value.conjugate()) if value.imag > 0 else (value,)
        found.append(Mode(max(share, key=lambda name: share[name]), pair))
    return tuple(sorted(found, key=lambda mode: -mode.frequency))


def largest_stable_dt(craft: MultirotorParams, fastest: MultirotorTrim) -> StableStep:
    """The longest step of RK4 that is stable for all damped modes about the trim at the largest airspeed.

    Rotors do not limit it.
    """
    damped = [m for m in linear_modes(craft, fastest).modes if m.eigenvalues[0].real < -SLOWEST]
    if not damped:
        return StableStep(np.inf, "nothing is damped")
    limits = [(min(rk4_limit(x) for x in mode.eigenvalues), mode) for mode in damped]
    dt, mode = min(limits, key=lambda item: item[0])
    eigenvalue, speed = mode.eigenvalues[0], np.linalg.norm(fastest.velocity_air)
    return StableStep(
        dt, f"RK4 holds the mode {mode.name} ({eigenvalue.real:.3g} 1/s at {speed:g} m/s) up to {dt:.3g} s"
    )
