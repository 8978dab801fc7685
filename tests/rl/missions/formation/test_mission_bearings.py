"""Where the mission shows target and team mates: in the body frame, squashed, or out of range."""

import math

import pytest
import torch
from small_missions import AXES, EAST, NORTH, SOUTH, TEAMS, arrange, begin, observed


@pytest.mark.parametrize(
    ("offset", "psi", "direction"),
    [
        ((-30.0, 0.0, 0.0), NORTH, (1, 0, 0)),  # target north of a northbound vehicle: ahead
        ((-30.0, 0.0, 0.0), EAST, (0, -1, 0)),  # north of an eastbound one: to port
        ((-30.0, 0.0, 0.0), SOUTH, (-1, 0, 0)),  # astern
        ((0.0, -30.0, 0.0), NORTH, (0, 1, 0)),  # east: to starboard
        ((0.0, -30.0, 0.0), EAST, (1, 0, 0)),
        ((0.0, 0.0, 30.0), EAST, (0, 0, -1)),  # 30 m above the aircraft
        ((-18.0, 0.0, -24.0), SOUTH, (-0.6, 0, 0.8)),  # astern and below: 3-4-5
    ],
)
def test_the_direction_is_in_the_body_frame(paper, offset, psi, direction):
    for name, n in AXES.items():
        if n == 3 or not offset[2]:  # boats observe the horizontal part
            observation = arrange(paper, name, offset, psi)
            # 30 m squashed: 30 / (30 + 10)
            expected = torch.tensor([0.75, *direction[:n]], dtype=torch.float32)
            torch.testing.assert_close(observation[: 1 + n], expected, atol=1e-4, rtol=0)


def test_an_aircraft_sees_the_target_from_its_attitude(paper):
    """A target 30 m ahead at the same height: below a raised nose, on the lower side of a bank when above."""
    raised = arrange(paper, "uav", (-30.0, 0.0, 0.0), NORTH, theta=math.pi / 6)
    expected = torch.tensor([0.75, math.sqrt(3) / 2, 0.0, 0.5])
    torch.testing.assert_close(raised[:4], expected, atol=1e-4, rtol=0)
    banked = arrange(paper, "uav", (0.0, 0.0, 30.0), NORTH, phi=math.pi / 2)  # right wing down, target above
    torch.testing.assert_close(banked[:4], torch.tensor([0.75, 0.0, -1.0, 0.0]), atol=1e-4, rtol=0)


def test_a_boat_sees_the_target_from_its_heading_alone(paper):
    upright = arrange(paper, "usv", (-30.0, -10.0, 0.0), NORTH)
    tossed = arrange(paper, "usv", (-30.0, -10.0, 0.0), NORTH, theta=0.4, phi=-0.5)
    torch.testing.assert_close(tossed[:6], upright[:6], atol=1e-4, rtol=0)


def test_an_aircraft_sees_its_team_mates_with_its_nose_straight_up(paper):
    """max_pitch_deg is 90, so this is an ordinary state: directions must not vanish in it."""
    observation = arrange(paper, "uav", (-30.0, 0.0, 0.0), NORTH, theta=math.pi / 2)
    mates = observation[-8:].view(2, 4)
    assert (mates[:, 0] > 0).all()  # 20 m away
    torch.testing.assert_close(mates[:, 1:].norm(dim=-1), mates[:, 0], atol=1e-3, rtol=0)


def test_the_distance_observed_grows_with_the_distance_and_stays_below_one(paper):
    squashed = [arrange(paper, "uav", (-d, 0.0, 0.0), NORTH)[0].item() for d in (1, 10, 40, 140)]
    assert squashed == pytest.approx([1 / 11, 1 / 2, 4 / 5, 14 / 15], abs=1e-4)  # d / (d + 10)


def test_what_is_out_of_range_is_observed_as_nothing(paper):
    """No obstacles, and team mates beyond the detection range of 40 m: closeness and direction are 0."""
    begin(paper)
    for name in TEAMS:
        start = paper.starts.states[name][0, 0]
        start[:, 0] = start[0, 0] + torch.tensor([0.0, 50.0, -50.0])
    zeros = torch.zeros(4, dtype=torch.int64)
    paper.reset(worlds=zeros, starts=zeros)
    for name, rows in observed(paper).items():
        beyond = rows[..., 2 * (1 + AXES[name]) :]
        assert not beyond.any(), f"{name}: {beyond[0, 0].tolist()}"
