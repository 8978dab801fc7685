"""What a step of the mission does: rewards, actions, slots and the target's speed."""

import math

import pytest
import torch
from small_missions import AXES, NORTH, TEAMS, arrange, begin, everything, make, observed, shapes, state, still, wander
from torch import Tensor

# -- rewards, as the mission gives them -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "near", "far"),
    [
        ("usv", 2.9 - 0.02 * 50, 1 - 0.001 * 120),  # eq. (10)
        ("uav", 1.95 - 0.01 * 50, 1 - 0.0005 * 120),  # eq. (11)
    ],
)
def test_the_paper_rewards_a_leader_by_where_it_points(paper, name, near, far):
    """Behind the target on its course; one step changes the distance by a few metres at the most."""
    track = paper.tracks.at(torch.zeros(1, dtype=torch.int64), paper.starts.progress[0, :1])
    course = track.course.item()
    for metres, expected in ((50.0, near), (120.0, far)):
        behind = (-metres * math.cos(course), -metres * math.sin(course), 0.0)
        for turn, sign in ((0.0, 1.0), (math.pi, -1.0)):
            arrange(paper, name, behind, course + turn)
            reward = paper.step(still(paper)).reward[name][:, 0]
            torch.testing.assert_close(reward, torch.full((4,), sign * expected), atol=0.12, rtol=0)


@pytest.mark.parametrize("name", TEAMS)
def test_the_paper_takes_one_for_a_collision(paper, name):
    """A follower with another on the same spot, or 3 m clear of it: the rest of its reward is equal."""
    begin(paper)
    team = paper.teams[name]
    arrange(paper, name, (-30.0, 0.0, 0.0), NORTH)

    def reward(offset: float) -> tuple[Tensor, Tensor]:
        zeros = torch.zeros(4, dtype=torch.int64)
        paper.reset(worlds=zeros, starts=zeros)
        state(paper, name)[:, 2] = state(paper, name)[:, 1]
        state(paper, name)[:, 2, 1] += offset
        step = paper.step(still(paper))
        return step.reward[name][:, 1], step.endings[name]["collided"][:, 1]

    apart, hit = reward(2 * team.radius + 3.0), reward(0.0)
    assert hit[1].all() and not apart[1].any()
    torch.testing.assert_close(hit[0], apart[0] - 1.0, atol=1e-3, rtol=0)


def test_tracking_rewards_the_slot_more_than_any_other_place(shared):
    """The same boat with the same motion, ever further from its slot, earns ever less."""
    rewards = []
    for away in (0.0, 2.0, 5.0, 20.0, 60.0):
        begin(shared)
        slot = shared.teams["usv"].now.slot[0, 2]
        state(shared, "usv")[0, 2, :2] = slot[:2] - away * slot[:2] / slot[:2].norm()
        rewards.append(shared.step(still(shared)).reward["usv"][0, 2].item())
    assert rewards == sorted(rewards, reverse=True)


# -- actions ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TEAMS)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_action_that_is_not_finite_is_refused_and_nothing_moves(shared, name, value):
    begin(shared)
    wander(shared, 1)
    before = everything(shared, [0, 1, 2, 3])
    actions = {n: a + 0.5 for n, a in still(shared).items()}
    actions[name][2, 1, 1] = value
    with pytest.raises(ValueError, match=f"'yaw' of {name}_1 in environment 2.*{value}"):
        shared.step(actions)
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


@pytest.mark.parametrize("shape", [(4, 3), (3, 3, 2), (4, 2, 2), (4, 3, 3)])
def test_actions_of_another_shape_are_refused(shared, shape):
    begin(shared)
    before = everything(shared, [0, 1, 2, 3])
    with pytest.raises(ValueError, match=r"usv.*shape.*expected \(4, 3, 2\)"):
        shared.step(still(shared) | {"usv": torch.zeros(shape)})
    for key, part in everything(shared, [0, 1, 2, 3]).items():
        assert part.equal(before[key]), key


def test_actions_beyond_the_range_are_clipped(shared):
    def outcome(clip: bool) -> dict[str, Tensor]:
        begin(shared)
        generator = torch.Generator().manual_seed(2)
        for _ in range(3):
            actions = {n: 3 * torch.randn(s, generator=generator) for n, s in shapes(shared).items()}
            assert max(a.abs().max() for a in actions.values()) > 2
            shared.step({n: a.clamp(-1, 1) if clip else a for n, a in actions.items()})
        return everything(shared, [0, 1, 2, 3])

    clipped = outcome(True)
    for key, part in outcome(False).items():
        assert part.equal(clipped[key]), key


def test_a_step_does_not_write_to_the_actions_given(shared):
    begin(shared)
    actions = {n: a + 2.0 for n, a in still(shared).items()}
    shared.step(actions)
    shared.reset(torch.tensor([0]))
    assert all((a == 2.0).all() for a in actions.values())


# -- variants ---------------------------------------------------------------------------------------------


def test_the_boats_alone_do_as_they_do_with_aircraft_above():
    """The teams share the target's track and the sea, and nothing else."""
    same = ("sea.hs=0", "obstacles.off_ways=false")  # starts that no team's obstacles draw again
    alone, both = make(*same, teams=("usv",)), make(*same)
    assert list(observed(alone)) == ["usv"]
    worlds, starts = torch.arange(4), torch.arange(4)
    for task in (alone, both):
        task.reset(worlds=worlds, starts=starts)
        for _ in range(3):
            task.step({n: a + 0.3 for n, a in still(task).items()})
    torch.testing.assert_close(state(alone, "usv"), state(both, "usv"))


def test_without_obstacles_nothing_is_in_the_way(paper):
    begin(paper)
    step = wander(paper, 3)
    assert not any(e["collided"].any() for e in step.endings.values())
    for name, rows in observed(paper).items():
        first = 2 * (1 + AXES[name])
        directions = rows[..., first : first + 6].unflatten(-1, (2, 3))[..., 1:]
        assert not directions.any()


def test_followers_astern_have_slots_behind_the_leader():
    task = make('usv.formation="astern"', "usv.spacing=20", "sea.hs=0", teams=("usv",))
    wander(task, 2)
    team = task.teams["usv"]
    course = torch.cat((team.target.course.cos(), team.target.course.sin()), dim=-1)
    leader = state(task, "usv")[:, 0, :2]
    for i in (1, 2):
        torch.testing.assert_close(team.now.slot[:, i, :2], leader - 20.0 * i * course, atol=1e-3, rtol=0)
    torch.testing.assert_close(team.now.slot[:, 0], team.target.position)


def test_the_target_moves_at_its_speed(shared):
    begin(shared)
    shared.reset(worlds=torch.arange(4), starts=torch.zeros(4, dtype=torch.int64))
    before = shared.teams["usv"].target.position.clone()
    for _ in range(5):
        shared.step(still(shared))
    moved = (shared.teams["usv"].target.position - before).norm(dim=-1)
    # 12 m/s for 0.5 s; a chord in a bend of 100 m is 6^3 / (24 100^2) = 1 mm shorter than its arc
    torch.testing.assert_close(moved, torch.full((4,), 6.0), atol=0.01, rtol=0)
