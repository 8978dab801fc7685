import math
from functools import partial

import numpy as np
import pytest

from taichi_sim.conventions import GRAVITY
from taichi_sim.sea import sea_state as wmo
from taichi_sim.sea import spectrum


def _sample(**changes):
    numbers = {"hs": 2.0, "tp": 7.0, "gamma_js": 3.3, "direction": 0.5, "spreading_s": 10.0}
    return spectrum.sample_components(
        **(numbers | {"components": 16, "realisations": 4, "seed": 3} | changes)
    )


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


@pytest.mark.parametrize("components", [1, 5, 64])
def test_realised_height_is_exact(components):
    assert np.allclose(_sample(components=components).hs, 2.0, rtol=1e-12)


def test_realisations_differ_and_more_of_them_keep_the_first():
    few, many = _sample(realisations=2), _sample(realisations=6)
    for name in ("omega", "direction", "phase"):
        assert np.array_equal(getattr(few, name), getattr(many, name)[:2])
        assert np.unique(getattr(many, name)[:, 0]).size == 6
    assert not np.array_equal(_sample(seed=4).phase, few.phase)


def test_components_obey_dispersion_and_the_band():
    sea = _sample(depth=6.0)
    wp = 2 * math.pi / 7.0
    assert np.allclose(GRAVITY * sea.k * np.tanh(6.0 * sea.k), sea.omega**2, rtol=1e-12)
    assert sea.omega.min() >= 0.6 * wp and sea.omega.max() <= 3.0 * wp


def test_directions_follow_the_spreading():
    """Mean direction and mean resultant length s / (s + 1) over many realisations."""
    sea = _sample(realisations=400, components=32)
    mean = np.exp(1j * sea.direction).mean()
    assert np.angle(mean) == pytest.approx(0.5, abs=0.01)
    assert abs(mean) == pytest.approx(10 / 11, abs=0.005)


def test_sea_states():
    assert wmo.sea_state_range(4) == (1.25, 2.5)
    assert wmo.sea_state_range(9) == (14.0, math.inf)
    assert [wmo.sea_state(hs) for hs in (0.0, 0.05, 0.5, 4.0, 4.01, 20.0)] == [0, 1, 2, 5, 6, 9]
    for wrong in (-1, 10):
        with pytest.raises(ValueError, match="0 to 9"):
            wmo.sea_state_range(wrong)
    with pytest.raises(ValueError, match="hs"):
        wmo.sea_state(float("nan"))
