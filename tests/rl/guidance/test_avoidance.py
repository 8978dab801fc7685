"""Avoidance (rl/guidance/avoidance.py): what is passed, by how much, and what is left alone."""

import math
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from rl.guidance.avoidance import STEPS, AvoidanceGains, Avoider, Shield
from rl.guidance.targets_and_errors import COURSE_RATE, ERRORS_SIZE, SLOT_VELOCITY, TARGET_SIZE, V
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN
from taichi_sim.vehicle import Limits

GAINS = AvoidanceGains(acceleration=5.0)
RADIUS, SPEED = 2.0, 10.0  # m, m/s


def scene(obstacles=(), mates=(), *, rate: float = 0.0, own: tuple[float, float] = (SPEED, 0.0), axes: int = 2):
    """A team of two, of which the second goes north at SPEED beside its leader, and what it sees.

    obstacles: (north, east, radius, velocity north and east, distance above or below). mates: (north, east, down).
    """
    dtype = runtime.current().torch_dtype
    seen, near = torch.zeros((1, 2, 2, 9), dtype=dtype), torch.zeros((1, 2, 2, 7), dtype=dtype)
    seen[..., 0], near[..., 0] = 100.0, 100.0
    for i in range(2):
        for k, (north, east, radius, v_north, v_east, aside) in enumerate(obstacles):
            far = math.hypot(north, east)
            level = far - radius
            distance = math.hypot(max(level, 0.0), aside) if aside else level
            row = [distance, north / far, east / far, 0.0, v_north, v_east, radius, level, 0.0]
            seen[0, i, k] = torch.tensor(row, dtype=dtype)
        for k, place in enumerate(mates):
            far = math.hypot(*place)
            near[0, i, k] = torch.tensor([far, *(x / far for x in place), 0.0, SPEED, 0.0], dtype=dtype)
    table, derived = torch.zeros((1, 2, ERRORS_SIZE), dtype=dtype), torch.zeros((1, 2, 14), dtype=dtype)
    table[..., SLOT_VELOCITY] = SPEED
    derived[..., V], derived[..., V + 1] = own
    target = torch.zeros((1, 1, TARGET_SIZE), dtype=dtype)
    target[..., COURSE_RATE] = rate
    model = SimpleNamespace(limits=Limits())
    fleet = SimpleNamespace(derived=derived, state=derived, num_envs=1, count=2, model=model)
    sensor = SimpleNamespace(obstacles=seen, team_mates=near, num_obstacles=2, num_mates=2)
    now = SimpleNamespace(table=table, about=False)
    target = SimpleNamespace(table=target)
    return SimpleNamespace(fleet=fleet, sensor=sensor, now=now, target=target, radius=RADIUS, axes=axes)


def steered(team, wanted=(SPEED, 0.0), gains: AvoidanceGains = GAINS) -> Tensor:
    """Velocities [vehicle, 2] that the team is given."""
    velocity = torch.tensor(wanted, dtype=runtime.current().torch_dtype).expand(1, 2, len(wanted))
    return Avoider(gains)(team, velocity)[0]


def passes(velocity: Tensor, north: float, east: float, v=(0.0, 0.0)) -> float:
    """Least distance (m) to a point that moves with v, on a straight way from now on."""
    w = velocity[:2] - torch.tensor(v).to(velocity)
    place = torch.tensor([north, east]).to(velocity)
    t = (place @ w / (w @ w)).clamp(min=0)
    return float((place - t * w).norm())


@pytest.mark.parametrize("east", [-12.0, 12.0])
def test_what_is_passed_with_room_changes_nothing(east):
    team = scene([(30.0, east, 5.0, 0.0, 0.0, 0.0)], [(0.0, -15.0, 0.0)])
    assert torch.equal(steered(team), torch.tensor([[SPEED, 0.0]]).to(team.fleet.state).expand(2, 2))


@pytest.mark.parametrize("east", [-4.0, -1.0, 1.0, 4.0])
@pytest.mark.parametrize("moving", [(0.0, 0.0), (-4.0, 0.0), (0.0, 3.0)])
def test_an_obstacle_in_the_way_is_cleared(east, moving):
    """On a straight way with the new velocity it stays further than the sum of the radii, whatever it does."""
    team = scene([(30.0, east, 5.0, *moving, 0.0)])
    for velocity in steered(team):
        assert passes(velocity, 30.0, east, moving) > 5.0 + RADIUS
        assert velocity.norm() > 0.4 * SPEED


def test_the_side_is_that_of_the_heading_though_waves_push_the_vessel():
    """Without `turning` it passes to the side on which the waves push it now."""
    sides = {}
    for turning in (0.0, 3.0):
        for push in (-2.0, 2.0):
            team = scene([(30.0, 0.0, 5.0, 0.0, 0.0, 0.0)], own=(SPEED, push))
            team.fleet.derived[..., HEADING_COS], team.fleet.derived[..., HEADING_SIN] = math.cos(0.4), math.sin(0.4)
            sides[turning, push] = float(steered(team, gains=GAINS.model_copy(update={"turning": turning}))[1, 1])
    assert sides[0.0, -2.0] < 0 < sides[0.0, 2.0]
    assert sides[3.0, -2.0] > 0 and sides[3.0, 2.0] > 0


def test_between_two_obstacles_there_is_a_way():
    """Each alone is passed on the side where the other is: together they are passed between, or both on one side."""
    both = [(30.0, -8.0, 4.0, 0.0, 0.0, 0.0), (30.0, 9.0, 4.0, 0.0, 0.0, 0.0)]
    velocity = steered(scene(both), (SPEED, -1.0))[1]
    assert min(passes(velocity, *o[:2]) for o in both) > 4.0 + RADIUS


def test_what_lies_above_or_below_is_no_obstacle():
    straight = steered(scene([(30.0, 0.0, 5.0, 0.0, 0.0, 20.0)], axes=3), (SPEED, 0.0, -1.0))
    assert torch.equal(straight, torch.tensor([[SPEED, 0.0, -1.0]]).to(straight).expand(2, 3))
    turned = steered(scene([(30.0, 0.0, 5.0, 0.0, 0.0, 2.0)], axes=3), (SPEED, 0.0, -1.0))
    assert (turned[:, 1].abs() > 1.0).all()
    assert torch.equal(turned[:, 2], straight[:, 2])  # nobody climbs over


def test_in_a_bend_what_the_arc_passes_is_left_alone():
    """Straight ahead at 30 m stands what a bend of 50 m radius leaves 8 m and more beside."""
    assert torch.equal(
        steered(scene([(30.0, 0.0, 2.0, 0.0, 0.0, 0.0)], rate=0.2))[:, 1], torch.zeros(2).to(torch.get_default_dtype())
    )
    on_the_arc = 50 * math.sin(0.6), 50 * (1 - math.cos(0.6))
    assert (steered(scene([(*on_the_arc, 2.0, 0.0, 0.0, 0.0)], rate=0.2))[:, 1].abs() > 0.3).all()


def test_followers_keep_clear_of_the_leader_and_not_it_of_them():
    leader, follower = steered(scene(mates=[(0.0, -12.0, 0.0)]), (SPEED, -3.0))
    assert leader.tolist() == [SPEED, -3.0]
    assert follower[1] > -2.5


def test_slowly_nearing_a_mate_inside_the_margin_is_left_if_that_counts():
    """It would be nearest after the horizon: without `parting` nothing is done until it is late."""
    wanted = (SPEED, 0.1)
    team = scene(mates=[(0.0, 2 * RADIUS + 0.8, 0.0)], own=wanted)
    assert steered(team, wanted)[1].tolist() == pytest.approx(wanted)
    apart = steered(team, wanted, GAINS.model_copy(update={"parting": 1.0}))[1]
    assert float(apart[1]) < -0.2 and float(apart[0]) > 0.7 * SPEED


def test_out_of_contact_is_the_way_that_is_taken():
    """Inside the berth it goes outwards."""
    velocity = steered(scene([(2.0, 7.5, 5.0, 0.0, 0.0, 0.0)]), (SPEED, 1.0))[1]
    assert velocity[1] < 0


def shielded(team, correction: tuple[float, float], own=(SPEED, 0.0)) -> Tensor:
    """Velocities [vehicle, 2] of a team that goes with `own` and wants to be corrected."""
    own, change = (torch.tensor(x, dtype=runtime.current().torch_dtype).expand(1, 2, 2) for x in (own, correction))
    return Shield(GAINS)(team, own, change)[0]


def test_a_correction_is_taken_back_as_far_as_it_leads_into_an_obstacle():
    """An obstacle is passed with room on the own way, and hit on the corrected one; on the other side is nothing. What
    is left leads past the berth; the next share that is tried would lead into it.
    """
    team = scene([(25.0, 14.0, 5.0, 0.0, 0.0, 0.0)])
    into, away = shielded(team, (0.0, 5.0)), shielded(team, (0.0, -5.0))
    assert passes(torch.tensor([SPEED, 5.0]), 25.0, 14.0) < 5.0 + RADIUS
    assert (into[:, 1] < 3.5).all() and (into[:, 1] >= 0).all() and (into[:, 0] == SPEED).all()
    more = into[0] + torch.tensor([0.0, 5.0 / STEPS]).to(into)
    assert passes(into[0], 25.0, 14.0) > 5.0 + RADIUS + GAINS.berth > passes(more, 25.0, 14.0)
    assert away.equal(torch.tensor([[SPEED, -5.0]]).to(away).expand(2, 2))


def test_a_correction_that_leads_out_of_danger_stays():
    """Straight into an obstacle on the own way, clear of it on the corrected one."""
    team = scene([(30.0, 1.0, 4.0, 0.0, 0.0, 0.0)], own=(SPEED, -6.0))
    assert shielded(team, (0.0, -6.0)).equal(torch.tensor([[SPEED, -6.0]]).to(team.fleet.state).expand(2, 2))
