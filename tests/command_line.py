"""Commands as a user runs them, and one tiny run.

Commands and listings run in processes of their own, forked from a server that has imported the packages; `tiny_run` is
one real call of the script, shared by all tests of a session.
"""

import atexit
import csv
import dataclasses
import functools
import importlib
import json
import multiprocessing
import os
import runpy
import shutil
import signal
import sys
import tempfile
import traceback
from pathlib import Path

import pytest
from filelock import FileLock
from folders import ROOT

from rl.commands import shared
from rl.learn.policy import checkpoints
from rl.missions import load_scenario
from rl.missions.formation.config import FormationScenario
from rl.runs import main_job
from taichi_sim.errors import MissingExtraError

ITERATIONS = 4
CHECKPOINT_INTERVAL = 2  # checkpoints after iterations 1, 3 and 4
TINY = (
    "stages={}",  # two small ones of PPO in place of the shipped recipe
    *(
        f"stages.{team}.{setting}"
        for team in ("usv", "uav")
        for setting in (
            f'team="{team}"',
            f"iterations={ITERATIONS}",
            "num_envs=8",
            "steps_per_iteration=8",
            f"checkpoint_interval={CHECKPOINT_INTERVAL}",
        )
    ),
    "track.worlds=4",
    "sea.realisations=4",
    "episode_duration=3",
    "usv.plan.horizon=2",
    "uav.plan.horizon=2",
    "evaluation.episodes=4",
    "evaluation.settle=1",
)
TEAMS = ("usv", "uav")
TIMEOUT = 900  # s, after which a command hangs: a busy machine takes minutes for what takes ten seconds
place = Path()  # of the tiny run
PLAIN = ("rl.commands.report", "rl.commands.export")  # commands without the common arguments


def sets(*overrides: str) -> list[str]:
    """Return `overrides` as --set arguments."""
    return [word for text in overrides for word in ("--set", text)]


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
    context.set_forkserver_preload(
        [
            "rl.runs.main_job",
            "rl.train",
            "rl.commands.evaluate",
            "rl.commands.play",
            "taichi_sim.visualisation.plotting.page",
            "rl.guidance.controllers",
        ]
    )
    return context


class Running:
    """A command in a process of its own, begun in `cwd`.

    `fault` = (team, iteration, signal) hits it right after that iteration. A `module` FILE.py is a listing.
    """

    def __init__(
        self, module: str, *arguments: object, fault: tuple[str, int, int] | None = None, cwd: Path | None = None
    ):
        self.folder = Path(tempfile.mkdtemp())
        if not module.endswith(".py"):
            arguments = (*arguments, "--quiet", *(() if "--threads" in arguments else ("--threads", "1")))
        words = tuple(map(str, arguments))
        self.process = server().Process(target=_child, args=(module, words, str(self.folder), fault, cwd))
        self.process.start()

    def wait(self) -> Ending:
        self.process.join(TIMEOUT)
        assert self.process.exitcode is not None, "the command hangs"
        texts = [(self.folder / name).read_text() if (self.folder / name).exists() else "" for name in ("out", "err")]
        shutil.rmtree(self.folder)
        return Ending(self.process.exitcode, *texts)


def _child(
    module: str, arguments: tuple[str, ...], folder: str, fault: tuple[str, int, int] | None, cwd: Path | None
) -> None:
    for descriptor, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(Path(folder, name), os.O_WRONLY | os.O_CREAT, 0o600), descriptor)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has it ignored by what runs in the background
    main_job.FILM_S = 1.0  # s, in place of ten: drawing takes longest
    if fault:
        _plan(*fault)
    if cwd is not None:
        os.chdir(cwd)
    try:
        if module.endswith(".py"):
            sys.path.insert(0, str(cwd))
            sys.argv = [module, *arguments]
            runpy.run_path(module, run_name="__main__")
            sys.exit(0)
        sys.exit(shared.run(importlib.import_module(module).main, list(arguments)))
    finally:
        atexit._run_exitfuncs()  # processes of multiprocessing forget it; the next one finds the compiled kernels


def _plan(team: str, iteration: int, number: int) -> None:
    from rl.learn.progress import ProgressLogger

    original = ProgressLogger.log

    def log(self, it, *args, **values):
        original(self, it, *args, **values)
        if it == iteration and Path(self.log_dir).name == team:
            os.kill(os.getpid(), number)

    ProgressLogger.log = log


def command(module: str, *arguments: object, fault=None, cwd: Path | None = None) -> Ending:
    """Run a command to its end."""
    return Running(module, *arguments, fault=fault, cwd=cwd).wait()


def printed(module: str, *arguments: object, cwd: Path) -> str:
    """Output of a command or a listing in `cwd`, which must end well."""
    ending = command(module, *arguments, cwd=cwd)
    assert ending.status == 0, ending.out + ending.err
    return ending.out


@functools.cache
def tiny_run() -> Path:
    """Return the folder of one whole tiny main job, run by the script; not to be changed.

    The worker that needs it first makes it in `place`, which a fixture sets; others wait for it.
    """
    folder = place / "tiny"
    with FileLock(place / "tiny.lock"):
        if not folder.is_dir():
            part = Path(tempfile.mkdtemp(dir=place))
            _make_tiny_run(part)
            part.rename(folder)
    return folder / "run"


def _make_tiny_run(folder: Path) -> None:
    script = str(ROOT / "rl" / "train.py")
    done = command(script, "--config", "paper", "--out", "run", "--threads", "1", *sets(*TINY), cwd=folder)
    assert done.status == 0, done.err
    assert "summary.json" in done.out and "episode.rrd" in done.out
    assert "stage 2/2 uav" in done.err  # progress


def tiny_config() -> FormationScenario:
    return load_scenario("paper", TINY)


def onnx_session(file: Path):
    """Return onnxruntime's session of an ONNX file; without the package the test is skipped, and names its extra."""
    missing = str(MissingExtraError("onnxruntime", "onnxruntime"))
    return pytest.importorskip("onnxruntime", reason=missing).InferenceSession(str(file))


def forget(run: Path, *teams: str) -> Path:
    """Take a run back to before `teams` were trained."""
    for name in (*teams, "figures", "evaluation"):
        shutil.rmtree(run / name)
    for name in ("summary.json", "episode.rrd", "report.html"):
        (run / name).unlink()
    return run


def content(folder: Path) -> dict[str, bytes]:
    """Return every file but the lock, which any command may touch."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != ".lock"}


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
    assert (run / "report.html").is_file() and (run / "episode.rrd").is_file() and list((run / "figures").glob("*.png"))
    assert not list(run.rglob("*.part*"))


@pytest.fixture(scope="session", autouse=True)
def place_of_the_tiny_run(tmp_path_factory):
    """Put the tiny run where all workers of a session find it."""
    global place
    own = tmp_path_factory.getbasetemp()
    place = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture
def here(capsys):
    """Return a function that runs a command in this process: enough for messages."""

    def run(module: str, *arguments: object) -> Ending:
        capsys.readouterr()
        main = importlib.import_module(module).main
        try:
            common = [] if module in PLAIN else ["--quiet", "--threads", "1"]
            status = shared.run(main, [*map(str, arguments), *common])
        except SystemExit as ending:
            status = int(ending.code or 0)
        except Exception:  # what a user would see of it
            status = 1
            traceback.print_exc()
        return Ending(status, *capsys.readouterr())

    return run


@pytest.fixture
def run(tmp_path) -> Path:
    """Return a copy of the tiny run."""
    return Path(shutil.copytree(tiny_run(), tmp_path / "run"))
