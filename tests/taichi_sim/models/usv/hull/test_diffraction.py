"""What hulls throw back between the courses of its table (taichi_sim/models/usv/hull/radiation.py)."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from taichi_sim.config.io import config_folder
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.database import HydroDatabase
from taichi_sim.models.usv.hull.radiation import Diffraction
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components

pytestmark = pytest.mark.usefixtures("f64")
DIRECTION = 0.3  # rad, of the waves: no course of a table
HEADINGS = np.random.default_rng(1).uniform(0, 2 * np.pi, 4000)  # rad, of the hull
AT_MOST = 0.03  # of the largest load


def database(name):
    return HydroDatabase.read(config_folder() / "vehicles" / f"{name}.hydro.json")


def applied(data, headings):
    """Complex loads [n, heading, 6] per metre of amplitude at the database's frequencies, linear between courses."""
    one = np.ones((1, len(data.omega)))
    sea = Sea(Components(1e-6 * one, data.omega**2 / GRAVITY * one, data.omega * one, DIRECTION * one, 0 * one))
    table = Diffraction(data, drift=False).of(sea.table).numpy() / 1e-6
    place = headings / (2 * np.pi) * (len(table) - 1)
    first = place.astype(int)
    loads = table[first] + (place - first)[:, None, None] * (table[first + 1] - table[first])
    return np.moveaxis(loads[:, :6] + 1j * loads[:, 6:], 2, 0)


def off(data, truth):
    """Largest difference over the headings, of the largest load [n, 6]; nan where symmetry leaves no load."""
    largest = np.abs(truth).max(axis=1)
    largest[largest < 1e-6 * largest.max(axis=0)] = np.nan
    return np.abs(applied(data, HEADINGS) - truth).max(axis=1) / largest


@pytest.mark.parametrize("name", ["otter", "wamv", "barge", "fpso"])
def test_loads_between_courses_are_those_of_the_database_s_series(name):
    """At every frequency of the database, whatever the heading; its Fourier series is evaluated here by FFT."""
    data = database(name)
    assert data.by_panels is not None
    half = data.excitation - data.by_panels
    mirrored = half[:, -2:0:-1] * np.array([1, -1, 1, -1, 1, -1])
    series = np.fft.fft(np.concatenate([half, mirrored], axis=1), axis=1, norm="forward")
    number = series.shape[1]
    order = np.arange(number // 2)
    waves = np.exp(1j * np.outer(DIRECTION - HEADINGS, np.concatenate([order, -order[:0:-1]])))
    kept = np.concatenate([series[:, : number // 2], series[:, number // 2 + 1 :]], axis=1)
    truth = np.einsum("hk,nkj->nhj", waves, kept)
    assert np.nanmax(off(data, truth)) < AT_MOST * (1 + 1e-9)


def test_two_points_far_apart_have_the_load_of_their_phases():
    """Closed form: points 4.9 m apart in waves of 1 m and more have the heave load 2 cos(k L/2 cos(beta)), and pitch
    in proportion to sin; as the WAM-V's two ends would.
    """
    shipped, length = database("wamv"), 4.9
    omega = np.sqrt(GRAVITY * 2 * np.pi / np.array([20.0, 5.0, 2.5, 1.5, 1.0]))
    kept = slice(0, len(omega))

    def load(beta):
        turn = 0.5 * length * (omega**2 / GRAVITY)[:, None] * np.cos(beta)
        out = np.zeros((*turn.shape, 6), dtype=complex)
        out[..., 2], out[..., 4] = 2 * np.cos(turn), 1j * length * np.sin(turn)
        return out

    given = load(np.deg2rad(shipped.heading_deg))
    data = replace(
        shipped, omega=omega, excitation=given, by_panels=0 * given, froude_krylov=0 * given,
        added_mass=shipped.added_mass[kept], damping=shipped.damping[kept], settings={}, drift=None,
    )  # fmt: skip
    found = off(data, load(DIRECTION - HEADINGS))
    assert np.nanmax(found) < AT_MOST * 1.1  # the series itself ends at the database's headings


def test_every_sea_has_its_own_loads_even_if_it_lies_where_an_earlier_one_lay():
    """A model serves all worlds of a process; a world that is gone leaves its memory to the next one's sea."""
    model = load_vehicle("otter", 0.02, 1)
    for amplitude in np.linspace(0.01, 0.12, 12):
        one = np.ones((1, 8))
        sea = Sea(Components(amplitude * one, 0.4 * one, 2.0 * one, 0 * one, 0 * one))
        around = Surroundings.of(sea, torch.zeros(1, dtype=torch.int32), torch.zeros(1, dtype=torch.float64))
        members = dict(model.tables(around).items)
        expected = model.radiation.tables(sea.table)["diffraction"]
        assert members["diffraction"].equal(expected), amplitude
        del sea, around, members
