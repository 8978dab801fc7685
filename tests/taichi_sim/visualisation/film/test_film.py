"""Moments and films of an episode: what is interpolated, what is seen, what is refused, and that a file is whole."""

import builtins
import dataclasses

import numpy as np
import pytest
from PIL import Image
from recorded import make_episode

from taichi_sim.errors import MissingExtraError
from taichi_sim.visualisation.film import FilmError, Picture, check_film, moment_of, write_film
from taichi_sim.visualisation.film.camera import FollowRig
from taichi_sim.visualisation.film.files import film_times
from taichi_sim.visualisation.film.moment import TRAIL_S
from taichi_sim.visualisation.film.picture import room_at_decks
from taichi_sim.visualisation.recording.east_north_up import euler
from taichi_sim.visualisation.recording.episode import Platform
from taichi_sim.visualisation.recording.overlays import Lines

TINY = {"size": (160, 120), "fps": 10.0}


def frames_of(path):
    picture = Image.open(path)
    return getattr(picture, "n_frames", 1), picture.size


def test_a_moment_is_between_its_steps():
    episode = make_episode(steps=60)
    track, share = episode.teams["uav"], 0.25
    moment = moment_of(episode, episode.time_s[20] + share * 0.1)
    team = moment.teams["uav"]
    expected = (1 - share) * track.position_n[20] + share * track.position_n[21]
    np.testing.assert_allclose(team.position_n, expected, atol=1e-9)
    turned = np.stack(euler(team.quaternion_nb))
    one, other = np.stack(euler(track.quaternion_nb[20])), np.stack(euler(track.quaternion_nb[21]))
    np.testing.assert_allclose(turned, (1 - share) * one + share * other, atol=1e-4)
    assert np.array_equal(team.trail_n[-1], team.position_n)
    early, late = (moment_of(episode, time).teams["uav"].position_n for time in (-5.0, 1e6))
    assert np.array_equal(early, track.position_n[0]) and np.array_equal(late, track.position_n[-1])


def test_attitudes_take_the_shorter_way_and_trails_break_where_a_vehicle_was_put_elsewhere():
    episode = make_episode(steps=40)
    track = episode.teams["usv"]
    signs = np.where(np.arange(40) % 2, -1.0, 1.0)[:, None, None]  # the same attitudes
    place = track.position_n + np.where(np.arange(40) < 30, 0.0, 500.0)[:, None, None]
    other = dataclasses.replace(track, quaternion_nb=signs * track.quaternion_nb, position_n=place)
    moved = dataclasses.replace(episode, teams={**episode.teams, "usv": other})
    time = episode.time_s[35] + 0.05
    a, b = (moment_of(e, time).teams["usv"] for e in (episode, moved))
    np.testing.assert_allclose(np.stack(euler(a.quaternion_nb)), np.stack(euler(b.quaternion_nb)), atol=1e-9)
    broken = np.isnan(b.trail_n).any(axis=(1, 2))
    assert broken.sum() == 1 and not np.isnan(a.trail_n).any()
    assert len(a.trail_n) <= TRAIL_S / 0.1 + 2


def test_overlays_are_of_one_frame_and_what_vanishes_stays_until_the_next_step():
    episode = make_episode(steps=4)
    points = np.zeros((4, 2, 2, 3))
    points[1] = 2.0
    points[1, 1] = np.nan
    lines = Lines(name="sight", colour=(1, 2, 3), points_n=points)
    (shown,) = moment_of(dataclasses.replace(episode, overlays=(lines,)), 0.05).overlays
    assert shown.points_n.shape == (1, 2, 2, 3)
    assert shown.points_n[0, :, 0, 0].tolist() == [1.0, 0.0]


def test_a_picture_shows_every_teams_colours_waves_and_a_horizon():
    episode = make_episode(steps=60)
    moment = moment_of(episode, 5.0)
    picture = Picture(moment, (640, 480)).paint(moment)
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    colours = {tuple(pixel) for pixel in np.unique(picture.reshape(-1, 3), axis=0).tolist()}
    for livery in episode.liveries.values():
        assert {livery.of(0), livery.of(1), livery.of(2)} <= colours
    sea = picture[300:460, 20:380].astype(int)
    assert sea[..., 2].mean() > sea[..., 0].mean() + 30 and sea[..., 1].std() > 3  # blue, and not flat
    assert picture[4, 200, 2] > 180  # the sky


def test_nothing_stands_between_the_camera_and_whom_it_follows():
    episode = make_episode(steps=60)
    moment = moment_of(episode, 5.0)
    eye = FollowRig("usv").camera(moment, 4 / 3).eye_n
    between = np.array([[*(0.5 * (eye + moment.teams["usv"].position_n.mean(axis=0)))[:2], 4.0, 30.0]])
    hidden = moment._replace(scene=dataclasses.replace(moment.scene, obstacles=between))
    picture = Picture(hidden, (640, 480), view="usv").paint(hidden)
    colours = {tuple(pixel) for pixel in np.unique(picture.reshape(-1, 3), axis=0).tolist()}
    assert {episode.liveries["usv"].of(vehicle) for vehicle in range(3)} <= colours


def test_over_a_deck_nobody_is_drawn_larger_than_there_is_room():
    episode = make_episode(steps=4)
    assert not room_at_decks(moment_of(episode, 0.0))  # there is no deck
    boats = dataclasses.replace(episode.teams["usv"], deck=Platform((0.0, 0.0, -1.0), (1.0, 0.5)))
    teams = {**episode.teams, "usv": boats}
    place = teams["uav"].position_n.copy()
    place[:, 0] = boats.position_n[:, 0] + (0.0, 0.0, -1.1)  # 0.1 m above the first deck, of a boat that hardly leans
    for above, (low, high) in ((False, (1.0, 1e3)), (True, (0.0, 0.5))):
        teams["uav"] = dataclasses.replace(teams["uav"], position_n=place) if above else teams["uav"]
        room = room_at_decks(moment_of(dataclasses.replace(episode, teams=teams), 0.0))
        assert set(room) == {"usv", "uav"} and all(low < metres < high for metres in room.values()), room


def test_a_state_that_is_not_finite_leaves_the_last_picture():
    moment = moment_of(make_episode(steps=5), 0.2)
    lost = moment.teams["uav"]._replace(position_n=np.full((3, 3), np.nan))
    picture = Picture(moment, (64, 48))
    seen = picture.paint(moment)
    assert np.array_equal(picture.paint(moment._replace(teams={**moment.teams, "uav": lost})), seen)


def test_a_film_holds_its_frames_and_nothing_else_is_left(tmp_path):
    episode = make_episode(steps=9)  # 0.8 s
    assert len(film_times([episode], 10.0, 1.0)) == 9 and len(film_times([episode], 10.0, 2.0)) == 5
    for suffix in (".png", ".gif", ".webp"):
        path = write_film(episode, tmp_path / f"film{suffix}", **TINY, speed=2.0)
        assert frames_of(path) == (5, (160, 120))
    both = {"before": make_episode(steps=5), "after": episode}  # the last moment of the shorter one stays
    path = write_film(both, tmp_path / "both.webp", **TINY, speed=2.0)
    assert frames_of(path) == (5, (160, 120))
    assert {path.name for path in tmp_path.iterdir()} == {"film.png", "film.gif", "film.webp", "both.webp"}


def test_an_mp4_is_read_back(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = write_film(make_episode(steps=8), tmp_path / "film.mp4", **TINY)
    assert ffmpeg.count_frames_and_secs(str(path)) == (8, pytest.approx(0.8))
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("suffix", [".mp4", ".png"])
def test_an_interrupted_film_leaves_nothing(tmp_path, monkeypatch, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    paint, painted = Picture.paint, []

    def fall(self, moment, *words):
        painted.append(moment.time_s)
        if moment.time_s > 0.4:
            raise KeyboardInterrupt
        return paint(self, moment, *words)

    monkeypatch.setattr(Picture, "paint", fall)
    with pytest.raises(KeyboardInterrupt):
        write_film(make_episode(steps=8), tmp_path / f"film{suffix}", **TINY)
    assert painted and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "how", "words"),
    [
        ("film.avi", {}, ("film.avi", ".mp4, .png")),
        ("film.mp4", {"size": (161, 120)}, ("161x120", "even")),
        ("film.gif", {"size": (16, 12)}, ("16x12", "64x48")),
        ("film.gif", {"view": "sky"}, ("'sky'", "overview, map, usv, uav")),
        ("film.gif", {"fps": 0.0}, ("fps = 0", "240")),
        ("nowhere/film.gif", {}, ("no such folder",)),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_is_drawn(tmp_path, monkeypatch, name, how, words):
    monkeypatch.setattr(Picture, "paint", None)
    with pytest.raises((FilmError, OSError)) as fault:
        write_film(make_episode(steps=3), tmp_path / name, **{**TINY, **how})
    assert all(word in str(fault.value) for word in words)
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    known = builtins.__import__

    def without(name, *args, **options):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return known(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"taichi-sim\[film\]"):
        check_film(tmp_path / "film.mp4")
    assert check_film(tmp_path / "film.gif") == tmp_path / "film.gif"
