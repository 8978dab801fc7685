"""The escort, tiny, from training to recording and report; and what is measured of cooperation."""

import json

import pytest
from command_line import command, sets

TINY = (
    "escort.worlds=4", "sea.realisations=4", "sea.components=6", "episode_duration=3", "evaluation.episodes=3",
    *(f"stages.{stage}.{key}" for stage in ("boats", "aircraft", "boats_again")
      for key in ("iterations=2", "num_envs=4", "steps_per_iteration=4", "set={}")),
)  # fmt: skip


@pytest.mark.slow
def test_a_run_trains_both_teams_and_shows_them(tmp_path):
    run = tmp_path / "run"
    ending = command("rl.train", "--config", "escort", "--out", run, *sets(*TINY))
    assert ending.status == 0, ending.err
    assert "never" in ending.out and "camera" in ending.out
    summary = json.loads((run / "summary.json").read_text())
    assert [(s["name"], s["team"]) for s in summary["stages"]] == [
        ("boats", "usv"), ("aircraft", "uav"), ("boats_again", "usv"),
    ]  # fmt: skip
    assert {p.name for p in (run / "usv").glob("model_*.pt")} >= {"model_2.pt", "model_4.pt"}
    assert {p.name for p in (run / "figures").iterdir()} == {
        "scene.png", "approach.png", "reward.png", "policy_loss.png", "checkups.png",
    }  # fmt: skip
    assert "uav: 2 iterations" in (run / "report.html").read_text()
    assert (run / "episode.rrd").stat().st_size > 10_000
    first = command("tools.cooperation", run, "--episodes", "3", "--only", "cooperating")
    assert first.status == 0, first.err
    assert "| classical both, cooperating |" in first.out
    kept = list((run / "cooperation").glob("*.npz"))
    assert len(kept) == 1
    again = command("tools.cooperation", run, "--episodes", "3", "--only", "cooperating")
    assert again.out == first.out and list((run / "cooperation").glob("*.npz")) == kept
