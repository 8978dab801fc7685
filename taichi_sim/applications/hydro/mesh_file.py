"""Reading of a hull's surface from a file, whole or not at all; mesh_check.py then checks what it is.

Formats are STL (text and binary), OBJ, WAMIT's GDF of flat panels, CSV of panels with the columns x1, y1, z1 ... x4,
y4, z4, panels of NEMOH (.dat, .mar), HAMS (.pnl) and HydroStar (.hst), which capytaine reads, and PLY, VTK, MSH and
others that meshio reads. The frame is x forward, y to port, z up. A file of one half declares this (ISX, ISY of a GDF);
a CSV of one half has no y below 0.

A reader refuses what it does not know: a file that was cut or damaged lacks its end, its count or its words.
Coordinates of a GDF are dimensional (WAMIT manual, "The geometric data file": ULEN makes output dimensionless, and
nothing else); their unit is the metre or the foot of its GRAV.
"""

import logging
import warnings
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.errors import needs, reading, refuse

Array = NDArray[np.float64]
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
GRAVITIES = {"m": 9.80665, "ft": 32.174}  # GRAV of a GDF per unit, unit/s^2
NEAR = 0.03  # relative difference of a GRAV from these (9.8 and 9.81, 32.2)
STL_HEADER = 84  # bytes before the first triangle of a binary STL: 80 free, 4 of the count
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
VERTEX = ("vertex", "0", "0", "0")
FACET = ("facet", "normal", "0", "0", "0", "outer", "loop", *3 * VERTEX, "endloop", "endfacet")  # words of a text STL
CODES = {".dat": "nemoh", ".mar": "nemoh", ".pnl": "hams", ".hst": "hydrostar"}  # endings that capytaine reads
OBJ_IGNORED = frozenset(
    ("vt", "vn", "vp", "g", "o", "s", "mg", "l", "p", "usemtl", "mtllib", "usemap", "maplib", "bevel", "c_interp",
     "d_interp", "lod", "shadow_obj", "trace_obj")
)  # fmt: skip  # statements of an OBJ that change no polygon
LINEAR = {"triangle": 3, "quad": 4}  # cells of meshio that are flat panels
NO_SURFACE = frozenset(("vertex", "line"))  # cells of meshio without an area
DRAWINGS = (".step", ".stp", ".iges", ".igs", ".brep", ".3dm", ".glb", ".gltf")  # endings that are not read
HALF = 1e-6  # share of a mesh's size by which the y of a half hull may lie below 0
CONVEX = -1e-9  # a polygon's smallest corner (sine of its turn) from which it is convex


class Polygons(NamedTuple):
    """Panels [n, 4, 3] of a file, and the planes of symmetry that it declares."""

    panels: Array
    planes: tuple[int, ...]


def read(path: Path, unit: str = "m") -> Polygons:
    """Read the panels of a file, in m."""
    drawing = path.suffix.lower() in DRAWINGS
    refuse(
        ConfigError,
        (not path.is_file(), f"{path}: no such file"),
        (drawing, f"{path}: meshes are STL, OBJ, GDF, CSV, PLY, VTK or MSH: export this drawing as STL, in m"),
    )
    readers = {".gdf": _gdf, ".csv": _csv, ".stl": _stl, ".obj": _obj} | dict.fromkeys(CODES, _of_code)
    reader = readers.get(path.suffix.lower())
    with reading(path, ConfigError):
        found = reader(path, unit) if reader else Polygons(UNITS[unit] * _meshio(path), ())
    refuse(
        ConfigError,
        (not len(found.panels), f"{path}: holds no panels (triangles or quadrilaterals)"),
        (not np.isfinite(found.panels).all(), f"{path}: a corner is not a finite number"),
    )
    return found


def _of_code(path: Path, unit: str) -> Polygons:
    """Panels of another boundary-element code, read by capytaine."""
    with needs("capytaine", "bem"):
        from capytaine import ReflectionSymmetricMesh, load_mesh
    logging.getLogger("capytaine").setLevel(logging.ERROR)  # panels that are not flat are usual
    planes = []
    with open(path, encoding="utf-8", errors="replace") as file:
        mesh = load_mesh(file, CODES[path.suffix.lower()])
    while isinstance(mesh, ReflectionSymmetricMesh):
        planes.append({"xOz": 1, "yOz": 0}[mesh.plane])
        mesh = mesh.half
    return Polygons(UNITS[unit] * np.asarray(mesh.as_array_of_faces()), tuple(sorted(planes, reverse=True)))


def _csv(path: Path, unit: str) -> Polygons:
    first = _text(path).partition("\n")[0].split(",")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a file without rows, which `read` refuses
        panels = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    wanted = "x1,y1,z1 ... x4,y4,z4"
    refuse(
        ConfigError,
        (all(map(_is_number, first)), f"its first line holds numbers; expected the header {wanted}"),
        (panels.size and panels.shape[1] != 12, f"{panels.shape[1]} columns; expected {wanted}"),
    )
    panels = UNITS[unit] * panels.reshape(-1, 4, 3)
    return Polygons(panels, (1,) if panels.size and panels[..., 1].min() > -HALF * np.ptp(panels) else ())


def _gdf(path: Path, unit: str) -> Polygons:
    lines = _text(path).splitlines()
    head = "a GDF has a title, ULEN and GRAV, ISX and ISY, the number of panels, and their corners"
    refuse(ConfigError, (len(lines) < 4, head))
    grav = _number(lines[1].split()[1])
    symmetry, first = [int(word) for word in lines[2].split()[:2]], lines[3].split()
    count, numbers = int(first[0]), np.array([_number(word) for word in " ".join(lines[4:]).split()])
    higher = len(first) > 1 and first[1].lstrip("-").isdigit() and int(first[1]) != 0
    refuse(
        ConfigError,
        (len(symmetry) < 2 or not {0, 1}.issuperset(symmetry),
         f"ISX and ISY are {lines[2].split()[:2]}: allowed are 0 (no symmetry) and 1 (symmetry)"),
        (higher, "a GDF of higher order (IGDEF not 0); export one of flat panels (WAMIT: ILOWGDF)"),
        (count < 1 or numbers.size != 12 * count,
         f"{count} panels announced, numbers for {numbers.size / 12:.4g} found: is the file truncated?"),
    )  # fmt: skip
    planes = tuple(axis for axis, on in ((1, symmetry[1]), (0, symmetry[0])) if on)
    return Polygons(UNITS[_gdf_unit(path, grav, unit)] * numbers.reshape(-1, 4, 3), planes)


def _gdf_unit(path: Path, grav: float, unit: str) -> str:
    """Unit of a GDF's coordinates: the user's, or feet where GRAV says so."""
    own = next((name for name, value in GRAVITIES.items() if abs(grav / value - 1) < NEAR), None)
    allowed, given = ", ".join(f"{value:g} ({name})" for name, value in GRAVITIES.items()), f"GRAV = {grav:g}"
    refuse(
        ConfigError,
        (own is None, f"{given} in its second line says no unit of its coordinates; allowed are {allowed}"),
        (own == "ft" and unit not in ("m", "ft"),
         f"{given} in its second line means feet, --unit says {unit}: mend one of them"),
    )  # fmt: skip
    if own == "m" or unit == own:
        return unit
    print(f"{path.name}: GRAV = {grav:g} means feet; coordinates converted to metres")
    return "ft"


def _stl(path: Path, unit: str) -> Polygons:
    """A binary STL has exactly the size that its count says; any other STL is text."""
    data = path.read_bytes()
    count = int(np.frombuffer(data, "<u4", 1, STL_HEADER - 4)[0]) if len(data) >= STL_HEADER else 0
    if count and len(data) == STL_HEADER + STL_TRIANGLE.itemsize * count:
        with np.errstate(invalid="ignore"):  # not a number, which `read` refuses
            corners = np.frombuffer(data, STL_TRIANGLE, count, STL_HEADER)["corners"].astype(float)
    elif data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        corners = _stl_text(data.decode("utf-8", errors="replace"))
    else:
        raise ConfigError(
            f"{len(data)} bytes; a binary STL of the {count} triangles that it announces has "
            f"{STL_HEADER + STL_TRIANGLE.itemsize * count}, and a text STL begins with 'solid': is the file truncated?"
        )
    return Polygons(UNITS[unit] * corners[:, [0, 1, 2, 2]], ())


def _stl_text(text: str) -> Array:
    """Corners [n, 3, 3] of one or more solids, each of them ended."""
    lines = text.splitlines()
    heads = [line.split()[0].lower() for line in lines if line.split()[:1] and "solid" in line.split()[0].lower()]
    words = [word for line in lines if "solid" not in line.partition(" ")[0].lower() for word in line.split()]
    facets = [words[first : first + len(FACET)] for first in range(0, len(words), len(FACET))]
    read = ((k, *pair) for k, facet in enumerate(facets, 1) for pair in zip_longest(facet, FACET, fillvalue=""))
    facet, word, wanted = next(((k, a, b) for k, a, b in read if b != "0" and a.lower() != b), (0, "", ""))
    refuse(
        ConfigError,
        (heads != ["solid", "endsolid"] * (len(heads) // 2),
         "'solid' and 'endsolid' do not alternate: is the file truncated?"),
        (facet, f"facet {facet} has {word[:40]!r}, expected {wanted!r}: truncated?"),
    )  # fmt: skip
    own = [n for n, word in enumerate(FACET) if word == "vertex"]
    corners = [[[_number(word) for word in facet[n + 1 : n + 4]] for n in own] for facet in facets]
    return np.array(corners, dtype=float).reshape(-1, 3, 3)


def _obj(path: Path, unit: str) -> Polygons:
    """Vertices (v) and polygons (f) of an OBJ; negative numbers of a polygon count back from the last vertex."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    for k, line in enumerate(_text(path).replace("\\\n", " ").splitlines(), 1):
        key, *words = line.partition("#")[0].split() or ["o"]
        known = key in OBJ_IGNORED
        if key == "v":
            known = len(words) in (3, 4, 6, 7)  # with a weight, a colour, or both
            points.append([_number(word) for word in words[:3]])
        elif key == "f":
            number = [int(word.partition("/")[0]) for word in words]
            number = [n - 1 if n > 0 else len(points) + n for n in number]
            known = len(number) >= 3 and all(0 <= n < len(points) for n in number)
            polygons.append(number)
        if not known:
            raise ConfigError(f"line {k} is {line.strip()[:40]!r}: an OBJ has 'v' and three numbers, 'f' and three or "
                              "more vertices of above it, and statements that change no polygon")  # fmt: skip
    if not polygons:
        return Polygons(np.empty((0, 4, 3)), ())
    corners = np.array(points)
    return Polygons(UNITS[unit] * np.concatenate([_fan(corners[number]) for number in polygons]), ())


def _fan(corners: Array) -> Array:
    """Panels [n, 4, 3] of a polygon [m, 3]: itself, or triangles from its first corner."""
    if len(corners) <= 4:
        return corners[[0, 1, 2, -1]][None]
    edge = np.roll(corners, -1, axis=0) - corners
    edge /= np.maximum(np.linalg.norm(edge, axis=1), 1e-300)[:, None]
    turns = np.cross(np.roll(edge, 1, axis=0), edge)
    if (turns @ turns.sum(axis=0)).min() < CONVEX:
        at = ", ".join(f"{v:.4g}" for v in corners[0])
        raise ConfigError(f"a polygon of {len(corners)} corners at {at} is not convex: triangulate on export")
    return np.stack([corners[[0, i, i + 1, i + 1]] for i in range(1, len(corners) - 1)])


def _meshio(path: Path) -> Array:
    """Panels [n, 4, 3] of another format."""
    with needs("meshio", "bem"):
        import meshio
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # a damaged file ends in any error of a reader's own
        raise ConfigError(str(error) or f"{type(error).__name__} in meshio: an unknown format, or damaged") from None
    points = np.asarray(mesh.points, dtype=float)
    parts = [np.empty((0, 4, 3))]
    for block in mesh.cells:
        if block.type in NO_SURFACE:
            continue
        number = [np.asarray(cell, dtype=np.int64) for cell in block.data]
        other, far = block.type not in LINEAR and block.type != "polygon", f"holds cells of the type {block.type}"
        refuse(
            ConfigError,
            (other, f"{far}: export the surface as triangles or quadrilaterals"),
            (any(cell.min() < 0 or cell.max() >= len(points) for cell in number),
             "a polygon has a corner that is not among the points: is the file damaged?"),
        )  # fmt: skip
        parts += [_fan(points[cell]) for cell in number]
    return np.concatenate(parts)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def _number(word: str) -> float:
    """A number as other programs write it; not Python's 1_0."""
    return float(word.replace("_", "x").replace("D", "E").replace("d", "e"))  # Fortran's


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
