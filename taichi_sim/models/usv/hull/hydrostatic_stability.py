"""Hydrostatics of a panelled hull: pressure loads, restoring matrix, equilibrium, righting arm, and a check that it
floats.

A panel of mesh.py is replaced by a few straight strips at the Gauss-Legendre points s_j of its length, along which

    x(t) = c + t u,    dA = w_j (A + t A_t) dt / 2,    t in [-1, 1].

A pressure that is linear in space, and clipped at zero out of the water, has exact averages on a strip,

    m0 = <p>,  m1 = <p t>,  m2 = <p t^2>.

The load on the hull is exactly linear in them:

    force = -w_j (A m0 + A_t m1),    moment = -<x x dA p>  about CO.

Two strips are exact for panels that are wholly wet, including warped ones, and for the force on flat panels that a
water line crosses from side to side. Elsewhere the error is of third order in the panel's length. The kernel therefore
uses two. While the water lies between keel and deck, a hull in still water is then pushed upwards only, and its load is
the gradient of an energy, to five digits. (With one strip per panel the load is wrong by a hundredth, and an undamped
hull would gain energy.) Where decks and keels cross the surface, `Hydrostatics` uses more strips, and both take back
what the strips' errors leave of a force along the surface and of a moment about its normal (an Otter at 20 deg of roll
and 10 of pitch: 1.2 % of its weight). The energy's gradient has neither, so it stays as it is.

A pose is heave z (m, down) of CO below the water, roll phi and pitch theta (rad). G is that of Fossen (2011), sec. 4.2,
with the weight of the hull included. GZ is dU/dphi over the weight, where U is the potential energy at free heave and
trim.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.models.usv.hull.mesh import Panels

HEAVE, ROLL, PITCH = 0, 1, 2  # columns of a pose

Array = NDArray[np.float64]

FINE = 8  # strips per panel; GZ of twin hulls is exact to 1 mm at any heel
STEP = 1e-3  # m and rad, of numerical derivatives; they are of fourth order, so the relative error is 1e-12
MAX_STEP = 0.1  # m and rad, largest step of Newton's method
LEAST_CURVATURE = 1e-3  # smallest curvature of the energy over the weight, which limits a step at a flat minimum
QUADRATURE = 64  # Gauss points for the depth of the centre of buoyancy
LARGEST_LIST = np.pi / 4  # rad; a hull with a larger list does not float upright
MAX_TRIM = 1.4  # rad, of a heeled hull
RELAXATION = (1.0,) * 40 + (0.5,) * 40 + (0.25,) * 80  # of Newton's steps; shorter ones converge at a kink
TOLERANCE = 1e-6  # m and rad
HEEL_STEP = np.deg2rad(1.0)  # largest step of the heel, so that the trim follows
HEEL_GRID = np.deg2rad(np.arange(1.0, 180.0, 1.0))


@dataclass(frozen=True)
class Strips:
    """Strips of a hull's N panels."""

    centre: Array  # [count, N, 3] c, m, b
    up: Array  # [count, N, 3] u, m
    wrench: Array  # [count, N, 3, 6] unit wrenches (force, moment about CO; b) for m0, m1, m2: m^2 and m^3

    @classmethod
    def of(cls, panels: Panels, count: int) -> "Strips":
        """Divide each of `panels` into `count` strips."""
        A_s, A_t = panels.area_slopes
        node, weight = (v[:, None, None] for v in np.polynomial.legendre.leggauss(count))
        c, u = panels.centre + node * panels.along, panels.up + node * panels.twist
        A, A_t = (panels.area + node * A_s) * (weight / 2), A_t * (weight / 2)
        none, cross = np.zeros_like(A), np.cross
        m0 = [A, cross(c, A)]
        m1 = [A_t, cross(u, A) + cross(c, A_t)]
        m2 = [none, cross(u, A_t)]
        return cls(c, u, np.stack([np.concatenate(w, axis=-1) for w in (m0, m1, m2)], axis=-2))


def pressure_moments(p_c: Array, d: Array) -> Array:
    """Averages m0, m1, m2 [..., 3] over strips of a pressure p_c + t d that is clipped at zero."""
    size = np.abs(d)
    p_hi = np.maximum(p_c + size, 0.0)
    wet = p_c >= size
    w = np.where(wet, 1.0, p_hi / np.maximum(2 * size, 1e-300))  # fraction of the strip under water
    m0 = np.where(wet, p_c, p_hi * w / 2)
    m1 = np.where(wet, d / 3, m0 * np.sign(d) * (1 - 2 * w / 3))
    m2 = np.where(wet, p_c / 3, m0 * (1 - 4 * w / 3 + 2 * w * w / 3))
    return np.stack([m0, m1, m2], axis=-1)


def down_in_body(phi: ArrayLike, theta: ArrayLike) -> Array:
    """Unit vector downwards, in b, [..., 3]."""
    phi, theta = np.broadcast_arrays(np.asarray(phi, dtype=np.float64), np.asarray(theta, dtype=np.float64))
    return np.stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)], axis=-1)


@dataclass(frozen=True)
class Hydrostatics:
    """A hull of `mass` (kg) with its centre of gravity at `cg` (m, b) in calm water."""

    panels: Panels
    mass: float
    cg: tuple[float, float, float]
    rho: float = RHO_SEA
    g: float = GRAVITY
    strips: int = FINE  # per panel

    @cached_property
    def _strips(self) -> Strips:
        return Strips.of(self.panels, self.strips)

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.mass * self.g

    def buoyancy(self, pose: ArrayLike) -> Array:
        """Wrench of the water [..., 6] (N, N m, about CO, b) at poses [..., 3] = (heave, roll, pitch).

        It has neither force along the water nor moment about the vertical.
        """
        pose = np.asarray(pose, dtype=np.float64)
        k, load = down_in_body(pose[..., ROLL], pose[..., PITCH]), self.strip_load(pose)
        force, moment = load[..., :3], load[..., 3:]
        up, turn = (np.sum(part * k, axis=-1, keepdims=True) * k for part in (force, moment))
        return np.concatenate([up, moment - turn], axis=-1)

    def strip_load(self, pose: ArrayLike) -> Array:
        """`buoyancy` with the strips' errors."""
        pose = np.asarray(pose, dtype=np.float64)
        k = down_in_body(pose[..., ROLL], pose[..., PITCH])
        strips, p = self._strips, self.rho * self.g
        depth = pose[..., None, :1] + np.einsum("...c,snc->...sn", k, strips.centre)
        moments = pressure_moments(p * depth, p * np.einsum("...c,snc->...sn", k, strips.up))
        return -np.tensordot(moments, strips.wrench, axes=3)

    def loads(self, pose: ArrayLike) -> Array:
        """Wrench of water and weight [..., 6] (N, N m, about CO, b) at poses [..., 3]."""
        pose = np.asarray(pose, dtype=np.float64)
        force = self.weight * down_in_body(pose[..., ROLL], pose[..., PITCH])
        cg = np.broadcast_to(np.asarray(self.cg), force.shape)
        return self.buoyancy(pose) + np.concatenate([force, np.cross(cg, force)], axis=-1)

    def energy_gradient(self, pose: ArrayLike) -> Array:
        """Derivatives of the potential energy [..., 3] (N, N m, N m) with respect to heave, roll and pitch."""
        pose = np.asarray(pose, dtype=np.float64)
        load = self.loads(pose)
        phi = pose[..., ROLL]
        down = np.sum(load[..., :3] * down_in_body(phi, pose[..., PITCH]), axis=-1)
        K, M, N = np.moveaxis(load[..., 3:], -1, 0)
        level = M * np.cos(phi) - N * np.sin(phi)  # about the level axis of pitch
        return -np.stack([down, K, level], axis=-1)

    def stiffness(self, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """Second derivatives of the energy by heave, roll and pitch, [..., 3, 3]; upright, this is G about CO."""
        pose = np.asarray(pose, dtype=np.float64)[..., None, None, :]
        steps = np.array([-2.0, -1.0, 1.0, 2.0])[:, None, None] * STEP * np.eye(3)
        gradients = self.energy_gradient(pose + steps)  # [..., step, of, by]
        return np.einsum("s,...sij->...ji", [1.0, -8.0, 8.0, -1.0], gradients) / (12 * STEP)

    @cached_property
    def volume(self) -> float:
        """Displaced volume at the design waterline, m^3."""
        return float(-self.buoyancy(np.zeros(3))[2] / (self.rho * self.g))

    @cached_property
    def volume_below_deck(self) -> float:
        """Volume of the whole closed hull, m^3."""
        return float(-self.buoyancy(np.array([1e3, 0.0, 0.0]))[2] / (self.rho * self.g))

    @cached_property
    def centre_of_buoyancy(self) -> Array:
        """Centroid of the displaced volume at the design waterline [3], m, b."""
        upright = self.buoyancy(np.zeros(3)) / (self.rho * self.g * self.volume)
        # The depth is the mean volume while the hull is lowered from the air to its waterline.
        node, weight = np.polynomial.legendre.leggauss(QUADRATURE)
        heave = -self.panels.draft * (1 - node) / 2
        volume = -self.buoyancy(heave[:, None] * [1.0, 0.0, 0.0])[:, 2] / (self.rho * self.g)
        return np.array([upright[4], -upright[3], self.panels.draft / 2 * (weight @ volume) / self.volume])

    @cached_property
    def waterplane(self) -> tuple[float, float]:
        """Area (m^2) of the design waterplane, and x of its centroid (LCF, m)."""
        G = self.stiffness()
        return float(G[0, 0] / (self.rho * self.g)), float(-G[0, 2] / G[0, 0])

    @cached_property
    def metacentric_heights(self) -> tuple[float, float]:
        """GM_T and GM_L at the design waterline, m; GM_L is for pitch about the centre of flotation."""
        G = self.stiffness()
        about_flotation = G[2, 2] - G[0, 2] * G[2, 0] / G[0, 0]
        return float(G[1, 1] / self.weight), float(about_flotation / self.weight)

    def settle(self, pose: ArrayLike, free: tuple[bool, bool, bool] = (True, True, True)) -> Array:
        """Poses [..., 3] of least potential energy near `pose`; components that are not `free` stay.

        Newton's method with absolute values of the curvatures goes downhill, and so leaves maxima.
        """
        pose = np.array(pose, dtype=np.float64)
        index = np.flatnonzero(free)
        for relaxation in RELAXATION:
            H = self.stiffness(pose)[..., index[:, None], index]
            value, axes = np.linalg.eigh((H + np.swapaxes(H, -1, -2)) / 2)
            size = np.maximum(np.abs(value), LEAST_CURVATURE * self.weight)
            gradient = self.energy_gradient(pose)[..., index, None]
            step = -relaxation * (axes @ ((np.swapaxes(axes, -1, -2) @ gradient) / size[..., None])).squeeze(-1)
            step *= np.minimum(1.0, MAX_STEP / np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-300))
            before = pose.copy()
            pose[..., index] += step
            pose[..., PITCH] = np.clip(pose[..., PITCH], -MAX_TRIM, MAX_TRIM)
            change = np.abs(pose - before).max()
            if change < TOLERANCE:
                return pose
        raise ValueError(f"the hull has no equilibrium after {len(RELAXATION)} iterations: last change {change:.1e}")

    @cached_property
    def equilibrium(self) -> Array:
        """Heave (m), roll and pitch (rad) [3] at which the hull comes to rest from upright."""
        return self.settle(np.zeros(3))

    def righting_arm(self, heel: ArrayLike) -> Array:
        """GZ (m) [...] at heel angles (rad), with free heave and trim; a positive GZ rights the hull.

        Heave and trim are followed from upright, because a hull may float at two trims at a large heel.
        """
        heel = np.asarray(heel, dtype=np.float64)
        flat, GZ = heel.ravel(), np.zeros(heel.size)
        for side in (1, -1):
            to_side = np.flatnonzero(side * flat >= 0)
            order = to_side[np.argsort(side * flat[to_side])]
            for i, pose in zip(order, self._heeled(flat[order]), strict=True):
                GZ[i] = self.energy_gradient(pose)[1] / self.weight
        return GZ.reshape(heel.shape)

    def _heeled(self, heels: Array) -> Iterator[Array]:
        """Poses at `heels` (rad), each followed from the previous one, beginning upright."""
        pose, last = np.zeros(3), 0.0
        for heel in heels:
            steps = max(int(np.ceil(abs(heel - last) / HEEL_STEP)), 1)
            for pose[1] in np.linspace(last, heel, steps + 1)[1:]:
                pose = self.settle(pose, free=(True, False, True))
            last = heel
            yield pose

    @cached_property
    def angle_of_vanishing_stability(self) -> float:
        """First heel (rad) to starboard beyond upright at which GZ falls to zero; pi if none."""
        listed = float(self.equilibrium[1])
        heels, last, GZ_last = HEEL_GRID[listed < HEEL_GRID], 0.0, 0.0
        for heel, pose in zip(heels, self._heeled(heels), strict=True):
            GZ = float(self.energy_gradient(pose)[1])
            if GZ <= 0:
                return float(last + (heel - last) * GZ_last / (GZ_last - GZ)) if GZ_last > 0 else float(heel)
            last, GZ_last = heel, GZ
        return float(np.pi)

    def freeboard(self, pose: ArrayLike) -> Array:
        """Height (m) [...] of the lowest deck corner above the water at poses [..., 3]."""
        pose = np.asarray(pose, dtype=np.float64)
        depth = pose[..., HEAVE, None] + down_in_body(pose[..., ROLL], pose[..., PITCH]) @ self.panels.deck.T
        return -depth.max(axis=-1)


def check_floats(hull: Hydrostatics) -> None:
    """Refuse a hull that sinks, capsizes or puts its deck under water."""
    afloat = hull.rho * hull.volume_below_deck
    if hull.mass >= afloat:
        raise ValueError(
            f"the hull sinks: its mass of {hull.mass:.4g} kg is above the {afloat:.4g} kg that it displaces up to its "
            "deck; lower the mass or enlarge draft, freeboard or beam"
        )
    pose = hull.equilibrium
    heave, roll_deg, pitch_deg = pose[0], *np.rad2deg(pose[1:])
    GM = float(np.linalg.eigvalsh(hull.stiffness(pose)[1:, 1:] / hull.weight).min())
    if GM <= 0 or np.prod(np.cos(pose[1:])) < np.cos(LARGEST_LIST):
        raise ValueError(
            f"the hull has no stable upright attitude: afloat it has GM = {GM:.3f} m, roll {roll_deg:.1f} deg and "
            f"pitch {pitch_deg:.1f} deg; lower the centre of gravity (z = {hull.cg[2]:.3f} m, positive down), "
            "bring it nearer to the middle, or widen the hull"
        )
    dry = float(hull.freeboard(pose))
    if dry <= 0:
        raise ValueError(
            f"the hull puts its deck {-dry:.3f} m under water at rest (heave {heave:.3f} m, roll {roll_deg:.1f} deg, "
            f"pitch {pitch_deg:.1f} deg); lower the mass of {hull.mass:.4g} kg, move the centre of gravity "
            f"x = {hull.cg[0]:.3f} m towards the centre of buoyancy x = {hull.centre_of_buoyancy[0]:.3f} m, or raise "
            "the freeboard"
        )
