"""Run folders that exist, are in use, cannot be written or are full: a clear message, and nothing is lost."""

import contextlib
import json
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from command_line import TEAMS, TINY, command, content, forget, sets

from rl.evaluation import store
from rl.runs import folder as run_folder
from rl.train import parser
from taichi_sim.config.io import config_folder


def test_a_run_folder_that_exists_is_left_alone(here, run):
    before = content(run)
    here("rl.train", "--config", "paper", "--out", run, *sets(*TINY)).fails(str(run), "exists already", "--resume")
    assert content(run) == before


def test_a_file_in_the_folders_place_is_left_alone(here, tmp_path):
    (tmp_path / "run").write_text("mine")
    here("rl.train", "--config", "paper", "--out", tmp_path / "run", *sets(*TINY)).fails("exists already")
    here("rl.train", "--config", "paper", "--out", tmp_path / "run" / "below", *sets(*TINY)).fails("cannot be written")
    assert (tmp_path / "run").read_text() == "mine"


@pytest.mark.parametrize("change", [["--set", "usv.count=2"], ["--seed", "3"], ["--config", "configs/paper.toml"]])
def test_a_run_is_not_continued_with_other_settings(change, here, run):
    before = content(run)
    here("rl.train", "--out", run, "--resume", *change).fails("--resume", "leave out")
    assert content(run) == before


def test_nothing_to_continue_is_named(here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here("rl.train", "--resume").fails("no run to continue", "--out")
    here("rl.train", "--resume", "--out", "gone").fails("gone", "not a run folder")


def test_what_was_begun_with_other_versions_is_told_of(run):
    assert run_folder.other_versions(run) == ""
    meta = json.loads((run / run_folder.META).read_text())
    meta["packages"]["torch"] = "1.0"
    (run / run_folder.META).write_text(json.dumps(meta))
    assert run_folder.other_versions(run).startswith("this run was begun with torch 1.0 (now ")


def test_wrong_overrides_are_not_the_saved_files_fault(here, run):
    ending = here("rl.commands.evaluate", run, "--set", "sea.swell.tp=7")
    ending.fails("sea.swell.hs: missing")
    assert "does not fit this version" not in ending.err
    here("rl.commands.evaluate", run, "--set", "evaluation.settle=3", "--set", "episode_duration=3").fails(
        "must exceed"
    )


def test_a_folder_in_use_is_refused(here, run):
    before = content(run)
    with run_folder.lock(run):
        here("rl.train", "--out", run, "--resume").fails(str(run), "another process")
    assert content(run) == before


def test_a_configuration_that_no_longer_parses_can_be_replaced(here, run):
    file = run / "config.toml"
    file.write_text(file.read_text().replace("spacing", "gap"))
    for module in ("rl.commands.evaluate", "rl.commands.play"):
        here(module, run).fails(str(file), "usv.gap", "uav.gap", "--config")
    ending = here("rl.commands.evaluate", run, "--config", config_folder() / "paper.toml", *sets(*TINY))
    assert ending.status == 0, ending.err
    assert set(json.loads(ending.out)["teams"]) == set(TEAMS)


def test_a_policy_that_corrected_nobody_corrects_nobody(here, run):
    file, fast = run / "config.toml", ("--episodes", "1")
    file.write_text(file.read_text() + "\n[usv.residual]\n")
    ending = here("rl.commands.evaluate", run, *fast, "--set", "usv.residual.velocity=0")
    assert ending.status == 0 and "classical controller acts" not in ending.err, ending.err
    here("rl.commands.evaluate", run, *fast, "--set", "usv.residual.velocity=1").fails(
        "its observations differ", "'reference'"
    )


@contextlib.contextmanager
def mounted(folder: Path, options: str):
    """Mount a small file system in memory; skip the test where that is not allowed."""
    folder.mkdir(exist_ok=True)
    if (
        not shutil.which("mount")
        or subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True).returncode
    ):
        pytest.skip("no file system may be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_read_only_folder_is_named(here, tmp_path):
    with mounted(tmp_path / "disk", "size=64k,ro") as disk:
        here("rl.train", "--config", "paper", "--out", disk / "run", *sets(*TINY)).fails(str(disk), "cannot be written")


def test_a_full_disk_is_named(tmp_path):
    with mounted(tmp_path / "disk", "size=48k") as disk:
        command("rl.train", "--config", "paper", "--out", disk / "run", *sets(*TINY)).fails("No space left on device")
        assert (disk / "run" / "config.toml").stat().st_size


def test_a_disk_full_in_stage_two_keeps_stage_one(run, tmp_path):
    with mounted(tmp_path / "disk", "size=2m") as disk:
        half = Path(shutil.copytree(forget(run, "uav"), disk / "run"))
        before = content(half / "usv")
        free = shutil.disk_usage(disk).free
        (disk / "filler").write_bytes(b"x" * (free - 40_000))
        command("rl.train", "--out", half, "--resume").fails("No space left on device")
        assert content(half / "usv") == before
        assert all(file.stat().st_size > 10_000 for file in half.glob("uav/model_*.pt"))
        assert not (half / "summary.json").exists()


def test_an_evaluation_that_cannot_be_written_says_so(here, run, tmp_path):
    (tmp_path / "file").write_text("")
    for module, option, name in (("rl.commands.evaluate", "--json", "a.json"), ("rl.commands.play", "--film", "a.gif")):
        place = tmp_path / "file" / name
        here(module, run, option, place).fails(option, str(place), "Not a directory", status=2)  # before any episode
    here("rl.commands.play", run, "--out", tmp_path / "file" / "a.rrd").fails("cannot be written", "Not a directory")


def test_commands_for_a_user_to_paste_bear_a_space(run, tmp_path):
    place = Path("my runs") / "it's"
    words = shlex.split(run_folder.resuming(place))
    assert words[0] == "taichi-sim" and Path(parser().parse_args(words[2:]).out) == place
    shutil.copytree(run, tmp_path / "my run")
    with pytest.raises(run_folder.RunError) as fault:
        store.shown_episode(tmp_path / "my run", "oracle", "worst")
    line = str(fault.value).partition("with: ")[2]
    assert shlex.split(line) == ["taichi-sim", "evaluate", str(tmp_path / "my run"), "--controller", "oracle"]
