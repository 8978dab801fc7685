"""The reward terms at points worked by hand, and their shape."""

import math

import pytest
import torch
from small_missions import make, wander

from rl.guidance import rewards as terms
from rl.missions.formation import rewards


def tensor(*values: float) -> torch.Tensor:
    """One environment, double precision."""
    return torch.tensor([values], dtype=torch.float64)


def close(actual: torch.Tensor, *expected: float) -> None:
    torch.testing.assert_close(actual, tensor(*expected))


def test_eq_10_at_points():
    d = tensor(0.0, 50.0, 145.0, 200.0, 1000.0, 2000.0)
    toward = tensor(9.0, 9.0, 1.0, -0.25, 1.0, 1.0)  # 9: not read below 100 m
    along = tensor(1.0, 0.5, 9.0, 9.0, 9.0, 9.0)
    close(
        rewards.paper_usv(d, toward, along),
        2.9,  # 1 (0.9 + 2 - 0)
        0.95,  # 0.5 (0.9 + 2 - 0.02 50) = 0.5 1.9
        0.855,  # 1 (1 - 0.001 145)
        -0.2,  # -0.25 (1 - 0.2)
        0.0,  # 1 - 1
        -1.0,  # 1 - 2: beyond a kilometre, pointing at the target is punished
    )


def test_eq_11_at_points():
    d = tensor(0.0, 40.0, 300.0, 600.0)
    toward = tensor(9.0, 9.0, -1.0, 0.5)
    along = tensor(1.0, 0.8, 9.0, 9.0)
    close(
        rewards.paper_uav_leader(d, toward, along),
        1.95,  # 1 (0.95 + 1 - 0)
        1.24,  # 0.8 (0.95 + 1 - 0.01 40) = 0.8 1.55
        -0.85,  # -1 (1 - 0.0005 300)
        0.35,  # 0.5 (1 - 0.0005 600) = 0.5 0.7
    )


def test_uav_follower_at_points():
    close(
        rewards.paper_uav_follower(tensor(0.0, 20.0, 40.0, 99.0, 100.0, 250.0)),
        1.0,
        0.5,  # 1 - 0.025 20
        0.0,  # 1 - 0.025 40
        -1.475,  # 1 - 0.025 99
        0.0,  # the paper gives nothing from 100 m on
        0.0,
    )


@pytest.mark.parametrize(
    ("reward", "at_100"),
    [(rewards.paper_usv, 0.9), (rewards.paper_uav_leader, 0.95)],  # 1 - 0.1 = 2.9 - 2; 1 - 0.05 = 1.95 - 1
)
@pytest.mark.parametrize("cosine", [1.0, 0.3, -1.0])
def test_leader_rewards_are_continuous_at_100_m_when_the_cosines_agree(reward, at_100, cosine):
    step = 1e-6
    same = tensor(cosine, cosine, cosine)
    below, at, above = reward(tensor(100 - step, 100.0, 100 + step), same, same)[0].tolist()
    assert at == pytest.approx(at_100 * cosine, abs=1e-12)
    assert below == pytest.approx(at, abs=1e-6)
    assert above == pytest.approx(at, abs=1e-6)


@pytest.mark.parametrize(("reward", "factor"), [(rewards.paper_usv, 0.9), (rewards.paper_uav_leader, 0.95)])
def test_exactly_100_m_takes_the_near_branch(reward, factor):
    toward, along = tensor(-0.7, -0.7), tensor(0.4, 0.4)
    at, beyond = reward(tensor(100.0, 100.0001), toward, along)[0].tolist()
    assert at == pytest.approx(factor * 0.4)
    assert beyond == pytest.approx(factor * -0.7, rel=1e-4)


def test_a_collision_costs_one():
    penalty = terms.penalty(torch.tensor([[True, False]]))
    torch.testing.assert_close(penalty, torch.tensor([[-1.0, 0.0]]))


# -- tracking --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("term", "at_scale"),
    [(terms.coarse, math.exp(-1)), (terms.fine, 0.5)],
)
@pytest.mark.parametrize("scale", [0.5, 8.0])
def test_bells_peak_at_one_on_the_slot_and_fall(term, at_scale, scale):
    close(term(tensor(0.0, scale), scale), 1.0, at_scale)
    fall = term(torch.linspace(0, 5 * scale, 200, dtype=torch.float64), scale).diff()
    assert (fall < 0).all()
    assert 0 < term(tensor(20 * scale), scale) + 1e-30 < 0.01


def test_far_away_the_bells_are_flat():
    d = torch.tensor([100.0], dtype=torch.float64, requires_grad=True)
    total = terms.coarse(d, 8.0) + terms.fine(d, 0.5)
    flat = torch.autograd.grad(total.sum(), d)[0]
    assert abs(flat.item()) < 1e-5


def test_action_rate_is_minus_the_square_of_the_change():
    action = torch.tensor([[[0.3, 0.4], [1.0, -1.0], [0.2, 0.2]]])
    previous = torch.tensor([[[0.0, 0.0], [-1.0, 1.0], [0.2, 0.2]]])
    # 0.09 + 0.16; 2^2 + 2^2; nothing
    torch.testing.assert_close(terms.action_rate(action, previous), torch.tensor([[-0.25, -8.0, 0.0]]))


def test_clearance_is_quadratic_inside_its_range_and_zero_outside():
    reach = 4.0
    close(terms.clearance(tensor(10.0, 4.0, 2.0, 1.0, 0.0), reach), 0.0, 0.0, -0.25, -0.5625, -1.0)
    gap = torch.linspace(-8.0, 8.0, 400, dtype=torch.float64)
    penalty = terms.clearance(gap, reach)
    assert (penalty.diff() >= 0).all()  # more room is never worse
    assert penalty.diff().max() < 0.1  # no jump
    assert penalty.min() >= -2.25  # deep inside an obstacle: bounded


def test_the_gap_ahead_is_the_least_one_on_straight_ways():
    """Ways of boats, their mates and moving obstacles are followed in small steps."""
    task = make("obstacles.count=80", "obstacles.clearance_min=-15", "obstacles.moving_fraction=0.3", envs=8)
    wander(task, 25)
    team = task.teams["usv"]
    time = torch.linspace(0, 4, 801)
    place, velocity = team.fleet.position_n[..., :2, None], team.fleet.velocity_n[..., :2, None]
    way = place + velocity * time
    mates = (way.unsqueeze(1) - way.unsqueeze(2)).norm(dim=-2) + 1e6 * torch.eye(3)[..., None]
    body = team.sensor.obstacles
    to = ((body[..., 7] + body[..., 6]).unsqueeze(-1) * body[..., 1:3]).unsqueeze(-1)
    to = to + (body[..., 4:6].unsqueeze(-1) - velocity.unsqueeze(2)) * time
    things = to.norm(dim=-2) - body[..., 6:7] - team.radius + 1e6 * (body[..., 8:9] < 0)
    least = torch.cat((mates - 2 * team.radius, things), dim=2).amin((-2, -1)).clamp(max=team.sensor.reach)
    found = rewards.gap_ahead(team, 4.0)
    torch.testing.assert_close(found, least, atol=0.01, rtol=0)
    assert (found < team.sensor.gap - 0.5).any()
    assert rewards.gap_ahead(team, 0.0) is team.sensor.gap
