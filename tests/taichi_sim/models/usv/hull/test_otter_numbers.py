"""configs/vehicles/otter.toml against the definitions of its source, PythonVehicleSimulator's otter (c717e07)."""

import numpy as np
import pytest

from taichi_sim.config.io import config_folder, read_toml
from taichi_sim.kernels.rigid_body import rigid_body_mass, skew

EXACT = 1e-14  # relative: all digits of a double
AHEAD, ASTERN = 24.4, 13.6  # kgf of both propellers at most
TOP_SPEED = 6 * 0.5144  # m/s
DAMPING_RATIOS = 0.3, 0.2, 0.4  # of heave, roll, pitch
LCF = -0.2  # m, centre of flotation


@pytest.fixture(scope="module")
def published(reference):
    return read_toml(reference / "params" / "otter.toml")


@pytest.fixture(scope="module")
def ours():
    return read_toml(config_folder() / "vehicles" / "otter.toml")


@pytest.fixture(scope="module")
def inertia(published):
    """cg [3] of hull and payload, their inertia about CO [3, 3], and M_rb [6, 6], which shifts that to CO again."""
    main = published["main"]
    m, payload = main["mass_hull_kg"], main["mass_payload_kg"]
    total = m + payload
    cg = (m * np.array(main["rg_hull_m"]) + payload * np.array(main["rp_payload_m"])) / total
    gyration = np.array([main["radius_gyration_m"][key] for key in ("R44", "R55", "R66")])
    I_g = m * (np.diag(gyration**2) - skew(cg) @ skew(cg)) - payload * np.linalg.matrix_power(
        skew(main["rp_payload_m"]), 2
    )
    return cg, I_g, rigid_body_mass(total, cg, I_g)


@pytest.fixture(scope="module")
def displaced(published):
    """Volume (m^3) and the draft of a pontoon (m)."""
    main, pontoon = published["main"], published["pontoon"]
    volume = (main["mass_hull_kg"] + main["mass_payload_kg"]) / main["rho"]
    return volume, volume / (2 * pontoon["Cb"] * pontoon["beam_m"] * main["length_m"])


@pytest.fixture(scope="module")
def stiffness(published, inertia, displaced):
    """G33, G44, G55 about the centre of flotation."""
    main, pontoon, (volume, draft) = published["main"], published["pontoon"], displaced
    L, B, y, C_w = main["length_m"], pontoon["beam_m"], pontoon["y_m"], pontoon["Cw"]
    area = C_w * L * B
    I_T = L * B**3 / 6 * (6 * C_w**3 / ((1 + C_w) * (1 + 2 * C_w))) + 2 * area * y**2
    I_L = 0.8 * B * L**3 / 6
    KB, KG = (5 * draft / 2 - 0.5 * volume / (L * B)) / 3, draft - inertia[0][2]
    weight = main["rho"] * main["g"] * volume
    return main["rho"] * main["g"] * 2 * area, weight * (KB + I_T / volume - KG), weight * (KB + I_L / volume - KG)


def test_rigid_body_and_added_mass(published, ours, inertia):
    cg, I_g, M_rb = inertia
    m = published["main"]["mass_hull_kg"]
    assert ours["rigid_body"]["cg"] == pytest.approx(cg, rel=EXACT)
    assert np.array(ours["rigid_body"]["M_rb"]) == pytest.approx(M_rb, rel=EXACT, abs=EXACT)
    added = [0.1 * m, 1.5 * m, m, 0.2 * I_g[0, 0], 0.8 * I_g[1, 1], 1.7 * I_g[2, 2]]
    assert ours["hydrodynamics"]["added_mass"] == pytest.approx(added, rel=EXACT)


def test_damping(published, ours, inertia, stiffness):
    """Surge by the top speed, sway and yaw by a second, heave, roll and pitch by their damping ratios."""
    hydro = ours["hydrodynamics"]
    M = np.diag(inertia[2]) + np.array(hydro["added_mass"])
    restored = [2 * z * np.sqrt(G * m) for z, G, m in zip(DAMPING_RATIOS, stiffness, M[2:5], strict=True)]
    linear = [AHEAD * published["main"]["g"] / TOP_SPEED, M[1], *restored, M[5]]
    assert hydro["linear"] == pytest.approx(linear, rel=EXACT)
    assert hydro["quadratic"] == pytest.approx([0.0] * 5 + [10 * M[5]], rel=EXACT)


def test_cross_flow(published, ours, displaced):
    """Hoerner's coefficient of a section as wide as a pontoon, of a pontoon's draft."""
    hydro, table = ours["hydrodynamics"], published["damping"]
    draft = displaced[1]
    ratio = published["pontoon"]["beam_m"] / (2 * draft)
    assert hydro["cross_flow_draft"] == pytest.approx(draft, rel=EXACT)
    expected = np.interp(ratio, table["hoerner_B_over_2T"], table["hoerner_Cd"])
    assert hydro["cross_flow_coefficient"] == pytest.approx(expected, rel=EXACT)


def test_restoring(ours, stiffness):
    """Shifted from the centre of flotation to CO."""
    G33, G44, G55 = stiffness
    expected = {"G33": G33, "G44": G44, "G55": G55 + LCF**2 * G33, "G35": -LCF * G33}
    for name, value in expected.items():
        assert ours["linear"][name] == pytest.approx(value, rel=EXACT), name


def test_propellers(published, ours):
    """Shaft speeds at which each of two gives half the most thrust."""
    t, g = ours["thrusters"], published["main"]["g"]
    assert t["n_max"] == pytest.approx(np.sqrt(AHEAD * g / 2 / t["k_positive"]), rel=EXACT)
    assert t["n_min"] == pytest.approx(-np.sqrt(ASTERN * g / 2 / t["k_negative"]), rel=EXACT)
