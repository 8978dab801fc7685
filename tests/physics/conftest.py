"""A team on a bench: one model, one sea, no world around them."""

import csv
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from taichi_sim import runtime
from taichi_sim.config.io import config_folder, read_toml, validate
from taichi_sim.conventions import GRAVITY, POSITION, QUATERNION, STATE_SIZE, SURFACE_SIZE, VELOCITY
from taichi_sim.kinematics import DERIVED_SIZE
from taichi_sim.maths.rotation import (
    torch_euler_from_quaternion,
    torch_quaternion_from_euler,
    torch_rotation_matrix,
)
from taichi_sim.sea import Sea
from taichi_sim.sea.spectrum import Components
from taichi_sim.surroundings import Surroundings
from taichi_sim.vehicles import MODELS

REFERENCE = Path(__file__).parents[1] / "data" / "reference"
_models = {}


class Bench:
    """`envs` x `count` vehicles of one model on one sea; one control step per `step`."""

    def __init__(self, model, sea, envs=1, count=1):
        options = {"dtype": runtime.current().torch_dtype}
        self.model, self.sea = model, sea
        self.time = torch.zeros(envs, dtype=torch.float64)
        self.env_sea = (torch.arange(envs) % sea.num_seas).to(torch.int32)
        self.state = torch.zeros((envs, count, STATE_SIZE), **options)
        self.state[..., 3] = 1.0
        self.aux = torch.zeros((envs, count, model.aux_size), **options)
        self.surface = torch.zeros((envs, count, SURFACE_SIZE), **options)
        self.derived = torch.zeros((envs, count, DERIVED_SIZE), **options)
        self.current = torch.zeros((envs, 2), **options)
        self.wind = torch.zeros((envs, 3), **options)

    def put(self, position=(0.0, 0.0, 0.0), euler=(0.0, 0.0, 0.0), velocity_b=(0.0, 0.0, 0.0)):
        """Place every vehicle alike."""
        to = {"dtype": self.state.dtype}
        self.state.zero_()
        self.state[..., POSITION] = torch.tensor(position, **to)
        self.state[..., QUATERNION] = torch_quaternion_from_euler(*torch.tensor(euler, **to))
        self.state[..., VELOCITY] = torch.tensor(velocity_b, **to)
        self.model.reset_aux(self.aux, self.state)
        return self

    def step(self, action, times=1):
        """Hold `action` (of one vehicle, or [env, vehicle, action]) for `times` control steps."""
        envs, count = self.state.shape[:2]
        held = torch.as_tensor(action, dtype=self.state.dtype).expand(envs, count, -1).contiguous()
        for _ in range(times):
            self.model.step(self, held, self.around)
            self.time += self.model.dt * self.model.substeps
        return self

    @property
    def around(self):
        """The sea now, with the current and the wind that the test has set."""
        calm = Surroundings.of(self.sea, self.env_sea, self.time)
        return calm._replace(current=self.current, wind=self.wind)

    @property
    def position(self):
        """NED position of the first vehicle, m."""
        return self.state[0, 0, POSITION].double().numpy()

    @property
    def velocity(self):
        """NED velocity of the first vehicle, m/s."""
        state = self.state[0, 0].double()
        return (torch_rotation_matrix(state[QUATERNION]) @ state[VELOCITY]).numpy()

    @property
    def euler(self):
        """Roll, pitch, heading of the first vehicle, rad."""
        return torch_euler_from_quaternion(self.state[0, 0, QUATERNION].double()).numpy()


def _single_wave(wavelength, amplitude, direction=0.0, phase=0.0, depth=None):
    """One deep-water wave."""
    one, k = np.ones((1, 1)), 2 * np.pi / wavelength
    return Sea(Components(amplitude * one, k * one, np.sqrt(GRAVITY * k) * one, direction * one, phase * one), depth)


def _make_model(name, dt=0.02, substeps=1, **overrides):
    """The model of a shipped vehicle file, with some numbers changed; a section's other numbers stay.

    Models hold no state: those of the same numbers and precision are one, and so is the kernel compiled for them.
    """
    data = read_toml(config_folder() / "vehicles" / f"{name}.toml")
    for key, value in overrides.items():
        old = data.get(key)
        data[key] = old | value if isinstance(value, dict) and isinstance(old, dict) else value
    model = MODELS[data.pop("model")]
    params = validate(model.Params, data, name)
    key = (name, params.model_dump_json(), dt, substeps, runtime.current().precision)
    if key not in _models:
        _models[key] = model(params, dt, substeps)
    return _models[key]


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
    return _make_model


@pytest.fixture(scope="session")
def single_wave():
    """Maker of a one-component sea: single_wave(wavelength, amplitude, direction, phase, depth)."""
    return _single_wave


@pytest.fixture(scope="session")
def bench():
    """Maker of a team on a bench: bench(model, sea=calm, envs, count)."""
    return lambda model, sea=None, **size: Bench(model, sea or _single_wave(1.0, 0.0), **size)
