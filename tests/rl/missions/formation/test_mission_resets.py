"""The mission's resets and starts, and that a seed determines them."""

import pytest
import torch
from small_missions import AXES, TEAMS, begin, everything, make, observed, past_and_present, state, wander
from torch import Tensor

from rl.missions.formation.slots import Drawn
from rl.missions.formation.worlds import Starts, _others_for


def test_a_reset_changes_only_the_given_environments(shared):
    begin(shared)
    wander(shared, 4)
    kept, renewed = everything(shared, [0, 2]), everything(shared, [1, 3])
    shared.reset(torch.tensor([1, 3]))
    for key, before in kept.items():
        assert everything(shared, [0, 2])[key].equal(before), key
    after = everything(shared, [1, 3])
    assert after["steps"].tolist() == [0, 0]
    for key in ("time", "progress", "usv state", "uav state", "usv observations"):
        assert not (after[key] == renewed[key]).all(), key


def test_the_future_of_other_environments_does_not_depend_on_a_reset(shared):
    def future(reset: bool) -> dict[str, Tensor]:
        begin(shared)
        wander(shared, 3)
        if reset:
            shared.reset(torch.tensor([1, 3]))
        wander(shared, 3, seed=1)
        return everything(shared, [0, 2])

    without = future(False)
    for key, part in future(True).items():
        assert part.equal(without[key]), key


def test_a_reset_of_nothing_changes_nothing(shared):
    begin(shared)
    wander(shared, 2)
    before = everything(shared, [0, 1, 2, 3])
    shared.reset(torch.zeros(0, dtype=torch.int64))
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


def test_an_episode_begins_without_a_past(shared):
    begin(shared)
    wander(shared, 3)
    shared.reset(torch.tensor([1]))
    for name, rows in observed(shared).items():
        now, before = past_and_present(rows[1], AXES[name])
        assert now.equal(before), name
        previous = shared.teams[name].observe()["previous_action"]
        assert not previous[1].any() and previous[0].any(), name


CROWDS = {
    "the paper's": (),
    "astern": ('usv.formation="astern"', 'uav.formation="astern"'),
    "eight abreast": ("usv.count=8", "uav.count=8"),
    "eight astern": (
        "usv.count=8",
        "uav.count=8",
        'usv.formation="astern"',
        'uav.formation="astern"',
    ),
    "any shape": (
        "usv.count=6",
        'usv.formation.shapes=["wedge", "echelon", "pairs", "circle", "astern"]',
        "usv.formation.spacing_range=[10.0, 20.0]",
    ),
    "obstacles in the lanes": ("obstacles.clearance_min=-15", "obstacles.count=60"),
}


@pytest.mark.parametrize("crowd", CROWDS)
def test_starts_are_clear_of_obstacles_and_team_mates(crowd):
    task = make(*CROWDS[crowd], "track.worlds=16")
    for name, states in task.starts.states.items():
        place = states[..., :2]
        axis, radius = task.obstacles[:, None, None, :, :2], task.obstacles[:, None, None, :, 2]
        gap = (place.unsqueeze(3) - axis).norm(dim=-1) - radius - task.teams[name].radius
        hit = (gap.amin(dim=(2, 3)) <= 0).float().mean().item()
        assert hit == 0, f"{name}: {hit:.1%} of starts are in an obstacle"
        apart = (states[:, :, :, None, :3] - states[:, :, None, :, :3]).norm(dim=-1)
        apart = apart + 1e3 * torch.eye(apart.shape[-1])
        touching, spacing = 2 * task.teams[name].radius, task.teams[name].section.spacings[0]
        assert apart.min() > min(touching + 2.9, (touching + spacing) / 2 - 0.01), name  # room to steer away in


def test_starts_are_near_the_target_at_flight_height_and_under_way(shared):
    for name, states in shared.starts.states.items():
        world = torch.arange(4)[:, None].expand(shared.starts.progress.shape)
        target = shared.tracks.at(world, shared.starts.progress).position
        assert (states[:, :, 0, :2] - target).norm(dim=-1).max() <= 30.0 + 1e-3  # start_distance
        height = -states[..., 2]
        assert ((height - (60.0 if name == "uav" else 0.0)).abs() < 30.0).all()
        torch.testing.assert_close(states[..., 3:7].norm(dim=-1), torch.ones(states.shape[:-1]))
        assert (states[..., 7] > 0).all()


def test_a_start_is_where_the_episode_begins(shared):
    """The world and the start asked for are the ones got; boats are lifted onto the wave under them."""
    begin(shared)
    worlds, starts = torch.tensor([3, 0]), torch.tensor([7, 11])
    shared.reset(torch.tensor([2, 0]), worlds=worlds, starts=starts)
    assert shared.env_world[[2, 0]].equal(worlds)
    assert shared.teams["usv"].targets.progress[[2, 0]].equal(shared.starts.progress[worlds, starts])
    for name in TEAMS:
        expected = shared.starts.states[name][worlds, starts].clone()
        here = state(shared, name)[[2, 0]]
        if name == "usv":
            zeta = shared.world.elevation(torch.tensor([2, 0]), here[..., 0], here[..., 1])
            assert zeta.abs().max() > 0
            expected[..., 2] = -zeta
        torch.testing.assert_close(here, expected)


def test_a_seed_determines_every_bit_and_another_changes_all():
    def history(seed: int) -> dict[str, Tensor]:
        task = make(seed=seed)
        wander(task, 3)
        task.reset(torch.tensor([0, 3]))
        wander(task, 2, seed=1)
        parts = everything(task, [0, 1, 2, 3])
        return parts | {
            "obstacles": task.obstacles,
            "track": task.tracks.table,
            "table": task.world.sea.table,
        }

    first, again, other = history(1), history(1), history(2)
    for key, part in first.items():
        assert part.equal(again[key]), key
    for key in ("obstacles", "track", "table", "time", "progress", "usv state", "uav state"):
        assert not first[key].equal(other[key]), key


def test_reseeding_replays_the_same_episodes(shared):
    def episode(seed: int) -> dict[str, Tensor]:
        begin(shared, seed)
        wander(shared, 2)
        return everything(shared, [0, 1, 2, 3])

    first, other, again = episode(5), episode(6), episode(5)
    for key, part in first.items():
        assert part.equal(again[key]), key
    assert not first["usv state"].equal(other["usv state"])


def test_starts_without_room_are_taken_from_others_of_their_world():
    place = torch.tensor([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    missing = torch.tensor([[False, True, False, True], [False, False, False, False]])
    formation = Drawn(place.long(), place)
    found = _others_for(missing, Starts(place, {"usv": place[..., None, None]}, {"usv": formation}))
    expected = torch.tensor([[1.0, 3.0, 3.0, 3.0], [5.0, 6.0, 7.0, 8.0]])
    assert found.progress.equal(expected) and found.states["usv"][..., 0, 0].equal(expected)
    assert found.formations["usv"].spacing.equal(expected)
