"""What callers hand in is taken for one thing alone, or refused by name: environments, actions, counts, seeds."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config.arguments import checked_action, environments, numbers, whole_number
from taichi_sim.state import snapshot
from taichi_sim.world import ActionError, World

SMALL = ("sea.realisations=2", "sea.components=4", "usv.count=1")
ENVS = 4


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ([True, False, False, True], [0, 3]),
        (np.array([False, True, False, False]), [1]),
        (torch.zeros(4, dtype=torch.bool), []),
        ([2, 0], [2, 0]),
        (3, [3]),
        (np.array([2, 3], np.uint16), [2, 3]),
        (range(1, 3), [1, 2]),
        ([], []),
        (torch.tensor([0, 1]), [0, 1]),
    ],
)
def test_environments_are_a_mask_of_bool_or_whole_numbers(given, meant):
    assert environments(given, ENVS).tolist() == meant


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (torch.tensor([1, 0, 0, 1]), r"4 zeros and ones of torch.int64: if a mask is meant, .*mask\.bool\(\)"),
        (torch.tensor([1, 0, 0, 1], dtype=torch.uint8), r"not torch.uint8: .*mask\.bool\(\)"),
        (torch.tensor([1.0, 0.0, 0.0, 1.0]), r"not torch.float32: .*mask\.bool\(\)"),
        (np.array([1, 0, 0, 0]), r"zeros and ones .*mask\.astype\(bool\)"),
        (np.ma.masked_array([1, 2], [True, False]), "numbers of environments or a bool mask"),
        ([1, 0, 0, 1], r"environment [01] twice \(if a mask is meant"),
        (torch.zeros(4, dtype=torch.int64), "zeros and ones"),
        ([1.7], "not torch.float64"),
        ([True, False, True], r"shape \[3\], expected .* a bool mask \[4\]"),
        (torch.ones(5, dtype=torch.bool), r"shape \[5\], expected"),
        (torch.ones(4, 1, dtype=torch.bool), r"shape \[4, 1\], expected"),
        ([[0, 1]], r"shape \[1, 2\], expected \[n\]"),
        ([2, 3, 2], "environment 2 twice"),
        ([4], "environment 4: there are 0 to 3"),
        ([-1], "environment -1: there are 0 to 3"),
        ("01", "numbers of environments or a bool mask"),
        ([None], "numbers of environments or a bool mask"),
        ({0, 1}, "numbers of environments or a bool mask"),
    ],
)
def test_what_may_be_meant_otherwise_is_no_environments(given, told):
    with pytest.raises(ValueError, match=told):
        environments(given, ENVS)


def act(given):
    return checked_action(given, "usv", ("surge", "yaw"), (1, 2), torch.float32)


@pytest.mark.parametrize(
    "given",
    [
        [[[3e38, 3e38], [-3e38, 3e38]]],
        torch.full((1, 2, 2), 3e38) * torch.tensor([[[1, 1], [-1, 1]]]),
        np.array([[[1e300, 7], [-1e300, 2]]]),
        np.array([[[1, 1], [-1, 2**62]]]),
        torch.tensor([[[1.0, 1.0], [-1.0, 1.0]]], requires_grad=True),
    ],
)
def test_actions_of_any_type_and_size_are_clipped(given):
    """Their sums overflow, and some exceed float32: both say nothing about a number in [-1, 1]."""
    taken = act(given)
    assert taken.tolist() == [[[1.0, 1.0], [-1.0, 1.0]]]
    assert taken.dtype == torch.float32 and not taken.requires_grad


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (np.zeros((2, 2)), r"shape \(2, 2\), expected \(1, 2, 2\)"),
        ([[[0, 0], [0]]], "actions of usv cannot be read as one tensor of numbers"),
        ([[["a", "b"], ["c", "d"]]], "cannot be read"),
        (None, "cannot be read"),
        (np.zeros((1, 2, 2), bool), "real numbers are expected, not torch.bool"),
        (np.zeros((1, 2, 2), complex), "real numbers"),
        ([[[0, 0], [0, np.inf]]], "'yaw' of usv_1 in environment 0 is inf"),
        (np.ma.masked_array(np.zeros((1, 2, 2)), [[[0, 1], [0, 0]]]), "no entry masked"),
        (torch.zeros(1, 2, 2).to_sparse(), "a dense tensor"),
        (torch.zeros(1, 2, 2).to(torch.float8_e4m3fn), "a dense tensor or array of 16 bits or more"),
        ([[[np.nan, 0], [0, 0]]], "'surge' of usv_0 in environment 0 is nan"),
    ],
)
def test_other_actions_are_refused_by_name(given, told):
    with pytest.raises(ActionError, match=told):
        act(given)


@pytest.mark.parametrize("given", [2.0, "3", True, np.True_, 0, -1, None, [2], np.float64(2), 10**9])
def test_a_number_of_environments_is_whole_and_fits_into_memory(given):
    with pytest.raises(ValueError, match=r"num_envs = .* must be a whole number, at least 1|take about .* GiB of mem"):
        World.from_scenario("paper", given, overrides=SMALL)


def test_memory_is_estimated_before_it_is_asked_for(monkeypatch):
    """The estimate is a multiple of the states' size, and no world is refused that one of its size has been given."""
    assert whole_number(np.int64(3), "num_envs", 1) == 3
    monkeypatch.setattr(snapshot, "_free_memory", lambda: 0.0)
    with pytest.raises(ValueError, match=r"2 environments would take about 0\.0 GiB of memory; 0\.0 GiB are free"):
        World.from_scenario("paper", 2, overrides=SMALL)


@pytest.mark.parametrize("seed", [2.5, "3", True, -1, [1]])
def test_a_seed_is_a_whole_number(seed):
    with pytest.raises(ValueError, match=r"seed = .* must be a whole number, at least 0"):
        World.from_scenario("paper", 2, overrides=SMALL, seed=seed)


def test_vehicles_are_placed_where_and_as_they_can_be_or_nothing_moves():
    world = World.from_scenario("paper", 3, overrides=SMALL, teams=("usv",))
    fleet, right = world.teams["usv"], torch.zeros(1, 1, 13)
    right[..., 3], right[..., 0] = 1.0, 7.0
    world.place("usv", [False, True, False], right)
    assert fleet.position_n[:, 0, 0].tolist() == [0.0, 7.0, 0.0]
    before = fleet.state.clone()
    for team, envs, where, told in (
        ("fish", [0], right, "no team 'fish'"),
        ("usv", [3], right, "environment 3"),
        ("usv", [0, 2], right, r"shape \(1, 1, 13\), expected \(2, 1, 13\)"),
        ("usv", [0], right * torch.nan, "not finite"),
        ("usv", [0], torch.zeros(1, 1, 13), "norms from 0"),
        ("usv", [0], np.ma.masked_values(right.numpy(), 7.0), "masked"),
    ):
        with pytest.raises(ValueError, match=told):
            world.place(team, envs, where)
    for envs in ([3], [1, 1], [0.5]):
        with pytest.raises(ValueError, match="envs"):
            world.renew(envs)
        with pytest.raises(ValueError, match="envs"):
            fleet.set_numbers({"mass": 70.0}, envs)
    assert torch.equal(fleet.state, before)


@pytest.mark.parametrize("sea", [-1, 2, 10**6, 0.5])
def test_a_sea_that_does_not_exist_is_refused(sea):
    world = World.from_scenario("paper", 2, overrides=SMALL, teams=("usv",))
    here, at = world.sea, ([0.0], [0.0])
    for ask in (
        lambda: here.elevation(*at, 0.0, sea), lambda: here.elevation_grid(*at, 0.0, sea),
        lambda: here.waves_at(0.0, sea), lambda: here.mean_level(sea),
    ):  # fmt: skip
        with pytest.raises((IndexError, ValueError), match="sea"):
            ask()
    right, world.env_sea = world.env_sea, world.env_sea.clone()
    with pytest.raises(ValueError, match="write into it"):
        world.step({"usv": torch.zeros_like(world.teams["usv"].action)})
    world.env_sea = right
    world.env_sea[0] = 50
    before = world.teams["usv"].state.clone()
    with pytest.raises(IndexError, match="sea 50: there are 0 to 1"):
        world.step({"usv": torch.zeros_like(world.teams["usv"].action)})
    assert torch.equal(world.teams["usv"].state, before)


def test_a_bench_takes_what_its_vehicle_has():
    bench = Bench("otter_3dof", envs=2)
    for call, told in (
        (lambda: bench.step((0.0, 0.0, 0.0)), r"has shape \[3\]: \[2\], or what broadcasts"),
        (lambda: bench.step((0.0, 0.0), times=-1), "times = -1"),
        (lambda: bench.put(position=(0.0, 0.0, math.nan)), "position is not finite"),
        (lambda: bench.put(euler=(0.0, 0.0)), "euler has shape"),
    ):
        with pytest.raises(ValueError, match=told):
            call()
    assert float(bench.time[0]) == 0.0 and bench.state.isfinite().all()


def test_names_of_teams_are_a_list():
    with pytest.raises(ValueError, match=r"teams = 'usv': a list of names is expected"):
        World.from_scenario("paper", 1, overrides=SMALL, teams="usv")


def test_numbers_of_python_keep_their_digits():
    for given in (0.1, [0.1], ((0.1, 1), (2, 3))):
        assert numbers(given, "entries").flatten()[0] == 0.1
