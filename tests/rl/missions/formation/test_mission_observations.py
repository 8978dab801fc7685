"""What the mission shows: sizes, bounds, the past, and that north is nothing special."""

import math

import pytest
import torch
from small_missions import AXES, PAPER_SIZE, TEAMS, begin, make, observed, past_and_present, wander
from torch import Tensor

from rl.guidance.course.tracks import Tracks
from rl.missions.formation.mission import Formation
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

ENCOUNTERS = 2 * 6 + 2 * 3  # of two obstacles, by the vehicle and by its slot, and of two team mates
# error, its rate, its mean, velocity, down axis, rates, course, turn, action, role, offset
FULL_EXTRA = {
    "usv": 2 + 2 + 2 + 3 + 3 + 3 + 2 + 1 + 2 + 1 + 2 + ENCOUNTERS,
    "uav": 3 + 3 + 3 + 3 + 3 + 3 + 3 + 1 + 3 + 1 + 2 + ENCOUNTERS,
}


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("formation", ["abreast", "astern"])
def test_every_team_size_and_formation_steps(count, formation):
    sizes = [f"{n}.{key}" for n in TEAMS for key in (f"count={count}", f"formation={formation}")]
    task = make(*sizes, envs=3)
    step = wander(task, 2)
    for name, rows in observed(task).items():
        assert rows.shape == (3, count, PAPER_SIZE[name] + FULL_EXTRA[name])
        assert rows.isfinite().all()
        assert step.reward[name].shape == (3, count)
        assert step.reward[name].isfinite().all()
        roles = torch.zeros(3, count)
        roles[:, 0] = 1.0
        assert rows[..., -3 - ENCOUNTERS].equal(roles)
        held = task.teams[name].offsets
        torch.testing.assert_close(rows[..., -2 - ENCOUNTERS : -ENCOUNTERS], held / (held.abs() + 10.0))


def test_encounters_are_what_going_straight_on_would_bring():
    """Ways are followed in small steps: the least gap, how far ahead and how far aside it is."""
    task = make("obstacles.count=80", "obstacles.clearance_min=-15", "obstacles.moving_fraction=0.3", envs=8)
    wander(task, 25)
    team = task.teams["usv"]
    seen, velocity = team.sensor.obstacles, team.fleet.velocity_n[..., :2]
    found = team.observe()["encounters"][..., :12].unflatten(-1, (2, 6))[..., :3]
    near = seen[..., 8] >= 0
    assert near.sum() > 10 and (found[~near] == 0).all()
    place = (seen[..., 7:8] + seen[..., 6:7]) * seen[..., 1:3]
    w = velocity.unsqueeze(2) - seen[..., 4:6]
    time = torch.linspace(0, 40, 8001)
    way = (place.unsqueeze(-1) - w.unsqueeze(-1) * time).norm(dim=-2)
    least, when = way.min(dim=-1)
    ahead = time[when] * w.norm(dim=-1)
    torch.testing.assert_close(found[..., 0][near], (20 / (20 + ahead))[near], atol=2e-3, rtol=0)
    gap = least - seen[..., 6] - team.radius
    torch.testing.assert_close(found[..., 2][near], (gap / (gap.abs() + 2))[near], atol=2e-3, rtol=0)
    passed = near & (ahead > 0.5)
    side = (w[..., 0] * place[..., 1] - w[..., 1] * place[..., 0]).sign() * least
    torch.testing.assert_close(found[..., 1][passed], (side / (side.abs() + 5))[passed], atol=2e-3, rtol=0)


@pytest.mark.parametrize("seen", [0, 4])
def test_sensing_sets_the_size_of_observations(seen):
    sensing = (f"sensing.obstacles={seen}", f"sensing.team_mates={seen}")
    task = make(*sensing, 'observations="paper"', teams=("uav",))
    assert task.teams["uav"].observations().shape == (4, 3, 2 * 4 + seen * 7 + seen * 4)


def test_paper_observations_have_their_size_and_bounds(paper):
    begin(paper)
    for i in range(10):
        wander(paper, 3, seed=i)
        for name, rows in observed(paper).items():
            assert rows.shape == (4, 3, PAPER_SIZE[name])
            assert rows.isfinite().all()
            assert rows.abs().max() <= 1.0 + 1e-5


def test_full_observations_begin_with_those_of_the_paper(shared):
    paper = make('observations="paper"')
    for task in (shared, paper):
        begin(task)
        wander(task, 3)
    for name, rows in observed(paper).items():
        assert shared.teams[name].observations()[..., : rows.shape[-1]].equal(rows)


def test_full_observations_are_bounded_where_they_should_be(shared):
    begin(shared)
    for i in range(10):
        wander(shared, 3, seed=i)
        for name, rows in observed(shared).items():
            n, axes = PAPER_SIZE[name], AXES[name]
            error, attitude = rows[..., n : n + axes], rows[..., n + 3 * axes + 3 : n + 3 * axes + 6]
            course = rows[..., n + 3 * axes + 9 : n + 4 * axes + 9]
            action = rows[..., n + 4 * axes + 10 : -3]
            assert rows.isfinite().all()
            assert error.abs().max() < 1.0
            one = torch.ones(rows.shape[:2])
            torch.testing.assert_close(attitude.norm(dim=-1), one, atol=1e-4, rtol=0)
            assert course.abs().max() <= 1.0 + 1e-5
            assert action.abs().max() <= 1.0


def test_observations_are_a_fresh_tensor_each_time(shared):
    begin(shared)
    first = observed(shared)
    copies = {name: rows.clone() for name, rows in first.items()}
    assert all(rows.data_ptr() != first[name].data_ptr() for name, rows in observed(shared).items())
    wander(shared, 2)
    shared.reset(torch.tensor([0, 2]))
    observed(shared)
    for name, rows in first.items():
        assert rows.equal(copies[name])


@pytest.mark.parametrize("reset", [[], [1, 3]])
def test_the_previous_distance_and_direction_are_those_of_the_last_step(shared, reset):
    begin(shared)
    wander(shared, 2)
    last = {n: past_and_present(rows, AXES[n])[0] for n, rows in observed(shared).items()}
    wander(shared, 1)
    shared.reset(torch.tensor(reset, dtype=torch.int64))
    going_on = [env for env in range(4) if env not in reset]
    for name, rows in observed(shared).items():
        now, previous = past_and_present(rows, AXES[name])
        assert previous[going_on].equal(last[name][going_on])
        assert not now[going_on].equal(previous[going_on])
        assert now[reset].equal(previous[reset])
        torch.testing.assert_close(
            now[..., 1:].norm(dim=-1), torch.ones(now.shape[:2]), atol=1e-4, rtol=0
        )  # a unit vector


def rotated(task: Formation, angle: float) -> None:
    """Turn the world about the vertical: tracks, obstacles, starts."""
    c, s = math.cos(angle), math.sin(angle)
    R = torch.tensor([[c, s], [-s, c]])  # rows: v @ R turns v clockwise
    tracks = task.tracks
    table = torch.cat((tracks.table[..., :2] @ R, tracks.table[..., 2:]), dim=-1)
    table[..., 2] += angle
    task.tracks = Tracks(table, tracks.length_m, tracks.checkpoints @ R, tracks.checkpoint_s)
    tracks.rows.copy_(task.tracks.rows)  # which targets move along
    vars(task)["obstacles"] = torch.cat((task.obstacles[..., :2] @ R, task.obstacles[..., 2:]), dim=-1).contiguous()
    zero = torch.zeros(())
    turn = torch_quaternion_from_euler(zero, zero, zero + angle)
    states = {}
    for name, old in task.starts.states.items():
        w, x, y, z = old[..., 3:7].unbind(-1)
        tw, tz = turn[0], turn[3]  # the product of a turn about the vertical with the attitude
        q = torch.stack((tw * w - tz * z, tw * x - tz * y, tw * y + tz * x, tw * z + tz * w), dim=-1)
        states[name] = torch.cat((old[..., :2] @ R, old[..., 2:3], q, old[..., 7:]), dim=-1)
    task.starts = task.starts._replace(states=states)


def test_observations_do_not_depend_on_where_north_is():
    """On a calm sea the same situation, turned about the vertical, looks and goes on the same."""
    crowded = ("obstacles.clearance_min=-20", "obstacles.count=120", "obstacles.radius_max=4", "area=4000")
    task = make("sea.hs=0", *crowded, envs=16)
    worlds, starts = torch.arange(16) % 4, torch.arange(16)

    def watch() -> list[dict[str, Tensor]]:
        task.reset(worlds=worlds, starts=starts)
        seen = [observed(task)]
        for i in range(4):
            wander(task, 2, seed=i)
            seen.append(observed(task))
        return seen

    generator = torch.Generator().manual_seed(0)
    for states in task.starts.states.values():  # no two team mates at the same distance: rounding would order them
        states[..., :2] += 0.3 * torch.randn(states[..., :2].shape, generator=generator)
    before = watch()
    sensed = before[0]["usv"][..., 6:14:4]
    assert (sensed > 0.3).any()  # obstacles near enough to matter
    rotated(task, 2.0)
    for old, new in zip(before, watch(), strict=True):
        for name in TEAMS:
            torch.testing.assert_close(new[name], old[name], atol=3e-3, rtol=0)
