"""From a hull to a hydrodynamic database: file, frames, shipped databases, meshes, offsets; boundary elements."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from taichi_sim.applications.hydro import hull_input as hulls
from taichi_sim.applications.hydro.make_database import ABOVE, BELOW, Spectrum, Wishes, plan, spikes
from taichi_sim.applications.hydro.offsets import compared, offsets
from taichi_sim.applications.hydro.panelling import wetted
from taichi_sim.applications.hydro.wetted_surface import TURN, WettedSurface, mirrored, reverse, turned_matrix
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder
from taichi_sim.models.usv.hull.database import HydroDatabase, database_file, hull_hash
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import BoxHull, Panels, StationsHull, mesh
from tools import hydrodynamics

VEHICLES = config_folder() / "vehicles"
HULLS = ("otter", "wamv", "barge", "fpso")
SHIPPED = tuple(name for name in HULLS if database_file(VEHICLES / f"{name}.toml").is_file())
RHO, G = 1025.0, 9.81
BOX = BoxHull(length=4.0, beam=2.0, draft=0.5, freeboard=0.5, panels_along=4, panels_across=2, panels_up=2)


def shipped(name: str) -> tuple[hulls.FloatingHull, HydroDatabase]:
    file = VEHICLES / f"{name}.toml"
    return hulls.of_vehicle(file)[0], HydroDatabase.read(database_file(file))


def test_a_database_comes_back_as_it_was_written(tmp_path):
    _, found = shipped("barge")
    found.write(tmp_path / "again.hydro.json")
    again = HydroDatabase.read(tmp_path / "again.hydro.json")
    for field in dataclasses.fields(HydroDatabase):
        if field.name != "memory":
            np.testing.assert_equal(getattr(again, field.name), getattr(found, field.name))
    assert again.memory is not None and found.memory is not None
    for name in ("frequency", "damping", "shape"):
        np.testing.assert_equal(getattr(again.memory, name), getattr(found.memory, name))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop("damping"), "damping: missing"),
        (lambda d: d["added_mass"].pop(), "added_mass has 49 entries, and omega 50"),
        (lambda d: d["omega"].reverse(), "omega must rise"),
        (lambda d: d["excitation_re"][0][0].__setitem__(0, None), "excitation_re.0.0.0 = None"),
        (lambda d: d.update(format="1"), "format = '1'"),
        (lambda d: d.update(rho=-1.0), "rho = -1.0: input should be greater than 0"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(tmp_path, change, says):
    data = json.loads((VEHICLES / "barge.hydro.json").read_text())
    change(data)
    file = tmp_path / "bad.hydro.json"
    file.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match=says) as refused:
        HydroDatabase.read(file)
    assert str(refused.value).startswith(str(file))


def test_the_hash_is_of_the_hull_and_of_no_order():
    panels = mesh(BOX)
    order = np.random.default_rng(1).permutation(len(panels))
    of = {name: getattr(panels, name)[order] for name in ("centre", "along", "up", "twist", "area", "row")}
    assert hull_hash(Panels(**of, deck=panels.deck)) == hull_hash(panels)
    assert hull_hash(mesh(BOX.model_copy(update={"beam": 2.0001}))) != hull_hash(panels)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_databases_are_of_the_shipped_hulls(name):
    craft, found = shipped(name)
    assert found.hull == hull_hash(craft.panels)
    assert found.omega[0] < BELOW * 1.01 * min(found.settings["resonances"])
    assert found.omega[-1] > 2.0 * max(found.settings["resonances"]) or name == "fpso"
    assert ABOVE >= 2.0
    hydrostatics = Hydrostatics(craft.panels, craft.mass, craft.cg)
    assert found.volume == pytest.approx(hydrostatics.volume, rel=2e-3)
    # Heave, roll, pitch of the simulator's own panels, in the vehicle's frame
    ours = found.stiffness[np.ix_([2, 3, 4], [2, 3, 4])]
    scale = np.sqrt(np.outer(np.diag(ours), np.diag(ours)))
    np.testing.assert_allclose(ours / scale, hydrostatics.stiffness() / scale, atol=4e-3)


@pytest.mark.parametrize("name", SHIPPED)
def test_long_waves_lift_a_hull_by_its_waterplane(name):
    """A wave much longer than the hull: heave load C33 - omega^2 A33, Froude-Krylov alone C33, upward at the crest."""
    _, found = shipped(name)
    omega, C33 = found.omega[0], found.stiffness[2, 2]
    np.testing.assert_allclose(found.froude_krylov[0, :, 2], -C33, rtol=0.12)  # z down: up is negative
    np.testing.assert_allclose(found.excitation[0, :, 2].real, -(C33 - omega**2 * found.added_mass[0, 2, 2]), rtol=0.12)


@pytest.mark.parametrize("name", SHIPPED)
def test_radiation_takes_energy(name):
    """B has no negative eigenvalue, in units in which a metre is a quarter of the length."""
    craft, found = shipped(name)
    unit = np.array([1, 1, 1, *[4 / np.ptp(craft.panels.deck[:, 0])] * 3])
    values = np.linalg.eigvalsh(found.damping * unit[:, None] * unit)
    assert (values.min(axis=1) > -2e-3 * values.max()).all()


def test_a_frequency_that_stands_out_alone_is_found():
    """One damping that is many times both its neighbours', in any mode; not a peak that its flanks show."""
    omega = np.linspace(1.0, 4.0, 31)
    peak = 1 / ((omega - 2.0) ** 2 + 0.01)
    damping = np.einsum("n,ij->nij", peak, np.eye(6))
    assert not len(spikes(omega, damping, ()))
    damping[23, 4, 4] *= 50.0
    assert spikes(omega, damping, ()).tolist() == [23]
    assert not len(spikes(omega, damping, (float(omega[23]),)))  # asked for: kept


HASKIND = tuple(case for case in (("fpso", 0.02), ("barge", 0.2)) if case[0] in SHIPPED)


@pytest.mark.parametrize(("name", "tolerance"), HASKIND)
def test_damping_is_what_haskind_makes_of_the_wave_loads(name, tolerance):
    """B_ii = k / (8 pi rho g c_g) integral |X_i|^2 over all headings: another way round the same waves.

    The barge is that of the published tables, 720 panels, whose roll damping is 18 % low (docs/hydrodynamics.md).
    """
    _, found = shipped(name)
    k, c_g = found.omega**2 / G, G / (2 * found.omega)
    around = np.trapezoid(np.abs(found.excitation) ** 2, np.deg2rad(found.heading_deg), axis=1) * 2
    haskind = k[:, None] / (8 * np.pi * RHO * G * c_g[:, None]) * around
    B = found.damping[:, range(6), range(6)]
    below = found.omega < found.omega[-1] / 3  # 15 deg between headings are few for short waves
    for mode in range(6):
        error = np.abs(haskind - B)[below, mode].max() / B[:, mode].max()
        assert error < tolerance, (mode, error)


def test_loads_turn_over_with_the_frame():
    """Half a turn about x: what a matrix does in one frame, the turned one does in the other."""
    A = np.random.default_rng(0).normal(size=(6, 6))
    v = np.arange(1.0, 7.0)
    np.testing.assert_allclose(turned_matrix(A) @ v, TURN * (A @ (TURN * v)))


@pytest.mark.parametrize("size", [0.4, 0.13])
def test_wetted_panels_are_the_simulators_hull(size):
    for name in HULLS:
        craft, _ = hulls.of_vehicle(VEHICLES / f"{name}.toml")
        scale = np.ptp(craft.panels.centre[:, 0]) / 4
        found = wetted(craft.panels, size * scale)
        hydrostatics = Hydrostatics(craft.panels, craft.mass, craft.cg)
        assert found.volume == pytest.approx(hydrostatics.volume, rel=1e-4)
        assert found.waterplane["A"] == pytest.approx(hydrostatics.waterplane[0], rel=1e-4)
        assert np.linalg.norm(found.area.sum(axis=0)[:2]) < 1e-9 * found.waterplane["A"]
        assert 1 in found.planes and found.whole[..., 2].max() < 1e-9


def test_offsets_keep_what_floats(tmp_path):
    """A round-bilged ship as a mesh, from a CSV of its port half."""
    x = np.linspace(-1, 1, 41)
    angle = np.linspace(0, np.pi / 2, 13)
    half_beam = 6.0 * (1 - x**4)
    y = half_beam[:, None] * np.sin(angle) ** 0.5
    points = np.stack([50 * x[:, None] + 0 * y, y, -4.0 * np.cos(angle) ** 0.5 + 0 * y], axis=-1)
    panels = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2).reshape(-1, 12)
    file = tmp_path / "ship.csv"
    np.savetxt(file, panels, delimiter=",", header="x1,y1,z1,x2,y2,z2,x3,y3,z3,x4,y4,z4", comments="")
    surface = hulls.read_mesh(file, "m", 0.0, None, None)
    made = mesh(offsets(surface, 14, 5, 2.0))
    assert np.linalg.norm(made.area.sum(axis=0)) < 1e-9
    for name, (ours, theirs) in compared(made, surface, RHO * surface.volume, np.zeros(3), RHO, G).items():
        scale = 100.0 if name.startswith("LCB") else theirs
        small = {"GM": 0.08, "KB": 0.02, "Ix": 0.02, "Iy": 0.02}  # GM is what two large lengths differ by
        allowed = next((value for part, value in small.items() if part in name), 0.006)
        assert abs(ours - theirs) / scale < allowed, name


def test_offsets_of_two_hulls_make_two_hulls():
    section = ((0.2, -0.1), (0.25, 0.0), (0.4, 0.3), (0.55, 0.0), (0.6, -0.1))
    panels = mesh(StationsHull(stations=((-1.0, section), (1.0, section))))
    assert np.linalg.norm(panels.area.sum(axis=0)) < 1e-12
    assert Hydrostatics(panels, 1.0, (0.0, 0.0, 0.0)).volume == pytest.approx(2 * 2 * 0.5 * 0.3 * 0.3)


def closed_box(scale: float = 1.0, dz: float = 0.0) -> np.ndarray:
    """Panels of the whole box with its deck, z up."""
    below = wetted(mesh(BOX), 0.5).whole
    above = reverse(below * [1.0, 1.0, -1.0])
    return (np.concatenate([below, above]) + [0.0, 0.0, dz]) * scale


def gdf(folder: Path, panels: np.ndarray) -> Path:
    file = folder / "box.gdf"
    rows = "\n".join(" ".join(f"{v:.9g}" for v in panel.ravel()) for panel in panels)
    file.write_text(f"a box\n1.0 9.81\n0 0\n{len(panels)}\n{rows}\n")
    return file


def test_a_whole_hull_at_a_corner_is_no_half(tmp_path):
    """Wigley's hull with its port side in y = 0, declared symmetric about that plane: it would be 2 hulls wide."""
    x, z = np.meshgrid(np.linspace(-2, 2, 13), np.linspace(-0.3, 0, 5), indexing="ij")
    side = np.stack((x, 0.5 * (1 - (x / 2) ** 2) * (1 - (z / 0.3) ** 2), z), axis=-1)
    quads = np.stack((side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]), axis=2).reshape(-1, 4, 3)
    port = reverse(quads * [1, -1, 1])
    file = gdf(tmp_path, np.concatenate([quads, port]) + [0.0, 0.5, 0.0])
    file.write_text(file.read_text().replace("\n0 0\n", "\n0 1\n"))
    with pytest.raises(ConfigError, match="only touches it, and is not open there"):
        hulls.read_mesh(file, "m", 0.0, None, None)
    half = gdf(tmp_path, quads)
    half.write_text(half.read_text().replace("\n0 0\n", "\n0 1\n"))
    assert hulls.read_mesh(half, "m", 0.0, None, None).volume == pytest.approx(4 * 0.3 * 4 / 9, rel=0.03)


def test_a_mesh_is_cut_at_the_water_and_halved(tmp_path):
    found = hulls.read_mesh(gdf(tmp_path, closed_box(1000.0, 0.2)), "mm", 0.2, None, 4.0)
    assert found.volume == pytest.approx(4.0) and found.waterplane["A"] == pytest.approx(8.0)
    assert found.planes == (1,)


def test_a_gdf_keeps_its_size_whatever_its_output_is_scaled_by(tmp_path, capsys):
    """WAMIT: ULEN only makes output dimensionless, and is of the unit of GRAV."""
    file = gdf(tmp_path, closed_box())
    text = file.read_text()
    file.write_text(text.replace("1.0 9.81", "4.0 9.80665"))
    assert hulls.read_mesh(file, "m", 0.0, None, None).volume == pytest.approx(4.0)
    file.write_text(text.replace("1.0 9.81", "4.0 32.174"))
    assert hulls.read_mesh(file, "m", 0.0, None, None).volume == pytest.approx(4.0 * 0.3048**3)
    assert "means feet" in capsys.readouterr().out
    file.write_text(text.replace("1.0 9.81", "4.0 1.0"))
    with pytest.raises(ConfigError, match="GRAV = 1 "):
        hulls.read_mesh(file, "m", 0.0, None, None)


def test_a_quarter_is_completed_about_its_own_planes(tmp_path):
    """x of a quarter runs from 0; its plane of symmetry, not its middle, is amidships, or where --midships is not."""
    panels = closed_box()
    quarter = panels[(panels[..., :2] > -1e-9).all(axis=(1, 2))]
    file = gdf(tmp_path, quarter)
    file.write_text(file.read_text().replace("\n0 0\n", "\n1 1\n"))
    for midships in (None, 0.5):
        found = hulls.read_mesh(file, "m", 0.0, midships, None)
        assert found.volume == pytest.approx(4.0) and np.ptp(found.whole[..., 0]) == pytest.approx(4.0)
        assert found.centre_of_buoyancy == pytest.approx([-(midships or 0.0), 0.0, -0.25])


def brick(x, y, z=(-0.3, 0.3), n=(8, 4, 3), without=()) -> np.ndarray:
    """Panels of a box between two x, y and z, divided n times, without some sides ("-x", "+y" ...)."""
    at = [np.linspace(low, high, count + 1) for (low, high), count in zip((x, y, z), n, strict=True)]
    found = []
    for axis in range(3):
        u, v = [a for a in range(3) if a != axis]
        points = np.zeros((n[u] + 1, n[v] + 1, 3))
        points[..., u], points[..., v] = np.meshgrid(at[u], at[v], indexing="ij")
        for sign, end in (("-", 0), ("+", -1)):
            if f"{sign}{'xyz'[axis]}" in without:
                continue
            points[..., axis] = at[axis][end]
            own = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
            outward = (sign == "+") == (axis != 1)  # x cross z is -y
            found.append(own.reshape(-1, 4, 3) if outward else reverse(own.reshape(-1, 4, 3)))
    return np.concatenate(found)


def bottom(z: float) -> np.ndarray:
    """A bottom or floor whose panels are not those of the sides."""
    return brick((-2, 2), (-0.6, 0.6), (z, 0.3), n=(5, 7, 2), without=("-x", "+x", "-y", "+y", "+z"))


def stl(folder: Path, panels: np.ndarray) -> Path:
    file = folder / "mesh.stl"
    rows = [f"vertex {' '.join(f'{v:.6f}' for v in p)}" for q in panels[:, [0, 1, 2, 0, 2, 3]] for p in q]
    facets = "\n".join(
        "\n".join(["facet normal 0 0 0", "outer loop", *rows[k : k + 3], "endloop", "endfacet"])
        for k in range(0, len(rows), 3)
    )
    file.write_text(f"solid mesh\n{facets}\nendsolid mesh\n")
    return file


HULL, X, Y = brick((-2, 2), (-0.6, 0.6)), (-2, 2), (-0.6, 0.6)
TWIN = np.concatenate([brick(X, (0.5, 0.9)), brick(X, (-0.9, -0.5))])
OUTSIDE = ~((np.abs(HULL.mean(axis=1)[:, :2]) < [0.5, 0.3]).all(axis=1))
WELL = np.concatenate([HULL[OUTSIDE], reverse(brick((-0.5, 0.5), (-0.3, 0.3), n=(2, 2, 3), without=("-z", "+z")))])


@pytest.mark.parametrize(
    ("panels", "volume"),
    [
        (HULL, 1.44),
        (brick(X, Y, without=("+z",)), 1.44),
        (reverse(HULL), 1.44),
        (brick(X, (0.0, 0.6), without=("-y",)), 1.44),
        (brick(X, (-0.6, 0.0), without=("+y",)) + [0.0, 1e-5, 0.0], 1.44),
        (np.concatenate([brick(X, Y, without=("-z",)), bottom(-0.3)]), 1.44),
        (TWIN, 0.96),
        (np.concatenate([TWIN, brick((-1, 1), (-0.9, 0.9), (0.25, 0.4))]), 0.96),
        (WELL, 1.44 - 1.0 * 0.6 * 0.3),
    ],
    ids=["whole", "open deck", "inward", "port", "starboard", "T-junctions", "twin", "deck", "moonpool"],
)
def test_one_skin_about_the_centreplane_passes(tmp_path, panels, volume):
    """Boxes of draught 0.3: volume is area times draught, KB half of it, whatever stands above the water."""
    found = hulls.read_mesh(stl(tmp_path, panels), "m", 0.0, None, None)
    assert found.volume == pytest.approx(volume, rel=1e-4) and found.planes == (1,)
    assert found.waterplane["A"] == pytest.approx(volume / 0.3, rel=1e-4)
    assert found.centre_of_buoyancy == pytest.approx([0.0, 0.0, -0.15], abs=1e-6)


@pytest.mark.parametrize(
    ("panels", "says"),
    [
        (closed_box(1000.0), "is it in millimetres"),
        (closed_box(0.01), "is it in another unit"),
        (closed_box(dz=3.0), "lies above the water"),
        (np.delete(closed_box(), 2, axis=0), "has holes below the water"),
        (HULL + [0.0, 0.6, 0.0], "y from 0 to 1.2 m, its own at y = 0.6 m; move it by -0.6 m in y"),
        (HULL + [0.0, 0.02, 0.0], "move it by -0.02 m in y"),
        (brick(X, (0.1, 0.6), without=("-y",)), "move the half so that it is open at y = 0"),
        (np.concatenate([HULL, brick((-1, 1), (0.9, 1.1))]), "not alike to port and starboard: they differ by 7.[5-9]"),
        (brick(X, (-0.3, 0.2), (-0.6, 0.6), without=("+y",)), "or is its y up"),
        (brick(X, Y, without=("-z",)), "its z points down"),
        (np.concatenate([brick((-2, 0.5), Y), brick((-0.5, 2), Y)]), "overlap"),
        (np.concatenate([brick((-2, 0.5), Y, n=(1, 1, 1)), brick((0.49, 2), Y, n=(1, 1, 1))]), "parts that overlap"),
        (np.concatenate([HULL, reverse(brick((-1.9, 1.9), (-0.5, 0.5), (-0.2, 0.25)))]), "has an inner skin"),
        (np.concatenate([HULL, brick((-1, 1), (-0.3, 0.3), (-0.25, -0.1))]), "has an inner skin"),
        (np.concatenate([HULL, brick((-2, 0), Y, without=("-x", "-y", "+y", "-z", "+z"))]), "inside .a bulkhead"),
        (np.concatenate([HULL, bottom(-0.13)]), "has a panel inside .a bulkhead"),
        (np.concatenate([brick((-2, 0), Y), brick((0, 2), Y)]), "panels twice"),
        (np.concatenate([brick((-2, 0), Y), brick((0, 2), Y, n=(3, 5, 2))]), "has a bulkhead, a plate, or parts face"),
        (np.concatenate([HULL, HULL[:1]]), "panels twice"),
        (np.concatenate([HULL, HULL + 1e-5]), "has panels twice"),
    ],
)
def test_a_mesh_that_is_no_hull_is_refused(tmp_path, panels, says):
    with pytest.raises(ConfigError, match=says):
        hulls.read_mesh(gdf(tmp_path, panels), "m", 0.0, None, None)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text[: len(text) // 2], "truncated|expected"),
        (lambda text: text.replace("endsolid mesh\n", ""), "truncated"),
        (lambda text: text.replace("vertex", "vertx", 1), "facet 1 has 'vertx"),
        (lambda text: text.replace("0.600000", "nan", 1), "not a finite number"),
    ],
)
def test_a_damaged_mesh_is_refused(tmp_path, change, says):
    file = stl(tmp_path, HULL)
    file.write_text(change(file.read_text()))
    with pytest.raises(ConfigError, match=f"mesh.stl.*({says})"):
        hulls.read_mesh(file, "m", 0.0, None, None)


def test_an_obj_is_read_as_others_read_it(tmp_path):
    """Numbers that count back, texture and normals beside them, polygons of many corners, several objects."""
    file = tmp_path / "mesh.obj"
    hexagon = [(2 * np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3]
    rows = [f"v {x:.9f} {y:.9f} {z} 1.0" for z in (-0.3, 0.3) for x, y in hexagon]
    sides = [f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7}/1/1 {i + 7}//1" for i in range(6)]
    file.write_text("\n".join(["o a", *rows, "vn 0 0 1", "s off", "f 6 5 4 3 2 1", "f -6 -5 -4 -3 -2 -1", *sides]))
    found = hulls.read_mesh(file, "m", 0.0, None, None)
    assert found.volume == pytest.approx(0.3 * 2 * 3 * np.sqrt(3) / 2, rel=1e-5)
    file.write_text(file.read_text().replace("f 6 5", "f 60 5"))
    with pytest.raises(ConfigError, match="line 16 is 'f 60 5"):
        hulls.read_mesh(file, "m", 0.0, None, None)


def test_offsets_that_are_not_the_meshs_hull_are_refused(tmp_path):
    """A trimaran: offsets hold one hull or two, so their GM is 20 % off."""
    one = (1, 1, 1)
    parts = [brick(X, Y, n=one), *(brick((-1, 1), y, (-0.1, 0.3), one) for y in ((0.9, 1.1), (-1.1, -0.9)))]
    surface = hulls.read_mesh(stl(tmp_path, np.concatenate(parts)), "m", 0.0, None, None)
    craft = hulls.of_mesh(surface, "trimaran", None, None, None, (2, 2, 0.3))
    wishes = Wishes(RHO, G, np.inf, 100, 0, None, True, "direct", Spectrum(None, None, (), None), 1, True)
    with pytest.raises(ConfigError, match="not the mesh's hull: waterplane Ixx, m.4: .*give this mesh as --mesh"):
        plan(craft, surface, wishes)
    with pytest.raises(ConfigError, match="no table of offsets can be made"):
        hulls.of_mesh(hulls.read_mesh(stl(tmp_path, WELL), "m", 0.0, None, None), "well", None, None, None, (3, 2, 0.3))


def test_bow_and_stern_exchanged_are_found_by_the_centre_of_buoyancy(tmp_path):
    """A box whose bottom rises towards the bow from 0.3 to 0.1 m: LCB = -1/3 m."""
    wedge = brick(X, Y, n=(1, 1, 1))
    wedge[..., 2] = np.where((wedge[..., 0] > 0) & (wedge[..., 2] < 0), -0.1, wedge[..., 2])
    ahead, astern = (hulls.read_mesh(stl(tmp_path, p), "m", 0.0, None, None) for p in (wedge, wedge * [-1.0, 1.0, 1.0]))
    assert ahead.centre_of_buoyancy[0] == pytest.approx(-astern.centre_of_buoyancy[0]) == pytest.approx(-1 / 3)
    craft = hulls.of_mesh(ahead, "wedge", None, None, None, (2, 2, 0.3))
    wishes = Wishes(RHO, G, np.inf, 100, 0, None, True, "direct", Spectrum(None, None, (), None), 1, True)
    with pytest.raises(ConfigError, match="LCB.*are bow and stern exchanged"):
        plan(dataclasses.replace(craft, shape=None), astern, wishes)


def test_normals_are_mended(tmp_path, capsys):
    panels = closed_box()
    panels[::3] = reverse(panels[::3])
    found = hulls.read_mesh(gdf(tmp_path, reverse(panels)), "m", 0.0, None, None)
    assert found.volume == pytest.approx(4.0)
    assert "turned over" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "way"), [("a.STEP", "export this drawing as STL"), ("a.pnl", "a.pnl: cannot be read")]
)
def test_a_mesh_of_another_kind_is_told_by_its_name(tmp_path, name, way):
    if name.endswith(".pnl"):
        pytest.importorskip("capytaine", reason="capytaine reads panels of other codes")
    (tmp_path / name).write_text("ISO-10303-21;\n")
    with pytest.raises(ConfigError, match=way):
        hulls.read_mesh(tmp_path / name, "m", 0.0, None, None)


@pytest.mark.parametrize(
    ("mass", "cg", "says"),
    [(9000.0, 0.0, "above the"), (4100.0, -1.0, "metacentric height"), (10.0, 0.0, "check mass")],
)
def test_what_does_not_float_is_refused(mass, cg, says):
    craft = hulls.FloatingHull("box", mesh(BOX), mass, (0.0, 0.0, cg), np.eye(6))
    with pytest.raises(ConfigError, match=says):
        hulls.check_floating(craft, wetted(mesh(BOX), 0.5), RHO, G)


def test_without_capytaine_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "capytaine", None)
    assert hydrodynamics.main(["barge"]) == 1
    assert capsys.readouterr().err.strip() == 'error: capytaine is not installed: pip install "taichi-sim[bem]"'


def test_only_a_vehicles_own_database_is_fitted_again(capsys, tmp_path):
    other = VEHICLES / "barge.hydro.json"
    assert hydrodynamics.main(["otter", "--refit", "--out", str(other)]) == 1
    assert "barge.hydro.json: of another hull than otter.toml's" in capsys.readouterr().err
    assert hydrodynamics.main(["raft.stl", "--refit"]) == 1
    assert "--refit is of a vehicle file" in capsys.readouterr().err
    assert hydrodynamics.main(["otter", "--refit", "--out", str(tmp_path / "none.hydro.json")]) == 1
    assert "none.hydro.json" in capsys.readouterr().err


def test_images_keep_their_normals_outward():
    panels = wetted(mesh(BOX), 0.5).panels
    for axis in (0, 1):
        assert WettedSurface(mirrored(panels, axis)).area[:, 2].sum() == pytest.approx(
            WettedSurface(panels).area[:, 2].sum()
        )
