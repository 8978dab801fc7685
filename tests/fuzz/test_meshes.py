"""Thousands of damaged meshes of a barge: each is refused by name, or is the barge within what was said.

Panels of an OBJ share their corners, so one changed number makes another hull, which is closed, too.
"""

import contextlib
import io
import struct
from pathlib import Path

import numpy as np
import pytest

from taichi_sim.applications.hydro import hull_input
from taichi_sim.applications.hydro.mesh_check import GAP
from taichi_sim.applications.hydro.wetted_surface import WettedSurface
from taichi_sim.config import ConfigError
from taichi_sim.models.usv.hull.mesh import BoxHull, mesh
from tests.fuzz.mutate import mutations

pytestmark = pytest.mark.slow
COUNT, CHUNKS = 2000, 4
SIZE = 4.0  # m
VOLUME = 4.0 * 1.2 * 0.3  # m^3
BARGE = BoxHull(length=SIZE, beam=1.2, draft=0.3, freeboard=0.3, panels_along=4, panels_across=2, panels_up=2)


def panels() -> np.ndarray:
    """Panels of the closed barge, z up."""
    return mesh(BARGE).corners * [1.0, -1.0, -1.0]


def triangles() -> np.ndarray:
    return panels()[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)


def stl_text() -> bytes:
    rows = ["solid barge"]
    for corners in triangles():
        vertices = [f"   vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in corners]
        rows += [" facet normal 0 0 1", "  outer loop", *vertices, "  endloop", " endfacet"]
    return "\n".join([*rows, "endsolid barge", ""]).encode()


def stl_binary() -> bytes:
    rows = [np.concatenate([np.zeros((1, 3)), t]).astype("<f4").tobytes() + b"\0\0" for t in triangles()]
    return b"barge".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def obj() -> bytes:
    corners, number = np.unique(panels().reshape(-1, 3), axis=0, return_inverse=True)
    rows = [f"v {x:g} {y:g} {z:g}" for x, y, z in corners]
    rows += [f"f {a} {b} {c} {d}" for a, b, c, d in number.reshape(-1, 4) + 1]
    return "\n".join(["# barge", "o barge", *rows, ""]).encode()


def gdf() -> bytes:
    rows = [" ".join(f"{v:g}" for v in panel.ravel()) for panel in panels()]
    return "\n".join(["barge", "1 9.80665 ULEN GRAV", "0 0 ISX ISY", str(len(rows)), *rows, ""]).encode()


def csv() -> bytes:
    rows = [",".join(f"{v:g}" for v in panel.ravel()) for panel in panels()]
    return "\n".join(["x1,y1,z1,x2,y2,z2,x3,y3,z3,x4,y4,z4", *rows, ""]).encode()


FILES = {"text.stl": stl_text, "binary.stl": stl_binary, "barge.obj": obj, "barge.gdf": gdf, "barge.csv": csv}


def read(path: Path) -> tuple[WettedSurface | None, str]:
    """The surface, or None if it is refused by name; and what was printed."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            return hull_input.read_mesh(path, "m", 0.0, None, None), said.getvalue()
    except ConfigError as error:
        assert path.name in str(error)
        return None, said.getvalue()


def volumes(found: WettedSurface) -> np.ndarray:
    """The integrals of x, y and z over the skin: of a closed one the same. A panel that is not flat counts as the mean
    of its two pairs of triangles.
    """
    a, b, c = np.moveaxis(found.whole[:, [[0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 0]]].reshape(-1, 3, 3), 1, 0)
    return ((a + b + c) / 3 * np.cross(b - a, c - a) / 4).sum(axis=0)


@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_mesh_is_refused_or_is_the_barge(tmp_path, name, chunk):
    """A corner may move by the gap that is joined, and x by half of what lengthens the mesh, above water, too."""
    right = FILES[name]()
    path = tmp_path / name
    path.write_bytes(right)
    whole, _ = read(path)
    assert whole is not None and whole.volume == pytest.approx(VOLUME, rel=1e-6)
    for k, (done, made) in enumerate(mutations(right, COUNT // CHUNKS, chunk, text=name != "binary.stl")):
        path.write_bytes(made)
        label = f"{name}, seed {chunk}, number {k}: {done}"
        try:
            found, said = read(path)
        except Exception as error:
            raise AssertionError(label) from error
        if found is None:
            continue
        figures = [found.volume, *found.waterplane.values(), *found.centre_of_buoyancy]
        assert np.isfinite(figures).all(), label
        if name == "barge.obj":
            assert volumes(found) == pytest.approx(found.volume, rel=4 * GAP * SIZE), label
            continue
        told = "means feet" in said
        assert told or found.volume == pytest.approx(VOLUME, rel=4 * GAP * SIZE), f"{label}: {found.volume}"
        assert told or abs(found.centre_of_buoyancy[1]) < GAP * SIZE, label
