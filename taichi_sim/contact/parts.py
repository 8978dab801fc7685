"""The two sides of a contact, as sections of vehicle files: `[deck]` of what carries, `[legs]` of what lands."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.kernels.rigid_body import skew

MOST_LEGS = 8
LONGEST_STEP = 1.25e-3  # s, of a contact: shorter than the 2 ms that reference tables of legs ask for
MOST_STEPS = 80  # contact steps of a physics step: of the longest one, 0.1 s, still LONGEST_STEP
PHASE = 0.25  # rad: frequency of the stiffest motion on legs times the contact step, at most; error of a sink below 1 %
DECAY = 0.5  # rate of the fastest decay on legs times the contact step, at most
OVERHANG = 1.0  # a deck ends where the hull does


class Deck(Strict):
    """A level rectangle of a vehicle on which others land, in its frame b (forward-right-down)."""

    place: tuple[Finite, Finite]  # of its centre, x and y, m
    size: tuple[Positive, Positive]  # along x and along y, m
    height: Positive  # above the origin, of a vessel the design waterline, m
    friction: NonNegative  # coefficient of Coulomb's law, sticking and sliding

    @property
    def centre(self) -> tuple[float, float, float]:
        """m, b."""
        return (*self.place, -self.height)

    @property
    def half(self) -> tuple[float, float]:
        """Half of its size, m."""
        return 0.5 * self.size[0], 0.5 * self.size[1]

    def check_inside(self, length: float, beam: float) -> None:
        """Refuse a deck that reaches over a hull of `length` and `beam` (m), midships at the origin.

        Raises:
            ValueError: naming key, value and range.
        """
        for axis, name, whole in ((0, "x", length), (1, "y", beam)):
            most = 0.5 * OVERHANG * whole - self.half[axis]
            if most < 0:
                raise ValueError(
                    f"deck.size = {list(self.size)} is outside the hull: along {name} it must be at most {whole:g} m"
                )
            if abs(self.place[axis]) > most * (1 + 1e-9):
                raise ValueError(
                    f"deck.place = {list(self.place)} is outside the hull: with deck.size = {list(self.size)}, "
                    f"|{name}| must be at most {most:.4g} m"
                )


class Legs(Strict):
    """Contact points of an aircraft: each presses with a spring and a damper, and sticks with the same ones."""

    points: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(min_length=1, max_length=MOST_LEGS)]
    """Soles, in the frame of the vehicle file's other places (forward-right-down), m."""
    stiffness: Positive  # of each, along and across, N/m
    damping: NonNegative  # of each, N s/m

    def check_below(self, rotors: NDArray[np.float64]) -> None:
        """Refuse legs above the rotors, whose hubs are at `rotors` [rotor, 3] (m, the same frame).

        Raises:
            ValueError: naming key, value and range.
        """
        lowest = float(rotors[:, 2].max())
        for k, point in enumerate(self.points):
            if point[2] <= lowest:
                raise ValueError(
                    f"legs.points.{k} = {list(point)} is not below the rotors: z (down) must be above {lowest:g} m"
                )

    def rates(self, mass: float, cg: tuple[float, float, float], inertia: NDArray[np.float64]) -> tuple[float, float]:
        """Frequency (rad/s) and rate of decay (1/s) of the stiffest motion on all legs, on a deck that stays.

        Args:
            mass: kg. cg: in the frame of `points`, m. inertia: [3, 3] about it, kg m^2.
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
        """Contact steps in a physics step `dt` (s) that follow the stiffest motion of a body as in `rates`.

        Raises:
            ValueError: where they would be more than `MOST_STEPS`: naming the step that it needs.
        """
        frequency, decay = self.rates(mass, cg, inertia)
        longest = min(LONGEST_STEP, PHASE / frequency, DECAY / decay if decay > 0 else math.inf)
        if dt > MOST_STEPS * longest * (1 + 1e-9):
            slower = MOST_STEPS * longest / dt
            key, value, most = "stiffness", self.stiffness, self.stiffness * slower**2
            if DECAY * frequency < PHASE * decay:
                key, value, most = "damping", self.damping, self.damping * slower
            raise ValueError(
                f"legs.{key} = {value:g}: dt = {dt:g} s cannot follow it (its motion takes {frequency:.4g} rad/s and "
                f"decays by {decay:.4g} 1/s): it needs a dt of at most {MOST_STEPS * longest:.3g} s, or a {key} of at "
                f"most {most:.4g}"
            )
        return max(1, math.ceil(dt / longest - 1e-9))
