"""Small motions about steady flight: linear models, natural modes, and the longest stable step of RK4."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from taichi_sim.conventions import ANGULAR_VELOCITY, SURGE
from taichi_sim.uav.fixed_wing.equations import rhs
from taichi_sim.uav.fixed_wing.params import FixedWingParams
from taichi_sim.uav.fixed_wing.trim import Trim

DIFFERENCE = 1e-5  # step of the central differences: m/s, rad, rad/s, 1
LONGITUDINAL = ("u", "w", "q", "theta")
LATERAL = ("v", "p", "r", "phi")
RK4_REACH = 3.0  # |lambda dt| beyond which RK4 is unstable for every mode
RK4_GRID = 30001
GROWTH = 1e-9  # growth per step that counts as rounding


@dataclass(frozen=True)
class Mode:
    """A natural mode: an oscillating pair of eigenvalues (1/s), or one or two real ones."""

    name: str
    eigenvalues: tuple[complex, ...]

    @property
    def oscillates(self) -> bool:
        """Whether the eigenvalues are a complex conjugate pair."""
        return abs(self.eigenvalues[0].imag) > 0

    @property
    def frequency(self) -> float:
        """Natural frequency, rad/s."""
        return abs(self.eigenvalues[0])

    @property
    def damping(self) -> float:
        """Damping ratio; 1 or -1 for a real eigenvalue."""
        return -self.eigenvalues[0].real / self.frequency if self.frequency else 0.0

    @property
    def time_constant(self) -> float:
        """-1 / (real part), s: negative if the mode grows, infinite if it neither grows nor decays."""
        real = self.eigenvalues[0].real
        return -1.0 / real if real else float("inf")


@dataclass(frozen=True)
class LinearModel:
    """x' = A x + B delta about a trim, and its modes by name.

    Longitudinal: x = (u, w, q, theta), delta = (elevator, throttle). Lateral: x = (v, p, r, phi), delta = (aileron,
    rudder). Units: m/s, rad, rad/s.
    """

    A_lon: np.ndarray
    B_lon: np.ndarray
    A_lat: np.ndarray
    B_lat: np.ndarray
    modes: dict[str, Mode]


def linear_modes(p: FixedWingParams, trim: Trim) -> LinearModel:
    """The linear model about `trim` in still air, by central differences, and its modes.

    The modes are short_period, phugoid, dutch_roll, roll and spiral; where roll and spiral have become one oscillation,
    roll_spiral takes their place.
    """
    phi, theta = trim.phi, trim.theta
    v = trim.airspeed * np.array(
        [np.cos(trim.alpha) * np.cos(trim.beta), np.sin(trim.beta), np.sin(trim.alpha) * np.cos(trim.beta)]
    )
    x = np.concatenate((v, trim.state[ANGULAR_VELOCITY], [phi, theta], trim.controls))
    names: tuple[str, ...] = (
        "u", "v", "w", "p", "q", "r", "phi", "theta", "elevator", "aileron", "rudder", "throttle",
    )  # fmt: skip
    by: dict[str, np.ndarray] = dict(zip(names, jacobian(partial(rhs, p), x), strict=True))

    def block(rows: tuple[str, ...], columns: tuple[str, ...]) -> np.ndarray:
        return np.array([[by[c][names.index(r)] for c in columns] for r in rows])

    A_lon, A_lat = block(LONGITUDINAL, LONGITUDINAL), block(LATERAL, LATERAL)
    modes = (*_longitudinal(np.linalg.eigvals(A_lon)), *_lateral(np.linalg.eigvals(A_lat)))
    return LinearModel(
        A_lon,
        block(LONGITUDINAL, ("elevator", "throttle")),
        A_lat,
        block(LATERAL, ("aileron", "rudder")),
        {mode.name: mode for mode in modes},
    )


def jacobian(rhs: Callable[[np.ndarray, np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Derivatives of the rates of u, v, w, p, q, r, phi, theta [8] with respect to x [n]: these and the controls.

    They are central differences of `rhs` (states [m, 13], controls [m, n - 8]), heading north; [n, 8].
    """
    steps = DIFFERENCE * np.eye(len(x))
    near = np.concatenate((x + steps, x - steps))
    nu, (phi, theta), controls = near[:, :6], near[:, 6:8].T, near[:, 8:]
    _, _, _, p, q, r = nu.T
    state = np.concatenate((np.zeros((len(near), 3)), level_attitude(phi, theta), nu), axis=1)
    turning = q * np.sin(phi) + r * np.cos(phi)
    angles = np.stack((p + turning * np.tan(theta), q * np.cos(phi) - r * np.sin(phi)), axis=1)
    rates = np.concatenate((rhs(state, controls)[:, SURGE:], angles), axis=1)
    return (rates[: len(x)] - rates[len(x) :]) / (2 * DIFFERENCE)


def level_attitude(phi: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Quaternions [n, 4] of roll and pitch, heading north."""
    cr, sr, cp, sp = np.cos(phi / 2), np.sin(phi / 2), np.cos(theta / 2), np.sin(theta / 2)
    return np.stack((cp * cr, cp * sr, sp * cr, -sp * sr), axis=1)


def _longitudinal(eigenvalues: np.ndarray) -> tuple[Mode, Mode]:
    """Short period (the fast pair) and phugoid (the slow pair)."""
    fast_first = sorted(eigenvalues.tolist(), key=lambda x: (-abs(x), -x.imag))
    return Mode("short_period", tuple(fast_first[:2])), Mode("phugoid", tuple(fast_first[2:]))


def _lateral(eigenvalues: np.ndarray) -> tuple[Mode, ...]:
    """Dutch roll is the faster oscillating pair; of the other eigenvalues roll is the fast one, spiral the slow one."""
    values = sorted(eigenvalues.tolist(), key=lambda x: (-abs(x), -x.imag))
    pairs = [x for x in values if abs(x.imag) > 0]
    real = [x for x in values if x.imag == 0]
    if len(pairs) == 4:
        return Mode("dutch_roll", tuple(pairs[:2])), Mode("roll_spiral", tuple(pairs[2:]))
    if not pairs:
        return Mode("roll", (real[0],)), Mode("dutch_roll", tuple(real[1:3])), Mode("spiral", (real[3],))
    return Mode("dutch_roll", tuple(pairs)), Mode("roll", (real[0],)), Mode("spiral", (real[1],))


@dataclass(frozen=True)
class StableStep:
    """The longest stable step (s), and the reason in words."""

    dt: float
    reason: str


def rk4_limit(eigenvalue: complex) -> float:
    """Longest step (s) with which the classical RK4 does not let a damped mode of this eigenvalue (1/s) grow."""
    z = eigenvalue / abs(eigenvalue) * np.linspace(0.0, RK4_REACH, RK4_GRID)[1:]
    growth = np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))
    return float(abs(z[np.argmax(growth > 1 + GROWTH)]) / abs(eigenvalue))


def largest_stable_dt(p: FixedWingParams, trim: Trim) -> StableStep:
    """The longest step of RK4 that is stable for all damped modes about `trim`, up to the aircraft's max_airspeed.

    Aerodynamic rates grow in proportion to airspeed, so the limit at max_airspeed is that at the trim times the
    ratio of the airspeeds.
    """
    modes = [m for m in linear_modes(p, trim).modes.values() if m.eigenvalues[0].real < 0]
    limits = {m.name: min(rk4_limit(x) for x in m.eigenvalues if x.real < 0) for m in modes}
    name = min(limits, key=lambda key: limits[key])
    eigenvalue = next(m for m in modes if m.name == name).eigenvalues[0]
    top = p.envelope.max_airspeed
    dt = limits[name] * min(1.0, trim.airspeed / top)
    reason = (
        f"RK4 holds the mode {name} ({eigenvalue.real:.3g} 1/s at {trim.airspeed:g} m/s) up to {limits[name]:.3g} s "
        f"there and up to {dt:.3g} s at max_airspeed = {top:g} m/s"
    )
    return StableStep(dt, reason)
