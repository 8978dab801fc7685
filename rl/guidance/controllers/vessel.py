"""Model of a displacement vessel for its controller, and the gains that follow from it.

    m11 (u' - v r) = X - d_u(u),   m33 r' = N - d_r(r),   d(x) = (a + b |x| + c x^2) x.

The largest moment limits how quickly a vessel can turn. The heading loop has both poles at

    w = sqrt(N_max / (m33 heading_error)),

so that a heading error of heading_error takes the whole moment. The bandwidths of the slower loops around it are shares
of w. Sway decays at s = d_v / m22, and so the course chi follows the heading psi: chi' = s (psi - chi) + ... Where that
is slower than COURSE_SHARE w, the nose leads the course by `lead` times the course error, which gives
chi' = s (1 + lead) (chi* - chi). There is no lead where a yaw rate first pushes the hull outward: it would do harm.
"""

import math
from typing import NamedTuple

from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains
from rl.guidance.controllers.sampled import decaying, place_poles
from taichi_sim.config import NonNegative, Positive
from taichi_sim.usv.vessel import steady_speed

SAMPLED_SHARE = 0.5  # limit of w times the decision interval; assumed
COURSE_SHARE = 0.3  # desired bandwidth of the course, as a share of w; assumed
MOST_LEAD = 3.0  # assumed
LAG_SHARE = 0.25  # limit of the poles of the position loop, as a share of s (1 + lead); assumed
SWAY_SHARE = 0.05  # sway at which its resistance is linearised, as a share of the top speed; assumed


class CourseGains(AvoidanceGains):
    """Gains of track control (course.py), besides those of avoidance."""

    heading_error: Positive = 0.35  # rad
    position_share: Positive = 0.11  # both poles of the position loop, as a share of w
    speed_bandwidth: Positive = 2.0  # rad/s, of the speed loop
    closing_share: Positive = 0.35  # limit of what an error adds to the slot's velocity, as a share of the top speed
    wave_share: NonNegative = 0.15  # share of the waves' push to starboard that a turn compensates


class Resistance(NamedTuple):
    """d(x) = (a + b |x| + c x^2) x (N, N m) against a motion x (m/s, rad/s) relative to the water."""

    a: float
    b: float = 0.0
    c: float = 0.0

    def at(self, x: Tensor) -> Tensor:
        """d(x)."""
        return (self.a + self.b * x.abs() + self.c * x * x) * x

    def steady(self, load: float) -> float:
        """The x > 0 with d(x) = `load` > 0; infinite without resistance."""
        return steady_speed(load, self.a, self.b, self.c)


class VesselDynamics(NamedTuple):
    """Inertia with added mass, resistance, and limits of the actuators."""

    m11: float  # kg
    m22: float  # kg
    m33: float  # kg m^2
    surge: Resistance
    sway: Resistance
    yaw: Resistance
    thrust: float  # N, ahead
    moment: float  # N m, to either side
    sway_yaw: float = 0.0  # d23, N s: sway force lost to a yaw rate

    @property
    def top_speed(self) -> float:
        """Steady speed (m/s) under full thrust."""
        return self.surge.steady(self.thrust)

    @property
    def top_rate(self) -> float:
        """Steady yaw rate (rad/s) under the full moment."""
        return self.yaw.steady(self.moment)

    @property
    def sway_decay(self) -> float:
        """s (1/s)."""
        v = SWAY_SHARE * self.top_speed
        return (self.sway.a + self.sway.b * v + self.sway.c * v * v) / self.m22

    @property
    def turns_outward(self) -> bool:
        """Whether a yaw rate first pushes the hull out of the turn: (1 - m11 / m22) u < d23 / m22 at half speed."""
        return (self.m22 - self.m11) * self.top_speed / 2 < self.sway_yaw

    def slide(self, u: Tensor, rate: Tensor) -> Tensor:
        """Sway (m/s, to port positive) in a steady turn at `rate` (rad/s): d_v(slide) = (m11 u + d23) rate."""
        load = (self.m11 * u + self.sway_yaw) * rate
        a, b = self.sway.a, self.sway.b
        return 2 * load / (a + (a * a + 4 * b * load.abs()).sqrt()).clamp(min=1e-6)


Vessel = VesselDynamics  # its earlier name


class Loops(NamedTuple):
    """Gains of the position loop e' = -k_e e - k_i (integral of e), the speed loop, and the heading loop; all 1/s."""

    k_e: float
    k_i: float  # 1/s^2
    k_u: float
    k_psi: float  # wanted yaw rate per heading error
    k_r: float  # yaw acceleration per error of the yaw rate, besides the resistance to the wanted one
    lead: float  # of the nose over the course, per course error; no unit


def loops(vessel: VesselDynamics, gains: CourseGains, interval: float) -> Loops:
    """Gains of the loops for decisions every `interval` s.

    The heading loop, N = m33 k_r (r* - r) + d_r(r*) with r* = k_psi (psi* - psi), has both its poles at
    exp(-w interval), with the resistance linear (k_r + d) k_psi = k of place_poles.
    """
    w = min(math.sqrt(vessel.moment / (vessel.m33 * gains.heading_error)), SAMPLED_SHARE / interval)
    d = vessel.yaw.a / vessel.m33
    k, k_r = place_poles(decaying(interval, d), w, interval)
    s = max(vessel.sway_decay, 1e-6)
    lead = 0.0 if vessel.turns_outward else min(max(COURSE_SHARE * w / s - 1, 0.0), MOST_LEAD)
    p = min(gains.position_share * w, LAG_SHARE * s * (1 + lead))
    return Loops(
        k_e=2 * p, k_i=p * p, k_u=(1 - math.exp(-gains.speed_bandwidth * interval)) / interval, k_psi=k / (k_r + d),
        k_r=k_r, lead=lead,
    )  # fmt: skip
