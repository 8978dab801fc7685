"""Slots: where they are in the world, rigidity, and a velocity that is the derivative of the position."""

import math
from types import SimpleNamespace

import pytest
import torch
from phases import due
from torch import Tensor

from rl.guidance.course.tracks import generate_tracks
from rl.guidance.shapes import SHAPES, formation_offsets, lane_half_width
from rl.guidance.targets_and_errors import DRIFT_SCALE, DRIFT_TIME, OFFSET, RATE, Geometry
from rl.guidance.targets_and_errors import SLOT_SIZE as SIZE
from rl.step import BEGINS, GOES_ON
from taichi_sim.kernels.conventions import POSITION, STATE_SIZE
from taichi_sim.kernels.rotation import DERIVED_SIZE, VELOCITY_N

DOUBLE = torch.float64
pytestmark = pytest.mark.usefixtures("f64")


def target(position: Tensor, course: Tensor, course_rate: Tensor, speed: float) -> Tensor:
    """The table of one target in each environment (geometry.py)."""
    others = course, course.cos(), course.sin(), course_rate, torch.full_like(course, speed)
    return torch.cat((position, torch.stack(others, dim=1)), dim=1).unsqueeze(1)


def slots(target: Tensor, leader: Tensor, velocity: Tensor, offsets: Tensor) -> Geometry:
    """Slots of teams whose leaders are at `leader` and move at `velocity`, each [env, 3]; they do not glide."""
    table = torch.zeros((leader.shape[0], offsets.shape[0], SIZE), dtype=DOUBLE)
    table[..., OFFSET:RATE] = offsets
    return measured(target, leader, velocity, table)


def measured(target: Tensor, leader: Tensor, velocity: Tensor, table: Tensor) -> Geometry:
    """The same with a `table` of slots (slots.py)."""
    shape = table.shape[:2]
    fleet = SimpleNamespace(
        state=torch.zeros((*shape, STATE_SIZE), dtype=DOUBLE), derived=torch.zeros((*shape, DERIVED_SIZE), dtype=DOUBLE)
    )
    fleet.derived[..., [0, 4, 8]] = 1.0  # level and northbound
    fleet.state[:, 0, POSITION], fleet.derived[:, 0, VELOCITY_N] = leader, velocity
    geometry = Geometry(fleet, target, 0.0, table, 3, 0.2)
    geometry.measure(due(shape[0]))
    return geometry


def place(course: float, formation: str, count: int, spacing: float = 15.0) -> Tensor:
    """Slots [vehicle, 3] of a leader at (100, 200, -5) behind a target at (130, 240, -5)."""
    here = target(
        torch.tensor([[130.0, 240.0, -5.0]], dtype=DOUBLE),
        torch.tensor([course], dtype=DOUBLE),
        torch.zeros(1, dtype=DOUBLE),
        12.0,
    )
    leader = torch.tensor([[100.0, 200.0, -5.0]], dtype=DOUBLE)
    offsets = formation_offsets(formation, count, spacing)
    return slots(here, leader, torch.zeros_like(leader), offsets).slot[0]


NORTHBOUND = {  # (north, east) of the leader; starboard of a northbound vehicle is east
    ("abreast", 1): [],
    ("abreast", 2): [(0, 15)],
    ("abreast", 3): [(0, 15), (0, -15)],
    ("abreast", 8): [(0, 15), (0, -15), (0, 30), (0, -30), (0, 45), (0, -45), (0, 60)],
    ("astern", 1): [],
    ("astern", 2): [(-15, 0)],
    ("astern", 3): [(-15, 0), (-30, 0)],
    ("astern", 8): [(-15 * i, 0) for i in range(1, 8)],
}


@pytest.mark.parametrize(("formation", "count"), NORTHBOUND)
def test_northbound_formation(formation, count):
    expected = [(130.0, 240.0, -5.0)]  # the leader's slot is the target
    expected += [(100.0 + n, 200.0 + e, -5.0) for n, e in NORTHBOUND[formation, count]]
    torch.testing.assert_close(place(0.0, formation, count), torch.tensor(expected, dtype=DOUBLE))


@pytest.mark.parametrize(
    ("formation", "first"),
    [("abreast", (-15.0, 0.0)), ("astern", (0.0, -15.0))],  # eastbound: starboard is south, astern is west
)
def test_eastbound_formation(formation, first):
    slot = place(math.pi / 2, formation, 2)[1, :2] - torch.tensor([100.0, 200.0], dtype=DOUBLE)
    torch.testing.assert_close(slot, torch.tensor(first, dtype=DOUBLE), atol=1e-12, rtol=0)


@pytest.mark.parametrize("formation", SHAPES)
def test_the_formation_is_rigid_when_the_course_turns(formation):
    """Distances and orientation between follower slots and the leader do not depend on the course."""
    leader = torch.tensor([100.0, 200.0, -5.0], dtype=DOUBLE)

    def shape(course: float) -> tuple[Tensor, Tensor]:
        arms = (place(course, formation, 8) - leader)[1:, :2]
        cross = arms[:, None, 0] * arms[None, :, 1] - arms[:, None, 1] * arms[None, :, 0]
        return arms @ arms.T, cross

    reference = shape(0.0)
    for course in torch.linspace(-math.pi, math.pi, 17).tolist():
        torch.testing.assert_close(shape(course), reference, atol=1e-9, rtol=0)


def test_the_mean_of_a_constant_error_approaches_it_exponentially_from_each_start():
    still = torch.zeros(1, dtype=DOUBLE)
    here = target(torch.tensor([[3.0, 4.0, 0.0]], dtype=DOUBLE), still, still, 12.0)
    leader = torch.zeros((1, 3), dtype=DOUBLE)  # 5 m away
    geometry = slots(here, leader, leader, torch.zeros((1, 2), dtype=DOUBLE))
    for which, times in ((BEGINS, 1), (GOES_ON, 2), (GOES_ON, 3), (BEGINS, 1), (GOES_ON, 2)):
        geometry.measure(due(1, which))
        share = 1 - math.exp(-0.2 * times / DRIFT_TIME)
        mean = share * torch.tensor([3.0, 4.0, 0.0], dtype=DOUBLE) / (5.0 + DRIFT_SCALE)
        torch.testing.assert_close(geometry.drift[0, 0], mean)


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_lane_holds_every_slot(count):
    widest = max((abs(east) for _, east in NORTHBOUND["abreast", count]), default=0)
    assert lane_half_width(("astern", "abreast"), count, 15.0) == widest


@pytest.mark.parametrize("formation", ["abreast", "astern"])
def test_slot_velocity_is_the_rate_of_the_slot_on_a_circle(formation):
    """Target on a circle of 100 m at 12 m/s, leader on a climbing curve of its own: exact to f64."""
    radius, speed = 100.0, 12.0
    offsets = formation_offsets(formation, 5, 15.0)

    def at(t: Tensor):
        angle = speed / radius * t
        north, east = radius * angle.sin(), -radius * angle.cos()
        position = torch.stack((north, east, torch.full_like(t, -60.0)), dim=-1)
        here = target(position, angle, torch.full_like(t, speed / radius), speed)
        leader = torch.stack((80 * (0.1 * t).sin(), 50 * (0.2 * t).cos(), -60 - 2 * t), dim=-1)
        rate = torch.stack((8 * (0.1 * t).cos(), -10 * (0.2 * t).sin(), torch.full_like(t, -2.0)), dim=-1)
        return slots(here, leader, rate, offsets)

    t, h = torch.linspace(0, 60, 13, dtype=DOUBLE), 1e-4
    difference = (at(t + h).slot - at(t - h).slot) / (2 * h)
    torch.testing.assert_close(at(t).slot_velocity, difference, atol=1e-6, rtol=0)


def test_slot_velocity_is_the_rate_of_the_slot_along_a_track():
    """The same on a drawn track (float32): the course rate is curvature times speed, with its sign."""
    worlds, speed, h = 6, 12.0, 0.2
    tracks = generate_tracks(worlds, 3)
    world = torch.arange(worlds).repeat(50)
    s = torch.arange(50).repeat_interleave(worlds) * 80.0 + 1.0
    offsets = formation_offsets("abreast", 5, 15.0)

    def at(t: float):
        here = tracks.at(world, s + speed * t)
        position = torch.nn.functional.pad(here.position, (0, 1)).double()
        velocity = torch.tensor([5.0, -3.0, 0.0], dtype=DOUBLE).expand_as(position)
        moving = target(position, here.course.double(), here.curvature.double() * speed, speed)
        return slots(moving, velocity * t, velocity, offsets)

    difference = (at(h).slot - at(-h).slot) / (2 * h)
    swing = (at(0).slot_velocity[:, 3] - torch.tensor([5.0, -3.0, 0.0])).norm(dim=-1)
    assert swing.max() > 1.0
    torch.testing.assert_close(at(0).slot_velocity, difference, atol=0.05, rtol=0)
