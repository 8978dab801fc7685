"""Missions in worlds that vary: what an episode is given, and that a seed determines it."""

import pytest
import torch
from small_missions import begin, everything, make, wander
from torch import Tensor

from rl.missions.formation.mission import Formation

VARIED = (
    "usv.vary.mass={factor=[0.8, 1.2]}", "uav.vary.mass={factor=[0.8, 1.2]}", "vary.sea.hs=[0.1, 0.6]",
    "vary.sea.current.speed=[0.1, 0.5]", "vary.air.speed=[1, 5]", "sea.current.std=0.05", "air.std=0.3",
)  # fmt: skip


@pytest.fixture(scope="module")
def varied() -> Formation:
    return make(*VARIED)


def given(task: Formation) -> dict[str, Tensor]:
    """Copies of what differs between environments, and of all that follows from it."""
    world = task.world
    tables = {"current": world.current.velocity, "wind": world.wind.velocity}
    for name, fleet in world.teams.items():
        tables |= {f"{name} truth": world.truth[name], f"{name} mass": fleet.vary["mass"]}
    return {key: table.clone() for key, table in tables.items()} | everything(task, [0, 1, 2, 3])


def test_a_reset_draws_for_the_given_environments_alone(varied):
    begin(varied)
    wander(varied, 3)
    before = given(varied)
    varied.reset(torch.tensor([1, 3]))
    after = given(varied)
    for key, table in after.items():
        assert table[[0, 2]].equal(before[key][[0, 2]]), key
    for key in ("current", "wind", "usv mass", "uav mass", "usv truth"):
        assert not (after[key][[1, 3]] == before[key][[1, 3]]).all(dim=-1).any(), key


def test_an_environment_s_means_are_those_of_its_sea(varied):
    begin(varied)
    world = varied.world
    means, seas = world.conditions.tables(), world.env_sea.long()
    names = world.truth_names["usv"]
    told = world.truth["usv"][..., names.index("sea.hs") :]
    assert told.equal(means.truth[seas].unsqueeze(1).expand_as(told))
    assert ((world.current.velocity - means.current[seas]).abs() < 5 * 0.05).all()
    assert ((world.wind.velocity - means.wind[seas]).abs() < 5 * 0.3).all()


def test_reseeding_replays_numbers_winds_and_currents(varied):
    def episode(seed: int) -> dict[str, Tensor]:
        begin(varied, seed)
        wander(varied, 2)
        return given(varied)

    first, other, again = episode(5), episode(6), episode(5)
    for key, table in first.items():
        assert table.equal(again[key]), key
    for key in ("current", "wind", "usv mass", "usv state"):
        assert not first[key].equal(other[key]), key


def test_every_episode_of_an_evaluation_has_a_sea_of_its_own(varied):
    varied.begin_each()
    assert varied.world.env_sea.tolist() == [0, 1, 2, 3]
