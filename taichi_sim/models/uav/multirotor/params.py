"""Parameters of a multirotor's vehicle file (configs/vehicles/x500.toml is an example), and numbers of its equations.

Places are in the airframe's own frame: the axes of b (forward, right, down) from any origin. The origin of the state is
the centre of gravity, `physical.cg` in that frame.
"""

import math
from collections import namedtuple
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.models.contact.deck_and_legs import Legs
from taichi_sim.vehicle import Number, VehicleParams, left_of, value_at

MOST_ROTORS = 12
HOUR, MILLI = 3600.0, 1e-3  # s; of a unit
APART = 1e-3  # m: rotors of the same spin that are closer than this are a mistake in the file
Offset = Annotated[Finite, Plausible(1e-5, 0.3, "m", of="reach", either=True)]  # of the CG
Arm = Annotated[Finite, Plausible(5e-3, 1.5, "m", of="reach", either=True)]  # of a rotor
Rise = Annotated[Finite, Plausible(1e-3, 2.0, "m", of="reach", either=True)]
Drag = Annotated[NonNegative, Plausible(2e-3, 3.0, "N s^2/m^2", of="physical.rho reach^2")]
Across = Annotated[Positive, Plausible(0.5, 4.0, "m", of="reach")]
Height = Annotated[Positive, Plausible(0.05, 4.0, "m", of="reach")]
Actions = Literal["rotors", "rates", "velocity"]


class MultirotorPhysical(Strict):
    """Mass, inertia about the centre of gravity, drag of the fuselage, and the air."""

    mass: Annotated[Positive, Plausible(0.02, 300.0, "kg")]  # rotors included
    Jx: Annotated[Positive, Plausible(5e-3, 1.0, "kg m^2", of="mass reach^2")]  # rotors included as if they stood still
    Jy: Annotated[Positive, Plausible(5e-3, 1.0, "kg m^2", of="mass reach^2")]
    Jz: Annotated[Positive, Plausible(5e-3, 1.5, "kg m^2", of="mass reach^2")]
    # kg m^2; inertia [[Jx, -Jxy, -Jxz], [-Jxy, Jy, -Jyz], [-Jxz, -Jyz, Jz]]
    Jxy: Annotated[Finite, Plausible(-0.7, 0.7, "kg m^2", of="Jx")] = 0.0
    Jxz: Annotated[Finite, Plausible(-0.7, 0.7, "kg m^2", of="Jx")] = 0.0
    Jyz: Annotated[Finite, Plausible(-0.7, 0.7, "kg m^2", of="Jx")] = 0.0
    cg: tuple[Offset, Offset, Offset]  # centre of gravity in the airframe's frame, m
    drag: tuple[Drag, Drag, Drag]  # along x, y, z: force = -|v| drag v, N s^2/m^2
    # density of the air, kg/m^3: for induced velocities, not for thrust
    rho: Annotated[Positive, Plausible(0.3, 1.6, "kg/m^3")] = 1.225

    @property
    def inertia(self) -> np.ndarray:
        """Inertia [3, 3], kg m^2."""
        return np.array(
            [[self.Jx, -self.Jxy, -self.Jxz], [-self.Jxy, self.Jy, -self.Jyz], [-self.Jxz, -self.Jyz, self.Jz]]
        )

    def _mistakes(self) -> Iterator[str]:
        least, middle, largest = np.linalg.eigvalsh(self.inertia)
        if least <= 0 or largest > (least + middle) * (1 + 1e-9):
            yield (
                f"principal moments of inertia {least:.4g}, {middle:.4g}, {largest:.4g} kg m^2: each must be positive, "
                "and none above the sum of the two others"
            )


class Rotor(Strict):
    """Parameters that all rotors share; rotors.py gives their force and moment."""

    radius: Annotated[Positive, Plausible(0.01, 3.0, "m")]
    # thrust over rotor speed squared
    k_f: Annotated[Positive, Plausible(3e-3, 0.2, "N s^2", of="physical.rho radius^4")]
    k_m: Annotated[Positive, Plausible(0.02, 0.8, "N m s^2", of="k_f radius")]  # torque over rotor speed squared
    # rotor drag across the axis, over speed and airspeed
    k_d: Annotated[NonNegative, Plausible(0.01, 10.0, "N s^2/m", of="k_f radius^-1")] = 0.0
    # thrust lost with airspeed along the axis
    k_z: Annotated[NonNegative, Plausible(0.02, 50.0, "N s^2/m", of="k_f radius^-1")] = 0.0
    # translational lift
    k_h: Annotated[NonNegative, Plausible(1e-3, 3.0, "N s^2/m^2", of="physical.rho radius^2")] = 0.0
    # flapping moment over speed and airspeed, N m s^2/m; positive: nose down in forward flight
    k_flap: Annotated[Finite, Plausible(1e-3, 10.0, "N m s^2/m", of="k_f", either=True)] = 0.0
    # inertia about the axis, kg m^2; 0: no gyroscopic moment
    J_r: Annotated[NonNegative, Plausible(1e-5, 0.05, "kg m^2", of="physical.Jz")] = 0.0
    omega_min: Annotated[NonNegative, Plausible(5e-3, 0.9, "rad/s", of="omega_max")] = 0.0
    omega_max: Annotated[Positive, Plausible(20.0, 340.0, "rad/s", of="radius^-1")]
    tau_up: Annotated[Positive, Plausible(2e-3, 0.5, "s")]  # time constant of the speed when it rises
    tau_down: Annotated[Positive, Plausible(0.2, 10.0, "s", of="tau_up")]  # time constant of the speed when it falls

    def _mistakes(self) -> Iterator[str]:
        if self.omega_min >= self.omega_max:
            yield f"omega_min = {self.omega_min:g}: must be below omega_max = {self.omega_max:g} rad/s"


class Mount(Strict):
    """One rotor: its position and its direction of rotation."""

    position: tuple[Arm, Arm, Rise]  # of its hub, in the airframe's frame, m
    spin: Literal["ccw", "cw"]  # seen from above
    gain: Annotated[NonNegative, Plausible(0.05, 1.5)] = 1.0  # factor of thrust and torque: below 1 worn, 0 lost

    @property
    def yaw(self) -> float:
        """Sign of the moment about b's z (down) that the rotor's drag exerts on the airframe."""
        return 1.0 if self.spin == "ccw" else -1.0


class MultirotorEnvelope(Strict):
    """Airspeeds of normal flight."""

    airspeed: Annotated[Positive, Plausible(0.5, 60.0, "m/s")]  # cruising airspeed
    max_airspeed: Annotated[Positive, Plausible(1.0, 10.0, "m/s", of="airspeed")]

    def _mistakes(self) -> Iterator[str]:
        if self.airspeed > self.max_airspeed:
            yield f"airspeed = {self.airspeed:g}: above max_airspeed = {self.max_airspeed:g}"


class Control(Strict):
    """The kind of actions, and the speeds and rates that an action of 1 commands (controller.py)."""

    actions: Actions = "velocity"
    # readings of its instruments a second, for all loops
    rate_hz: Annotated[float, Field(gt=0, le=1000), Plausible(5.0, 1000.0, "Hz")] = 50.0
    # horizontal speed over ground at actions of 1
    speed: Annotated[Positive, Plausible(0.02, 2.0, "m/s", of="envelope.max_airspeed")] = 8.0
    climb: Annotated[Positive, Plausible(0.05, 30.0, "m/s")] = 3.0
    descent: Annotated[Positive, Plausible(0.05, 20.0, "m/s")] = 2.0
    yaw_rate_deg: Annotated[float, Field(gt=0, le=720), Plausible(5.0, 720.0, "deg/s")] = 90.0
    # roll and pitch rate
    max_rate_deg: Annotated[float, Field(gt=0, le=2000), Plausible(20.0, 2000.0, "deg/s")] = 220.0
    max_tilt_deg: Annotated[float, Field(gt=0, lt=80), Plausible(5.0, 80.0, "deg")] = 35.0


class MultirotorBody(Strict):
    """Dimensions for pictures and collisions."""

    size: tuple[Across, Across, Height]  # length, width, height, rotors included
    # distance from the centre of gravity down to the feet
    below: Annotated[NonNegative, Plausible(0.02, 3.0, "m", of="reach")]
    collision_radius: Annotated[Positive, Plausible(0.5, 3.0, "m", of="reach")]


class Battery(Strict):
    """`[battery]` of a vehicle file (rotors.py). Without it the rotors always have their nominal voltage."""

    capacity_mah: Annotated[Positive, Plausible(100.0, 1e5, "mAh")]  # mA h
    full: Annotated[Positive, Plausible(3.0, 130.0, "V")]  # open-circuit voltage, full
    empty: Annotated[Positive, Plausible(0.5, 1.0, "V", of="full")]  # open-circuit voltage, empty
    nominal: Annotated[Positive, Plausible(0.5, 1.2, "V", of="full")]  # voltage at which a rotor reaches omega_max
    resistance: Annotated[NonNegative, Plausible(5e-4, 1.0, "ohm")]  # of battery and leads
    efficiency: Annotated[float, Field(gt=0, le=1), Plausible(0.2, 1.0)]  # of motors and their controllers
    avionics: Annotated[NonNegative, Plausible(0.1, 500.0, "W")] = 0.0  # power of everything else
    charge: Annotated[float, Field(gt=0, le=1), Plausible(0.05, 1.0)] = 1.0  # at the beginning of a flight

    @property
    def coulombs(self) -> float:
        """Capacity, A s."""
        return self.capacity_mah * MILLI * HOUR

    def _mistakes(self) -> Iterator[str]:
        if self.empty > self.full:
            yield f"empty = {self.empty:g} V: must not be above full = {self.full:g} V"


class MultirotorParams(VehicleParams):
    """All parameters of a multirotor's vehicle file."""

    physical: MultirotorPhysical
    rotor: Rotor
    rotors: Annotated[tuple[Mount, ...], Field(min_length=1, max_length=MOST_ROTORS)]
    envelope: MultirotorEnvelope
    body: MultirotorBody
    control: Control = Control()
    battery: Battery | None = None
    legs: Legs | None = None  # what it stands on (contact/deck_and_legs.py)
    ground_effect: bool = True  # thrust grows near water and decks (ground.py)

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere around the aircraft, m."""
        return self.body.collision_radius

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width, height, m."""
        return self.body.size

    @property
    def reach(self) -> float:
        """Distance from the axis through the centre of gravity to the tip of the furthest rotor, m."""
        return float(np.linalg.norm(self.arms[:, :2], axis=1).max()) + self.rotor.radius

    @property
    def greatest_thrust(self) -> Annotated[float, Plausible(1.1, 15.0, "N", of="physical.mass g", far=5 / 3)]:
        """Thrust of all rotors at omega_max, N."""
        return len(self.rotors) * self.rotor.k_f * self.rotor.omega_max**2

    @property
    def stance(self) -> Annotated[float, Plausible(0.0, 0.1, "m", of="reach", far=math.inf)]:
        """Distance of the middle of its soles from the axis through the centre of gravity, m; 0 without legs."""
        if self.legs is None:
            return 0.0
        return float(np.linalg.norm(np.mean(self.legs.points, axis=0)[:2] - self.physical.cg[:2]))

    @property
    def figure_of_merit(self) -> Annotated[float, Plausible(0.1, 1.0)]:
        """Power of an ideal rotor over that of the rotor, in hover: k_f^1.5 / (k_m radius sqrt(2 pi rho))."""
        r = self.rotor
        return r.k_f**1.5 / (r.k_m * r.radius * math.sqrt(2 * math.pi * self.physical.rho))

    @property
    def arms(self) -> np.ndarray:
        """Rotors' hubs [rotor, 3] from the centre of gravity, m, b."""
        return np.array([mount.position for mount in self.rotors]) - np.array(self.physical.cg)

    def _mistakes(self) -> Iterator[str]:
        for i, one in enumerate(self.rotors):
            for j, other in enumerate(self.rotors[:i]):
                if math.dist(one.position, other.position) < APART:
                    yield (
                        f"rotors.{j} and rotors.{i} coincide at {list(one.position)}: hubs must be at least "
                        f"{APART:g} m apart"
                    )
        if self.legs:
            yield from self.legs.above(np.array([mount.position for mount in self.rotors]))


INERTIA = ("Jx", "Jy", "Jz", "Jxy", "Jxz", "Jyz")
COEFFICIENTS = ("k_f", "k_m", "k_d", "k_z", "k_h", "k_flap", "J_r")
AXES = range(3)
LEGS = ("legs.stiffness", "legs.damping")
FIELDS = (
    "dt",  # physics step, s
    "inverse_mass",  # 1/kg
    *INERTIA,  # kg m^2
    *(f"inverse_{a}{b}" for a in AXES for b in AXES if a <= b),  # inverse of the inertia, 1/(kg m^2)
    *(f"cg_{i}" for i in AXES),  # m, in the airframe's frame
    *(f"drag_{i}" for i in AXES),  # N s^2/m^2
    *COEFFICIENTS,  # of params.Rotor
    "per_tau_up", "per_tau_down",  # 1/s
    "left_up", "left_down",  # fraction of a change of speed that is left after half a step
    "leg_stiffness", "leg_damping",  # each leg, N/m, N s/m; 0 without legs
)  # fmt: skip


@cache
def numbers_of(rotors: int) -> Any:
    """NamedTuple class of the numbers of a multirotor with `rotors` rotors: `FIELDS`, then the gain of each rotor.

    Values are floats, or tensors of one shape.
    """
    return namedtuple("MultirotorNumbers", (*FIELDS, *(f"gain_{k}" for k in range(rotors))))


def gains(p: object, rotors: int) -> tuple[Number, ...]:
    """Gain of each rotor."""
    return tuple(getattr(p, f"gain_{k}") for k in range(rotors))


def varying_keys(craft: MultirotorParams) -> tuple[str, ...]:
    """Keys of the vehicle file that may differ between environments."""
    return (
        "physical.mass",
        *(f"physical.{name}" for name in INERTIA),
        *(f"physical.cg.{i}" for i in AXES),
        *(f"physical.drag.{i}" for i in AXES),
        *(f"rotor.{name}" for name in (*COEFFICIENTS, "tau_up", "tau_down")),
        *(f"rotors.{k}.gain" for k in range(len(craft.rotors))),
        *(LEGS if craft.legs else ()),
    )


def multirotor_numbers(craft: MultirotorParams, values: Mapping[str, Number], dt: float) -> Any:
    """Compute the kernel's numbers of a multirotor like `craft` with the parameters `values`, for a step dt (s).

    `values` has each of `varying_keys`: floats, or tensors of one shape. Other parameters are those of `craft`.
    """
    J = [values[f"physical.{name}"] for name in INERTIA]
    up, down = values["rotor.tau_up"], values["rotor.tau_down"]
    return numbers_of(len(craft.rotors))(
        dt, 1 / values["physical.mass"], *J, *_inverse(*J),
        *(values[f"physical.cg.{i}"] for i in AXES), *(values[f"physical.drag.{i}"] for i in AXES),
        *(values[f"rotor.{name}"] for name in COEFFICIENTS),
        1 / up, 1 / down, left_of(0.5 * dt, up), left_of(0.5 * dt, down), *(values.get(key, 0.0) for key in LEGS),
        *(values[f"rotors.{k}.gain"] for k in range(len(craft.rotors))),
    )  # fmt: skip


def _inverse(Jx, Jy, Jz, Jxy, Jxz, Jyz) -> tuple[Number, ...]:
    """Entries xx, xy, xz, yy, yz, zz of the inverse of [[Jx, -Jxy, -Jxz], [-Jxy, Jy, -Jyz], [-Jxz, -Jyz, Jz]]."""
    xx, xy, xz = Jy * Jz - Jyz * Jyz, Jxy * Jz + Jxz * Jyz, Jxy * Jyz + Jxz * Jy
    determinant = Jx * xx - Jxy * xy - Jxz * xz
    yy, yz, zz = Jx * Jz - Jxz * Jxz, Jx * Jyz + Jxy * Jxz, Jx * Jy - Jxy * Jxy
    return tuple(x / determinant for x in (xx, xy, xz, yy, yz, zz))


@cache
def nominal_numbers(craft: MultirotorParams) -> Any:
    """Compute the kernel's numbers of the vehicle file itself."""
    data = craft.model_dump()
    values = {key: float(value_at(data, key)) for key in varying_keys(craft)}
    return multirotor_numbers(craft, values, math.inf)
