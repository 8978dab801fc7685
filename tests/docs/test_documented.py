"""Every command in README.md and docs/: its own parser takes it, its overrides fit a scenario, and it runs."""

import argparse
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import command_line
import pytest
from command_line import ROOT, TIMEOUT, sets, tiny_run
from folders import REFERENCE
from named_thrusters import write_hull

from rl.commands.main import SCRIPTS, STARTERS, starter_parser
from rl.missions import load_scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder

PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
FENCE = re.compile(r"^ *```(\w*)[^\n]*\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`((?:taichi-sim|python (?:rl|tools)/)[^`]*)`")
OVERRIDES = re.compile(r"`(--set [^`]*|(?:sea|air|track|usv|uav|vary)\.[a-z][\w.]*=[^`]*)`")
OTHERS = {"cd", "git", "make", "mkdocs", "pyright", "pytest", "ros2", "ruff", "sim_vehicle.py", "tensorboard",
          ".ci/run", "./waf"}  # fmt: skip
"""Programs of others, whose command lines are not ours to check."""


class Documented(NamedTuple):
    """A command line of a page."""

    page: str
    line: str
    words: tuple[str, ...]
    fenced: bool  # or between backticks in a sentence


def documented() -> Iterator[Documented]:
    """Commands of all pages: those of fenced blocks of a shell, and ours between backticks."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(block for kind, block in FENCE.findall(text) if kind == "sh").replace("\\\n", " ")
        for fenced, lines in ((True, blocks.splitlines()), (False, SPAN.findall(FENCE.sub("", text)))):
            for line in (part for whole in lines for part in whole.split(" && ")):
                words = shlex.split(re.sub(r"\[(runs/\w+)\]", r"\1", line), comments=True)  # [what may be left out]
                while words and re.fullmatch(r"export|\w+=.*", words[0]):  # variables of the shell
                    words = words[1:]
                if words:
                    yield Documented(str(page.relative_to(ROOT)), shlex.join(words), tuple(words), fenced)


COMMANDS = tuple(dict.fromkeys(documented()))


class Taken(Exception):  # noqa: N818
    """A parser has taken a command line."""


def ours(words: tuple[str, ...]) -> tuple[str, list[str]] | None:
    """The module and the arguments of a command of ours; None for another."""
    if words[0] == "torchrun":
        words = ("python", *words[next(k for k, word in enumerate(words) if word.endswith(".py")) :])
    if words[0] == "python" and words[1].startswith(("rl/", "tools/")):
        return words[1].removesuffix(".py").replace("/", "."), list(words[2:])
    if words[0] == "taichi-sim" and words[1:2] and words[1] in SCRIPTS:
        module, beside, _ = SCRIPTS[words[1]]
        return module, [*words[2:], *((*beside, "default") if beside else ())]
    return None


def taken(module: str, arguments: list[str], monkeypatch) -> argparse.Namespace:
    """What the parser of a command makes of its arguments; the command itself does not begin."""
    found: list[argparse.Namespace] = []

    def ending(parse):
        def parsed(*args, **more):
            found.append(parse(*args, **more))
            raise Taken

        return parsed

    for name in ("parse_args", "parse_intermixed_args"):
        monkeypatch.setattr(argparse.ArgumentParser, name, ending(getattr(argparse.ArgumentParser, name)))
    with pytest.raises(Taken):
        importlib.import_module(module).main(arguments)
    return found[0]


SHIPPED = sorted(file.stem for file in config_folder().glob("*.toml"))


def scenarios_of(page: str, args: argparse.Namespace) -> list[str]:
    """The scenarios that must take the overrides of a command: the named one, or that of the page's runs.

    README.md promises its commands for the runs of every scenario.
    """
    named = str(args.config or getattr(args, "run", "cruise"))
    if named in SHIPPED or Path(named).is_file():
        return [named]
    other = OTHER_RUNS.get(page, "cruise")
    return SHIPPED if page == "README.md" else [other if other in SHIPPED else f"{other}.toml"]


def fits(overrides: list[str], config: str) -> str:
    """Why the scenario `config` does not take the overrides; empty if it does."""
    try:
        load_scenario(config, overrides)
    except ConfigError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("found", COMMANDS, ids=lambda found: f"{found.page}: {found.line[:60]}")
def test_the_parser_of_a_documented_command_takes_it(found, monkeypatch, capsys, tmp_path):
    program, *rest = found.words
    if program in OTHERS or found.words in (("taichi-sim",), ("taichi-sim", "COMMAND", "--help")):
        return
    if program == "pip":
        extras = {name for word in rest for names in re.findall(r"\[(.*)\]", word) for name in names.split(",")}
        assert extras <= set(re.findall(r"^(\w+) = \[", (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
        return
    if program == "python" and "/" not in rest[0]:
        page = (ROOT / found.page).read_text(encoding="utf-8")
        assert f"file={rest[0]}\n" in page or rest[0].startswith("-"), f"{rest[0]} is no file of the page"
        return
    if program == "taichi-sim" and rest[0] in STARTERS:
        starter_parser(rest[0]).parse_args(rest[1:] or ["name"])
        return
    command = ours(found.words)
    assert command is not None, f"{program}: neither ours nor among {sorted(OTHERS)}"
    module, arguments = command
    if not arguments and not found.fenced:  # a command's name in a sentence
        importlib.import_module(module)
        return
    try:
        args = taken(module, arguments, monkeypatch)
    except SystemExit as ended:
        assert ended.code == 0, capsys.readouterr().err  # 0: --help
        return
    if "config" in args and module.startswith("rl.") and getattr(args, "overrides", ()):
        for page in (found.page, "docs/tutorials/mission.md"):
            _stand_ins(page, tmp_path)
        monkeypatch.chdir(tmp_path)
        given = [text.replace("=N", "=1") for text in args.overrides]
        assert not [why for name in scenarios_of(found.page, args) if (why := fits(given, name))]


def test_overrides_of_the_text_fit_a_scenario(tmp_path, monkeypatch):
    """`--set KEY=VALUE ...` and `sea.KEY=VALUE` between backticks, which name no command."""
    _stand_ins("docs/tutorials/mission.md", tmp_path)
    monkeypatch.chdir(tmp_path)
    refused = {}
    for page in PAGES:
        for text in OVERRIDES.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
            words = [word for word in shlex.split(text) if word != "--set"]
            of_vehicle = any(word.startswith("actions=") for word in words)
            whole = all(re.search(r"=(?!\.\.\.|\[?FILE|VALUE|N$).", word) for word in words)
            if whole and not of_vehicle and page.name != "extending.md":  # which adds terms
                why = (fits(words, name) for name in (*SHIPPED, "buoy.toml"))
                first = next(why)
                refused |= {(page.name, text): first} if first and all(why) else {}
    assert not refused


def test_no_block_without_a_language_hides_a_command():
    for page in PAGES:
        for kind, block in FENCE.findall(page.read_text(encoding="utf-8")):
            assert kind or not re.search(r"^ *(taichi-sim|python|pip|torchrun) ", block, re.MULTILINE), (page, block)


# What follows runs them.

RUNS = ("RUN", "runs/NAME", "runs/OTHER", "runs/A", "runs/B", "runs/C", "runs/rough")
OTHER_RUNS = {"docs/landing.md": "landing", "docs/tutorials/report.md": "buoy"}
BUOY = REFERENCE / "buoys"
NEEDS = {
    "taichi-sim sitl": "an autopilot at the other end: test_sitl.py",
    "taichi-sim pilot": "autopilots at the other end: test_pilot.py",
    "firmware_landings": "an autopilot's program: test_firmware_landings.py",
    "--live": "a viewer: test_live.py",
    "--watch": "a viewer: test_watch.py",
    "taichi-sim score": "policies that fit its tasks: test_benchmark_tasks.py, test_interfaces.py",
    "hydrodynamics cat.stl": "a hull's drawing: test_hydrodynamics.py",
    "fit cat.toml": "logs of a boat: test_fit.py",
    "HOST": "several machines: test_processes.py",
    "esso_osaka": "logs of others",
    "00000012.bin": "a log of an autopilot: test_fit.py",
}
"""What keeps a command from running in a test."""
OWN_TEST = ("docs/tutorials/", "CONTRIBUTING.md")  # test_tutorials.py; tools of developers have tests by name
SHORT = {
    "rl.commands.evaluate": ("--episodes", "2"),
    "rl.commands.odds": ("--effort", "8", "--relative", "0.9", *sets("episode_duration=4", "evaluation.settle=1")),
    "rl.commands.play": ("--duration", "1"),
    "rl.commands.tune": ("--rounds", "1", "--candidates", "2", "--episodes", "4"),
    "tools.compare": ("--episodes", "2"),
    "tools.hydrodynamics": ("--divisions", "3", "--frequencies", "6", "--range", "1.2", "3.2"),
}
"""Module -> arguments that make it short."""


def runnable(found: Documented) -> bool:
    """Whether a test can run a command."""
    return found.fenced and ours(found.words) is not None and not found.page.startswith(OWN_TEST) \
        and not any(word in found.line for word in NEEDS)  # fmt: skip


def _stand_ins(page: str, folder: Path) -> None:
    """Write small files of the names that a page uses."""
    for name, text in FILE.findall((ROOT / page).read_text(encoding="utf-8")):
        (folder / name).write_text(text, encoding="utf-8")
    for file in BUOY.glob("41010.*"):
        shutil.copy(file, folder)
    shutil.copy(config_folder() / "paper.toml", folder / "my.toml")
    (folder / "survey.plan").write_text("north,east\n0,0\n300,0\n300,100\n0,100\n", encoding="utf-8")
    barge = (config_folder() / "vehicles" / "barge.toml").read_text(encoding="utf-8")
    write_hull(folder / "cat.toml", like="wamv")
    (folder / "my_boat.toml").write_text(barge.replace("barge.hydro", "my_boat.hydro"), encoding="utf-8")


def _short_training(name: str) -> list[str]:
    """Overrides of a scenario that make its training short."""
    config = load_scenario(name)
    pools = {"formation": ["track.worlds=4"], "escort": ["escort.worlds=4"]}.get(config.mission, [])
    stages = [
        f"stages.{team}.{key}"
        for team in config.trained
        for key in (f'team="{team}"', "iterations=2", "num_envs=8", "steps_per_iteration=4")
    ]
    return sets("stages={}", *stages, *pools, "sea.realisations=4", "episode_duration=3", "evaluation.episodes=4",
                "evaluation.settle=1")  # fmt: skip


def _run(words: list[str], folder: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout[-2000:]}{done.stderr[-4000:]}"


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted({found.page for found in COMMANDS if runnable(found)}))
def test_the_commands_of_a_page_run(page, tmp_path, monkeypatch):
    """In the order of the page, in one folder, with stand-ins for what a user has, each made short."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command_line, "place", tmp_path)
    _stand_ins(page, tmp_path)
    if any(run in found.line for found in COMMANDS if found.page == page for run in RUNS):
        for name in RUNS:
            shutil.copytree(tiny_run(), tmp_path / name)
        if page in OTHER_RUNS:
            shutil.rmtree(tmp_path / "RUN")
            small = _short_training(OTHER_RUNS[page])
            _run([sys.executable, str(ROOT / "rl" / "train.py"), "--config", OTHER_RUNS[page], "--out", "RUN", *small],
                 tmp_path)  # fmt: skip
    for found in COMMANDS:
        if found.page != page or not runnable(found):
            continue
        module, arguments = ours(found.words) or ("", [])
        short = list(SHORT.get(module, ()))
        if module == "rl.train" and "--resume" not in arguments:
            name = arguments[arguments.index("--config") + 1] if "--config" in arguments else "cruise"
            short = _short_training(name)
            if "--out" in arguments:
                shutil.rmtree(tmp_path / arguments[arguments.index("--out") + 1], ignore_errors=True)
        engine = [sys.executable]
        if found.words[0] == "torchrun":
            engine += ["-m", "torch.distributed.run", *found.words[1 : found.words.index("rl/train.py")]]
        given = [str(file) for word in arguments for file in (sorted(tmp_path.glob(word)) if "*" in word else [word])]
        _run([*engine, str(ROOT / f"{module.replace('.', '/')}.py"), *given, *short], tmp_path)
