"""The two sides of a contact, as sections of vehicle files: `[deck]` of a carrier, `[legs]` of a vehicle that lands."""

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from taichi_sim.config import ConfigError, Finite, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.rigid_body import skew

MOST_LEGS = 8
LONGEST_STEP = 1.25e-3  # s, of a contact step; shorter than the 2 ms that reference tables of legs require
MOST_STEPS = 80  # contact steps in a physics step; the longest physics step, 0.1 s, has steps of LONGEST_STEP
PHASE = 0.25  # rad; limit of (frequency of the stiffest motion on legs) x (contact step): sinkage error below 1 %
DECAY = 0.5  # limit of (rate of the fastest decay on legs) x (contact step)
OVERHANG = 1.0  # largest extent of a deck, over that of the hull


class Deck(Strict):
    """A level rectangle of a vehicle on which others land, in the frame b (forward-right-down)."""

    # x and y of the centre
    place: tuple[
        Annotated[Finite, Plausible(1e-3, 0.5, "m", of="length", either=True)],
        Annotated[Finite, Plausible(1e-3, 0.5, "m", of="beam", either=True)],
    ]
    # along x and along y
    size: tuple[
        Annotated[Positive, Plausible(0.02, 1.0, "m", of="length")],
        Annotated[Positive, Plausible(0.05, 1.0, "m", of="beam")],
    ]
    # above the origin (for a vessel, the design waterline)
    height: Annotated[Positive, Plausible(0.05, 1.5, "m", of="height")]
    friction: Annotated[NonNegative, Plausible(0.05, 2.0)]  # Coulomb's coefficient, the same for sticking and sliding

    @property
    def centre(self) -> tuple[float, float, float]:
        """Centre of the deck, m, b."""
        return (*self.place, -self.height)

    @property
    def half(self) -> tuple[float, float]:
        """Half of the size, m."""
        return 0.5 * self.size[0], 0.5 * self.size[1]

    def outside(self, length: float, beam: float) -> Iterator[str]:
        """Why the deck extends beyond a hull of `length` and `beam` (m) with its midship at the origin."""
        for axis, name, whole in ((0, "x", length), (1, "y", beam)):
            most = 0.5 * OVERHANG * whole - self.half[axis]
            if most < 0:
                yield (
                    f"deck.size = {list(self.size)} is outside the hull: along {name} it must be at most {whole:g} m"
                )
            if abs(self.place[axis]) > most * (1 + 1e-9):
                yield (
                    f"deck.place = {list(self.place)} is outside the hull: with deck.size = {list(self.size)}, "
                    f"|{name}| must be at most {most:.4g} m"
                )


Across = Annotated[Finite, Plausible(5e-3, 2.0, "m", of="reach", either=True)]
Down = Annotated[Finite, Plausible(5e-3, 3.0, "m", of="reach", either=True)]


class Legs(Strict):
    """Contact points of an aircraft. Each has one spring and one damper, the same along the normal and in the plane."""

    points: Annotated[tuple[tuple[Across, Across, Down], ...], Field(min_length=1, max_length=MOST_LEGS)]
    """Positions of the soles, in the frame of the vehicle file's other positions (forward-right-down), m."""
    # of each sole, along the normal and in the plane
    stiffness: Annotated[Positive, Plausible(0.5, 2000.0, "N/m", of="physical.mass g reach^-1")]
    damping: Annotated[NonNegative, Plausible(5e-3, 5.0, "N s/m", of="stiffness^0.5 physical.mass^0.5")]  # of each sole

    def above(self, rotors: NDArray[np.float64]) -> Iterator[str]:
        """Which legs are not below the rotors, whose hubs are at `rotors` [rotor, 3] (m, the same frame)."""
        lowest = float(rotors[:, 2].max())
        for k, point in enumerate(self.points):
            if point[2] <= lowest:
                yield f"legs.points.{k} = {list(point)} is not below the rotors: z (down) must be above {lowest:g} m"

    def rates(self, mass: float, cg: tuple[float, float, float], inertia: NDArray[np.float64]) -> tuple[float, float]:
        """Frequency (rad/s) and decay rate (1/s) of the stiffest motion of a body that stands on all legs on a fixed
        deck.

        Args:
            mass: kg.
            cg: centre of gravity, in the frame of `points`, m.
            inertia: [3, 3] about the CG, kg m^2.
        """
        stiffness = np.zeros((6, 6))
        for point in self.points:
            G = np.hstack((np.eye(3), -skew(np.subtract(point, cg))))  # velocity of the sole: G (v, omega)
            stiffness += self.stiffness * G.T @ G
        inverse = np.zeros((6, 6))
        inverse[:3, :3], inverse[3:, 3:] = np.eye(3) / mass, np.linalg.inv(inertia)
        largest = float(np.linalg.eigvals(inverse @ stiffness).real.max())
        return math.sqrt(largest), largest * self.damping / self.stiffness

    def steps(self, dt: float, mass: float, cg: tuple[float, float, float], inertia: NDArray[np.float64]) -> int:
        """Number of contact steps in a physics step `dt` (s) that resolve the stiffest motion of a body (arguments as
        in `rates`).
        """
        frequency, decay = self.rates(mass, cg, inertia)
        longest = min(LONGEST_STEP, PHASE / frequency, DECAY / decay if decay > 0 else math.inf)
        if dt > MOST_STEPS * longest * (1 + 1e-9):
            slower = MOST_STEPS * longest / dt
            key, value, most = "stiffness", self.stiffness, self.stiffness * slower**2
            if DECAY * frequency < PHASE * decay:
                key, value, most = "damping", self.damping, self.damping * slower
            raise ConfigError(
                f"legs.{key} = {value:g}: dt = {dt:g} s cannot follow it: the motion on these legs has "
                f"{frequency:.4g} rad/s and decays by {decay:.4g} 1/s. Use a dt of at most "
                f"{MOST_STEPS * longest:.3g} s, or a {key} of at most {most:.4g}"
            )
        return max(1, math.ceil(dt / longest - 1e-9))
