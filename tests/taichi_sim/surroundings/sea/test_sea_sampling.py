"""Drawing components: exact heights, spreading, systems that add, seas that do not repeat (NumPy)."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from taichi_sim.config import SeaConfig, SwellConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.surroundings.sea import spectrum
from taichi_sim.surroundings.sea.sampling import WaveSystem, draw_components
from taichi_sim.surroundings.sea.sea import wave_systems

WIND_SEA = WaveSystem(partial(spectrum.jonswap, hs=2.0, tp=7.0), 2.0, 7.0, 0.5, 10.0, 16)
SWELL = WaveSystem(partial(spectrum.jonswap, hs=1.5, tp=12.0, gamma_js=5.0), 1.5, 12.0, -1.0, 50.0, 8)


def _sample(*systems, realisations=4, seed=3, depth=None, **changes):
    systems = systems or (replace(WIND_SEA, **changes),)
    return draw_components([systems] * realisations, seed=seed, depth=depth)


@pytest.mark.parametrize("components", [1, 5, 64])
def test_realised_height_is_exact(components):
    assert np.allclose(_sample(components=components).hs, 2.0, rtol=1e-12)


def test_variances_of_wind_sea_and_swell_add():
    both = _sample(WIND_SEA, SWELL)
    assert both.omega.shape == (4, 24)
    assert np.allclose(both.hs, 2.5, rtol=1e-12)  # 2^2 + 1.5^2 = 2.5^2
    assert np.allclose(both.omega[:, :16], _sample().omega)  # the wind sea is what it was without swell
    assert abs(both.direction[:, 16:] + 1.0).max() < 1.0


def test_each_component_carries_the_energy_of_its_bin():
    """Partial sums of a^2 / 2 are the density's integral up to the bin's edge, by quadrature."""
    wp, edges = 2 * math.pi / 7.0, WIND_SEA.bins
    band = edges[0] / wp, edges[-1] / wp
    whole = spectrum.spectral_moment(WIND_SEA.density, 0, wp, band)
    for n in (3, 7, 12):
        part = spectrum.spectral_moment(WIND_SEA.density, 0, wp, (band[0], edges[n] / wp))
        ours = (WIND_SEA.amplitudes[:n] ** 2).sum() / (WIND_SEA.amplitudes**2).sum()
        assert ours == pytest.approx(part / whole, rel=2e-4)


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


@pytest.mark.parametrize("s", [2.0, 10.0, 75.0])
def test_directions_follow_the_spreading(s):
    """Energy-weighted mean direction, and circular deviation sqrt(2 (1 - s / (s + 1))), over many realisations."""
    sea = _sample(realisations=400, components=32, spreading_s=s)
    energy = sea.amplitude**2
    mean = (energy * np.exp(1j * sea.direction)).sum() / energy.sum()
    assert np.angle(mean) == pytest.approx(0.5, abs=0.02)
    assert math.sqrt(2 * (1 - abs(mean))) == pytest.approx(math.sqrt(2 / (s + 1)), rel=0.03)


def test_the_default_sea_does_not_repeat_within_600_s():
    """Autocorrelation sum a^2 cos(omega lag) / sum a^2 of every realisation, beyond two periods."""
    config = SeaConfig()
    sea = draw_components([wave_systems(config)] * config.realisations, seed=1)
    assert config.tp is not None
    lag = np.arange(2 * config.tp, 600.0, 0.1)
    weight = sea.amplitude[0] ** 2 / (sea.amplitude[0] ** 2).sum()
    highest = max((np.cos(lag[:, None] * omega) @ weight).max() for omega in sea.omega)
    assert highest < 0.9


@pytest.mark.parametrize(
    ("config", "gamma"),
    [
        (SeaConfig(gamma_js=4.0), 4.0),
        (SeaConfig(spectrum="bretschneider", gamma_js=4.0), 1.0),
        (SeaConfig(spectrum="pierson_moskowitz", sea_state=3), 1.0),
    ],
)
def test_gamma_counts_for_jonswap_only(config, gamma):
    (system,) = wave_systems(config)
    omega = np.linspace(0.8, 4.0, 20)
    ours, other = system.density(omega), spectrum.jonswap(omega, system.hs, system.tp, gamma)
    assert np.allclose(ours / ours.max(), other / other.max())


def test_swell_is_a_system_of_its_own():
    wind, swell = wave_systems(SeaConfig(swell=SwellConfig(hs=0.7, tp=11.0, direction_deg=180.0)))
    assert (wind.hs, wind.tp) == (0.5, 4.0)
    assert (swell.hs, swell.tp, swell.components) == (0.7, 11.0, 8)
    assert swell.direction == pytest.approx(math.pi)
    assert swell.spreading_s > wind.spreading_s
