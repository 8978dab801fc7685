"""The rasteriser against closed forms: which pixels, what is in front, where the horizon is, where the sea."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from recorded import make_episode

from taichi_sim.config import SeaConfig
from taichi_sim.surroundings.sea import Sea
from taichi_sim.visualisation.film import raster, water
from taichi_sim.visualisation.film.camera import FilmCamera, eye_that_holds, heading, look, look_at
from taichi_sim.visualisation.film.moment import moment_of
from taichi_sim.visualisation.film.primitives import BALL, BALL_NORMALS, NO_SOLIDS, NO_STROKES, Solids, Strokes
from taichi_sim.visualisation.film.raster import Raster

WIDE, HIGH = 80, 60
NORTH = np.array([1.0, 0.0, 0.0])
RED, GREEN = (255, 0, 0), (0, 255, 0)


def shining(corners, *colours) -> Solids:
    """Triangles whose colour nothing changes."""
    corners = np.array(corners, dtype=np.float64).reshape(-1, 3, 3)
    return Solids(corners, np.zeros((len(corners), 3)), np.array(colours, np.uint8).reshape(-1, 3))


def draw(solids: Solids, camera: FilmCamera | None = None, strokes: Strokes = NO_STROKES):
    return Raster(WIDE, HIGH).draw(camera or look(np.zeros(3), NORTH, 1.0), solids, strokes)


def is_(picture, colour):
    return (picture == np.array(colour)).all(axis=-1)


def on_screen(column: float, row: float, ahead: float) -> list[float]:
    """The place that a camera at the origin which looks north sees at a pixel, `ahead` m away: east is right."""
    return [ahead, ahead * (column - WIDE / 2) / HIGH, ahead * (row - HIGH / 2) / HIGH]


def test_a_triangle_covers_its_pixels_and_no_other():
    corners = [on_screen(10.3, 5.2, 7.0), on_screen(70.1, 20.7, 9.0), on_screen(31.6, 52.4, 30.0)]
    picture = draw(shining(corners, RED))
    flat = np.array([(10.3, 5.2), (70.1, 20.7), (31.6, 52.4)])
    column, row = np.meshgrid(np.arange(WIDE) + 0.5, np.arange(HIGH) + 0.5)
    inside = np.full(row.shape, np.inf)  # px from the nearest edge, inwards
    for a, b in zip(flat, np.roll(flat, -1, axis=0), strict=True):
        along, down = (b - a) / np.linalg.norm(b - a)
        inside = np.minimum(inside, along * (row - a[1]) - down * (column - a[0]))
    red = is_(picture, RED)
    assert red[inside > 0.75].all() and (inside > 0.75).sum() > 500
    assert not (picture[..., 0] > picture[..., 2])[inside < -0.75].any()  # the sky is blue


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_of_two_crossing_triangles_is_seen(order):
    """One comes nearer from left to right, the other from right to left: they cross where they are as far."""
    square = ((0, 0), (80, 0), (80, 60), (0, 60))
    sheets = [[on_screen(*square[k], 5.0 if square[k][0] == 0 else 20.0) for k in (0, 1, 2, 0, 2, 3)],
              [on_screen(*square[k], 20.0 if square[k][0] == 0 else 5.0) for k in (0, 1, 2, 0, 2, 3)]]  # fmt: skip
    both = [shining(sheet, colour, colour) for sheet, colour in zip(sheets, (RED, GREEN), strict=True)]
    picture = draw(Solids(*(np.concatenate(part) for part in zip(*(both[k] for k in order), strict=True))))
    assert is_(picture, RED)[:, : WIDE // 2].all() and is_(picture, GREEN)[:, WIDE // 2 :].all()


def test_a_closed_body_has_no_gap_and_hides_what_is_behind():
    ball = Solids(np.array([10.0, 0.0, 0.0]) + 2.0 * BALL, BALL_NORMALS, np.full((len(BALL), 3), 200, np.uint8))
    behind = Strokes(np.array([[[20.0, -9.0, 0.0], [20.0, 9.0, 0.0]]]), np.array([RED], np.uint8), np.array([4.0]),
                     np.zeros(1))  # fmt: skip
    picture = draw(ball, strokes=behind)
    column, row = np.meshgrid(np.arange(WIDE) + 0.5, np.arange(HIGH) + 0.5)
    away = np.hypot(column - WIDE / 2, row - HIGH / 2)
    edge = HIGH * math.tan(math.asin(0.2))  # of the silhouette
    grey = np.ptp(picture.astype(int), axis=-1) < 40
    assert grey[away < 0.9 * edge].all()
    assert is_(picture, RED)[HIGH // 2, [WIDE // 2 - 20, WIDE // 2 + 20]].all()  # beside it the line is seen


def test_a_floor_that_passes_under_the_eye_is_cut_at_the_near_plane():
    floor = shining([[-90, -900, 2], [2000, 0, 2], [-90, 900, 2]], GREEN)
    green = is_(draw(floor), GREEN)
    assert green[HIGH // 2 + 4 :, WIDE // 2].all() and not green[: HIGH // 2].any()


def test_a_picture_is_the_same_bits_on_any_number_of_threads(monkeypatch):
    """Bands are shared out among the threads."""
    rng = np.random.default_rng(1)
    solids = shining(rng.normal((30, 0, 0), (9, 12, 9), (400, 3, 3)), *rng.integers(0, 255, (400, 3)))
    pictures = []
    for threads in (1, 3, 64):
        monkeypatch.setattr(raster.runtime, "current", lambda n=threads: SimpleNamespace(arch="cpu", threads=n))
        pictures.append(draw(solids))
    assert len(np.unique(pictures[0].reshape(-1, 3), axis=0)) > 300
    assert all(np.array_equal(pictures[0], other) for other in pictures)


def test_pixels_are_where_a_compass_and_the_sky_say():
    camera = look_at([0.0, 0.0, -10.0], [0.0, 100.0, -10.0], 1.5)  # looks east
    ahead, south, above = camera.pixels([[0, 50, -10], [-20, 50, -10], [0, 50, -30]], (640, 480))
    assert ahead == pytest.approx([320, 240, 50])
    assert south[0] > 600 and south[1] == pytest.approx(240)  # facing east, south is at the right hand
    assert above[1] < 0 and above[0] == pytest.approx(320)


@pytest.mark.parametrize("pitch", [0.05, 0.3])
def test_the_horizon_is_where_the_camera_looks_level(pitch):
    size, focal = (160, 120), 1.2
    camera = look([0.0, 0.0, -8.0], heading(0.7, pitch), focal)
    row = size[1] / 2 - focal * size[1] * math.tan(pitch)
    far = 1e6 * heading(0.7, 0.0) - (0.0, 0.0, 8.0)
    assert camera.pixels(far, size)[1] == pytest.approx(row)
    moment = moment_of(make_episode(steps=2), 0.0)._replace(waves=np.zeros((6, 1)))
    sea = water.water_seen(camera, size, moment)
    with_sea = Raster(*size).draw(camera, NO_SOLIDS, NO_STROKES, sea)
    without = Raster(*size).draw(camera, NO_SOLIDS, NO_STROKES)
    begins = np.flatnonzero((with_sea != without).any(axis=(1, 2)))[0]
    assert abs(begins - row) < 1.5
    assert (with_sea[begins + 3 :] != without[begins + 3 :]).any(axis=-1).all()


def test_an_eye_that_holds_places_is_the_nearest_that_does():
    rng = np.random.default_rng(2)
    places, forward = rng.normal(0, (50, 80, 10), (40, 3)), heading(1.0, 0.5)
    eye = eye_that_holds(places, forward, 1.15, 4 / 3, 0.8)
    spot = look(eye, forward, 1.15).pixels(places, (640, 480))
    low, high = spot.min(axis=0), spot.max(axis=0)
    assert low[0] > 63.9 and high[0] < 576.1 and low[1] > 47.9 and high[1] < 432.1 and low[2] > 0
    assert (high - low)[0] > 511 or (high - low)[1] > 383  # one pair of sides is touched


def test_the_seas_grid_lies_on_the_sea(monkeypatch):
    """Heights and normals of its points, where all waves are drawn, are those that the simulation has."""
    monkeypatch.setattr(water, "RIPPLE_SLOPE", 0.0)
    sea = Sea.from_config(SeaConfig(hs=1.0, tp=6.0, components=12, realisations=2), seed=4)
    camera = look([300.0, -200.0, -12.0], heading(2.0, 0.5), 1.2)
    moment = moment_of(make_episode(steps=2), 0.0)._replace(waves=sea.waves_at(17.0, sea=1))
    points = water.water_seen(camera, (640, 480), moment).points.astype(np.float64)
    near = points[points[:, 6] == 0.0]
    assert len(near) > 2000
    place = near[:, :3] + camera.eye_n
    there = sea.surface(place[:, 0], place[:, 1], 17.0, 1)
    assert np.abs(there.elevation.numpy() + place[:, 2]).max() < 5e-3 and there.elevation.std() > 0.1
    assert np.abs(there.normal.numpy() - near[:, 3:6]).max() < 5e-3
