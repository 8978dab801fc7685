"""Sensing against geometry: distance to a cylinder, the nearest things in order, gap and range."""

import math
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from rl.guidance.course.obstacles import ROWS, Bodies
from rl.perception.sensors import Sensor
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime

REACH = 40.0


def team(positions: Tensor, psi: float = 0.0) -> Fleet:
    """Vehicles at `positions` [env, vehicle, 3], all heading `psi`."""
    vehicles = Fleet("uav", SimpleNamespace(aux_size=1, action_names=(), dt=0.1), *positions.shape[:2])
    vehicles.state[..., :3] = positions
    vehicles.state[..., 3], vehicles.state[..., 6] = math.cos(psi / 2), math.sin(psi / 2)
    vehicles.update()
    return vehicles


def sense(
    positions: list,
    obstacles: list,
    *,
    seen: int = 2,
    mates: int = 2,
    radius: float = 1.0,
    psi: float = 0.0,
) -> Sensor:
    """One environment with vehicles at `positions` (NED) among `obstacles` (north, east, radius, height)."""
    sensor = Sensor(team(torch.tensor([positions], dtype=torch.float64), psi), seen, mates, REACH, radius)
    world = torch.tensor([obstacles], dtype=runtime.current().torch_dtype).reshape(1, -1, 4)
    sensor.look(world, torch.zeros(1, dtype=torch.int64))
    return sensor


def assert_rows(sensed: Tensor, expected: list) -> None:
    torch.testing.assert_close(sensed, torch.tensor(expected).to(sensed))


def distance(position: tuple, obstacle: tuple) -> float:
    """Distance (m) sensed by a vehicle alone with one obstacle."""
    return sense([position], [obstacle], seen=1, mates=0).obstacles[0, 0, 0, 0].item()


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ((13.0, 0.0, -5.0), 3.0),  # beside: 13 - 10
        ((6.0, -8.0, -5.0), 0.0),  # on the wall
        ((18.0, 24.0, 0.0), 20.0),  # beside, at the foot: 30 - 10
        ((0.0, 0.0, -27.0), 7.0),  # over the axis: 27 - 20
        ((9.9, 0.0, -27.0), 7.0),  # over the rim, inside
        ((0.0, 13.0, -24.0), 5.0),  # beside and above: 3-4-5
        ((-22.0, 0.0, -29.0), 15.0),  # 12, 9: 15
        ((0.0, 0.0, -5.0), -10.0),  # on the axis, inside
        ((7.0, 0.0, -5.0), -3.0),  # inside, nearest to the wall
    ],
)
def test_distance_to_a_cylinder_at_points(position, expected):
    assert distance(position, (0.0, 0.0, 10.0, 20.0)) == pytest.approx(expected, abs=1e-5)


def test_distance_outside_is_to_the_nearest_point_of_the_solid():
    """The nearest point of a convex solid is the projection: clamp the radius and the height."""
    generator = torch.Generator().manual_seed(3)
    axis, radius, height = torch.tensor([500.0, -300.0]), 6.0, 15.0
    offset = (torch.rand((200, 2), generator=generator) - 0.5) * 40
    altitude = torch.rand(200, generator=generator) * 30
    rho = offset.norm(dim=-1)
    foot = torch.hypot((rho - radius).clamp(min=0.0), (altitude - height).clamp(min=0.0))
    positions = torch.cat((axis + offset, -altitude.unsqueeze(-1)), dim=-1).unsqueeze(1)
    sensor = Sensor(team(positions), 1, 0, REACH, 1.0)
    sensor.look(torch.tensor([[[*axis.tolist(), radius, height]]]), torch.zeros(200, dtype=torch.int64))
    outside = foot > 0
    assert 100 < int(outside.sum()) < 200
    sensed = sensor.obstacles[:, 0, 0, 0]
    torch.testing.assert_close(sensed[outside], foot[outside].clamp(max=REACH), atol=1e-3, rtol=0)


def test_obstacles_come_nearest_first_with_unit_directions_to_their_axes():
    obstacles = [(0, 25, 2, 9), (-9, 0, 2, 9), (16, 0, 4, 9), (0, -17, 6, 9), (60, 0, 1, 9)]
    # surfaces at 23, 7, 12, 11 m; the last, at 59 m, is out of range
    sensor = sense([(0.0, 0.0, 0.0)], obstacles, seen=5, mates=0)
    expected = [[7, -1, 0, 0], [11, 0, -1, 0], [12, 1, 0, 0], [23, 0, 1, 0], [REACH, 0, 0, 0]]
    assert_rows(sensor.obstacles[0, 0, :, :4], expected)


@pytest.mark.parametrize("seen", [1, 3])
def test_only_the_nearest_obstacles_are_seen_whatever_their_order(seen):
    generator = torch.Generator().manual_seed(1)
    ranges = [6.0, 11.0, 17.0, 22.0, 29.0, 36.0]
    obstacles = [(r * math.cos(r), r * math.sin(r), 1.0, 9.0) for r in ranges]
    for _ in range(5):
        order = torch.randperm(len(ranges), generator=generator).tolist()
        sensor = sense([(0.0, 0.0, 0.0)], [obstacles[i] for i in order], seen=seen, mates=0)
        assert_rows(sensor.obstacles[0, 0, :, 0], [r - 1 for r in ranges[:seen]])
        bearing = torch.atan2(sensor.obstacles[0, 0, :, 2], sensor.obstacles[0, 0, :, 1])
        for sensed, r in zip(bearing.tolist(), ranges, strict=False):
            assert math.cos(sensed - r) == pytest.approx(1.0, abs=1e-6)


def test_team_mates_come_nearest_first_in_three_dimensions():
    positions = [(0.0, 0.0, -50.0), (0.0, 20.0, -50.0), (2.0, 3.0, -56.0), (-30.0, 0.0, -50.0)]
    sensor = sense(positions, [], seen=0, mates=3)
    seven = (2 / 7, 3 / 7, -6 / 7)  # 4 + 9 + 36 = 49
    expected = [[7, *seven], [20, 0, 1, 0], [30, -1, 0, 0]]
    assert_rows(sensor.team_mates[0, 0][:, :4], expected)
    back = [7, *(-x for x in seven)]  # seen from the other side
    assert_rows(sensor.team_mates[0, 2, 0, :4], back)


def test_what_is_not_in_range_reads_as_the_range_with_no_direction():
    sensor = sense([(0.0, 0.0, 0.0), (0.0, 50.0, 0.0)], [(100, 0, 5, 9)], seen=2, mates=2)
    assert_rows(sensor.obstacles[0, 0], [[REACH, 0, 0, 0, 0, 0, 0, REACH, -1]] * 2)
    assert_rows(sensor.team_mates[0, 0], [[REACH, 0, 0, 0, -1, 0, 0]] * 2)
    assert sensor.gap.tolist() == [[REACH, REACH]]


def test_the_range_is_to_the_surface():
    """A cylinder of 10 m is seen when its wall, not its axis, comes within 40 m."""
    assert distance((49.9, 0.0, 0.0), (0, 0, 10, 9)) == pytest.approx(39.9, abs=1e-4)
    assert distance((50.1, 0.0, 0.0), (0, 0, 10, 9)) == REACH
    assert distance((0.0, 0.0, -48.9), (0, 0, 10, 9)) == pytest.approx(39.9, abs=1e-4)  # straight below
    assert distance((0.0, 0.0, -49.1), (0, 0, 10, 9)) == REACH


@pytest.mark.parametrize("slack", [-0.01, 0.01])
def test_the_gap_to_an_obstacle_changes_sign_at_contact(slack):
    """A sphere of 2 m touches a wall of 5 m at 7 m from the axis, and a top of 9 m at 11 m height."""
    for position in ((7 + slack, 0.0, 0.0), (0.0, 0.0, -11 - slack)):
        gap = sense([position], [(0, 0, 5, 9)], seen=0, mates=0, radius=2.0).gap.item()
        assert gap == pytest.approx(slack, abs=1e-5)


@pytest.mark.parametrize("slack", [-0.01, 0.01])
def test_the_gap_to_a_team_mate_changes_sign_at_contact(slack):
    """Two spheres of 2 m touch at 4 m between centres, in any direction."""
    for axis in range(3):
        other = [0.0, 0.0, 0.0]
        other[axis] = 4 + slack
        sensor = sense([(0.0, 0.0, 0.0), tuple(other)], [], seen=0, mates=0, radius=2.0)
        assert sensor.gap[0].tolist() == pytest.approx([slack, slack], abs=1e-5)


def test_the_gap_is_the_smallest_of_all_even_if_nothing_is_observed():
    near_obstacle = sense([(0.0, 0.0, 0.0), (0.0, 30.0, 0.0)], [(20, 0, 5, 9)], seen=0, mates=0)
    assert near_obstacle.gap[0, 0].item() == pytest.approx(20 - 5 - 1)
    near_mate = sense([(0.0, 0.0, 0.0), (0.0, 10.0, 0.0)], [(20, 0, 5, 9)], seen=1, mates=0)
    assert near_mate.gap[0, 0].item() == pytest.approx(10 - 2)


def test_a_vehicle_over_an_obstacle_is_clear_of_it():
    low, high = sense([(0.0, 0.0, -3.0), (0.0, 0.0, -30.0)], [(0, 0, 5, 9)]).gap[0].tolist()
    assert low < 0
    assert high == pytest.approx(30 - 9 - 1)


@pytest.mark.parametrize("psi", [0.0, 1.0, math.pi / 2, -2.5])
def test_directions_are_given_from_the_heading_too(psi):
    """What bears 1 rad from north bears 1 - psi from the bow: ahead its cosine, to starboard its sine."""
    c, s = math.cos(1.0), math.sin(1.0)
    sensor = sense([(0, 0, 0), (20 * c, 20 * s, 0)], [(30 * c, 30 * s, 5, 9)], seen=1, mates=1, psi=psi)
    direction = torch.tensor([math.cos(1.0 - psi), math.sin(1.0 - psi)]).to(sensor.signals)
    obstacle, width, still, mate = sensor.signals[0, 0].split((3, 1, 2, 3))
    assert not still.any()
    assert width.item() == pytest.approx(5 / 30)  # radius over distance to the axis: the sine of half the angle
    for signal, distance_m in ((obstacle, 25.0), (mate, 20.0)):
        assert signal[0].item() == pytest.approx(1 - distance_m / REACH)
        torch.testing.assert_close(signal[1:], signal[0] * direction, atol=1e-5, rtol=0)


def test_a_body_that_moves_is_seen_with_its_velocity_among_what_stands():
    """Between two heights: under it, it is out of the way; its velocity is told in n, and ahead and to starboard."""
    psi, vehicle = 0.7, team(torch.tensor([[[0.0, 0.0, -50.0]]]), 0.7)
    bodies = Bodies(1, torch.zeros((1, 1, ROWS, 1), dtype=vehicle.state.dtype))
    bodies.table[0, :, 0] = torch.tensor([30.0, 0.0, 4.0, 40.0, 60.0, 3.0, -4.0, 0.0])
    sensor = Sensor(vehicle, 2, 0, REACH, 1.0)
    stands = torch.tensor([[[0.0, 35.0, 5.0, 90.0]]], dtype=vehicle.state.dtype)

    def look():
        sensor.look(stands, torch.zeros(1, dtype=torch.int64), bodies=bodies)
        return sensor.obstacles[0, 0]

    assert_rows(look(), [[26, 1, 0, 0, 3, -4, 4, 26, 8], [30, 0, 1, 0, 0, 0, 5, 30, 0]])
    c, s = math.cos(psi), math.sin(psi)
    moves = torch.tensor([3 * c - 4 * s, -4 * c - 3 * s]) / (5.0 + 10.0)
    assert_rows(sensor.signals[0, 0, 4:6], moves.tolist())
    assert sensor.gap.item() == pytest.approx(25.0)
    bodies.move(5.0, torch.zeros((1, 2), dtype=vehicle.state.dtype))
    assert look()[0, 0].item() == pytest.approx(30.0)  # 45 m ahead and 20 to port by now: beyond what stands
    vehicle.state[0, 0, 2] = -20.0
    bodies.table[0, :2] = 0.0
    assert look()[0, 0].item() == pytest.approx(20.0)  # straight above, from 40 m on


def test_environments_see_their_own_world_and_their_own_team():
    positions = torch.zeros((3, 2, 3))
    positions[:, 1, 1] = torch.tensor([11.0, 12.0, 13.0])
    obstacles = torch.tensor([[[20.0, 0, 1, 9]], [[30.0, 0, 1, 9]]], dtype=runtime.current().torch_dtype)
    sensor = Sensor(team(positions), 1, 1, REACH, 1.0)
    sensor.look(obstacles, torch.tensor([1, 0, 1]))
    assert column(sensor.obstacles) == [29.0, 19.0, 29.0]
    assert column(sensor.team_mates) == [11.0, 12.0, 13.0]


def column(sensed: Tensor) -> list[float]:
    """Distances of vehicle 0 to its nearest thing, by environment."""
    return sensed[:, 0, 0, 0].tolist()
