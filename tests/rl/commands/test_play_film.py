"""`taichi-sim play --film`: a film instead of a recording, or both; what cannot be is told before anything is
simulated."""

import pytest
from PIL import Image

from rl.evaluation import episode_recording

SMALL = ("--duration", "0.4", "--film-size", "64x48", "--film-fps", "5")


def test_a_film_takes_the_recordings_place_unless_both_are_wanted(run, tmp_path, here):
    before = set(run.iterdir())
    film = tmp_path / "film.gif"
    ending = here("rl.commands.play", run, "--film", film, *SMALL)
    assert ending.status == 0, ending.err
    assert ending.out.splitlines()[-1] == f"film: {film}"
    assert set(run.iterdir()) == before
    assert (Image.open(film).n_frames, Image.open(film).size) == (2, (64, 48))
    ending = here("rl.commands.play", run, "--film", film, "--out", tmp_path / "both.rrd", *SMALL)
    assert ending.status == 0 and (tmp_path / "both.rrd").is_file(), ending.err


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("--film", "film.avi"), 1, ("film.avi", ".webp")),
        (("--film", "film.gif", "--film-view", "sky"), 1, ("'sky'", "usv")),
        (("--film-fps", "30"), 1, ("--film-fps", "no --film FILE")),
        (("--film", "film.gif", "--film-size", "640"), 2, ("640", "1280x720")),
    ],
)
def test_what_cannot_be_filmed_is_told_before_anything_is_simulated(
    run, tmp_path, monkeypatch, here, arguments, status, words
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(episode_recording, "record_episode", None)
    here("rl.commands.play", run, *arguments).fails(*words, status=status)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
