"""Parameters of a `hull_6dof` vehicle file, and the numbers of kernels: compiled in, or of each vehicle if they vary.

Frame b is forward-right-down with its origin CO midships, on the centreline, at the design waterline. Mass and CG
affect everything that depends on them: M_rb (rigid_body.changed_mass) and the weight, and through it the draught, list
and trim of a hull on panels. `restoring = "linear"` keeps the published G, so mass does not change the draught there.
"""

from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Annotated, Any, Literal, Protocol

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from taichi_sim.config import Finite, NonNegative, NonPositive, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.kernels.rigid_body import changed_mass, rigid_body_mass
from taichi_sim.models.contact.deck_and_legs import Deck
from taichi_sim.models.usv.hull.mesh import HullShape
from taichi_sim.models.usv.hull.thrusters import MOST_THRUSTERS, NamedThruster, PropellerPair, Thruster
from taichi_sim.models.usv.mmg import DERIVATIVES, OF_PARTS, part_numbers, polynomial_numbers
from taichi_sim.models.usv.mmg_params import MmgSection
from taichi_sim.models.usv.vessel_base import (
    RHO_AIR,
    Beam,
    CollisionRadius,
    Height,
    Length,
    Number,
    TopSpeed,
    WaterDensity,
    Windage,
    steady_speed,
)
from taichi_sim.vehicle import VehicleParams, left_of

AddedMass6 = tuple[  # -X_udot, -Y_vdot, -Z_wdot (kg), -K_pdot, -M_qdot, -N_rdot (kg m^2)
    Annotated[NonNegative, Plausible(5e-3, 1.5, "kg", of="mass")],
    Annotated[NonNegative, Plausible(0.03, 5.0, "kg", of="mass")],
    Annotated[NonNegative, Plausible(0.05, 15.0, "kg", of="mass")],
    Annotated[NonNegative, Plausible(2e-3, 1.0, "kg m^2", of="mass beam^2")],
    Annotated[NonNegative, Plausible(5e-3, 1.0, "kg m^2", of="mass length^2")],
    Annotated[NonNegative, Plausible(2e-3, 1.0, "kg m^2", of="mass length^2")],
]
Linear6 = tuple[  # -X_u ... (N s/m, N m s); g^0.5 length^-0.5 is the rate of motion in waves of the hull's length
    Annotated[NonNegative, Plausible(3e-4, 1.5, "N s/m", of="mass g^0.5 length^-0.5")],
    Annotated[NonNegative, Plausible(0.05, 100.0, "N s/m", of="linear.0")],
    Annotated[NonNegative, Plausible(0.03, 30.0, "N s/m", of="mass g^0.5 length^-0.5")],
    Annotated[NonNegative, Plausible(5e-4, 1.0, "N m s", of="mass g^0.5 length^-0.5 beam^2")],
    Annotated[NonNegative, Plausible(1e-3, 3.0, "N m s", of="mass g^0.5 length^1.5")],
    Annotated[NonNegative, Plausible(1e-3, 1.2, "N m s", of="linear.1 length^2")],
]
Quadratic6 = tuple[  # -X_uu ... (N s^2/m^2, N m s^2), factors of |nu| nu
    Annotated[NonNegative, Plausible(3e-4, 0.3, "N s^2/m^2", of="rho_sea length beam")],
    Annotated[NonNegative, Plausible(0.02, 3.0, "N s^2/m^2", of="rho_sea length draft")],
    Annotated[NonNegative, Plausible(0.02, 5.0, "N s^2/m^2", of="rho_sea length beam")],
    Annotated[NonNegative, Plausible(1e-5, 0.5, "N m s^2", of="rho_sea length beam^4")],
    Annotated[NonNegative, Plausible(5e-4, 0.5, "N m s^2", of="rho_sea beam length^4")],
    Annotated[NonNegative, Plausible(3e-4, 1.0, "N m s^2", of="rho_sea draft length^4")],
]
Roll = Annotated[Finite, Plausible(0.02, 0.8, "kg m^2", of="mass beam^2")]
Pitch = Yaw = Annotated[Finite, Plausible(0.01, 0.4, "kg m^2", of="mass length^2")]
Weight = Annotated[Finite, Plausible(0.99, 1.01, "kg", of="mass")]
Arm = Annotated[Finite, Plausible(-1.0, 1.0, "kg m", of="mass length")]
Product = Annotated[Finite, Plausible(-0.5, 0.5, "kg m^2", of="mass beam length")]
Matrix = tuple[
    tuple[Weight, Arm, Arm, Arm, Arm, Arm],
    tuple[Arm, Weight, Arm, Arm, Arm, Arm],
    tuple[Arm, Arm, Weight, Arm, Arm, Arm],
    tuple[Arm, Arm, Arm, Roll, Product, Product],
    tuple[Arm, Arm, Arm, Product, Pitch, Product],
    tuple[Arm, Arm, Arm, Product, Product, Yaw],
]
Position = tuple[
    Annotated[Finite, Plausible(5e-4, 0.5, "m", of="length", either=True)],
    Annotated[Finite, Plausible(5e-4, 0.5, "m", of="beam", either=True)],
    Annotated[Finite, Plausible(5e-4, 1.5, "m", of="height", either=True)],
]
RollArm = Annotated[Positive, Plausible(0.1, 0.8, "m", of="beam")]
LongArm = Annotated[Positive, Plausible(0.1, 0.6, "m", of="length")]
Name = Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$")]
OFF_MASS = 5e-3  # tolerated rounding of a published M_rb, over mass, or mass times |cg|; assumed
REACH = 1.0  # m, least |cg| there
ASYMMETRY = 1e-6  # tolerated asymmetry of a published M_rb over its largest entry, from its rounding
COUPLED = ((0, 4), (1, 3), (1, 5), (2, 4), (3, 5))  # entries of AddedCoupling
OVERHANG = 1.1  # limit of a thruster's position over that of the hull's side, for outboard engines; assumed


class RigidBody(Strict):
    """Mass and its distribution: radii of gyration about the CG, or a published matrix."""

    mass: Annotated[Positive, Plausible(0.02, 1.3, "kg", of="rho_sea length beam draft")]  # payload included
    cg: Position  # payload included
    gyration: tuple[RollArm, LongArm, LongArm] | None = None  # about the CG, for roll, pitch, yaw
    M_rb: Matrix | None = None  # 6 x 6 about CO, symmetric, where a source gives it

    def _mistakes(self) -> Iterator[str]:
        if (self.gyration is None) == (self.M_rb is None):
            yield "give either gyration or M_rb"
        if self.M_rb is not None:
            M = np.array(self.M_rb)
            if np.abs(M - M.T).max() > ASYMMETRY * np.abs(M).max():
                yield "M_rb must be symmetric: row i, column j as row j, column i"
            own = rigid_body_mass(self.mass, self.cg, np.zeros((3, 3)))
            reach = max(REACH, float(np.linalg.norm(self.cg)))
            for i, j in np.argwhere(np.abs(M - own)[:3] > OFF_MASS * self.mass * np.array([1.0] * 3 + [reach] * 3)):
                yield (
                    f"M_rb[{i}][{j}] = {M[i, j]:g}, and mass and cg make it {own[i, j]:g}: M_rb holds these, too; "
                    "change all three, or give gyration in place of M_rb"
                )
            if np.linalg.eigvalsh(M)[0] <= 0:
                yield "M_rb is not positive definite: its inertia is too small for mass and cg"

    @property
    def matrix(self) -> np.ndarray:
        """M_rb [6, 6]."""
        if self.M_rb is not None:
            return np.array(self.M_rb)
        return rigid_body_mass(self.mass, self.cg, self.mass * np.diag(np.square(np.array(self.gyration))))


class AddedCoupling(Strict):
    """Entries of M_a beside its diagonal, about CO: those that a hull with port and starboard alike has."""

    surge_pitch: Annotated[Finite, Plausible(-1.0, 1.0, "kg m", of="mass length")] = 0.0  # -X_qdot
    sway_roll: Annotated[Finite, Plausible(-3.0, 3.0, "kg m", of="mass beam")] = 0.0  # -Y_pdot
    sway_yaw: Annotated[Finite, Plausible(-2.0, 2.0, "kg m", of="mass length")] = 0.0  # -Y_rdot
    heave_pitch: Annotated[Finite, Plausible(-5.0, 5.0, "kg m", of="mass length")] = 0.0  # -Z_qdot
    roll_yaw: Annotated[Finite, Plausible(-1.0, 1.0, "kg m^2", of="mass beam length")] = 0.0  # -K_rdot

    @property
    def entries(self) -> dict[tuple[int, int], float]:
        """Entries of the upper triangle by row and column."""
        return dict(zip(COUPLED, (value for _, value in self), strict=True))


class Lift(Strict):
    """Lift of a hull at speed u, beyond Coriolis and Munk loads of its added mass:

        Y = Y_uv |u| v + Y_ur u r,   N = N_uv u v + N_ur |u| r.
    """

    # 0: no lift
    Y_uv: Annotated[NonPositive, Plausible(-20.0, -1e-3, "kg/m", of="rho_sea draft^2")] = 0.0
    Y_ur: Annotated[Finite, Plausible(-10.0, 10.0, "kg", of="rho_sea draft^2 length")] = 0.0
    N_uv: Annotated[Finite, Plausible(-10.0, 10.0, "kg", of="rho_sea draft^2 length")] = 0.0
    N_ur: Annotated[NonPositive, Plausible(-10.0, -2e-4, "kg m", of="rho_sea draft^2 length^2")] = 0.0

    def _mistakes(self) -> Iterator[str]:
        if 4 * self.Y_uv * self.N_ur < (self.Y_ur + self.N_uv) ** 2:
            yield "gives energy to the hull: (Y_ur + N_uv)^2 must be at most 4 Y_uv N_ur"


class Hydrodynamics(Strict):
    """Added mass and damping about CO, for the motion relative to the water.

    With `radiation = "constant"`, added mass and damping are the same at every frequency, and represent radiation and
    diffraction. With `radiation = "memory"`, both come from a boundary-element `database` (radiation.py), and this
    section adds the rest:

    - `added_mass` and `added_coupling` are for Coriolis and Munk loads only, so they are those of slow motion.
    - `linear` counts in full in surge, sway and yaw, where slow motion radiates nothing. In heave, roll and pitch it
      counts as far as it exceeds the radiation at the natural frequency, because a published linear damping includes
      that.
    - `quadratic` and cross-flow count in full.
    - `lift` counts in full.
    - `damping_relative_to` says which velocity `linear` and `quadratic` take: that relative to the water, with the
      waves' orbital motion, or that relative to the current alone (over ground where there is none). Codes that compute
      RAOs add damping to the hull's own motion: "current". Cross-flow drag always takes the water's.

    With `restoring = "linear"`, for comparison with published codes, radiation is always constant.
    """

    radiation: Literal["constant", "memory"] = "constant"
    database: str | None = None  # NAME.hydro.json, in the folder of the vehicle file (tools/hydrodynamics.py)
    drift: bool = False  # mean and slowly varying wave drift of the database, by Newman's approximation
    added_mass: AddedMass6
    added_coupling: AddedCoupling = AddedCoupling()
    linear: Linear6
    quadratic: Quadratic6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    damping_relative_to: Literal["water", "current"] = "water"
    # of the strip integral; 0: no cross-flow drag
    cross_flow_length: Annotated[NonNegative, Plausible(0.3, 1.2, "m", of="length")] = 0.0
    cross_flow_draft: Annotated[NonNegative, Plausible(0.1, 2.5, "m", of="draft")] = 0.0  # of two hulls: both
    # 2-D drag coefficient of a section (Hoerner 1965)
    cross_flow_coefficient: Annotated[NonNegative, Plausible(0.1, 4.0)] = 0.0  # of two hulls: both
    cross_flow_strips: Annotated[int, Field(ge=2, le=101)] = 21  # including both ends; width = length / (strips - 1)
    cross_flow_density: WaterDensity = RHO_SEA  # kg/m^3
    lift: Lift = Lift()

    def _mistakes(self) -> Iterator[str]:
        if np.linalg.eigvalsh(self.M_a)[0] < -ASYMMETRY * np.abs(self.M_a).max():
            yield "added_coupling is too large for added_mass: together they are not positive definite"
        if self.radiation == "memory" and self.database is None:
            yield 'radiation = "memory" needs a database: NAME.hydro.json, made by tools/hydrodynamics.py'
        if self.drift and self.radiation != "memory":
            yield 'drift = true needs radiation = "memory"'
        if self.damping_relative_to == "current" and self.radiation != "memory":
            yield (
                'damping_relative_to = "current" needs radiation = "memory": constant damping is also diffraction'
            )

    @property
    def has_cross_flow(self) -> bool:
        """Whether the strip integral has a drag."""
        return self.cross_flow_length > 0 and self.cross_flow_coefficient > 0

    @property
    def M_a(self) -> np.ndarray:  # noqa: N802
        """Added-mass matrix about CO, [6, 6]."""
        M = np.diag(self.added_mass)
        for (i, j), value in self.added_coupling.entries.items():
            M[i, j] = M[j, i] = value
        return M


class LinearRestoring(Strict):
    """`restoring = "linear"`: -G eta of the source, and the payload as a weight (PythonVehicleSimulator's otter)."""

    G33: Annotated[Positive, Plausible(0.05, 1.3, "N/m", of="rho_sea g length beam")]
    G44: Annotated[Positive, Plausible(0.01, 10.0, "N m", of="mass g beam")]
    G55: Annotated[Positive, Plausible(0.05, 20.0, "N m", of="mass g length")]
    G35: Annotated[Finite, Plausible(1e-3, 0.3, "N", of="rho_sea g length^2 beam", either=True)] = 0.0
    # kg; the source adds its weight to -G eta
    payload_mass: Annotated[NonNegative, Plausible(5e-3, 1.0, "kg", of="mass")] = 0.0
    payload_position: Position = (0.0, 0.0, 0.0)


class Hull6DofParams(VehicleParams):
    """Parameters of a vehicle file of `hull_6dof`."""

    length: Length  # overall
    beam: Beam  # overall
    height: Height  # keel to the highest part (for drawing)
    collision_radius: CollisionRadius
    restoring: Literal["panels", "linear"] = "panels"
    current_frame: Literal["body", "heading"] = "body"  # "heading": the source's own, level frame
    actions: Literal["surge_yaw", "left_right", "wrench", "units", "propeller_rudder"] = "surge_yaw"
    rigid_body: RigidBody
    hydrodynamics: Hydrodynamics
    hull: HullShape
    linear: LinearRestoring | None = None
    thrusters: PropellerPair | None = None
    actuators: Annotated[dict[Name, NamedThruster], Field(max_length=MOST_THRUSTERS)] = {}
    mmg: MmgSection | None = None
    windage: Windage = Windage()
    deck: Deck | None = None  # for aircraft that land on it (contact/deck_and_legs.py)

    def _mistakes(self) -> Iterator[str]:
        if self.restoring == "linear" and self.linear is None:
            yield 'restoring = "linear" needs the section [linear]'
        yield from self._unfit_thrusters()
        if self.deck:
            yield from self.deck.outside(self.length, self.beam)

    def __hash__(self) -> int:
        """Hash as every frozen model, with the dictionary of thrusters as pairs, because a dict has no hash."""
        return hash(tuple(tuple(x.items()) if isinstance(x, dict) else x for x in self.__dict__.values()))

    def _unfit_thrusters(self) -> Iterator[str]:
        """Impossible thrusters, and actions that do not suit them."""
        if self.mmg and (self.thrusters or self.actuators):
            yield "give either [mmg], propellers and rudders, or [thrusters], or [actuators.NAME]"
        if (self.mmg is not None) != (self.actions == "propeller_rudder"):
            yield (
                f'actions = "{self.actions}": with [mmg] write actions = "propeller_rudder" (revolutions of each '
                "propeller, rudder), which is for [mmg] alone"
            )
        yield from self._unfit_damping()
        if self.thrusters and self.actuators:
            yield "give either [thrusters], two propellers, or [actuators.NAME], each by itself"
        h = self.hydrodynamics
        if self.all_thrusters and not h.linear[0] and not h.quadratic[0]:
            yield "hydrodynamics.linear, quadratic: a hull with thrusters needs damping in surge, the first"
        x_max, y_max = OVERHANG * self.length / 2, OVERHANG * self.beam / 2
        for thruster in self.all_thrusters:
            x, y, _ = thruster.position
            if abs(x) > x_max or abs(y) > y_max:
                name = f"actuators.{thruster.name}.position" if self.actuators else f"thrusters.{thruster.name}"
                yield (
                    f"{name} = {thruster.position} is outside the hull: |x| must be at most "
                    f"{x_max:.3g} m and |y| at most {y_max:.3g} m (length {self.length}, beam {self.beam})"
                )
        if self.thrusters and self.thrusters.left[1] >= self.thrusters.right[1]:
            yield "thrusters.left must be to port of thrusters.right: its y must be smaller"
        if self.actuators and self.actions in ("surge_yaw", "left_right"):
            yield (
                f'actions = "{self.actions}" is for the two propellers of [thrusters]; for [actuators] write '
                'actions = "wrench" (surge, sway, yaw) or "units" (each thruster)'
            )
        for thruster in self.all_thrusters:
            if self.actions == "wrench" and thruster.azimuth and not thruster.reaches_round:
                yield (
                    f'actions = "wrench" needs an actuators.{thruster.name} that pushes every way: a range_deg of 180 '
                    'degrees or more and a thrust_min below 0, or no range_deg; or write actions = "units"'
                )

    def _unfit_damping(self) -> Iterator[str]:
        """Damping of surge, sway and yaw beside a polynomial, and propellers without resistance."""
        h = self.hydrodynamics
        planar = [f"{name}[{i}]" for name in ("linear", "quadratic") for i in (0, 1, 5) if getattr(h, name)[i] != 0]
        planar += [name for name, value in (("cross_flow_length", h.cross_flow_length), ("lift", h.lift.Y_uv)) if value]
        if self.mmg and self.mmg.hull and planar:
            given = ", ".join(planar)
            yield (
                f"hydrodynamics.{given}: must be 0, for [mmg.hull] holds all damping of surge, sway and yaw"
            )
        if self.mmg and not 0 < self.mmg.steady_speed(h.linear[0], h.quadratic[0]) < np.inf:
            yield "mmg.propeller.k_0, k_1, k_2 with the resistance give no steady speed at n_ahead"

    @property
    def all_thrusters(self) -> tuple[Thruster, ...]:
        """All thrusters, from either section."""
        if self.thrusters:
            return self.thrusters.both
        return tuple(given.thruster(name) for name, given in self.actuators.items())

    @property
    def gains(self) -> tuple[float, ...]:
        """Gains of `all_thrusters`."""
        if self.thrusters:
            return self.thrusters.gain_left, self.thrusters.gain_right
        return tuple(given.gain for given in self.actuators.values())

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return self.rigid_body.mass

    @property
    def draft(self) -> Annotated[float, Plausible(0.02, 1.5, "m", of="beam")]:
        """Depth of the keel below the design waterline, m."""
        return self.hull.depth

    @property
    def top_speed(self) -> TopSpeed:
        """Speed (m/s) of a straight run with all thrusters, or with the propellers of [mmg]; 0 without any."""
        h = self.hydrodynamics
        if self.mmg:
            return self.mmg.steady_speed(h.linear[0], h.quadratic[0])
        force = sum(t.ahead for t in self.all_thrusters)
        return steady_speed(force, h.linear[0], h.quadratic[0]) if force else 0.0

    @property
    def M_rb(self) -> np.ndarray:  # noqa: N802
        """Rigid-body mass matrix about CO, [6, 6]."""
        return self.rigid_body.matrix

    @property
    def M_a(self) -> np.ndarray:  # noqa: N802
        """Added-mass matrix about CO, [6, 6]."""
        return self.hydrodynamics.M_a

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.rigid_body.mass * GRAVITY


def mass_followed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of a vehicle file with `changes`; a published M_rb follows a change of mass or CG alone (`changed_mass`)."""
    old, new = data.get("rigid_body"), changes.get("rigid_body")
    if isinstance(old, dict) and isinstance(new, dict) and old.get("M_rb") and new.get("M_rb") == old["M_rb"]:
        with suppress(TypeError, ValueError, KeyError, IndexError):  # wrong values are told by their own names
            M_rb = changed_mass(old["M_rb"], old["mass"], old["cg"], float(new["mass"]), [float(x) for x in new["cg"]])
            changes = {**changes, "rigid_body": {**new, "M_rb": tuple(map(tuple, M_rb))}}
    return {**data, **changes}


MASS, LAG = "rigid_body.mass", "thrusters.lag"
CG = tuple(f"rigid_body.cg.{i}" for i in range(3))
ADDED_MASS, LINEAR, QUADRATIC = (
    tuple(f"hydrodynamics.{name}.{i}" for i in range(6)) for name in ("added_mass", "linear", "quadratic")
)
CROSS_FLOW = "hydrodynamics.cross_flow_coefficient"
LIFT = tuple(f"hydrodynamics.lift.{name}" for name in Lift.model_fields)
GAINS = ("thrusters.gain_left", "thrusters.gain_right")
DECK_FRICTION = "deck.friction"
AREAS = ("windage.frontal_area", "windage.lateral_area")
UPPER = tuple((i, j) for i in range(6) for j in range(i, 6))  # entries of a symmetric 6 x 6 matrix

FIELDS = (
    "dt",  # physics step, s
    "weight",  # N
    *(f"cg_{i}" for i in range(3)),  # m, b
    *(f"added_{i}" for i in range(6)),  # diagonal of M_a, kg, kg m^2
    *(f"linear_{i}" for i in range(6)),  # damping, N s/m, N m s
    *(f"quadratic_{i}" for i in range(6)),  # N s^2/m^2, N m s^2
    "wind_x", "wind_y", "wind_n",  # factors of products of relative wind speeds (vessel.py), N s^2/m^2, N s^2/m
    *(f"M_rb_{i}{j}" for i, j in UPPER),
    *(f"inverse_{i}{j}" for i, j in UPPER),  # inverse of M_rb + M_a
)  # fmt: skip
THRUSTER_FIELDS = (  # for each thruster k (`THRUSTER_FIELDS`_k), after FIELDS
    "keep_half", "keep",  # share of its speed's deviation from the command that is left after half a step, after one
    "gain",  # factor of its thrust
)  # fmt: skip


@cache
def numbers_of(thrusters: int, more: tuple[str, ...] = ()) -> Callable[..., tuple[Number, ...]]:
    """NamedTuple type of a hull with this many thrusters, and the fields `more` of cross-flow drag, lift, propellers
    and rudders (see `FIELDS`); its entries are floats, or tensors of one shape.
    """
    fitted = (f"{name}_{k}" for name in THRUSTER_FIELDS for k in range(thrusters))
    return namedtuple("HullNumbers", (*FIELDS, *fitted, *more))


def varying_keys(p: Hull6DofParams) -> tuple[str, ...]:
    """Keys of the vehicle file that may differ between environments."""
    gains, lags = thruster_keys(p)
    thrusters = (*gains, *dict.fromkeys(lags))
    deck = (DECK_FRICTION,) if p.deck else ()  # contact/between_teams.py reads it
    flow = flow_fields(p).values()
    return (MASS, *CG, *ADDED_MASS, *LINEAR, *QUADRATIC, *flow, *thrusters, *mmg_keys(p), *AREAS, *deck)


def flow_fields(p: Hull6DofParams) -> dict[str, str]:
    """Fields of cross-flow drag and lift, and their keys, of a hull that has them."""
    drag = {"cross_flow": CROSS_FLOW} if p.hydrodynamics.has_cross_flow else {}
    return drag | (dict(zip(Lift.model_fields, LIFT, strict=True)) if p.hydrodynamics.lift.Y_uv < 0 else {})


def mmg_keys(p: Hull6DofParams) -> tuple[str, ...]:
    """Keys of propellers, rudders and polynomial."""
    if p.mmg is None:
        return ()
    derivatives = tuple(f"hull.{name}" for name in DERIVATIVES) if p.mmg.hull else ()
    return tuple(f"mmg.{key}" for key in (*derivatives, *OF_PARTS))


def mmg_numbers(p: Hull6DofParams, dt: float, values: Mapping[str, Number]) -> dict[str, Number]:
    """Compute numbers of one propeller, one rudder and the polynomial (usv/mmg.py), by field."""
    m = p.mmg
    if m is None:
        return {}
    own = {key.removeprefix("mmg."): values[key] for key in mmg_keys(p)}
    found = part_numbers(own, m.propeller, m.rudder, 1, 1, m.length, m.density, dt)
    return found | (polynomial_numbers(own, m.length, m.draft, m.density) if m.hull else {})


def thruster_keys(p: Hull6DofParams) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keys of the thrusters' gains, and of their lags."""
    if p.thrusters:
        return GAINS, (LAG, LAG)
    return tuple(f"actuators.{name}.gain" for name in p.actuators), tuple(f"actuators.{n}.lag" for n in p.actuators)


class AddedMass(Protocol):
    """What numbers of a hull take of its radiation (radiation.py)."""

    inertia: np.ndarray  # [6, 6] added mass that acts at once
    counted: np.ndarray  # [6] linear damping that is counted elsewhere

    def inertia_change(self, change: Sequence[Number]) -> Sequence[Number]:
        """Changes of the diagonal by changes of the file's added mass."""
        ...


def hull_numbers(
    p: Hull6DofParams, radiation: AddedMass, dt: float, values: Mapping[str, Number]
) -> tuple[Number, ...]:
    """Compute the kernel's numbers of a hull for a step `dt` (s), from `values` (floats or float64 tensors)."""
    mass, cg = values[MASS], [values[key] for key in CG]
    added, linear, quadratic = ([values[key] for key in keys] for keys in (ADDED_MASS, LINEAR, QUADRATIC))
    M_rb = changed_mass(p.M_rb, p.rigid_body.mass, p.rigid_body.cg, mass, cg)
    M = [[M_rb[i][j] + float(radiation.inertia[i, j]) for j in range(6)] for i in range(6)]
    change = [value - nominal for value, nominal in zip(added, p.hydrodynamics.added_mass, strict=True)]
    for i, more in enumerate(radiation.inertia_change(change)):
        M[i][i] = M[i][i] + more
    linear = [_beyond(value, float(counted)) for value, counted in zip(linear, radiation.counted, strict=True)]
    inverse = _inverse(M)
    w, (frontal, lateral) = p.windage, (values[key] for key in AREAS)
    gains, lags = ([values[key] for key in keys] for keys in thruster_keys(p))
    more = {field: values[key] for field, key in flow_fields(p).items()} | mmg_numbers(p, dt, values)
    return numbers_of(len(gains), tuple(more))(
        dt, mass * GRAVITY, *cg, *added, *linear, *quadratic,
        0.5 * RHO_AIR * w.c_x * frontal, 0.5 * RHO_AIR * w.c_y * lateral, RHO_AIR * w.c_n * lateral * p.length,
        *(M_rb[i][j] for i, j in UPPER), *(inverse[i][j] for i, j in UPPER),
        *(left_of(0.5 * dt, lag) for lag in lags), *(left_of(dt, lag) for lag in lags), *gains, *more.values(),
    )  # fmt: skip


def _beyond(value: Number, counted: float) -> Number:
    """The part of a damping that is not in `counted`."""
    if counted == 0.0:
        return value
    return (value - counted).clamp(min=0.0) if isinstance(value, Tensor) else max(value - counted, 0.0)


def _inverse(rows: list[list[Number]]) -> Sequence[Sequence[Number]]:
    """Inverse of a 6 x 6 matrix of floats, or of floats and tensors of one shape; the entries are of the same kind."""
    entries = [x for row in rows for x in row]
    given = next((x for x in entries if isinstance(x, Tensor)), None)
    if given is None:
        return np.linalg.inv(np.array(rows)).tolist()
    whole = torch.stack([torch.as_tensor(x, dtype=given.dtype, device=given.device).expand_as(given) for x in entries])
    inverse = torch.linalg.inv(whole.movedim(0, -1).unflatten(-1, (6, 6)))
    return [row.unbind(-1) for row in inverse.unbind(-2)]


# -- inside `ti.static`: `p` is a HullNumbers, or the struct with those of one vehicle -----------------------------


def vector(p: object, name: str, size: int) -> tuple[Number, ...]:
    """The numbers `name`_0, `name`_1, ..."""
    return tuple(getattr(p, f"{name}_{i}") for i in range(size))


def added_mass(p: object, h: Hydrodynamics) -> tuple[tuple[Number, ...], ...]:
    """Rows of M_a: its diagonal is of each vehicle, the rest of the file."""
    beside = h.M_a.tolist()
    return tuple(tuple(x if i == j else beside[i][j] for j in range(6)) for i, x in enumerate(vector(p, "added", 6)))


def symmetric(p: object, name: str) -> tuple[tuple[Number, ...], ...]:
    """Rows of the symmetric 6 x 6 matrix `name`_ij."""
    return tuple(tuple(getattr(p, f"{name}_{min(i, j)}{max(i, j)}") for j in range(6)) for i in range(6))
