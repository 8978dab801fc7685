"""Traffic meets the team, in nobody's way at the start; what drifts goes with the water."""

import math

import pytest
import torch
from small_missions import begin, make, still

from rl.guidance.course.obstacles import BOTTOM, CARRIED, RADIUS, ROOM_M, TOP, V_EAST, V_NORTH, distance_to_tracks
from taichi_sim.config import ConfigError

BUSY = (
    "obstacles.count=24", "obstacles.clearance_min=-15", "obstacles.clearance_max=0", "obstacles.moving_fraction=0.4",
    "sea.current.speed=0.5", "sea.current.direction_deg=30",
)  # fmt: skip


@pytest.fixture(scope="module")
def busy():
    """Return a mission in the lanes of which something stands and something moves."""
    return make(*BUSY)


def bodies(task):
    """Bodies [world, start, 8, body] as episodes begin."""
    return task.bodies._pool


def test_every_episode_meets_traffic_of_each_medium(busy):
    """Each body would hit a vehicle of a team in its slot, the line abreast 15 m apart."""
    pool, config = bodies(busy), busy.config
    met = 24 * config.episode_duration * config.track.target_speed / config.track.length
    assert pool.shape[-1] == 2 * math.ceil(0.4 * met)
    time = torch.linspace(0.0, config.episode_duration, 601)
    water = torch.tensor([0.5 * math.cos(math.radians(30)), 0.5 * math.sin(math.radians(30))])
    velocity = pool[..., V_NORTH : V_EAST + 1, :] + pool[..., CARRIED : CARRIED + 1, :] * water.unsqueeze(-1)
    place = pool[..., :2, :].unsqueeze(-1) + velocity.unsqueeze(-1) * time
    world = torch.arange(pool.shape[0]).view(-1, 1, 1).expand(*pool.shape[:2], len(time))
    target = busy.tracks.at(world, busy.starts.progress.unsqueeze(-1) + config.track.target_speed * time)
    starboard = torch.stack((-target.course.sin(), target.course.cos()), dim=-1)
    slots = target.position.unsqueeze(2) + torch.tensor([-15.0, 0.0, 15.0]).view(3, 1, 1) * starboard.unsqueeze(2)
    nearest = (place.permute(0, 1, 3, 4, 2).unsqueeze(3) - slots.unsqueeze(2)).norm(dim=-1).amin((-1, -2))
    there = pool[..., 0, :] < 1e5
    assert there.float().mean() > 0.9
    assert (nearest - pool[..., RADIUS, :])[there].max() < 0.0
    spans = pool[..., BOTTOM, :], pool[..., TOP, :]
    flies = torch.arange(pool.shape[-1]) % 2 == 1
    assert (spans[1][there & ~flies] <= 15.0).all()
    assert (spans[0][there & flies] == 45.0).all()
    assert (spans[1][there & flies] == 75.0).all()


def test_nothing_is_hit_at_the_start_and_nothing_sails_through_what_stands(busy):
    pool = bodies(busy)
    for state in busy.starts.states.values():
        away = (state[..., :2].unsqueeze(3) - pool[..., :2, :].transpose(-1, -2).unsqueeze(2)).norm(dim=-1)
        assert (away - pool[..., RADIUS, :].unsqueeze(2)).min() > 30.0
    for t in torch.linspace(0.0, busy.config.episode_duration, 200):
        place = pool[..., :2, :] + t * pool[..., V_NORTH : V_EAST + 1, :]
        gap = (place.transpose(-1, -2).unsqueeze(3) - busy.obstacles[:, None, None, :, :2]).norm(dim=-1)
        room = gap - pool[..., RADIUS, :].unsqueeze(-1) - busy.obstacles[:, None, None, :, 2]
        assert room[pool[..., CARRIED, :] == 0].min() > 0.99 * ROOM_M


def test_what_moves_moves_and_what_drifts_goes_with_the_water(busy):
    begin(busy)
    before = busy.bodies.table.clone()
    for _ in range(10):
        busy.step(still(busy), begin=False)
    moved = busy.bodies.table[:, :2] - before[:, :2]
    carried = before[:, CARRIED] == 1
    assert carried.any()
    water = busy.world.current.velocity.unsqueeze(-1).expand_as(moved)
    expected = torch.where(carried.unsqueeze(1), water, before[:, V_NORTH : V_EAST + 1])
    torch.testing.assert_close(moved, expected * 1.0, atol=1e-3, rtol=0)
    torch.testing.assert_close(busy.bodies.table[:, V_NORTH : V_EAST + 1], expected)


def test_a_contact_with_what_moves_is_a_collision(busy):
    begin(busy)
    state = busy.teams["usv"].fleet.state
    busy.bodies.table[2, :2, 0] = state[2, 1, :2]
    busy.bodies.table[2, V_NORTH:CARRIED, 0] = 0.0
    ended = busy.step(still(busy)).endings
    assert ended["usv"]["collided"][2, 1]
    assert not ended["uav"]["collided"][2].any()  # it passes above


def test_without_obstacles_nothing_moves():
    task = make("obstacles.count=0", "obstacles.moving_fraction=0.5")
    assert not task.bodies.present
    assert begin(task).teams["usv"].sensor.obstacles[..., 0].min() == 40.0


def test_obstacles_stand_in_the_lanes_no_nearer_to_the_track_than_asked():
    task = make(
        "obstacles.clearance_min=-12", "obstacles.clearance_max=0", "obstacles.track_clearance=4", teams=("usv",)
    )
    place, radius = task.obstacles[..., :2].flatten(0, 1), task.obstacles[..., 2].flatten()
    world = torch.arange(task.obstacles.shape[0]).repeat_interleave(task.obstacles.shape[1])
    surface = distance_to_tracks(task.tracks, world, place) - radius
    assert surface.min() > 4.0
    assert surface.max() < 15.0


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("obstacles.speed_max=25", "obstacles.speed_max = 25.0 m/s: traffic must not be faster than usv"),
        ("obstacles.speed_max=1", "speed_max = 1.0 must not be below speed_min = 2.0"),
        ("obstacles.drifting_fraction=0.9", "must not be above 1 together"),
        ("obstacles.moving_fraction=1.5", "obstacles.moving_fraction"),
    ],
)
def test_impossible_traffic_is_refused(override, message):
    with pytest.raises(ConfigError, match=message):
        make(*BUSY, override)
