"""The commands as a user meets them: bad input, faults and interruptions end in a clear message and lose nothing.

Commands run in processes of their own, forked from a server that has imported the packages; `tiny_run` is one real
call of the script, shared by this file and test_training.py.
"""

import atexit
import contextlib
import csv
import dataclasses
import functools
import importlib
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path

import pytest
import torch

from rl import cli, run_folder
from rl.controllers import controllers
from rl.definitions import DEFINITIONS
from rl.main_job import report
from rl.policy import checkpoints
from rl.stages import train_stages
from taichi_sim import runtime
from taichi_sim.config import ScenarioConfig
from taichi_sim.config_io import config_folder, load_scenario

ROOT = Path(__file__).resolve().parents[2]
ITERATIONS = 4
CHECKPOINT_INTERVAL = 2  # checkpoints after iterations 1, 3 and 4
TINY = (
    *(
        f"stages.{team}.{setting}"
        for team in ("usv", "uav")
        for setting in (
            f"iterations={ITERATIONS}",
            "num_envs=8",
            "steps_per_iteration=8",
            f"checkpoint_interval={CHECKPOINT_INTERVAL}",
        )
    ),
    "track.worlds=4",
    "sea.realisations=4",
    "episode_duration=3",
    "evaluation.episodes=4",
    "evaluation.settle=1",
)
TEAMS = ("usv", "uav")
TIMEOUT = 180  # s


def sets(*overrides: str) -> list[str]:
    """Return `overrides` as --set arguments."""
    return [word for text in overrides for word in ("--set", text)]


# -- running commands ---------------------------------------------------------------------------------------


@dataclasses.dataclass
class Ending:
    """How a command ended."""

    status: int
    out: str
    err: str

    def fails(self, *words: str, status: int = 1) -> None:
        """Assert a clear failure whose message holds all `words`."""
        assert self.status == status, (self.status, self.err)
        assert "Traceback" not in self.err, self.err
        assert "error: " in self.err or status == 130
        for word in words:
            assert word in self.err, self.err


@functools.cache
def server():
    """Return the context whose processes begin with everything imported."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["rl.main_job", "rl.train", "rl.evaluate", "rl.play", "rl.controllers"])
    return context


class Running:
    """A command in a process of its own; `fault` = (team, iteration, signal) hits it right after that iteration."""

    def __init__(self, module: str, *arguments: object, fault: tuple[str, int, int] | None = None):
        self.folder = Path(tempfile.mkdtemp())
        arguments = tuple(map(str, (*arguments, "--quiet")))
        if "--threads" not in arguments:
            arguments += ("--threads", "1")
        self.process = server().Process(target=_child, args=(module, arguments, str(self.folder), fault))
        self.process.start()

    def wait(self) -> Ending:
        self.process.join(TIMEOUT)
        assert self.process.exitcode is not None, "the command hangs"
        texts = [(self.folder / name).read_text() if (self.folder / name).exists() else "" for name in ("out", "err")]
        shutil.rmtree(self.folder)
        return Ending(self.process.exitcode, *texts)


def _child(module: str, arguments: tuple[str, ...], folder: str, fault: tuple[str, int, int] | None) -> None:
    for descriptor, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(Path(folder, name), os.O_WRONLY | os.O_CREAT, 0o600), descriptor)
    if fault:
        _plan(*fault)
    sys.exit(cli.run(importlib.import_module(module).main, list(arguments)))


def _plan(team: str, iteration: int, number: int) -> None:
    from rl.runner import ProgressLogger

    original = ProgressLogger.log

    def log(self, it, *args, **values):
        original(self, it, *args, **values)
        if it == iteration and Path(self.log_dir).name == team:
            os.kill(os.getpid(), number)

    ProgressLogger.log = log


def command(module: str, *arguments: object, fault=None) -> Ending:
    """Run a command to its end."""
    return Running(module, *arguments, fault=fault).wait()


@pytest.fixture
def here(capsys):
    """Return a function that runs a command in this process: enough for messages."""

    def run(module: str, *arguments: object) -> Ending:
        capsys.readouterr()
        main = importlib.import_module(module).main
        try:
            status = cli.run(main, [*map(str, arguments), "--quiet", "--threads", "1"])
        except SystemExit as ending:
            status = int(ending.code or 0)
        except Exception:  # what a user would see of it
            status = 1
            traceback.print_exc()
        return Ending(status, *capsys.readouterr())

    return run


@functools.cache
def tiny_run() -> Path:
    """Return the folder of one whole tiny main job, run by the script; not to be changed."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    script = [sys.executable, str(ROOT / "rl" / "train.py"), "--out", "run", "--threads", "1", *sets(*TINY)]
    done = subprocess.run(script, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    assert "summary.json" in done.stdout and "episode.rrd" in done.stdout
    assert "stage 2/2 uav" in done.stderr  # progress
    return folder / "run"


def tiny_config() -> ScenarioConfig:
    return load_scenario("paper", TINY)


@pytest.fixture(scope="module", autouse=True)
def _restore():
    threads = torch.get_num_threads()
    runtime.init(threads=1)
    yield
    torch.set_num_threads(threads)
    runtime.init()


@pytest.fixture
def run(tmp_path) -> Path:
    """Return a copy of the tiny run."""
    return Path(shutil.copytree(tiny_run(), tmp_path / "run"))


def forget(run: Path, *teams: str) -> Path:
    """Take a run back to before `teams` were trained."""
    for name in (*teams, "figures"):
        shutil.rmtree(run / name)
    for name in ("summary.json", "episode.rrd"):
        (run / name).unlink()
    return run


def content(folder: Path) -> dict[str, bytes]:
    """Return every file but the lock, which any command may touch."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != ".lock"
    }


def iterations(run: Path, team: str) -> list[int]:
    with (run / team / "progress.csv").open(newline="") as file:
        return [int(row["iteration"]) for row in csv.DictReader(file)]


def assert_whole(run: Path) -> None:
    """Assert that a run is finished and has each iteration once."""
    for team in TEAMS:
        assert iterations(run, team) == list(range(ITERATIONS))
        assert checkpoints(run / team)[-1].name == f"model_{ITERATIONS}.pt"
        assert (run / team / "policy.onnx").is_file() and (run / team / "policy.pt").is_file()
    summary = json.loads((run / "summary.json").read_text())
    assert [stage["iterations"] for stage in summary["stages"]] == [ITERATIONS] * 2
    assert (run / "episode.rrd").is_file() and list((run / "figures").glob("*.png"))
    assert not list(run.rglob("*.part*"))


# -- bad input ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("usv.cuont=5", ("usv.cuont", "did you mean 'count'")),
        ("storm.hs=1", ("storm", "unknown key")),
        ("usv.count=many", ("usv.count", "'many'")),
        ("usv.count=0", ("usv.count = 0", "greater than or equal to 1")),
        ("sea.tp=nan", ("sea.tp",)),
        ("usv.count", ("usv.count", "KEY=VALUE")),
        ("=3", ("KEY=VALUE",)),
        ("usv..count=3", ("usv..count=3", "KEY=VALUE")),
        ("seed.x=3", ("seed is a value",)),
        ("usv.vehicle=submarine", ("submarine", "unity_boat")),
        ("usv.vehicle=/nowhere/boat.toml", ("/nowhere/boat.toml", "no such vehicle file")),
        ("stages.usv.team=tug", ("stages.usv.team", "'tug'")),
    ],
)
def test_a_wrong_key_or_value_is_named_and_nothing_is_made(override, words, here, tmp_path):
    here("rl.train", "--out", tmp_path / "new", "--set", override).fails(*words)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "x"\n[usv\n', ("not valid TOML", "line 2")),
        ('name = "x"\n', ("usv: missing", "uav: missing")),
        ("\xff\xfe", ("cannot be read",)),
        ("", ("name: missing",)),
    ],
)
def test_a_malformed_scenario_is_named(text, words, here, tmp_path):
    (tmp_path / "mine.toml").write_bytes(text.encode("latin-1"))
    here("rl.train", "--config", tmp_path / "mine.toml", "--out", tmp_path / "new").fails("mine.toml", *words)
    assert not (tmp_path / "new").exists()


def test_a_missing_scenario_is_named_with_those_there_are(here, tmp_path):
    ending = here("rl.train", "--config", tmp_path / "gone.toml", "--out", tmp_path / "new")
    ending.fails("gone.toml", "no such configuration file", "paper")


def test_an_episode_too_short_to_judge_is_refused_before_training(here, tmp_path):
    ending = here("rl.train", "--out", tmp_path / "new", *sets(*TINY, "evaluation.settle=3"))
    ending.fails("episode_duration", "evaluation.settle")
    assert not list(tmp_path.rglob("*.pt"))


def test_a_scenario_without_stages_is_refused(here, tmp_path):
    paper = (config_folder() / "paper.toml").read_text()
    (tmp_path / "mine.toml").write_text(
        "\n".join(line for line in paper.split("[stages.usv]")[0].splitlines()) + "\n"
    )
    here("rl.train", "--config", tmp_path / "mine.toml", "--out", tmp_path / "new").fails("stages", "nothing to train")


def test_a_sea_too_steep_is_refused(here, tmp_path):
    ending = here("rl.train", "--out", tmp_path / "new", *sets(*TINY, "sea.hs=10"))
    ending.fails("too steep", "sea.hs")


@pytest.mark.parametrize("arguments", [["--threads", "0"], ["--seed", "-1"], ["--seed", "x"], ["--what"], ["word"]])
def test_bad_arguments_are_refused(arguments, here):
    ending = here("rl.train", *arguments)
    assert ending.status == 2 and "usage:" in ending.err
    assert arguments[0] in ending.err


@pytest.mark.parametrize("module", ["rl.evaluate", "rl.play"])
def test_what_is_not_a_run_is_named(module, here, tmp_path):
    here(module, tmp_path / "gone").fails("gone", "not a run folder")
    here(module, tmp_path).fails(str(tmp_path), "not a run folder")


def test_evaluate_help_defines_every_figure():
    from rl.evaluate import parser

    text = parser().format_help()
    for key, definition in DEFINITIONS.items():
        assert f"{key}:" in text and definition in text


def test_the_script_itself_ends_with_the_message_and_status(tmp_path):
    script = [sys.executable, str(ROOT / "rl" / "train.py"), "--set", "usv.cuont=5"]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, timeout=TIMEOUT)
    Ending(done.returncode, done.stdout, done.stderr).fails("usv.cuont")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["evaluate", "play"])
def test_the_other_scripts_end_with_the_message_and_status(name, tmp_path):
    script = [sys.executable, str(ROOT / "rl" / f"{name}.py"), "gone"]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, timeout=TIMEOUT)
    Ending(done.returncode, done.stdout, done.stderr).fails("not a run folder")


def test_a_team_without_measured_time_is_reported():
    nothing = dict.fromkeys(DEFINITIONS, None) | {"collision_free_episodes": 0.5, "success_rate": 0.0}
    text = report({"episodes": 2, "controller": "policy", "teams": {"usv": nothing}})
    assert "usv" in text and "50.0 %" in text


# -- run folders --------------------------------------------------------------------------------------------


def test_a_run_folder_that_exists_is_left_alone(here, run):
    before = content(run)
    here("rl.train", "--out", run, *sets(*TINY)).fails(str(run), "exists already", "--resume")
    assert content(run) == before


def test_a_file_in_the_folders_place_is_left_alone(here, tmp_path):
    (tmp_path / "run").write_text("mine")
    here("rl.train", "--out", tmp_path / "run", *sets(*TINY)).fails("exists already")
    here("rl.train", "--out", tmp_path / "run" / "below", *sets(*TINY)).fails("cannot be written")
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


def test_a_folder_in_use_is_refused(here, run):
    before = content(run)
    with run_folder.lock(run):
        here("rl.train", "--out", run, "--resume").fails(str(run), "another process")
    assert content(run) == before


def test_a_configuration_that_no_longer_parses_can_be_replaced(here, run):
    file = run / "config.toml"
    file.write_text(file.read_text().replace("spacing", "gap"))
    for module in ("rl.evaluate", "rl.play"):
        here(module, run).fails(str(file), "usv.gap", "uav.gap", "--config")
    ending = here("rl.evaluate", run, "--config", config_folder() / "paper.toml", *sets(*TINY))
    assert ending.status == 0, ending.err
    assert set(json.loads(ending.out)["teams"]) == set(TEAMS)


@contextlib.contextmanager
def mounted(folder: Path, options: str):
    """Mount a small file system in memory; skip the test where that is not allowed."""
    folder.mkdir(exist_ok=True)
    if not shutil.which("mount") or subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True
    ).returncode:
        pytest.skip("no file system may be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_read_only_folder_is_named(here, tmp_path):
    with mounted(tmp_path / "disk", "size=64k,ro") as disk:
        here("rl.train", "--out", disk / "run", *sets(*TINY)).fails(str(disk), "cannot be written")


def test_a_full_disk_is_named(tmp_path):
    with mounted(tmp_path / "disk", "size=48k") as disk:
        command("rl.train", "--out", disk / "run", *sets(*TINY)).fails("No space left on device")
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
    ending = here("rl.evaluate", run, "--json", tmp_path / "file" / "out.json")
    ending.fails(str(tmp_path / "file"))


# -- checkpoints --------------------------------------------------------------------------------------------


class Malice:
    """Pickles to something that makes a file when it is loaded."""

    def __init__(self, marker: Path):
        self.marker = marker

    def __reduce__(self):
        return os.system, (f"touch {self.marker}",)


def put(run: Path, what: str, marker: Path) -> Path:
    """Put a bad checkpoint where the newest one of the USV team would be."""
    good, file = checkpoints(run / "usv")[-1], run / "usv" / "model_99.pt"
    if what == "half":
        file.write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    elif what == "empty":
        file.write_bytes(b"")
    elif what == "malicious":
        torch.save({"actor_state_dict": Malice(marker), "iter": 99}, file)
    elif what == "malicious pickle":
        file.write_bytes(pickle.dumps(Malice(marker), protocol=2))
    elif what == "something else":
        torch.save({"weights": torch.zeros(3)}, file)
    elif what == "a list":
        torch.save([1, 2], file)
    return file


@pytest.mark.parametrize("what", ["half", "empty", "malicious", "malicious pickle", "something else", "a list"])
def test_a_bad_checkpoint_is_named_and_executes_nothing(what, here, run, tmp_path):
    file = put(run, what, tmp_path / "marker")
    before = content(run)
    here("rl.evaluate", run).fails(str(file), "checkpoint")
    here("rl.play", run).fails(str(file), "checkpoint")
    here("rl.train", "--out", run, "--resume").fails(str(file), "checkpoint")
    assert not (tmp_path / "marker").exists()
    assert content(run) == before


def test_a_checkpoint_of_another_network_is_named(here, run):
    config = run / "config.toml"
    config.write_text(config.read_text().replace("64,\n    64,", "32,\n    32,"))
    here("rl.evaluate", run).fails("model_4.pt", "network")


def test_policies_of_other_observations_are_refused(here, run):
    here("rl.evaluate", run, "--set", "sensing.obstacles=5").fails("observations", "trained on")


def spoil(checkpoint: Path) -> None:
    """Make every weight of an actor NaN."""
    saved = torch.load(checkpoint, weights_only=True)
    for tensor in saved["actor_state_dict"].values():
        if tensor.is_floating_point():
            tensor.fill_(float("nan"))
    torch.save(saved, checkpoint)


def test_a_policy_that_acts_nan_is_named(here, run):
    spoil(checkpoints(run / "usv")[-1])
    here("rl.evaluate", run).fails("finite")
    here("rl.play", run).fails("finite")


def test_training_that_has_diverged_is_named_and_nothing_is_lost(here, run):
    forget(run)
    checkpoints(run / "uav")[-1].unlink()
    spoil(checkpoints(run / "uav")[-1])
    before = {file: file.read_bytes() for file in run.rglob("*.pt")}
    here("rl.train", "--out", run, "--resume").fails(str(run / "uav"), "finite")
    assert {file: file.read_bytes() for file in run.rglob("*.pt")} == before


# -- interruptions ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("team", TEAMS)
def test_ctrl_c_in_a_stage_saves_and_the_run_can_go_on(team, run):
    forget(run, *(TEAMS if team == "usv" else ("uav",)))
    ending = command("rl.train", "--out", run, "--resume", fault=(team, 1, signal.SIGINT))
    ending.fails("interrupted", str(run), "--resume", status=130)
    assert checkpoints(run / team)[-1].name == "model_2.pt"
    assert iterations(run, team) == [0, 1]
    config, _ = run_folder.load_config(run)
    results = train_stages(config, run, show_progress=False)
    assert [result["iterations"] for result in results] == [ITERATIONS] * 2
    for name in TEAMS:
        assert iterations(run, name) == list(range(ITERATIONS))
        assert (run / name / "policy.onnx").is_file()


def test_a_killed_run_goes_on_from_its_last_checkpoint(run):
    forget(run, "uav")
    usv = content(run / "usv")
    killed = command("rl.train", "--out", run, "--resume", fault=("uav", 1, signal.SIGKILL))
    assert killed.status == -signal.SIGKILL
    assert checkpoints(run / "uav")[-1].name == "model_1.pt"
    assert iterations(run, "uav") == [0, 1]
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
    arguments = sets(*TINY, "stages.usv.iterations=30", "stages.uav.iterations=30")
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
    both = [Running("rl.train", "--out", tmp_path / name, *sets(*TINY)) for name in "ab"]
    for running, name in zip(both, "ab", strict=True):
        ending = running.wait()
        assert ending.status == 0, ending.err
        assert_whole(tmp_path / name)


@pytest.mark.slow
def test_two_runs_at_once_in_one_folder_one_is_refused(tmp_path):
    both = [Running("rl.train", "--out", tmp_path / "run", *sets(*TINY)) for _ in range(2)]
    endings = sorted((running.wait() for running in both), key=lambda ending: ending.status)
    assert endings[0].status == 0, endings[0].err
    endings[1].fails(str(tmp_path / "run"))
    assert_whole(tmp_path / "run")


def test_evaluating_a_run_still_in_training_uses_what_there_is(run):
    forget(run, "uav")
    config, _ = run_folder.load_config(run)
    assert set(controllers("policy", run, config)) == {"usv"}
