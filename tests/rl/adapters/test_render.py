"""Gymnasium's pictures: what `render` gives, that a rollout does not depend on it, and films by RecordVideo."""

import gymnasium
import matplotlib
import numpy as np
import pytest
from gym_envs import IDS, SHORT, make_vec, rollout, same
from gymnasium.utils.passive_env_checker import env_render_passive_checker

from rl.adapters.render import Pictures, tiled
from rl.missions.escort.mission import Escort
from taichi_sim.visualisation.film.moment import TRAIL_POINTS

USV = IDS[0]


def film_files(folder):
    return sorted(path.name for path in folder.glob("*.mp4"))


def test_a_rollout_has_the_same_bits_with_and_without_pictures():
    plain = rollout(make_vec(USV, num_envs=2), 3)
    seen = make_vec(USV, num_envs=2, render_mode="rgb_array", render_size=(64, 48))
    pictures, step = [], seen.step

    def step_and_look(actions):
        pictures.append(seen.render())
        return step(actions)

    seen.step = step_and_look
    assert same(plain, rollout(seen, 3))
    assert len(pictures) == 14
    for frames in pictures:
        assert isinstance(frames, tuple) and len(frames) == 2
        assert all(frame.shape == (48, 64, 3) and frame.dtype == np.uint8 for frame in frames)
    assert not np.array_equal(*pictures[5])  # two environments
    assert not np.array_equal(pictures[0][0], pictures[5][0])  # it moves
    kept = seen.unwrapped._pictures._trail(0)["usv"]  # episodes last 10 steps, and a trail ends where one begins
    assert 0 < len(kept) <= 5 < TRAIL_POINTS


def test_one_environment_gives_one_picture_a_decision():
    env = gymnasium.make(USV, overrides=SHORT, render_mode="rgb_array")
    assert env.metadata["render_fps"] == 10 and "rgb_array" in env.metadata["render_modes"]
    env.reset(seed=1)
    env_render_passive_checker(env.unwrapped)
    picture = env.render()
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    env.step(env.action_space.sample())
    assert not np.array_equal(picture, env.render())
    env.close()


def test_modes_that_cannot_be_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="'depth'.*'rgb_array', 'human'"):
        make_vec(USV, render_mode="depth")
    with pytest.raises(ValueError, match="64x48"):
        make_vec(USV, render_mode="rgb_array", render_size=(8, 8))
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "agg")
    with pytest.raises(ValueError, match="display.*rgb_array"):
        make_vec(USV, render_mode="human")


def test_pictures_of_many_are_laid_side_by_side():
    frames = tuple(np.full((2, 3, 3), k, np.uint8) for k in range(5))
    page = tiled(frames)
    assert page.shape == (4, 9, 3)
    assert page[::2, ::3, 0].tolist() == [[0, 1, 2], [3, 4, 0]]


@pytest.mark.slow
def test_an_escort_is_seen_as_it_is_now():
    """Each picture draws the environment that it is of, in one frame."""
    env = make_vec(
        USV, num_envs=2, scenario="escort", other="classical", render_mode="rgb_array", render_size=(320, 240),
        overrides=("escort.worlds=4", "sea.realisations=4", "sea.components=6"),
    )  # fmt: skip
    task, pictures = env.unwrapped.task, env.unwrapped._pictures
    assert isinstance(task, Escort) and isinstance(pictures, Pictures)
    env.reset(seed=2)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
        env.render()
    moments = [pictures._moment(k) for k in range(2)]
    assert moments[0].time_s == pytest.approx(3 * task.config.decision_interval)
    assert {overlay.name for overlay in moments[0].overlays} >= {"footprints", "sight lines", "circle"}
    middles = [next(o for o in moment.overlays if o.name == "circle").points_n.mean() for moment in moments]
    assert middles[0] != middles[1]


def test_record_video_writes_films_of_one_and_of_many(tmp_path):
    pytest.importorskip("moviepy")
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    one = gymnasium.make(USV, overrides=SHORT, render_mode="rgb_array", render_size=(160, 120))
    one = gymnasium.wrappers.RecordVideo(one, str(tmp_path / "one"), episode_trigger=lambda episode: True)
    one.reset(seed=1)
    ended = False
    while not ended:
        *_, terminated, truncated, _ = one.step(one.action_space.sample())
        ended = terminated or truncated
    one.close()
    (film,) = film_files(tmp_path / "one")
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "one" / film))
    assert 2 <= frames <= 11 and seconds == pytest.approx(frames / 10)

    many = make_vec(USV, num_envs=3, render_mode="rgb_array", render_size=(160, 120))
    many = gymnasium.wrappers.vector.RecordVideo(many, str(tmp_path / "many"), video_length=6)
    many.reset(seed=1)
    for _ in range(8):
        many.step(many.action_space.sample())
    many.close()
    (film,) = film_files(tmp_path / "many")
    frames, _ = ffmpeg.count_frames_and_secs(str(tmp_path / "many" / film))
    assert frames >= 6
    size = next(ffmpeg.read_frames(str(tmp_path / "many" / film)))["size"]
    assert size[0] % 160 == 0 and size[1] % 120 == 0 and size != (160, 120)
