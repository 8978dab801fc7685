"""Numbers that differ between environments, of the boat, the aircraft of the seed paper and the vessel in the plane.

One fleet serves all tests of a model: environment 0 is as the file says, environment k has number k - 1 changed, the
last has all of them changed, each by a factor of its own.
"""

import numpy as np
import pytest
import torch

from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.models.uav.unity_aircraft import UnityAircraft
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.models.usv.unity_boat import UnityBoat
from taichi_sim.surroundings.sea import Sea

pytestmark = pytest.mark.usefixtures("f64")
# Every number counts: none is zero, and all three forces are commanded.
FILES = {
    "unity_boat": {},
    "unity_aircraft": {},
    "cybership2": {
        "Y_rdot": -0.3, "N_vdot": -0.2, "N_rrr": -0.2, "time_constant": 0.4, "actions": "surge_sway_yaw",
    },
}
KEYS = {"unity_boat": UnityBoat.varying, "unity_aircraft": UnityAircraft.varying, "cybership2": Manoeuvring3dof.varying}
STEPS, HELD = 40, 5  # of 0.1 s; steps for which an action is held
ROUNDING = 1e-9  # of m, m/s, rad/s after these steps


def _changed(model):
    """Every number by its own factor, from 1.01 to 1.2."""
    factors = np.linspace(1.01, 1.2, len(model.varying))
    return {key: factor * value for factor, (key, value) in zip(factors, model.nominal.items(), strict=True)}


def _run(model, bench, envs=1, vary=None):
    """Final states [env, 13] of the same motion in waves, current and wind."""
    sea = Sea.from_config(SeaConfig(hs=0.2, tp=4.0, components=8, realisations=1), seed=5)
    team = bench(model, sea, air=AirConfig(speed=6.0, direction_deg=200.0), envs=envs)
    team.current[:] = torch.tensor([0.2, -0.3], dtype=torch.float64)
    team.put((3.0, -2.0, -20.0 if model.medium == "air" else 0.0), (0.0, 0.0, 0.7), (0.5, 0.0, 0.0), settle=True)
    for key, values in (vary or {}).items():
        team.fleet.set_numbers({key: values})
    rng = np.random.default_rng(4)
    for _ in range(STEPS // HELD):
        team.step(rng.uniform(-1, 1, len(model.action_names)), HELD)
    return team.state[:, 0].numpy().copy()


@pytest.fixture(scope="module", params=FILES)
def family(request, f64, make_model, bench):
    """A model, and final states [2 + number, 13] of its fleet."""
    model = make_model(request.param, 0.02, 5, **FILES[request.param])
    envs, changed, vary = len(model.varying) + 2, _changed(model), {}
    for k, key in enumerate(model.varying):
        vary[key] = torch.full((envs, 1), model.nominal[key], dtype=torch.float64)
        vary[key][[k + 1, -1]] = changed[key]
    return model, _run(model, bench, envs, vary)


def test_an_environment_is_what_a_vehicle_file_of_its_numbers_is(family, bench):
    model, states = family
    assert all(model.nominal.values())
    other = type(model)(model.with_numbers(_changed(model)), model.dt, model.substeps)
    assert states[-1] == pytest.approx(_run(other, bench)[0], abs=ROUNDING)
    assert states[0] == pytest.approx(_run(model, bench)[0], abs=ROUNDING)


def test_each_number_does_something(family):
    model, states = family
    moved = np.abs(states[1:-1] - states[0]).max(axis=1)
    assert not [key for key, by in zip(model.varying, moved, strict=True) if by < 1e3 * ROUNDING]


@pytest.mark.slow
@pytest.mark.parametrize(("file", "key"), [(file, key) for file in FILES for key in KEYS[file]])
def test_one_number_is_that_of_a_vehicle_file(file, key, make_model, bench):
    model = make_model(file, 0.02, 5, **FILES[file])
    value = _changed(model)[key]
    other = type(model)(model.with_numbers({key: value}), model.dt, model.substeps)
    assert _run(model, bench, vary={key: value}) == pytest.approx(_run(other, bench), abs=ROUNDING)
