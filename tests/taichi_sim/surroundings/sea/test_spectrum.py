import json
import math
from functools import partial

import numpy as np
import pytest

from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.surroundings.sea import spectrum
from taichi_sim.surroundings.sea import wind_sea as wmo


@pytest.fixture
def read_json(reference):
    return lambda name: json.loads((reference / name).read_text(encoding="utf-8"))


def test_dispersion_against_brentq(columns):
    table = columns("waves/dispersion_g9.81.csv")
    for omega, depth, k, cg in zip(table.omega, table.depth_m, table.k, table.group_speed, strict=True):
        water = None if depth < 0 else depth
        assert float(spectrum.wavenumber(omega, water)) == pytest.approx(k, rel=1e-10)
        assert float(spectrum.group_speed(k, water)) == pytest.approx(cg, rel=1e-9)


@pytest.mark.parametrize("depth", [0.5, 3.0, 50.0, 1e4])
def test_group_speed_is_the_slope_of_dispersion(depth):
    k = np.geomspace(0.01, 5.0, 30)
    step = 1e-5 * k

    def omega(k):
        return np.sqrt(GRAVITY * k * np.tanh(k * depth))

    slope = (omega(k + step) - omega(k - step)) / (2 * step)
    assert np.allclose(spectrum.group_speed(k, depth), slope, rtol=1e-7)


def test_wavenumber_solves_dispersion_from_shallow_to_deep():
    omega, depth = np.geomspace(0.01, 20, 200), 3.0
    k = spectrum.wavenumber(omega, depth)
    assert np.allclose(GRAVITY * k * np.tanh(k * depth), omega**2, rtol=1e-13)


@pytest.mark.parametrize("order", [-1, 0, 1, 2])
def test_bretschneider_moments_have_a_closed_form(order):
    """m_n = A/4 B^(n/4 - 1) Gamma(1 - n/4), A = 5/16 Hs^2 wp^4, B = 5/4 wp^4."""
    hs, tp = 2.0, 8.0
    wp = 2 * math.pi / tp
    A, B = 5 / 16 * hs**2 * wp**4, 1.25 * wp**4
    exact = A / 4 * B ** (order / 4 - 1) * math.gamma(1 - order / 4)
    density = partial(spectrum.jonswap, hs=hs, tp=tp, gamma_js=1.0)
    assert spectrum.spectral_moment(density, order, wp, (0.1, 1e6)) == pytest.approx(exact, rel=1e-9)


def test_jonswap_height_is_within_the_approximation_of_its_norm():
    """A_g = 1 - 0.287 ln(gamma) returns the height to 0.2 % for gamma up to 5."""
    for gamma in (1.0, 2.0, 3.3, 5.0):
        density = partial(spectrum.jonswap, hs=1.0, tp=5.0, gamma_js=gamma)
        height = 4 * math.sqrt(spectrum.spectral_moment(density, 0, 2 * math.pi / 5.0))
        assert height == pytest.approx(1.0, rel=2e-3)


def test_pierson_moskowitz_is_bretschneider_at_its_own_height_and_peak():
    hs, tp = spectrum.pierson_moskowitz_hs_tp(15.0)
    omega = np.linspace(0.3, 3.0, 50)
    density = spectrum.pierson_moskowitz(omega, 15.0)
    assert np.allclose(density, spectrum.jonswap(omega, hs, tp, 1.0), rtol=1e-12)
    assert hs == pytest.approx(0.2092 * 15**2 / GRAVITY, rel=1e-3)


@pytest.mark.parametrize("s", [1.0, 2.5, 10.0, 50.0])
def test_spreading_integrates_to_one_with_mean_cosine_s_over_s_plus_one(s):
    node, weight = np.polynomial.legendre.leggauss(400)
    density = spectrum.spreading(np.pi * node, s)
    assert np.sum(np.pi * weight * density) == pytest.approx(1.0, rel=1e-7)
    assert np.sum(np.pi * weight * density * np.cos(np.pi * node)) == pytest.approx(s / (s + 1), rel=1e-7)


def test_encounter_frequency_in_following_and_head_seas():
    """omega (1 -+ U / c): at the phase speed a following wave stands still."""
    omega = 1.2
    c = GRAVITY / omega
    assert spectrum.encounter_frequency(omega, c, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert spectrum.encounter_frequency(omega, c, math.pi) == pytest.approx(2 * omega)
    assert spectrum.encounter_frequency(omega, 2 * c, 0.0) == pytest.approx(-omega)


def test_jonswap_density_against_the_table(columns):
    table = columns("waves/jonswap_density_samples.csv")
    rows = zip(table.omega, table.Hs, table.Tp, table.gamma, strict=True)
    ours = np.array([float(spectrum.jonswap(*row)) for row in rows])
    assert np.allclose(ours, table.S_m2s, rtol=1e-10)


def test_jonswap_moments_against_adaptive_quadrature(read_json):
    for row in read_json("waves/jonswap_moments.json")["rows"]:
        density = partial(spectrum.jonswap, hs=row["Hs"], tp=row["Tp"], gamma_js=row["gamma"])
        for order, key in ((-1, "m_1"), (0, "m0"), (1, "m1"), (2, "m2")):
            moment = spectrum.spectral_moment(density, order, 2 * math.pi / row["Tp"], (0.2, 200.0))
            assert moment == pytest.approx(row[key], rel=1e-9)


def test_pierson_moskowitz_against_the_table(read_json):
    for row in read_json("waves/pierson_moskowitz_by_wind.json")["rows"]:
        assert spectrum.pierson_moskowitz_hs_tp(row["U19_5"]) == pytest.approx((row["Hs"], row["Tp"]), rel=1e-9)


def test_spreading_against_the_table(read_json):
    for row in read_json("waves/spreading_cos2s.json")["rows"]:
        peak = float(spectrum.spreading(0.0, row["s"]))
        assert peak == pytest.approx(row["norm_cos2s_half_angle"], rel=1e-9)


def test_sea_states():
    assert wmo.sea_state_range(4) == (1.25, 2.5)
    assert wmo.sea_state_range(9) == (14.0, math.inf)
    assert [wmo.sea_state(hs) for hs in (0.0, 0.05, 0.5, 4.0, 4.01, 20.0)] == [0, 1, 2, 5, 6, 9]
    for wrong in (-1, 10):
        with pytest.raises(ValueError, match="0 to 9"):
            wmo.sea_state_range(wrong)
    with pytest.raises(ValueError, match="hs"):
        wmo.sea_state(float("nan"))
