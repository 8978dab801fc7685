"""Height and period of a wind sea against published laws."""

import math

import numpy as np
import pytest

from taichi_sim.config import SeaConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.surroundings.sea import sea_size
from taichi_sim.surroundings.sea.spectrum import pierson_moskowitz, spectral_moment
from taichi_sim.surroundings.sea.wind_sea import developed_period, developed_sea, growing_sea, wind_19_5

WINDS = (3.0, 10.0, 25.0)  # m/s at 10 m


def test_given_height_and_period_are_what_is_asked_for():
    assert sea_size(SeaConfig(hs=1.5, tp=6.0)) == (1.5, 6.0)
    assert sea_size(SeaConfig()) == (0.5, 4.0)


@pytest.mark.parametrize(("code", "hs"), [(0, 0.0), (1, 0.05), (2, 0.3), (3, 0.875), (4, 1.875), (6, 5.0), (8, 11.5)])
def test_a_sea_state_is_the_middle_of_its_heights(code, hs):
    size = sea_size(SeaConfig(sea_state=code))
    assert size.hs == pytest.approx(hs)
    assert size.tp > 0


@pytest.mark.parametrize("wind", WINDS)
def test_a_developed_sea_has_the_height_and_peak_of_its_density(wind):
    """4 sqrt(m0) by quadrature, and the maximum of the Pierson-Moskowitz density under the wind at 19.5 m."""
    size = developed_sea(wind)
    u, wp = wind_19_5(wind), 2 * math.pi / size.tp
    m0 = spectral_moment(lambda w: pierson_moskowitz(w, u), 0, wp, (0.1, 1e6))
    assert size.hs == pytest.approx(4 * math.sqrt(m0), rel=1e-6)
    omega = wp * np.linspace(0.99, 1.01, 2001)
    assert omega[pierson_moskowitz(omega, u).argmax()] == pytest.approx(wp, rel=1e-5)
    assert developed_period(size.hs) == pytest.approx(size.tp)
    assert sea_size(SeaConfig(wind_speed=wind)) == size


def test_a_developed_sea_agrees_with_the_limit_for_wind_at_10_m():
    """hs = 0.24 U10^2 / g and f_p = 0.13 g / U10 (Komen, Hasselmann & Hasselmann 1984)."""
    hs, tp = developed_sea(12.0)
    assert hs == pytest.approx(0.24 * 12.0**2 / GRAVITY, rel=0.03)
    assert 1 / tp == pytest.approx(0.13 * GRAVITY / 12.0, rel=0.03)


@pytest.mark.parametrize(("wind", "fetch_km"), [(8.0, 5.0), (15.0, 50.0), (20.0, 200.0)])
def test_growth_agrees_with_carters_formula(wind, fetch_km):
    """Carter (1982), fitted to JONSWAP: hs = 0.0163 X^(1/2) U, X in km."""
    hs, tp = growing_sea(wind, 1000 * fetch_km)
    assert hs == pytest.approx(0.0163 * math.sqrt(fetch_km) * wind, rel=0.015)
    assert tp == sea_size(SeaConfig(wind_speed=wind, fetch=1000 * fetch_km)).tp


@pytest.mark.parametrize("wind", WINDS)
def test_growth_ends_in_the_developed_sea(wind):
    """Two independent laws meet: where the height is fully developed, so is the period, to 3 %."""
    limit = developed_sea(wind)
    fetches = np.geomspace(1e3, 1e7, 400)
    hs, tp = np.array([growing_sea(wind, x) for x in fetches]).T
    assert (np.diff(hs) >= 0).all() and (np.diff(tp) >= 0).all()
    assert (hs[-1], tp[-1]) == limit
    grown = int((hs < limit.hs).sum())
    assert 0 < grown < 400
    assert tp[grown] == pytest.approx(limit.tp, rel=0.03)
