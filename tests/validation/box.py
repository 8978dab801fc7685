"""The box of the hydrostatic and boundary-element tables, as a hull of this package."""

import re
from dataclasses import dataclass
from typing import Any

from taichi_sim.config.io import validate
from taichi_sim.kernels.conventions import RHO_SEA
from taichi_sim.models.usv.hull.mesh import BoxHull
from taichi_sim.models.usv.hull.params import Hull6DofParams
from tests.validation.case import Case
from tests.validation.parameters import only, shipped
from tests.validation.tables import TableError, number, read_json

SIZE = re.compile(r"box_(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)(?=[_.])")
FILE = "barge.toml"
NO_LOADS = {"added_mass": [0.0] * 6, "linear": [0.0] * 6}


@dataclass(frozen=True)
class Box:
    """Length, beam, draft and height KG of the centre of gravity over the keel, m; mass, kg."""

    length: float
    beam: float
    draft: float
    KG: float
    mass: float

    @property
    def cg(self) -> tuple[float, float, float]:
        """Centre of gravity, m, b."""
        return (0.0, 0.0, self.draft - self.KG)

    def shape(self, along: int, across: int, up: int) -> BoxHull:
        """The hull, with a freeboard as high as its draft."""
        sizes = {"length": self.length, "beam": self.beam, "draft": self.draft, "freeboard": self.draft}
        return BoxHull(**sizes, panels_along=along, panels_across=across, panels_up=up)

    def params(self, shape: BoxHull, gyration: list[float], hydrodynamics: dict[str, Any]) -> Hull6DofParams:
        """A vehicle without thrusters that floats by its panels."""
        numbers = {
            "length": self.length,
            "beam": self.beam,
            "height": 2 * self.draft,
            "collision_radius": self.length / 2,
            "rigid_body": {"mass": self.mass, "cg": list(self.cg), "gyration": gyration},
            "hydrodynamics": hydrodynamics,
            "hull": shape.model_dump(),
        }
        return validate(Hull6DofParams, numbers, "box")


def box_of(case: Case) -> Box:
    """The box that a table is about: of its own name, else the one box_*.json beside it, else the shipped barge.

    KG and mass are those of the JSON of that box where there is one.
    """
    named = SIZE.search(case.path.name)
    pattern = f"{named[0]}.json" if named else "box_*[0-9].json"
    path = only(case.path.parent, pattern)
    if path:
        data = read_json(case.folder.use(path))
        try:
            return Box(*(number(data, key) for key in ("L", "B", "T", "KG", "mass")))
        except TableError as error:
            raise TableError(f"{path.name}: {error}") from None
    barge = shipped(FILE)
    sizes = [float(v) for v in named.groups()] if named else [barge["hull"][k] for k in ("length", "beam", "draft")]
    KG = sizes[2] - barge["rigid_body"]["cg"][2]
    return Box(*sizes, KG=KG, mass=RHO_SEA * sizes[0] * sizes[1] * sizes[2])
