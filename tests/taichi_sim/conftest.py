"""Vehicles on a bench (taichi_sim/bench.py), seas of one wave, models with other numbers, reference
tables."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest
from folders import REFERENCE

from taichi_sim.bench import Bench
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components


def _single_wave(wavelength, amplitude, direction=0.0, phase=0.0, depth=None):
    """One deep-water wave."""
    one, k = np.ones((1, 1)), 2 * np.pi / wavelength
    return Sea(Components(amplitude * one, k * one, np.sqrt(GRAVITY * k) * one, direction * one, phase * one), depth)


def _read_columns(name):
    """Columns of a table under tests/data/reference, by name up to any bracket."""
    with (REFERENCE / name).open() as file:
        header, *rows = csv.reader(file)
    return SimpleNamespace(**{h.split("(")[0]: np.array([float(r[i]) for r in rows]) for i, h in enumerate(header)})


@pytest.fixture(scope="session")
def reference():
    """Folder of the reference tables' subset."""
    return REFERENCE


@pytest.fixture(scope="session")
def columns():
    """Reader of a reference table."""
    return _read_columns


@pytest.fixture(scope="session")
def make_model():
    """Maker of a vehicle model: make_model(name, dt, substeps, **overrides)."""
    return load_vehicle


@pytest.fixture(scope="session")
def constant_model():
    """The same, of hulls whose added mass and damping are the same at every frequency."""

    def make(name, *step, hydrodynamics=None, **overrides):
        return load_vehicle(name, *step, hydrodynamics={"radiation": "constant"} | (hydrodynamics or {}), **overrides)

    return make


@pytest.fixture(scope="session")
def single_wave():
    """Maker of a one-component sea: single_wave(wavelength, amplitude, direction, phase, depth)."""
    return _single_wave


@pytest.fixture(scope="session")
def bench():
    """Maker of a fleet on a bench: bench(model, sea=calm, envs, count)."""
    return lambda model, sea=None, **size: Bench(model, sea=sea, **size)
