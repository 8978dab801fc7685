"""Training that is interrupted, killed or run twice at once: it goes on, and nothing is lost."""

import contextlib
import os
import signal
import time
from pathlib import Path

import pytest
from command_line import (
    ITERATIONS,
    TEAMS,
    TIMEOUT,
    TINY,
    Running,
    assert_whole,
    command,
    content,
    forget,
    iterations,
    sets,
)

from rl.learn.policy import checkpoints, policies_of
from rl.learn.stages import train_stages
from rl.runs import folder as run_folder


@pytest.mark.slow
def test_ctrl_c_in_the_first_stage_saves_and_the_run_can_go_on(run):
    forget(run, *TEAMS)
    ending = command("rl.train", "--out", run, "--resume", fault=("usv", 1, signal.SIGINT))
    ending.fails("interrupted", str(run), "--resume", status=130)
    assert checkpoints(run / "usv")[-1].name == "model_2.pt"
    assert iterations(run, "usv") == [0, 1]
    results = train_stages(run_folder.load_config(run)[0], run, show_progress=False)
    assert [result["iterations"] for result in results] == [ITERATIONS] * 2
    for name in TEAMS:
        assert iterations(run, name) == list(range(ITERATIONS))
        assert (run / name / "policy.onnx").is_file()


@pytest.mark.slow
def test_a_run_goes_on_after_ctrl_c_and_after_a_kill(run):
    """Ctrl-C saves the iteration that is done; what is killed goes on from its last checkpoint; the end is whole."""
    forget(run, "uav")
    usv = content(run / "usv")
    ending = command("rl.train", "--out", run, "--resume", fault=("uav", 1, signal.SIGINT))
    ending.fails("interrupted", str(run), "--resume", status=130)
    assert checkpoints(run / "uav")[-1].name == "model_2.pt"
    assert iterations(run, "uav") == [0, 1]
    killed = command("rl.train", "--out", run, "--resume", fault=("uav", 2, signal.SIGKILL))
    assert killed.status == -signal.SIGKILL
    assert checkpoints(run / "uav")[-1].name == "model_2.pt"
    assert iterations(run, "uav") == [0, 1, 2]
    ending = command("rl.train", "--out", run, "--resume")
    assert ending.status == 0, ending.err
    assert_whole(run)
    trained = {name: data for name, data in content(run / "usv").items() if "tfevents" not in name}
    assert trained == {name: data for name, data in usv.items() if "tfevents" not in name}


def test_a_run_killed_before_its_export_is_exported_later(run):
    for name in ("policy.onnx", "policy.pt"):
        (run / "usv" / name).unlink()
    train_stages(run_folder.load_config(run)[0], run, show_progress=False)
    assert (run / "usv" / "policy.onnx").is_file() and (run / "usv" / "policy.pt").is_file()


def wait_for(run: Path, team: str, rows: int) -> None:
    """Wait until a stage is in its middle."""
    begin = time.monotonic()
    while time.monotonic() - begin < TIMEOUT:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            if len(iterations(run, team)) >= rows:
                return
        time.sleep(0.02)
    raise AssertionError(f"{team} does not get to iteration {rows}")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_signals_from_outside_in_both_stages(number, tmp_path):
    out = tmp_path / "run"
    arguments = ["--config", "paper", *sets(*TINY, "stages.usv.iterations=30", "stages.uav.iterations=30")]
    for team in TEAMS:
        running = Running("rl.train", "--out", out, *arguments)
        arguments = ["--resume"]
        wait_for(out, team, 8)
        os.kill(running.process.pid, number)
        ending = running.wait()
        if number == signal.SIGINT:
            ending.fails("--resume", status=130)
        else:
            assert ending.status == -number
    ending = command("rl.train", "--out", out, "--resume")
    assert ending.status == 0, ending.err
    for team in TEAMS:
        assert iterations(out, team) == list(range(30))
    assert (out / "summary.json").is_file()


@pytest.mark.slow
def test_two_runs_at_once_in_two_folders_finish(tmp_path):
    both = [Running("rl.train", "--config", "paper", "--out", tmp_path / name, *sets(*TINY)) for name in "ab"]
    for running, name in zip(both, "ab", strict=True):
        ending = running.wait()
        assert ending.status == 0, ending.err
        assert_whole(tmp_path / name)


@pytest.mark.slow
def test_two_runs_at_once_in_one_folder_one_is_refused(tmp_path):
    both = [Running("rl.train", "--config", "paper", "--out", tmp_path / "run", *sets(*TINY)) for _ in range(2)]
    endings = sorted((running.wait() for running in both), key=lambda ending: ending.status)
    assert endings[0].status == 0, endings[0].err
    endings[1].fails(str(tmp_path / "run"))
    assert_whole(tmp_path / "run")


def test_evaluating_a_run_still_in_training_uses_what_there_is(run):
    forget(run, "uav")
    config, _ = run_folder.load_config(run)
    assert set(policies_of("policy", run, config)) == {"usv"}
