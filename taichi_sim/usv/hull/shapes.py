"""Hull sections of vehicle files: shapes and their limits. mesh.py makes panels of them.

All are in the body frame b (forward-right-down), origin CO midships, on the centreline, in the design waterline; in
metres.

The Wigley hull is y = +-B/2 (1 - (2x/L)^2) (1 - (z/T)^2) (Wigley 1942).
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict

Array = NDArray[np.float64]
Count = Annotated[int, Field(ge=1, le=400)]
Section = Annotated[tuple[tuple[NonNegative, Finite], ...], Field(min_length=2, max_length=50)]
DECK_STEP = 1e-9  # m, tolerance for a level deck


class BoxHull(Strict):
    """A box with its bottom `draft` below the design waterline, and its deck `freeboard` above it."""

    shape: Literal["box"] = "box"
    length: Positive  # m
    beam: Positive  # m
    draft: Positive  # m
    freeboard: Positive  # m
    panels_along: Count = 2
    panels_across: Count = 2
    panels_up: Count = 2  # rows of the sides; with 2 or more, the last row is above the design waterline


class WigleyHull(Strict):
    """Wigley's parabolic hull below the design waterline, wall-sided above it."""

    shape: Literal["wigley"] = "wigley"
    length: Positive  # m
    beam: Positive  # m
    draft: Positive  # m
    freeboard: Positive  # m
    panels_along: Count = 10
    panels_up: Annotated[int, Field(ge=2, le=400)] = 3  # the last row is above the design waterline


class TwinPontoons(Strict):
    """Two equal pontoons with straight lines between stations; ends with a beam are closed by transoms.

    With `section = "vee"` the sides are flat from the keel to the deck edge. With `"round"` a section is a half circle
    of the station's beam, replaced by a polygon of `panels_girth` equal sides with the same area and centre, wall-sided
    above the centre.
    """

    shape: Literal["twin_pontoons"] = "twin_pontoons"
    y: Positive  # distance of the pontoons' centrelines from the hull's, m
    stations: Annotated[tuple[tuple[Finite, NonNegative, Finite], ...], Field(min_length=2, max_length=100)]
    freeboard: Positive  # m
    section: Literal["vee", "round"] = "vee"
    panels_girth: Annotated[int, Field(ge=2, le=200)] = 3  # sides of a round section

    @model_validator(mode="after")
    def _sensible(self):
        x, beam, keel = np.array(self.stations).T
        if np.any(np.diff(x) <= 0):
            raise ValueError("stations = [[x, beam, keel depth], ...] must run forward, from stern to bow")
        if np.any(beam > 2 * self.y):
            raise ValueError(f"a pontoon's beam {beam.max()} reaches over the centreline: at most 2 y = {2 * self.y}")
        if np.any(keel <= -self.freeboard):
            raise ValueError(f"a keel lies above the deck: every keel depth must be above {-self.freeboard}")
        if self.section == "round" and np.any(beam / 2 - keel > self.freeboard + 1e-9):
            raise ValueError(
                f"freeboard = {self.freeboard} is below the centre of a round section: "
                f"it must be at least {(beam / 2 - keel).max():.4g}"
            )
        return self


class StationsHull(Strict):
    """A hull given by a table of offsets: sections of points (y, z), straight between points and between stations.

    Points are those of the starboard half, the same number at each station. Those of a single hull run from the keel (y
    = 0) to the deck edge. Those of a twin hull run from the inner deck edge around the keel to the outer one.
    """

    shape: Literal["stations"] = "stations"
    # x from stern to bow, and [y, z] of each point with z down from the design waterline, m
    stations: Annotated[tuple[tuple[Finite, Section], ...], Field(min_length=2, max_length=100)]

    @property
    def points(self) -> Array:
        """Points [station, point, 3] of the starboard half."""
        return np.array([[(x, y, z) for y, z in section] for x, section in self.stations], dtype=np.float64)

    @property
    def twin(self) -> bool:
        """Whether there is water between two hulls."""
        return any(section[0][0] > 0 for _, section in self.stations)

    @model_validator(mode="after")
    def _sensible(self):
        if any(len(section) != len(self.stations[0][1]) for _, section in self.stations):
            raise ValueError("stations = [[x, [[y, z], ...]], ...] must have as many points at each station")
        x, deck = self.points[:, 0, 0], self.points[:, -1, 2]
        if np.any(np.diff(x) <= 0):
            raise ValueError("stations = [[x, [[y, z], ...]], ...] must run forward, from stern to bow")
        if np.any(np.abs(deck - deck[0]) > DECK_STEP):
            raise ValueError(f"the deck must be level: the last points' z run from {deck.min()} to {deck.max()}")
        if self.twin and np.any(np.abs(self.points[:, 0, 2] - deck) > DECK_STEP):
            raise ValueError(
                "the first points must lie on the centreline (y = 0), or, of twin hulls, on the inner deck edge, as "
                "high as the outer one"
            )
        return self


HullShape = Annotated[BoxHull | WigleyHull | TwinPontoons | StationsHull, Field(discriminator="shape")]
