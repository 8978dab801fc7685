"""Steady flight of a fixed-wing aircraft, climbing or turning at a given airspeed, by Newton's method in float64.

`trimmed` begins a flight in it, in any wind. Of the small motions about it there are linear models, natural modes, and
the longest stable step of RK4.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from taichi_sim.errors import refuse
from taichi_sim.kernels.conventions import (
    ANGULAR_VELOCITY,
    GRAVITY,
    POSITION,
    QUATERNION,
    STATE_SIZE,
    SURGE,
    VELOCITY,
)
from taichi_sim.kernels.rotation import torch_heading, torch_to_body
from taichi_sim.models.uav.aircraft import TrimError as TrimError
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads, rhs, stall_angles
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.local_air import wind_at
from taichi_sim.surroundings.around_vehicles import Surroundings

DIFFERENCE = 1e-6  # step of the Jacobian's central differences, rad and 1
RESIDUAL = 1e-9  # largest residual of a trim, m/s^2 and rad/s^2; rounding leaves 1e-13
ITERATIONS = 100
STEP_PARTS = 0.5 ** np.arange(12)  # fractions of a search step, all tried at once
MAX_BANK = 1.45  # rad
MAX_SIDESLIP = 0.5  # rad, for aircraft without rudder
AT_LIMIT = 1e-3  # a search this close to a bound, as a fraction of the range, counts as stopped by it
FIRST_THROTTLE = 0.6  # initial guess
SMALL_MOTION = 1e-5  # step of the central differences of the linear model: m/s, rad, rad/s, 1
LONGITUDINAL = ("u", "w", "q", "theta")
LATERAL = ("v", "p", "r", "phi")
RK4_REACH = 3.0  # |lambda dt| beyond which RK4 is unstable for every mode
RK4_GRID = 30001
GROWTH = 1e-9  # growth per step that counts as rounding


@dataclass(frozen=True)
class Trim:
    """Steady flight. Angles are in rad; `state` [13] is at the origin, heading north."""

    airspeed: float  # m/s
    gamma: float  # angle of climb relative to the air
    turn_rate: float  # of the heading, rad/s, positive to the right
    alpha: float
    beta: float
    phi: float
    theta: float
    controls: np.ndarray  # elevator, aileron, rudder (rad), throttle
    state: np.ndarray
    thrust: float  # N
    torque: float  # of the motor on the propeller, N m

    @property
    def elevator(self) -> float:
        """Deflection, rad."""
        return float(self.controls[0])

    @property
    def aileron(self) -> float:
        """Deflection, rad."""
        return float(self.controls[1])

    @property
    def rudder(self) -> float:
        """Deflection, rad."""
        return float(self.controls[2])

    @property
    def throttle(self) -> float:
        """Fraction of full throttle."""
        return float(self.controls[3])


def trim(
    p: FixedWingParams,
    Va: float,
    gamma: float = 0.0,
    turn_radius: float | None = None,
    turn_rate: float | None = None,
    wind=(0.0, 0.0, 0.0),
) -> Trim:
    """Steady flight at airspeed Va (m/s), climbing by gamma (rad), straight or turning.

    Args:
        p: the aircraft.
        Va: airspeed, m/s.
        gamma: angle of climb relative to the air, rad.
        turn_radius: radius relative to the air, m, positive to the right; or
        turn_rate: heading rate, rad/s, positive to the right; neither: straight flight.
        wind: velocity of the air (NED, m/s), added to the velocity over ground in `state`.

    There is no sideslip, except for an aircraft without rudder. Six accelerations are zero; the unknowns are alpha,
    phi, elevator, throttle, aileron, and rudder (or beta).
    """
    numbers = not np.isnan(turn_radius or 0.0) and np.isfinite(turn_rate or 0.0)
    refuse(
        TrimError,
        (turn_radius is not None and turn_rate is not None, "turn_radius and turn_rate: give one of them"),
        (turn_radius == 0, "turn_radius = 0: must not be zero; leave it out for straight flight"),
        (not 0 < Va < np.inf, f"airspeed Va = {Va:g} m/s: must be positive and finite"),
        (not abs(gamma) < np.pi / 2, f"climb gamma = {np.degrees(gamma):g} deg: must lie between -90 and 90 deg"),
        (not numbers, f"turn_radius = {turn_radius}, turn_rate = {turn_rate}: must be numbers"),
    )
    rate = float(turn_rate or 0.0) if turn_radius is None else Va * float(np.cos(gamma)) / turn_radius

    def unpack(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        alpha, phi, elevator, throttle, aileron, last = x.T
        rudder, beta = (last, 0 * last) if p.lateral.has_rudder else (0 * last, last)
        return steady_state(Va, gamma, rate, alpha, beta, phi), np.stack((elevator, aileron, rudder, throttle), 1)

    def residual(x: np.ndarray) -> np.ndarray:
        return rhs(p, *unpack(x))[:, 7:]

    low, high = _bounds(p)
    x = _newton(residual, np.clip(_guess(p, Va, rate), low, high), low, high)
    left = residual(x[None])[0]
    if not np.abs(left).max() < RESIDUAL:
        turning = f", turning at {rate:.3g} rad/s" if rate else ""
        reached = _limits_reached(p, x, low, high) or _remaining(left)
        raise TrimError(f"no steady flight at {Va:g} m/s, climbing at {np.degrees(gamma):.3g} deg{turning}: {reached}")
    (state,), (controls,) = unpack(x[None])
    beta = 0.0 if p.lateral.has_rudder else float(x[5])
    theta = float(pitch_for_climb(x[0], beta, x[1], gamma))
    thrust, torque = loads(p, state[VELOCITY], state[ANGULAR_VELOCITY], controls)[0, 6:]
    state[VELOCITY] += in_body(wind, state[QUATERNION])
    return Trim(Va, gamma, rate, float(x[0]), beta, float(x[1]), theta, controls, state, float(thrust), float(torque))


def pitch_for_climb(alpha, beta, phi, gamma):
    """Pitch (rad) at which the path relative to the air climbs by gamma (Stevens & Lewis 2003, eq. 3.6-3)."""
    a = np.cos(alpha) * np.cos(beta)
    b = np.sin(phi) * np.sin(beta) + np.cos(phi) * np.sin(alpha) * np.cos(beta)
    s = np.sin(gamma)
    return np.arctan2(a * b + s * np.sqrt(np.maximum(a * a - s * s + b * b, 0.0)), a * a - s * s)


def steady_state(Va: float, gamma: float, turn_rate: float, alpha, beta, phi) -> np.ndarray:
    """States [n, 13] of steady flight in still air, heading north, at alpha, beta, phi [n] (rad)."""
    theta = pitch_for_climb(alpha, beta, phi, gamma)
    state = np.zeros((len(theta), STATE_SIZE))
    state[:, QUATERNION] = level_attitude(phi, theta)
    cb = np.cos(beta)
    state[:, VELOCITY] = Va * np.stack((np.cos(alpha) * cb, np.sin(beta), np.sin(alpha) * cb), axis=1)
    state[:, ANGULAR_VELOCITY] = turn_rate * np.stack(
        (-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)), axis=1
    )
    return state


def _bounds(p: FixedWingParams) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of alpha, phi, elevator, throttle, aileron, and rudder or beta."""
    low, high = p.actuators.lower, p.actuators.upper
    stall = stall_angles(p)
    last = (low[2], high[2]) if p.lateral.has_rudder else (-MAX_SIDESLIP, MAX_SIDESLIP)
    pairs = (stall, (-MAX_BANK, MAX_BANK), (low[0], high[0]), (low[3], high[3]), (low[1], high[1]), last)
    return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])


def _limits_reached(p: FixedWingParams, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Names of the bounds that stopped the search, as text; empty if none did."""
    last = "rudder" if p.lateral.has_rudder else "sideslip"
    told = []
    for name, value, a, b in zip(("alpha", "bank", "elevator", "throttle", "aileron", last), x, low, high, strict=True):
        if min(value - a, b - value) < AT_LIMIT * (b - a):
            end = "upper" if b - value < value - a else "lower"
            if name == "alpha":
                told.append(f"stall (the wing lifts no more beyond alpha = {np.degrees(value):.3g} deg)")
            elif name == "throttle":
                told.append(f"throttle at its {end} limit ({value:g})")
            else:
                told.append(f"{name} at its {end} limit ({np.degrees(value):.3g} deg)")
    return ", ".join(told)


def _remaining(left: np.ndarray) -> str:
    """The largest unbalanced acceleration, as text."""
    names = ("forward", "sideways", "downward", "in roll", "in pitch", "in yaw")
    worst = int(np.argmax(np.abs(left)))
    unit = "m/s^2" if worst < 3 else "rad/s^2"
    cause = "no throttle setting balances " if worst == 0 else "nothing balances "
    return f"{cause}{left[worst]:.2g} {unit} {names[worst]}"


def _guess(p: FixedWingParams, Va: float, turn_rate: float) -> np.ndarray:
    """Initial guess: a coordinated turn, lift equal to weight times load factor, no pitching moment."""
    lon, body = p.longitudinal, p.physical
    phi = np.arctan(Va * turn_rate / GRAVITY)
    C_L = body.mass * GRAVITY / (np.cos(phi) * 0.5 * body.rho * Va**2 * body.S)
    alpha = (C_L - lon.C_L_0) / lon.C_L_alpha
    elevator = -(lon.C_m_0 + lon.C_m_alpha * alpha) / lon.C_m_delta_e
    return np.array([alpha, phi, elevator, FIRST_THROTTLE, 0.0, 0.0])


def _newton(residual: Callable, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """A root of residual [n, 6] -> [n, 6] between the bounds, or the least residual that the search found.

    Gauss-Newton, with shorter steps where a whole one does not reduce the residual. Unknowns at a bound that a step
    would cross stay there.
    """
    steps = DIFFERENCE * np.eye(len(x))
    for _ in range(ITERATIONS):
        values = residual(np.concatenate((x[None], x + steps, x - steps)))
        jacobian = (values[1 : len(x) + 1] - values[len(x) + 1 :]).T / (2 * DIFFERENCE)
        step = np.linalg.lstsq(jacobian, -values[0], rcond=None)[0]
        stuck = (x <= low) & (step < 0) | (x >= high) & (step > 0)
        step = np.where(stuck, 0.0, step)
        step[~stuck] = np.linalg.lstsq(jacobian[:, ~stuck], -values[0], rcond=None)[0]
        tried = np.clip(x + STEP_PARTS[:, None] * step, low, high)
        errors = np.linalg.norm(residual(tried), axis=1)
        if not errors.min() < np.linalg.norm(values[0]):
            break
        x = tried[errors.argmin()]
    return x


def in_body(vector_n, q: np.ndarray) -> np.ndarray:
    """vector_n in the body axes of attitude q (w, x, y, z): v + 2 w (v x r) + 2 (v x r) x r, r the vector part."""
    v, w, r = np.asarray(vector_n, dtype=np.float64), q[0], q[1:]
    t = 2 * np.cross(v, r)
    return v + w * t + np.cross(t, r)


def trimmed(state: Tensor, at: Trim, around: Surroundings) -> Tensor:
    """States [n, vehicle, 13] in the flight `at` in the mean wind, at the positions and headings of `state`."""
    half = 0.5 * torch_heading(state[..., QUATERNION]).unsqueeze(-1)
    w, x, y, z = at.state[QUATERNION].tolist()
    q = torch.cos(half) * state.new_tensor((w, x, y, z)) + torch.sin(half) * state.new_tensor((-z, -y, x, w))
    velocity = state.new_tensor(at.state[VELOCITY]) + torch_to_body(wind_at(state, around), q)
    return torch.cat((state[..., POSITION], q, velocity, torch.zeros_like(velocity)), dim=-1)


def air_readings(state: Tensor, wind: Tensor) -> Tensor:
    """Airspeed (m/s), angles of attack and sideslip (rad) [.., 3] of `state` [.., 13] in `wind` [.., 3] (NED, m/s)."""
    u, v, w = (state[..., VELOCITY] - torch_to_body(wind, state[..., QUATERNION])).unbind(-1)
    return torch.stack(
        (torch.sqrt(u * u + v * v + w * w), torch.atan2(w, u), torch.atan2(v, torch.hypot(u, w))), dim=-1
    )


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
    steps = SMALL_MOTION * np.eye(len(x))
    near = np.concatenate((x + steps, x - steps))
    nu, (phi, theta), controls = near[:, :6], near[:, 6:8].T, near[:, 8:]
    _, _, _, p, q, r = nu.T
    state = np.concatenate((np.zeros((len(near), 3)), level_attitude(phi, theta), nu), axis=1)
    turning = q * np.sin(phi) + r * np.cos(phi)
    angles = np.stack((p + turning * np.tan(theta), q * np.cos(phi) - r * np.sin(phi)), axis=1)
    rates = np.concatenate((rhs(state, controls)[:, SURGE:], angles), axis=1)
    return (rates[: len(x)] - rates[len(x) :]) / (2 * SMALL_MOTION)


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
