"""The main job's own scenario, tiny, from training to recording and report; and what is measured of cooperation."""

import json

import numpy as np
import pytest
from command_line import command, sets

from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario
from rl.runs.record import record_episode
from taichi_sim.recording.overlays import Lines, Plot

TINY = (
    "escort.worlds=4", "sea.realisations=4", "sea.components=6", "episode_duration=3", "evaluation.episodes=3",
    *(f"stages.{stage}.{key}" for stage in ("boats", "aircraft", "boats_again")
      for key in ("iterations=2", "num_envs=4", "steps_per_iteration=4", "set={}")),
)  # fmt: skip


@pytest.mark.slow
def test_the_main_job_trains_both_teams_and_shows_them(tmp_path):
    run = tmp_path / "run"
    ending = command("rl.train", "--out", run, *sets(*TINY))
    assert ending.status == 0, ending.err
    assert "never" in ending.out and "camera" in ending.out
    summary = json.loads((run / "summary.json").read_text())
    assert [(s["name"], s["team"]) for s in summary["stages"]] == [
        ("boats", "usv"), ("aircraft", "uav"), ("boats_again", "usv"),
    ]  # fmt: skip
    assert {p.name for p in (run / "usv").glob("model_*.pt")} >= {"model_2.pt", "model_4.pt"}
    assert {p.name for p in (run / "figures").iterdir()} == {
        "scene.png", "approach.png", "reward.png", "policy_loss.png",
    }  # fmt: skip
    assert "2 + 2 iterations" in (run / "report.html").read_text()
    assert (run / "episode.rrd").stat().st_size > 10_000
    first = command("tools.cooperation", run, "--episodes", "3", "--only", "cooperating")
    assert first.status == 0, first.err
    assert "| classical both, cooperating |" in first.out
    kept = list((run / "cooperation").glob("*.npz"))
    assert len(kept) == 1
    again = command("tools.cooperation", run, "--episodes", "3", "--only", "cooperating")
    assert again.out == first.out and list((run / "cooperation").glob("*.npz")) == kept


def test_a_recording_shows_who_sees_and_tells_what():
    """Every aircraft's messages to every boat are drawn, arrived or lost, and end there."""
    config = load_scenario("escort", TINY)
    policies = {name: ClassicalPolicy() for name in ("usv", "uav")}
    episode = record_episode(config, policies, seed=3, duration=6.0)
    assert set(episode.teams) == {"usv", "uav", "vessel"}
    drawn = {overlay.name: overlay for overlay in episode.overlays}
    arrived, lost = drawn["messages/arrived"], drawn["messages/lost"]
    assert isinstance(arrived, Lines) and isinstance(lost, Lines)
    there = [np.isfinite(lines.points_n[..., 0, 0]) for lines in (arrived, lost)]
    assert there[0].shape[1] == 9 and not (there[0] & there[1]).any()
    assert (there[0] | there[1])[2:].all()  # each is one or the other, from the first that could be there on
    assert 0.02 < there[1][2:].mean() < 0.25  # a tenth is lost
    boats = episode.teams["usv"].position_n
    ends = arrived.points_n[:, ::3, -1]  # of the first aircraft's, at each boat
    seen = np.isfinite(ends[..., 0])
    np.testing.assert_allclose(ends[seen], boats[seen], atol=1e-3)
    prints = drawn["footprints"]
    assert isinstance(prints, Lines) and np.nanmax(np.abs(prints.points_n[..., 2])) == 0.0
    ages = drawn["age of what is known of the vessel"]
    assert isinstance(ages, Plot) and ages.lines == ("usv0", "usv1", "usv2", "uav0", "uav1", "uav2")
