"""How hulls begin on waves: afloat, tilted and moving with the water, so that their first second is like the others."""

import numpy as np
import pytest
import torch

from taichi_sim.kernels.conventions import ELEVATION, FREEBOARD, GRAVITY, QUATERNION, STATE_SIZE
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.usv.hull.motion import LABEL
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components
from taichi_sim.world import World

ENVS = 40
STARTS = 512


def placed(envs, dtype, spread=0.0):
    """Level hulls on still water, each at its own heading and speed, somewhere within `spread` (m)."""
    rng = np.random.default_rng(7)
    state = torch.zeros((envs, 1, STATE_SIZE), dtype=dtype)
    level, heading = torch.zeros(envs, 1), torch.tensor(rng.uniform(-3.1, 3.1, (envs, 1)))
    state[..., QUATERNION] = torch_quaternion_from_euler(level, level, heading).to(dtype)
    state[..., :2] = torch.tensor(rng.uniform(-1, 1, (envs, 1, 2)) * spread)
    state[..., 7] = torch.tensor(rng.uniform(0.0, 1.8, (envs, 1)))
    return state


@pytest.fixture(scope="module")
def otter(f64, make_model):
    return make_model("otter")


@pytest.fixture(scope="module")
def long_waves(f64):
    """Two systems at once, 60 to 200 m long, in ENVS realisations."""
    rng = np.random.default_rng(6)
    k = 2 * np.pi / rng.uniform(60, 200, (ENVS, 2))
    a = rng.uniform(0.1, 0.3, (ENVS, 2))
    return Sea(Components(a, k, np.sqrt(GRAVITY * k), *rng.uniform(-np.pi, np.pi, (2, ENVS, 2))))


def begun(model, state, team):
    """States, auxiliary states and surface of hulls put at `state`."""
    aux, surface = torch.empty_like(team.aux), torch.empty_like(team.surface)
    state = model.settle(state, surface, team.around)
    model.reset_aux(aux, state, team.around)
    return state, aux, surface


@pytest.mark.usefixtures("f64")
def test_on_long_waves_it_lies_on_the_surface_and_moves_with_the_water(otter, bench, long_waves):
    """Height, normal and orbital velocity at the draft, as the sea gives them; its own speed and heading are kept."""
    team = bench(otter, long_waves, envs=ENVS)
    team.current[:] = torch.tensor([0.3, -0.5])
    before = placed(ENVS, torch.float64, spread=200.0)
    state, aux, surface = begun(otter, before, team)
    index = torch.arange(ENVS)
    north, east = before[:, 0, 0], before[:, 0, 1]
    sea = long_waves.surface(north, east, 0.0, index)
    assert (-state[:, 0, 2] - sea.elevation).abs().max() < 2e-3
    assert (surface[:, 0, ELEVATION] - sea.elevation).abs().max() < 2e-3
    R = torch_rotation_matrix(state[:, 0, QUATERNION])
    down = -sea.normal
    assert (R[:, :, 2] - down).abs().max() < 1e-3 and float(down[:, :2].abs().max()) > 0.02
    headings = [torch_euler_from_quaternion(x[:, 0, QUATERNION])[:, 2] for x in (before, state)]
    assert torch.allclose(*headings, atol=1e-12)
    assert (surface[:, 0, FREEBOARD] - otter.deck_height / R[:, 2, 2]).abs().max() < 1e-9
    water = long_waves.kinematics(north, east, otter.draft - sea.elevation, 0.0, index).velocity
    own = torch.einsum("eij,ej->ei", R, state[:, 0, 7:10]) - water - torch.tensor([0.3, -0.5, 0.0])
    ahead = torch.einsum("eij,ej->ei", R, before[:, 0, 7:10])
    assert (own - ahead).abs().max() < 1e-3 and float(water.norm(dim=1).max()) > 0.3
    assert (aux[:, 0, LABEL : LABEL + 2] - (sea.label - before[:, 0, :2])).abs().max() < 2e-3  # of the label under it


@pytest.mark.usefixtures("f64")
def test_on_calm_water_it_stays_as_placed(otter, bench):
    before = placed(ENVS, torch.float64, spread=50.0)
    state, aux, _ = begun(otter, before, bench(otter, envs=ENVS))
    assert torch.allclose(state, before, atol=1e-12, rtol=0) and not aux.any()


@pytest.fixture(scope="module")
def first_seconds():
    """First two seconds of Otters in sea state 4, at rest on the surface or settled: depth of the deck below the mean
    surface (m) and vertical acceleration (m/s^2), both [step, env].
    """
    found = {}
    for how in ("at rest", "settled"):
        world = World.from_scenario(
            "otter", STARTS, overrides=["sea.sea_state=4", "usv.count=1", "air.speed=0.0"], teams=("usv",)
        )
        team, envs = world.teams["usv"], torch.arange(STARTS)
        world.time += torch.arange(STARTS)
        world.place("usv", envs, placed(STARTS, torch.float32, spread=500.0))
        if how == "at rest":
            state = placed(STARTS, torch.float32, spread=500.0)
            state[..., 2] -= world.elevation(envs, state[..., 0], state[..., 1])
            team.state[:] = state
            team.model.reset_aux(team.aux, team.state, world.around)
            team.update()
        depth, speed = [], [team.velocity_n[:, 0, 2].clone()]
        for _ in range(10):
            world.step({"usv": torch.full((STARTS, 1, 2), -0.2)})
            depth.append((team.position_n[..., 2] + team.surface[..., ELEVATION] - team.model.deck_height)[:, 0])
            speed.append(team.velocity_n[:, 0, 2].clone())
        interval = world.config.decision_interval
        found[how] = torch.stack(depth), torch.diff(torch.stack(speed), dim=0) / interval
    return found


@pytest.mark.slow
def test_no_otter_is_swamped_in_its_first_second(first_seconds):
    """Of 512 in sea state 4, where at rest on the surface some are."""
    for how, (depth, _) in first_seconds.items():
        swamped = int((depth[:5] > 0).any(dim=0).sum())
        assert swamped == 0 if how == "settled" else swamped > 0


@pytest.mark.slow
def test_the_first_second_is_like_the_next(first_seconds):
    """Root mean square of the vertical acceleration: within a tenth; of hulls at rest it is twice that."""
    for how, (_, acceleration) in first_seconds.items():
        first, later = (x.square().mean().sqrt() for x in (acceleration[:5], acceleration[5:]))
        assert float(first / later) < 1.1 if how == "settled" else float(first / later) > 1.5
