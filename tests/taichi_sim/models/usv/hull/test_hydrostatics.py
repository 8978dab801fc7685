"""Hydrostatics of panelled hulls against closed forms, published tables and invariants."""

import json
from dataclasses import replace

import numpy as np
import pytest

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics, check_floats, down_in_body
from taichi_sim.models.usv.hull.mesh import BoxHull, TwinPontoons, WigleyHull, mesh

BOX = BoxHull(length=4.0, beam=2.0, draft=0.5, freeboard=0.5)
CG_BOX = (0.0, 0.0, -0.1)  # KG 0.6 m
VEE = TwinPontoons(
    y=0.4, freeboard=0.12, stations=((-1.0, 0.4, 0.17), (-0.5, 0.4, 0.15), (0.5, 0.4, 0.24), (1.0, 0.4, 0.3))
)
UPRIGHT = np.zeros(3)


@pytest.fixture(scope="module")
def box():
    return Hydrostatics(mesh(BOX), 4100.0, CG_BOX)


@pytest.fixture(scope="module")
def table(reference):
    return json.loads((reference / "hydrostatics" / "box_4x2x0.5.json").read_text())


def poses(count, heave, angle, seed=0):
    """Random poses [count, 3] with |heave|, |roll|, |pitch| below the bounds."""
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3)) * [heave, angle, angle]


def test_box_has_its_closed_form_stiffness(box, table):
    G = box.stiffness()
    assert np.diag(G) == pytest.approx([table["C33"], table["C44"], table["C55"]], rel=1e-9)
    assert np.abs(G - np.diag(np.diag(G))).max() < 1e-9 * G.max()
    assert box.volume == pytest.approx(table["mass"] / table["rho"], rel=1e-12)
    assert box.centre_of_buoyancy == pytest.approx([0, 0, table["T"] - table["KB"]], abs=1e-12)
    assert box.waterplane == pytest.approx((8.0, 0.0), abs=1e-9)
    assert box.metacentric_heights == pytest.approx((table["GM_T"], table["GM_L"]), rel=1e-9)
    assert box.equilibrium == pytest.approx([0, 0, 0], abs=1e-9)


def test_box_rights_itself_like_a_wall_sided_hull(box, table, columns):
    t = columns("hydrostatics/gz_wall_sided.csv")
    dry = t.heel_deg < 27  # neither the bilge leaves the water nor the deck enters
    assert box.righting_arm(np.deg2rad(t.heel_deg[dry])) == pytest.approx(t.GZ_m[dry], rel=1e-6, abs=1e-9)
    phi = np.deg2rad([3.0, 12.0, 24.0])
    wall = np.sin(phi) * (table["GM_T"] + table["BM_T"] * np.tan(phi) ** 2 / 2)
    assert box.righting_arm(phi) == pytest.approx(wall, rel=1e-6)
    assert np.rad2deg(box.angle_of_vanishing_stability) == pytest.approx(76.4, abs=1.0)


def test_box_at_90_degrees_has_the_arm_of_a_box_on_its_side(box):
    # On its side, 1 m wide and 2 m high, half immersed: buoyancy acts at mid-depth of the side, 0.1 m from the cg.
    assert box.righting_arm(np.pi / 2) == pytest.approx(-0.1, rel=1e-6)


def test_wigley_converges_to_its_closed_forms_at_second_order():
    L, B, T = 3.0, 0.3, 0.2
    errors = []
    for n in (8, 16, 32):
        panels = mesh(WigleyHull(length=L, beam=B, draft=T, freeboard=0.1, panels_along=n, panels_up=n + 1))
        volume = 4 / 9 * L * B * T
        hull = Hydrostatics(panels, RHO_SEA * volume, (0.0, 0.0, 3 / 8 * T))
        G = hull.stiffness() / (RHO_SEA * GRAVITY)
        # With the weight in the centre of buoyancy the stiffness is the waterplane's second moment.
        exact = {"V": volume, "A": 2 / 3 * L * B, "I_T": 4 / 105 * L * B**3, "I_L": L**3 * B / 30, "z_B": 3 / 8 * T}
        got = {"V": hull.volume, "A": G[0, 0], "I_T": G[1, 1], "I_L": G[2, 2], "z_B": hull.centre_of_buoyancy[2]}
        errors.append([abs(got[k] / exact[k] - 1) for k in exact])
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(order > 1.8) and np.all(order < 2.2)
    assert np.max(errors[-1]) < 5e-3


def vee_volume_and_centroid(hull):
    """Closed form of two wedge pontoons: area b (k + f) / 2 of each section, its centroid a third below the deck."""
    x, b, k = np.array(hull.stations).T
    node, weight = np.polynomial.legendre.leggauss(4)
    t = (1 + node[:, None]) / 2
    w = weight[:, None] / 2 * np.diff(x)
    at, beam, keel = (v[:-1] + t * np.diff(v) for v in (x, b, k))
    section = w * beam * (keel + hull.freeboard) / 2
    V = section.sum()
    return 2 * V, np.array(
        [(section * at).sum(), 0, (section * ((keel + hull.freeboard) / 3 - hull.freeboard)).sum()]
    ) / V


def test_submerged_hull_is_lifted_through_its_centroid_at_any_attitude():
    volume, centroid = vee_volume_and_centroid(VEE)
    hull = Hydrostatics(mesh(VEE), 1.0, (0.0, 0.0, 0.0))
    assert hull.volume_below_deck == pytest.approx(volume, rel=1e-9)
    pose = poses(50, 1.0, np.pi) * [1, 1, 0.5] + [10.0, 0, 0]
    water = hull.buoyancy(pose)
    force = -RHO_SEA * GRAVITY * volume * down_in_body(pose[:, 1], pose[:, 2])
    assert water[:, :3] == pytest.approx(force, abs=1e-9 * np.abs(force).max())
    assert water[:, 3:] == pytest.approx(np.cross(centroid, force), abs=1e-9 * np.abs(force).max())


def horizontal_force(hull, pose):
    """Largest horizontal force over the weight in calm water, of the strips alone."""
    force = hull.strip_load(pose)[:, :3]
    down = down_in_body(pose[:, 1], pose[:, 2])
    level = force - np.sum(force * down, axis=1, keepdims=True) * down
    return np.linalg.norm(level, axis=1).max() / hull.weight


def test_strips_do_not_push_sideways_in_calm_water():
    """With the kernel's two strips: exact where a water line crosses panels from side to side, warped ones nearly."""
    pose = poses(200, 1.0, 1.0)
    vee = Hydrostatics(mesh(VEE), 80.0, (0.0, 0.0, 0.0), strips=2)
    assert horizontal_force(vee, pose * [0.04, 0.05, 0.03]) < 2e-5
    assert horizontal_force(replace(vee, strips=1), pose * [0.04, 0.05, 0.03]) > 5e-4  # a middle line is not enough
    box = Hydrostatics(mesh(BOX), 4100.0, CG_BOX, strips=2)
    assert horizontal_force(box, pose * [0.2, 0.3, 0.0]) < 1e-12
    # a water line that ends within a panel: the error falls with the panel's length
    errors = []
    for n in (2, 4, 8, 16):
        finer = BOX.model_copy(update={"panels_along": n, "panels_across": n, "panels_up": 2})
        errors.append(horizontal_force(replace(box, panels=mesh(finer)), pose * [0.2, 0.35, 0.35]))
    assert errors[0] < 0.05
    assert errors[-1] < errors[0] / 16


def test_restoring_loads_do_no_work_round_a_closed_loop():
    t = np.linspace(0, 2 * np.pi, 2001)
    loop = np.stack([np.cos(t), np.sin(t), np.cos(t + 1.0)], axis=1)
    box = Hydrostatics(mesh(BOX), 4100.0, CG_BOX, strips=2)
    vee = Hydrostatics(mesh(VEE), 80.0, (0.0, 0.0, 0.0), strips=2)
    for hull, size, limit in ((box, [0.15, 0.25, 0.09], 1e-12), (vee, [0.04, 0.06, 0.04], 1e-5)):
        gradient = hull.energy_gradient(loop * size)
        work = np.sum((gradient[1:] + gradient[:-1]) / 2 * np.diff(loop * size, axis=0), axis=1)
        assert abs(work.sum()) / np.abs(work).sum() < limit


def test_loads_are_continuous_where_a_panel_enters_the_water(box):
    # A pitched deck panel has no slope along `up`: it goes from dry to wet at once.
    heave = np.linspace(0.3, 0.7, 4001)
    pose = np.stack([heave, 0 * heave, np.full_like(heave, np.deg2rad(8.0))], axis=1)
    jump = np.abs(np.diff(box.loads(pose), axis=0)).max()
    assert jump < 0.005 * box.weight


def test_round_pontoons_float_like_the_points_of_vrx(reference):
    immersion, _, force = np.loadtxt(reference / "wamv" / "buoyancy_per_point.csv", delimiter=",", skiprows=2).T
    rho, r, L = 997.7735, 0.213, 4.9
    sides = TwinPontoons(
        y=1.03, freeboard=r, section="round", panels_girth=60, stations=((-L / 2, 2 * r, 0.0), (L / 2, 2 * r, 0.0))
    )
    hull = Hydrostatics(mesh(sides), 211.0, (0.0, 0.0, 0.0), rho)
    heave = immersion[:, None] * [1.0, 0.0, 0.0]
    assert -hull.buoyancy(heave)[:, 2] / 4 == pytest.approx(force, rel=0.01)


def test_few_sided_round_pontoons_keep_the_area_of_the_half_circle():
    r, L = 0.213, 4.9
    for n in (2, 3, 5):
        sides = TwinPontoons(
            y=1.0, freeboard=r, section="round", panels_girth=n, stations=((-L / 2, 2 * r, 0.0), (L / 2, 2 * r, 0.0))
        )
        hull = Hydrostatics(mesh(sides), 1.0, (0.0, 0.0, 0.0))
        assert hull.volume_below_deck == pytest.approx(2 * L * np.pi * r**2 / 2, rel=1e-9)


def test_equilibrium_balances_weight_and_trim():
    hull = Hydrostatics(mesh(BOX), 4100.0, (0.1, 0.02, -0.1))
    pose = hull.equilibrium
    assert np.abs(hull.energy_gradient(pose)).max() < 1e-3
    # To first order the shift of weight over the stiffness.
    assert pose[1] == pytest.approx(0.02 / (0.31666666), rel=0.02)
    assert pose[2] == pytest.approx(-0.1 / 2.31666666, rel=0.02)


def test_a_twin_hull_keeps_righting_until_its_windward_pontoon_is_high():
    hull = Hydrostatics(mesh(VEE), 100.0, (0.08, 0.0, 0.0))
    assert np.deg2rad(45) < hull.angle_of_vanishing_stability < np.pi
    assert hull.righting_arm(hull.angle_of_vanishing_stability) == pytest.approx(0.0, abs=2e-3)


def test_trim_follows_the_heel_and_never_jumps():
    """Twin hulls find two trims at large heels; the arm of each side is the other's mirror image."""
    hull = Hydrostatics(mesh(VEE), 80.0, (0.2, 0.0, -0.1))
    heel = np.deg2rad(np.arange(20.0, 110.0, 3.0))
    GZ = hull.righting_arm(heel)
    assert np.abs(np.diff(GZ, 2)).max() < 0.01
    assert hull.righting_arm(-heel[::5]) == pytest.approx(-GZ[::5], abs=1e-6)


@pytest.mark.parametrize(
    "mass, cg, words",
    [
        (9000.0, CG_BOX, "sinks: its mass of 9000 kg is above the 8200 kg"),
        (4100.0, (0.0, 0.0, -0.5), "no stable upright attitude.*lower the centre of gravity"),
        (6500.0, (0.2, 0.0, -0.1), "deck .* under water at rest"),
    ],
)
def test_hulls_that_do_not_float_are_refused(mass, cg, words):
    with pytest.raises(ValueError, match=words):
        check_floats(Hydrostatics(mesh(BOX), mass, cg))


def test_a_hull_that_floats_is_accepted(box):
    check_floats(box)
