"""The tracks and the obstacles beside them: invariants, each measured without the code that makes them."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from rl.guidance.course.obstacles import distance_to_tracks, generate_obstacles
from rl.guidance.course.tracks import Tracks, generate_tracks

WORLDS = 48
LANE_M = 30.0


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    """Return the default tracks of one seed."""
    return generate_tracks(WORLDS, 7)


@pytest.fixture(scope="module")
def obstacles(tracks: Tracks) -> Tensor:
    """Return the default obstacles beside them."""
    return generate_obstacles(tracks, 7, lane_half_width_m=LANE_M)


def lap(tracks: Tracks, points: int, start: float = 0.0) -> tuple[Tensor, Tensor]:
    """World and arc length [world, point] of `points` even places on each lap."""
    s = start + torch.arange(points) * (4000.0 / points)
    world = torch.arange(tracks.worlds)[:, None].expand(-1, points)
    return world, s.expand(tracks.worlds, -1)


def wrapped(angle: Tensor) -> Tensor:
    """Return the angle in [-pi, pi] (rad)."""
    return torch.atan2(angle.sin(), angle.cos())


def distance_to_lap(tracks: Tracks, obstacles: Tensor) -> Tensor:
    """Distance [world, obstacle] (m) from each centre to places 0.5 m apart on the whole lap."""
    position = tracks.at(*lap(tracks, 8000)).position.double()
    centre = obstacles[..., :2].double()
    pairs = zip(centre, position, strict=True)
    return torch.stack([torch.cdist(c, p).amin(dim=1) for c, p in pairs])


def test_a_lap_is_as_long_as_asked(tracks: Tracks) -> None:
    """The chords of a fine sampling add up to the length."""
    position = tracks.at(*lap(tracks, 3000)).position.double()
    length = (position.roll(-1, dims=1) - position).norm(dim=-1).sum(dim=1)
    assert length.sub(4000).abs().max() < 0.005 * 4000
    assert length.sub(4000).abs().max() < 0.5  # what sampling and float32 leave


def test_samples_are_equally_spaced(tracks: Tracks) -> None:
    """Every step of the table, that over the seam too, is one sample of arc length."""
    step = (tracks.table.roll(-1, dims=1) - tracks.table)[..., :2].norm(dim=-1)
    assert step.sub(4000 / 1024).abs().max() < 0.01


def test_course_is_the_direction_of_travel(tracks: Tracks) -> None:
    """A central difference of position points along the course, clockwise from north."""
    world, s = lap(tracks, 700, start=0.3)
    ahead, behind = (tracks.at(world, s + d).position.double() for d in (5.0, -5.0))
    direction = torch.atan2(*(ahead - behind).flip(-1).unbind(-1))
    assert wrapped(direction - tracks.at(world, s).course).abs().max() < 5e-3


def test_curvature_is_the_derivative_of_course(tracks: Tracks) -> None:
    """Curvature adds up to the change of course between samples, the seam included, and to one turn a lap."""
    course, curvature = tracks.table[..., 2].double(), tracks.table[..., 3].double()
    spacing = 4000 / 1024
    turned = wrapped(course.roll(-1, dims=1) - course)
    mean = (curvature + curvature.roll(-1, dims=1)) / 2
    assert (turned / spacing - mean).abs().max() < 2e-4  # 2 % of the tightest bend
    assert (curvature.sum(dim=1) * spacing).abs().sub(2 * math.pi).abs().max() < 0.01
    assert course.diff(dim=1).abs().max() < 0.05  # unwrapped


def test_course_and_curvature_are_continuous_over_the_seam(tracks: Tracks) -> None:
    """A place just before checkpoint 1 and one just after differ as little as two such places elsewhere."""
    world = torch.arange(WORLDS)
    before, after = (tracks.at(world, torch.full((WORLDS,), s)) for s in (3999.9, 4000.1))
    assert (before.position - after.position).norm(dim=-1).sub(0.2).abs().max() < 5e-3
    assert wrapped(before.course - after.course).abs().max() < 0.2 * 0.01 + 1e-4
    assert (before.curvature - after.curvature).abs().max() < 1e-4
    step = tracks.table[..., 3].diff(dim=1).abs().amax()
    assert (tracks.table[:, 0, 3] - tracks.table[:, -1, 3]).abs().max() <= 1.5 * step


@pytest.mark.parametrize(("checkpoints", "radius"), [(22, 100.0), (22, 200.0), (4, 100.0), (40, 60.0)])
def test_no_bend_or_gap_is_tighter_than_the_radius(checkpoints: int, radius: float) -> None:
    """No circle through three neighbouring places is smaller; no two strands are nearer than 2 R."""
    tracks = generate_tracks(24, 3, checkpoints=checkpoints, min_radius_m=radius)
    assert tracks.table[..., 3].abs().max() <= 1 / radius
    p = tracks.at(*lap(tracks, 250)).position.double()
    a, b, c = (p.roll(-i, dims=1) for i in range(3))
    (ab_n, ab_e), (ac_n, ac_e) = (b - a).unbind(-1), (c - a).unbind(-1)
    twice_area = (ab_n * ac_e - ab_e * ac_n).abs()
    circle = (b - a).norm(dim=-1) * (c - b).norm(dim=-1) * (c - a).norm(dim=-1) / (2 * twice_area + 1e-12)
    assert circle.min() >= radius
    away = torch.arange(250)[:, None].sub(torch.arange(250)).abs()
    away = torch.minimum(away, 250 - away) * 16.0
    apart = torch.cdist(p, p).where(away > math.pi * radius * 1.05, torch.inf)
    assert apart.min() >= 2 * radius


def test_tracks_stay_in_the_area(tracks: Tracks) -> None:
    """No place is outside the area less its margin, and worlds do not all sit in the middle."""
    assert tracks.table[..., :2].abs().max() <= 1500 - 200 + 0.05
    assert tracks.table[..., :2].mean(dim=1).std(dim=0).min() > 100


def test_tracks_pass_through_their_checkpoints(tracks: Tracks) -> None:
    """Checkpoints lie on the track at their arc lengths, in order, the first at the start."""
    world = torch.arange(WORLDS)[:, None].expand(-1, 22)
    assert (tracks.at(world, tracks.checkpoint_s).position - tracks.checkpoints).norm(dim=-1).max() < 0.02
    assert (tracks.checkpoint_s[:, 0] == 0).all()
    assert (tracks.checkpoint_s.diff(dim=1) > 0).all()
    assert torch.allclose(tracks.table[:, 0, :2], tracks.checkpoints[:, 0], atol=1e-3)


def test_checkpoints_are_unevenly_spaced(tracks: Tracks) -> None:
    """On every track the gaps spread by a fifth of their mean, and none vanishes."""
    gap = torch.diff(tracks.checkpoint_s, append=tracks.length_m[:, None], dim=1)
    assert (gap.std(dim=1) / gap.mean(dim=1)).min() > 0.2
    assert gap.min() > 20


def test_tracks_bend_both_ways_and_run_both_ways(tracks: Tracks) -> None:
    """No track is convex; some laps turn to starboard and some to port."""
    inside_out = tracks.table[..., 3] * (tracks.table[:, -1:, 2] - tracks.table[:, :1, 2]) < 0
    assert (inside_out.float().mean(dim=1) > 0.05).float().mean() > 0.9
    starboard = (tracks.table[:, -1, 2] > tracks.table[:, 0, 2]).float().mean()
    assert 0.25 < starboard < 0.75


def test_at_takes_any_lap_and_shape(tracks: Tracks) -> None:
    """Laps earlier and later are the same place; shapes follow the argument; course is wrapped."""
    world, s = torch.arange(12).reshape(3, 4), torch.linspace(1, 3999, 12).reshape(3, 4)
    here = tracks.at(world, s)
    assert here.position.shape == (3, 4, 2)
    assert here.course.shape == here.curvature.shape == (3, 4)
    for laps in (-2, 1, 3):
        assert (tracks.at(world, s + 4000.0 * laps).position - here.position).abs().max() < 0.01
    for s_end in (-1e-12, -1e-5, 0.0, 4000.0, 3999.9998):
        end = tracks.at(torch.arange(WORLDS), torch.full((WORLDS,), s_end)).position
        assert (end - tracks.checkpoints[:, 0]).abs().max() < 0.01
    everywhere = tracks.at(*lap(tracks, 999)).course
    assert everywhere.abs().max() <= math.pi + 1e-6


def test_position_is_smooth_between_samples() -> None:
    """A table of 256 rows gives the places of one of 4096 within 0.1 m, where bare chords miss by 0.3 m."""
    coarse, fine = (generate_tracks(8, 5, samples=samples) for samples in (256, 4096))
    where = lap(coarse, 5000)
    miss = (coarse.at(*where).position - fine.at(*where).position).norm(dim=-1).max()
    chord = (4000 / 256) ** 2 * fine.table[..., 3].abs().max() / 8
    assert chord > 0.2
    assert miss < 0.1


def test_a_world_depends_only_on_its_seed_and_number(tracks: Tracks, obstacles: Tensor) -> None:
    """The same seed gives the same bits, and asking for fewer worlds gives the first of them."""
    fewer = generate_tracks(5, 7)
    for name in ("table", "length_m", "checkpoints", "checkpoint_s"):
        assert torch.equal(getattr(fewer, name), getattr(tracks, name)[:5]), name
    assert torch.equal(generate_obstacles(fewer, 7, lane_half_width_m=LANE_M), obstacles[:5])
    assert not torch.equal(generate_tracks(5, 8).table, fewer.table)
    assert not torch.equal(generate_obstacles(fewer, 8, lane_half_width_m=LANE_M), obstacles[:5])


def test_obstacles_keep_clear_of_every_lane(tracks: Tracks, obstacles: Tensor) -> None:
    """No surface is within the least clearance of a lane, and nearly all are within the greatest."""
    clearance = distance_to_lap(tracks, obstacles) - obstacles[..., 2] - LANE_M
    assert clearance.min() >= 6.0
    assert clearance.max() <= 70.0
    assert (clearance <= 60.0).float().mean() > 0.98


def test_a_place_is_as_far_from_a_track_as_from_its_nearest_sample(tracks: Tracks) -> None:
    """To within half of the spacing of samples, for places anywhere and on the track."""
    world = torch.arange(tracks.worlds).repeat_interleave(64)
    anywhere = (torch.rand(len(world), 2, generator=torch.Generator().manual_seed(0)) - 0.5) * 3000
    on_it = tracks.table[world, torch.arange(len(world)) * 37 % tracks.samples, :2]
    for place in (anywhere, on_it):
        to_sample = (tracks.table[world, :, :2] - place[:, None]).norm(dim=-1).amin(dim=1)
        less = to_sample - distance_to_tracks(tracks, world, place)
        assert (less > -1e-3).all() and (less <= tracks.length_m[world] / tracks.samples / 2 + 0.1).all()


def test_obstacles_may_stand_in_lanes_but_not_on_the_track(tracks: Tracks) -> None:
    """With a negative clearance some stand inside the lanes; all keep 12 m from the track itself."""
    obstacles = generate_obstacles(tracks, 1, lane_half_width_m=LANE_M, clearance_m=(-40.0, 10.0))
    surface = distance_to_lap(tracks, obstacles) - obstacles[..., 2]
    assert surface.min() >= 12.0
    assert (surface < LANE_M).float().mean() > 0.2


def test_obstacles_stand_apart_inside_the_area(tracks: Tracks, obstacles: Tensor) -> None:
    """No two cylinders touch, and none crosses the edge."""
    for world in obstacles.double():
        between = torch.cdist(world[:, :2], world[:, :2]) - world[:, 2] - world[:, 2, None]
        assert (between + torch.eye(24) * 1e9).min() > 0
    assert (obstacles[..., :2].abs() + obstacles[..., 2:3]).max() <= 1500
    assert obstacles[..., 2].min() >= 3.0
    assert obstacles[..., 2].max() <= 10.0


def test_obstacles_are_spread_over_the_lap_on_both_sides(tracks: Tracks, obstacles: Tensor) -> None:
    """Every quarter of every lap has obstacles, unevenly; of all, about half are to starboard."""
    position = tracks.at(*lap(tracks, 1000)).position
    nearest = torch.cdist(obstacles[..., :2], position).argmin(dim=-1)
    for quarter in range(4):
        assert ((nearest // 250) == quarter).sum(dim=1).min() >= 2
    gap = nearest.sort(dim=1).values.diff(dim=1).float()
    assert gap.std() / gap.mean() > 0.2
    here = tracks.at(torch.arange(WORLDS)[:, None].expand(-1, 24), nearest * 4.0)
    out = obstacles[..., :2] - here.position
    to_starboard = (out[..., 1] * here.course.cos() - out[..., 0] * here.course.sin() > 0).float().mean()
    assert 0.4 < to_starboard < 0.6


def test_the_tall_share_crosses_the_flight_height(obstacles: Tensor) -> None:
    """In every world 40 % of 24 reach above 70 m, and no other comes near 60 m."""
    height = obstacles[..., 3]
    assert ((height > 70).sum(dim=1) == round(0.4 * 24)).all()
    assert ((height > 50) & (height <= 70)).sum() == 0
    assert height.min() >= 5.0
    assert height.max() <= 90.0


def test_no_obstacles(tracks: Tracks) -> None:
    """A count of zero is an empty table."""
    assert generate_obstacles(tracks, 1, count=0, lane_half_width_m=LANE_M).shape == (WORLDS, 0, 4)


@pytest.mark.parametrize(
    ("demand", "name"),
    [
        ({"length_m": 9000.0}, "length_m"),
        ({"length_m": 4000.0, "area_m": 1000.0}, "length_m"),
        ({"min_radius_m": 400.0}, "min_radius_m"),
        ({"checkpoints": 3}, "checkpoints"),
        ({"margin_m": -1.0}, "margin_m"),
        ({"samples": 20}, "samples"),
        ({"length_m": math.nan}, "length_m"),
    ],
)
def test_impossible_tracks_are_refused(demand: dict[str, float], name: str) -> None:
    """The message names the parameter and its range."""
    with pytest.raises(ValueError, match=rf"^{name} must be in \[.*\].* got"):
        generate_tracks(2, 0, **demand)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^num_worlds must be in"):
        generate_tracks(0, 0)
    with pytest.raises(ValueError, match=r"^seed must be in"):
        generate_tracks(2, -1)


@pytest.mark.parametrize(
    ("demand", "message"),
    [
        ({"count": -1}, "^count must be in"),
        ({"tall_fraction": 1.5}, "^tall_fraction must be in"),
        ({"flight_height_m": 85.0}, "^tall_fraction must be in"),
        ({"radius_m": (5.0, 3.0)}, r"^radius_m\[1\] must be in"),
        ({"clearance_m": (5.0, 3.0)}, r"^clearance_m\[1\] must be in"),
        ({"height_m": (80.0, 90.0)}, r"^height_m\[0\] must be in"),
        ({"lane_half_width_m": -1.0}, "^lane_half_width_m must be in"),
        ({"lane_half_width_m": 2000.0}, "no room for"),
        ({"count": 200, "radius_m": (60.0, 80.0)}, "no room for"),
    ],
)
def test_impossible_obstacles_are_refused(demand: dict[str, float], message: str) -> None:
    """The message names the parameter and its range, or what to lower when there is no room."""
    with pytest.raises(ValueError, match=message):
        generate_obstacles(generate_tracks(2, 7), 0, **({"lane_half_width_m": LANE_M} | demand))  # type: ignore[arg-type]
