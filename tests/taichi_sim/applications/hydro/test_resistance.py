"""Resistance of hulls against closed forms and published numbers, and the vehicle file that is made of it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import k0, k1
from test_hydrodynamics_meshes import read, stl, twin

from taichi_sim.applications.hydro import hull_input, resistance
from taichi_sim.applications.hydro.resistance import HullForm, Race, Resistance
from taichi_sim.applications.hydro.vehicle_file import Flow, Given, Thruster, added_mass, vehicle_text
from taichi_sim.applications.hydro.wetted_surface import WettedSurface
from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof

RHO, G = 1025.0, 9.81


def octahedron(depth: float, y: float = 0.0) -> np.ndarray:
    """Panels of a slender body with half axes 0.2, 0.05, 0.05 m."""
    ends = np.array([[0.2, 0, 0], [-0.2, 0, 0]])
    ring = np.array([[0, 0.05, 0], [0, 0, 0.05], [0, -0.05, 0], [0, 0, -0.05]])
    faces = [
        [end, *(pair if end[0] > 0 else pair[::-1]), (pair if end[0] > 0 else pair[::-1])[-1]]
        for end in ends
        for pair in zip(ring, np.roll(ring, -1, axis=0), strict=True)
    ]
    return np.array(faces) + [0.0, y, -depth]


@pytest.mark.parametrize("u", [3.0, 4.0, 5.0])
def test_a_small_deep_body_makes_the_waves_of_a_dipole(u):
    """Havelock: rho g k^3 V^2 / (4 pi) exp(-a) (K0 + (1 + 1 / 2a) K1) of a = k f, for a moment V u."""
    f, V, k = 1.5, 4 / 3 * 0.2 * 0.05**2, G / u**2
    one = Resistance(HullForm(WettedSurface(octahedron(f)), 1), RHO, G).thin_ship(u)
    a = k * f
    exact = RHO * G * k**3 * V**2 / (4 * np.pi) * np.exp(-a) * (k0(a) + (1 + 0.5 / a) * k1(a))
    assert one == pytest.approx(exact, rel=0.02)
    pairs = (np.concatenate([octahedron(f, y), octahedron(f, -y)]) for y in (0.051, 60.0))
    close, far = (Resistance(HullForm(WettedSurface(pair), 2), RHO, G).thin_ship(u) for pair in pairs)
    assert close == pytest.approx(4 * one, rel=0.03)  # twice the waves
    assert far == pytest.approx(2 * one, rel=0.1)  # no interference


def test_holtrop_and_mennens_own_example():
    """The ship of their paper (1982) at 25 kn, without its bulb (c_2 = 0.7595): R_W 557.11 kN, 1 + k 1.156."""
    L, B, T, V, C_P = 205.0, 32.0, 10.0, 37500.0, 0.5833
    form: Any = SimpleNamespace(
        length=L, beam=B, draught=T, volume=V, prismatic=C_P, midship=0.98 * B * T, waterplane_share=0.75, lcb=-0.75,
        run_length=81.385, transom=16.0,
    )  # fmt: skip
    assert resistance._regression(form, 25 * 0.514444, RHO, G) == pytest.approx(557.11e3 / 0.7595, rel=0.02)
    of: Any = HullForm
    assert of.form_factor.fget(form) == pytest.approx(1.156, rel=0.01)
    assert of.run_length.fget(form) == pytest.approx(81.385, rel=1e-3)


def flow(sway: float = 320.0) -> Flow:
    """Added mass of a catamaran of 250 kg, with a resonance of the water between its hulls in heave."""
    slow, endless = (np.diag(values) for values in ([11, sway, 560, 80, 150, 185.0], [4, 150, 185, 53, 82, 90.0]))
    slow[1, 5] = slow[5, 1] = -9.7
    omega = np.linspace(1.0, 12.0, 24)
    A = np.repeat(endless[None], len(omega), axis=0)
    A[:, 2, 2] = np.where(np.abs(omega - 6.5) < 1.0, -150.0, A[:, 2, 2])
    B = np.repeat(np.diag([1, 1, 300, 60, 150, 1.0])[None], len(omega), axis=0)
    return Flow(slow, endless, omega, A, B, {2: 6.5, 3: 5.6, 4: 6.6})


@pytest.fixture(scope="module")
def boat(tmp_path_factory):
    """A catamaran of 3 m, as a mesh."""
    surface = read(tmp_path_factory.mktemp("boat"), "cat.stl", stl(twin(n=(24, 10))))
    return hull_input.of_mesh(surface, "cat", 263.0, (-0.12, 0.0, -0.1), None, (24, 3, 0.24)), HullForm(surface, 2)


def test_added_mass_of_slow_motion_is_neither_a_resonances_nor_clipped(boat):
    A, told = added_mass(flow(), boat[1], RHO, "cat")
    assert np.diag(A) == pytest.approx([11, 320, 185, 53, 82, 185]) and A[1, 5] == -9.7
    assert len(told) == 1 and "infinite frequency" in told[0]
    assert "times that of strips" in added_mass(flow(30.0), boat[1], RHO, "cat")[1][-1]
    with pytest.raises(ConfigError, match="not positive definite.*raise --panels"):
        added_mass(flow(0.0), boat[1], RHO, "cat")


def test_the_vehicle_of_a_mesh_is_whole(boat, tmp_path):
    """It loads, its thrust at rest, which falls with speed, drives it somewhat slower than a thrust that stays, and it
    says what is assumed.
    """
    craft, form = boat
    units = tuple(Thruster(-1.35, y, 0.15, 60.0) for y in (-0.55, 0.55))
    C = np.diag([0, 0, 16000.0, 4500, 8700, 0])
    races = (Race(60.0, np.sqrt(8 * 60.0 / (np.pi * RHO * 0.2**2))),) * 2
    driven = (Given(units, azimuth, 0.2) for azimuth in (False, True))
    for given, thrust in (*((each, 120.0) for each in driven), (Given(), None)):
        text, told = vehicle_text(craft, form, flow(), C, given, RHO, G, "constant", "hydrodynamics cat.stl")
        file = tmp_path / "cat.toml"
        file.write_text(text)
        model = load_vehicle(file, 0.02, 5)
        assert isinstance(model, Hull6Dof)
        if thrust:
            assert model.top_speed == pytest.approx(Resistance(form, RHO, G, races).speed(thrust), rel=0.01)
            assert (model.params.actions == "wrench") == given.azimuth
        assert (thrust is None) == any("no --thruster" in line for line in told)
        assert text.count("assumed") >= 6 and "Ikeda (2009): two hulls" in text
        assert np.linalg.eigvalsh(model.slow_mass)[0] > 0
