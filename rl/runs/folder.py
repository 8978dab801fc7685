"""A run's folder: its content, and how it is created and read.

config.toml          the resolved scenario, every key      vehicles/*   vehicle files, and the files that they name
measured/KEY/*       the scenario's files of spectra, currents and winds over time
*.py                 your own modules that the scenario or its vehicles name, unless they are installed
meta.json            seed, versions, commit, machine       progress.csv, checkups.csv, model_N.pt,
                                                     policy.onnx/.pt in TEAM/
summary.json         wall times, stages, evaluation        figures/*.png, episode.rrd, .webp, report.html
evaluation/*         last evaluation of each controller    sweeps/NAME/*    results of sweeps
dumps/*.dump         environments whose state stopped being finite (tools/replay.py), if any
"""

import contextlib
import glob
import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TypedDict, TypeVar

import tomli_w

from rl.learn.results import StageResult
from rl.missions import load_scenario
from rl.runs import ranks
from rl.scenario import Scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.files import files_of, named_files, with_files
from taichi_sim.config.io import (
    apply_overrides,
    find_config,
    key_of,
    read_toml,
    replacing,
    toml_text,
    vehicle_file,
    write_toml,
)
from taichi_sim.config.plugins import PluginError, imported_from, is_plugin, plugin_source
from taichi_sim.errors import UserError, refuse
from taichi_sim.models.catalogue import vehicle_files

CONFIG, META, SUMMARY, DUMPS = "config.toml", "meta.json", "summary.json", "dumps"
LOCK, MEASURED = ".lock", "measured"
GOES_ON = (
    "iterations", "learning_rate", "learning_epochs", "mini_batches", "clip", "entropy", "desired_kl",
    "checkpoint_interval",
)  # fmt: skip
"""Keys of a stage that may change in a run that goes on: none changes its environments."""
ABANDONED = 3600.0  # s, after which an unfinished folder counts as left by a killed process
PACKAGES = ("taichi-sim", "taichi", "torch", "numpy", "rsl-rl-lib", "gymnasium", "rerun-sdk", "pydantic")

T = TypeVar("T")

Figures = dict[str, float | None]
"""Figure -> its value; None where nothing was measured."""


class RunError(UserError, RuntimeError):
    """A run folder that cannot be used; the message says what to do."""


class EvaluationResult(TypedDict):
    """Result of an evaluation: its conditions, the figures of each team, and the episodes that a report shows."""

    controller: str
    scenario: str
    seed: int
    episodes: int
    teams: dict[str, Figures]
    worst_episode: int
    median_episode: int


class Summary(TypedDict):
    """summary.json."""

    scenario: str
    seed: int
    wall_time_s: float
    processes: int
    stages: list[StageResult]
    evaluation: EvaluationResult


class Machine(TypedDict):
    """The machine of a run."""

    system: str
    cpus: int | None
    processor: str


class Software(TypedDict):
    """All besides configuration and seed that a result depends on."""

    packages: dict[str, str | None]
    git_commit: str | None
    python: str
    machine: Machine
    command: list[str]


class Meta(Software, total=False):
    """meta.json."""

    scenario_file: str
    seed: int
    scenario_digest: str


def create(out: Path, config: Scenario, source: Path) -> None:
    """Create a run folder with the resolved configuration."""
    from rl.learn.policy import UNTRAINED, write_checkpoint
    from rl.learn.policy_sources import given_policies
    from rl.learn.start_from import starting_weights

    given_policies(config)  # or it is said now that there are none
    weights = starting_weights(config, source.parent)
    refuse_existing(out)
    made, out = out, _part(out)  # so that a kill leaves no partial run
    try:
        (out / "vehicles").mkdir(parents=True)
        saved = {}
        for team, section in config.teams.items():
            file = vehicle_file(section, source)
            for own in vehicle_files(file, source):
                _keep(own, out / "vehicles" / own.name)
            saved[team] = section.model_copy(update={"vehicle": file.stem})
            _keep_plugin(read_toml(file).get("model"), [file.parent, source.parent], out)
            _keep_plugin(section.script, [source.parent], out)
        for name in (config.mission, *config.functions):
            _keep_plugin(name, [source.parent], out)
        places = {key: _keep_files(files, out, f"{MEASURED}/{key}") for key, files in measured_files(config).items()}
        write_toml(with_measured(config.model_copy(update=saved), places), out / CONFIG)
        for team, content in weights.items():
            (out / team).mkdir()
            write_checkpoint(content, out / team / UNTRAINED)
        about = {"scenario_file": source.name, "seed": config.seed, "scenario_digest": digest(config, source)}
        write_json(out / META, describe_machine() | about)
        refuse_existing(made)  # another process may have created it meanwhile
        out.replace(made)
    except OSError as error:
        raise RunError(f"{made}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _part(out: Path) -> Path:
    """A temporary folder in which the run folder is made; old ones that killed processes left are removed."""
    for left in out.parent.glob(f"{glob.escape(out.name)}.*.part"):
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > ABANDONED:
                shutil.rmtree(left, ignore_errors=True)
    return out.with_name(f"{out.name}.{uuid.uuid4().hex[:8]}.part")


def begin(out: Path, config: Scenario, source: Path) -> None:
    """Create a run folder. Under torchrun, which restarts all processes when one is lost, continue an existing one."""
    if ranks.engine() is not None and (out / META).is_file():
        if read_json(out / META, dict).get("scenario_digest") == digest(config, source):
            return
        raise RunError(f"{out} exists already and holds another scenario: change --out, or torchrun's --rdzv-id")
    create(out, config, source)


def digest(config: Scenario, source: Path) -> str:
    """A hash of the scenario and of all files that it and its vehicles name: equal for all processes of one run."""
    files = measured_files(config)
    bare = with_measured(config, {key: named[0].name for key, named in files.items()})  # wherever the files are
    hashed = hashlib.sha256(toml_text(bare).encode())
    for section in config.teams.values():
        for file in vehicle_files(vehicle_file(section, source), source):
            hashed.update(file.read_bytes())
    for file in sum(files.values(), []):
        hashed.update(file.read_bytes())
    return hashed.hexdigest()[:16]


def refuse_existing(out: Path) -> None:
    """Refuse a folder that exists and is not empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError(f"{out} exists already: give another --out, or continue it with: {resuming(out)}")


def resuming(out: Path) -> str:
    """The command line that continues a run."""
    return shlex.join(("taichi-sim", "train", "--out", str(out), "--resume"))


def _keep_files(files: list[Path], out: Path, place: str) -> str:
    """Copy a file that the scenario names, with the files that it needs, into the run; return its path in the run."""
    (out / place).mkdir(parents=True)
    for file in files:
        shutil.copyfile(file, out / place / file.name)
    return f"{place}/{files[0].name}"


def _keep(file: str | Path, place: str | Path) -> None:
    """Copy a file into the run, which holds one file of a name."""
    place = Path(place)
    other = place.is_file() and place.read_bytes() != Path(file).read_bytes()
    refuse(RunError, (other, f"{file}: another {place.name} is a file of this scenario, too: rename one of them"))
    shutil.copyfile(file, place)


def _keep_plugin(name: str | None, beside: list[Path], out: Path) -> None:
    """Copy the module of a `module:Class` into the run, unless installed, and what it imported from its folder, so that
    the run continues anywhere.
    """
    if name is None or not is_plugin(name) or (own := plugin_source(name, beside)) is None:
        return
    for place in {own, *imported_from(own.parent)}:
        if place.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(place, out / place.name, dirs_exist_ok=True, ignore=ignored, copy_function=_keep)
        else:
            _keep(place, out / place.name)


def load_config(run: Path, overrides=(), config: Path | None = None) -> tuple[Scenario, Path]:
    """The scenario of a run (or the file `config` instead) with overrides, and the file it came from."""
    if config is not None:
        file = find_config(config)
        return load_scenario(file, overrides), file
    file = run / CONFIG
    if not file.is_file():
        raise RunError(f"{run}: not a run folder (no {CONFIG} in it)")
    try:
        return load_scenario(file, overrides), file
    except PluginError:
        raise  # a module that the run or its folder lacks
    except ConfigError as error:
        if overrides and _loads(file):
            raise  # the overrides are wrong
        raise ConfigError(
            f"{error}\nThe run's saved configuration does not fit this version; pass --config FILE to use another"
        ) from None


def _loads(file: Path) -> bool:
    try:
        return bool(load_scenario(file))
    except ConfigError:
        return False


def other_versions(run: Path) -> str:
    """A sentence that lists the packages whose version has changed since the run began; empty if none has."""
    if not (run / META).is_file():
        return ""
    before, now = read_json(run / META, dict).get("packages", {}), versions()
    changed = [f"{name} {before[name]} (now {now[name]})" for name in before if before[name] != now.get(name)]
    return f"this run was begun with {', '.join(changed)}" if changed else ""


def newest(folder: Path) -> Path:
    """The run in `folder` that began last."""
    runs = [p for p in folder.glob("*") if (p / CONFIG).is_file()] if folder.is_dir() else []
    if not runs:
        raise RunError(f"{folder}: no run to continue; name one with --out")
    return max(runs, key=lambda p: (p / CONFIG).stat().st_mtime)


def continued(out: Path, config: str | None, overrides: list[str]) -> tuple[Scenario, Path]:
    """The scenario of a run to be continued, and its file: the saved one, but for what may change in it (`GOES_ON`)."""
    keys = [tuple(key_of(text).split(".")) for text in overrides]
    other = config or any(len(key) != 3 or key[0] != "stages" or key[2] not in GOES_ON for key in keys)
    told = "--resume continues a run with its saved configuration: leave out --config, --seed and --set, but for "
    refuse(RunError, (other, f"{told}stages.NAME.{', stages.NAME.'.join(GOES_ON)}, or begin a new run"))
    (before, _), (now, file) = load_config(out), load_config(out, overrides)
    for name, stage in now.stages.items():
        old, key = before.stages[name].iterations, f"stages.{name}.iterations = {stage.iterations}"
        for team in stage.learners if stage.iterations != old else ():
            done = _completed(out / team) - now.iterations_before(name, team)
            refuse(
                RunError,
                (done > stage.iterations, f"{key}: {team} has completed {done} already"),
                (done > old, f"{key}: {team} has gone on in a later stage: let that one go on, or begin a new run"),
            )
    return now, file


def keep_changes(out: Path, overrides: list[str]) -> None:
    """Write changes of a run that is `continued` into its configuration, and note them in meta.json."""
    data = read_toml(out / CONFIG)
    apply_overrides(data, overrides, Scenario)
    with replacing(out / CONFIG) as part:
        part.write_text(tomli_w.dumps(data), encoding="utf-8")
    about = read_json(out / META, dict)
    write_json(out / META, about | {"continued_with": [*about.get("continued_with", ()), *overrides]})


def _completed(folder: Path) -> int:
    """Iterations of the newest checkpoint in a team's folder."""
    from rl.learn.policy import checkpoints

    saved = checkpoints(folder)
    return int(saved[-1].stem.removeprefix("model_")) if saved else 0


@contextlib.contextmanager
def lock(out: Path):
    """Lock a run folder, so that no other command writes to it."""
    with (out / LOCK).open("w") as file:
        try:
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(f"{out}: another process is writing to this run folder") from None
        yield


def write_json(file: Path, content: object) -> None:
    """Write JSON to a temporary file and rename it to `file`."""
    with replacing(file) as part:
        part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def read_json(file: Path, kind: type[T]) -> T:
    """The content of a JSON file, which is taken for a `kind` without a check."""
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{file}: cannot be read: {error}") from None


def versions() -> dict[str, str | None]:
    """Versions of the packages that a result depends on; None for one that is not installed."""
    found: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def describe_machine() -> Software:
    """Package versions, git commit, Python and machine: everything besides config and seed that a result depends on."""
    return {
        "packages": versions(),
        "git_commit": _git_commit(),
        "python": sys.version.split()[0],
        "machine": {"system": platform.platform(), "cpus": os.cpu_count(), "processor": platform.machine()},
        "command": sys.argv,
    }


def _git_commit() -> str | None:
    def git(*words: str) -> str:
        folder = Path(__file__).resolve().parent
        done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, timeout=5, check=True)
        return done.stdout.strip()

    try:
        return git("rev-parse", "HEAD") + ("+changes" if git("status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def measured_files(config: Scenario) -> dict[str, list[Path]]:
    """The files of measurements of a scenario and of its stages: key -> files; a stage's key is stages.X.set.KEY."""
    found = named_files(config)
    for name, stage in config.stages.items():
        found |= {f"stages.{name}.set.{key}": files for key, files in files_of(stage.set).items()}
    return found


def with_measured(config: Scenario, places: Mapping[str, str]) -> Scenario:
    """The same scenario with new paths for files of measurements, by key."""
    stages = {}
    for name, stage in config.stages.items():
        own = {key: places[full] for key in stage.set if (full := f"stages.{name}.set.{key}") in places}
        stages[name] = stage.model_copy(update={"set": stage.set | own})
    return with_files(config.model_copy(update={"stages": stages}), places)
