"""Sound hulls as other programs export them are read whole, beside the broken ones of test_hydrodynamics.py."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taichi_sim.applications.hydro import hull_input
from taichi_sim.applications.hydro.mesh_file import CODES
from taichi_sim.applications.hydro.panelling import of_number
from taichi_sim.applications.hydro.wetted_surface import mirrored
from taichi_sim.config import ConfigError

Panels = np.ndarray  # [n, 4, 3]


def grid(points: np.ndarray) -> Panels:
    """Quadrilaterals between points [i, j, 3]."""
    return np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def wigley(gap: float = 0.0, n: tuple[int, int] = (24, 6)) -> Panels:
    """Port half of Wigley's hull, 246 x 40 x 14 m; its bow ends `gap` (m) beside the centreplane."""
    x, z = np.linspace(-123, 123, n[0] + 1), -14.0 * np.linspace(0, 1, n[1] + 1)
    y = 20 * np.outer(1 - (x / 123) ** 2, 1 - (z / 14) ** 2)
    y[-1, : n[1] // 2] = gap
    return grid(np.stack([np.repeat(x[:, None], n[1] + 1, 1), y, np.repeat(z[None], n[0] + 1, 0)], axis=-1))


def demihull(n: tuple[int, int] = (18, 8), y: float = 0.55, high: float = 0.2) -> Panels:
    """A hull of 3 m with a transom and a bow of 6 mm, as triangles and quadrilaterals of a closed skin, at y (m)."""
    x, a = np.linspace(-1.5, 1.5, n[0] + 1), np.linspace(-np.pi / 2, np.pi / 2, n[1] + 1)
    breadth = 0.18 * (1 - 0.25 * (x / 1.5) ** 2)
    breadth = np.where(x < 0, breadth, 0.18 * (1 - np.abs(x / 1.5) ** 2.5) + 0.003)
    keel = -0.21 + 0.1 * np.clip((x - 0.6) / 0.9, 0, 1) ** 2 + 0.06 * np.clip((-x - 0.8) / 0.7, 0, 1)
    points = np.empty((len(x), len(a), 3))
    points[..., 0] = x[:, None]
    points[..., 1] = y + breadth[:, None] * np.sign(a) * np.abs(np.sin(a)) ** 0.6
    points[..., 2] = high + (keel[:, None] - high) * np.abs(np.cos(a)) ** 0.9
    deck = grid(points[:, [-1, 0]])
    ends = [np.stack([p[0], p[j], p[j + 1], p[j + 1]]) for p in points[[0, -1]] for j in range(1, len(a) - 1)]
    return np.concatenate([grid(points), deck, np.stack(ends)])


def twin(**sizes) -> Panels:
    """Two such hulls, alike in shape, not in their triangles."""
    return np.concatenate([demihull(**sizes), demihull(y=-0.55, **sizes)])


def numbers(panels: Panels, form: str = "12.5f") -> str:
    """Corners, one a line."""
    return "".join("".join(f"{v:{form}}" for v in p) + "\n" for p in panels.reshape(-1, 3))


def gdf(isx: int, isy: int, form: str = "12.5f", grav: str = "9.80665") -> Callable[[Panels], str]:
    """WAMIT's, as MSS and others write it."""
    return lambda panels: f"made by a test\n1.0 {grav} ULEN GRAV\n{isx} {isy}\n{len(panels)}\n{numbers(panels, form)}"


def shared(panels: Panels) -> tuple[np.ndarray, np.ndarray]:
    """Points [p, 3] and, from 1 on, the corners of panels [n, 4]; corners within 1e-6 are one."""
    points, number = np.unique(np.round(panels.reshape(-1, 3), 6) + 0.0, axis=0, return_inverse=True)
    return points, number.reshape(-1, 4) + 1


def nemoh(symmetric: int) -> Callable[[Panels], str]:
    """NEMOH's, ended by rows of zeros."""

    def text(panels: Panels) -> str:
        points, number = shared(panels)
        rows = [f"{i} {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(points, 1)]
        faces = [" ".join(map(str, face)) for face in number]
        return "\n".join([f"2 {symmetric}", *rows, "0 0.00 0.00 0.00", *faces, "0 0 0 0", ""])

    return text


def hams(x: int, y: int) -> Callable[[Panels], str]:
    """HAMS's, with its titles."""

    def text(panels: Panels) -> str:
        points, number = shared(panels)
        rows = [f"{i} {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(points, 1)]
        faces = [f"{i} 4 {' '.join(map(str, face))}" for i, face in enumerate(number, 1)]
        head = ["--", "hull mesh", "# panels, nodes, symmetry", f"{len(panels)} {len(points)} {x} {y}", "", "# nodes"]
        return "\n".join([*head, *rows, "", "# panels", "", *faces, ""])

    return text


def obj(panels: Panels) -> str:
    """Blender's: triangles where corners coincide, normals beside them."""
    points, number = shared(panels)
    faces = ["f " + " ".join(f"{v}//1" for v in dict.fromkeys(face.tolist())) for face in number]
    return "\n".join(["# Blender", "o hull", *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points), "vn 0 0 1", *faces])


def stl(panels: Panels) -> bytes:
    """Binary, as most CAD programs write it."""
    triangles = np.concatenate([panels[:, [0, 1, 2]], panels[:, [0, 2, 3]]]).astype("<f4")
    size = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    rows = [bytes(12) + t.tobytes() + bytes(2) for t in triangles[size > 0]]
    return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def csv(panels: Panels) -> str:
    """MSS's published tables, as panels."""
    head = ",".join(f"{axis}{k}" for k in range(1, 5) for axis in "xyz")
    return "\n".join([head, *(",".join(f"{v:.4f}" for v in panel.ravel()) for panel in panels)])


def read(folder: Path, name: str, content: str | bytes, waterline: float = 0.0):
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return hull_input.read_mesh(file, "m", waterline, None, None)


SHIP, QUARTER = wigley(), wigley()[wigley()[..., 0].mean(axis=1) > 0]
WHOLE = np.concatenate([SHIP, mirrored(SHIP, 1)])


FILES = {
    "half.gdf": gdf(0, 1)(SHIP),
    "whole.gdf": gdf(0, 0)(WHOLE),
    "quarter.gdf": gdf(1, 1)(QUARTER),
    "gap.gdf": gdf(0, 1)(wigley(0.0354)),
    "wide.gdf": gdf(0, 0)(np.concatenate([wigley(0.0354), mirrored(wigley(0.0354), 1)])),
    "fortran.gdf": gdf(0, 1, "16.7e", "0.980665D+01")(SHIP),
    "half.dat": nemoh(1)(SHIP),
    "whole.mar": nemoh(0)(WHOLE),
    "half.pnl": hams(0, 1)(SHIP),
    "quarter.pnl": hams(1, 1)(QUARTER),
    "half.csv": csv(SHIP),
    "half.obj": obj(SHIP),
    "gap.stl": stl(np.concatenate([wigley(0.0354), mirrored(wigley(0.0354), 1)])),
    "whole.stl": stl(WHOLE),
}


@pytest.mark.parametrize("name", FILES)
def test_a_ship_of_other_programs_is_read(tmp_path, capsys, name):
    """Its volume and waterplane, panels of the same corners, whatever the file's form; a gap at the stem is told."""
    if Path(name).suffix in CODES:
        pytest.importorskip("capytaine", reason="capytaine reads panels of other codes")
    form = read(tmp_path, "exact.gdf", gdf(0, 1, "20.12f")(SHIP))
    capsys.readouterr()
    found = read(tmp_path, name, FILES[name])
    assert found.volume == pytest.approx(form.volume, rel=1e-4)
    assert found.waterplane["A"] == pytest.approx(form.waterplane["A"], rel=1e-4)
    assert 1 in found.planes
    said = capsys.readouterr().out
    assert ("gap" in said or "do not meet" in said) == name.startswith(("gap", "wide"))


@pytest.mark.parametrize("waterline", [-0.01, 0.0, 0.037])
def test_a_catamaran_is_read_however_coarse_its_triangles(tmp_path, waterline):
    """Cut anywhere by the water, with a bow of a few mm: volume and waterplane approach those of fine triangles."""
    fine = read(tmp_path, "fine.stl", stl(twin(n=(60, 40))), waterline)
    for n in ((8, 6), (18, 8), (24, 10), (40, 20)):
        found = read(tmp_path, "cat.stl", stl(twin(n=n)), waterline)
        assert found.planes == (1,)
        assert found.volume == pytest.approx(fine.volume, rel=4 / n[1] ** 2)
        assert found.waterplane["A"] == pytest.approx(fine.waterplane["A"], rel=4 / n[1] ** 2)


def test_a_mesh_is_divided_to_the_wanted_number(tmp_path):
    for n in ((18, 8), (24, 10)):
        surface = read(tmp_path, "cat.stl", stl(twin(n=n)))
        fine = of_number(surface, 1200)
        assert 960 < len(fine) <= 1200
        assert fine.volume == pytest.approx(surface.volume, rel=1e-6)


def test_a_place_on_two_hulls_is_on_one_of_them(tmp_path):
    holed = twin()
    at = np.abs(holed.mean(axis=1) - [0.5, 0.6, -0.1]).sum(axis=1).argsort()[:1]
    both = [*at, *(at + len(holed) // 2)]
    with pytest.raises(ConfigError, match=r"holes .* y = -?0\.[4-7]"):
        read(tmp_path, "holed.stl", stl(np.delete(holed, both, axis=0)))
