"""docs/tutorials: every listing and command, run as it stands, in the order of the lessons, in one folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT, printed

PAGES = ROOT / "docs" / "tutorials"
FILE = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMANDS = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LISTING = re.compile(r"python (\S+\.py)\n")
LESSONS = ("sea", "boat", "mission", "policy", "report", "reward", "traffic")


def lesson(folder: Path, name: str) -> str:
    """Output of a page's commands, beside its files; each must end well."""
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    for file, content in FILE.findall(text):
        (folder / file).write_text(content, encoding="utf-8")
    return "".join(_output(folder, commands) for commands in COMMANDS.findall(text))


def _output(folder: Path, commands: str) -> str:
    """Output of commands of a shell; a line `python FILE.py` is spared the import of what a server has imported."""
    if listing := LISTING.fullmatch(commands):
        return printed(listing[1], cwd=folder)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-euc", commands], cwd=folder, env=environment, capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def number(pattern: str, text: str) -> float:
    """The number that a pattern finds."""
    found = re.search(pattern, text)
    assert found, text
    return float(found[1])


def test_every_page_is_a_lesson():
    assert {page.stem for page in PAGES.glob("*.md")} == {"index", *LESSONS}


@pytest.mark.slow
def test_a_sea_a_boat_and_a_mission(tmp_path):
    assert 0.8 < number(r"height: (\S+) m", lesson(tmp_path, "sea")) < 1.2
    assert (tmp_path / "sea.png").is_file()
    assert 1.5 < number(r"after 10 s: (\S+) m/s", lesson(tmp_path, "boat")) < 3.0
    assert (tmp_path / "bay.rrd").is_file()
    assert "distances, m:" in lesson(tmp_path, "mission")


@pytest.mark.slow
def test_a_policy_and_its_report(tmp_path):
    """Trained for a minute or two, boats that begin 45 m away on average end within a metre of the buoy."""
    lesson(tmp_path, "mission")
    assert number(r"median (\S+) m", lesson(tmp_path, "policy")) < 1.0
    report = lesson(tmp_path, "report")
    assert number(r"calm .* distance (\S+) m", report) < 1.0
    assert number(r"rough .* distance (\S+) m", report) < 2.0
    assert (tmp_path / "worst.rrd").is_file() and (tmp_path / "runs" / "buoy" / "report.html").is_file()


@pytest.mark.slow
def test_a_reward_of_ones_own(tmp_path):
    """In a folder with a space in its name."""
    (folder := tmp_path / "my lessons").mkdir()
    told = lesson(folder, "reward")
    assert "weight 0.3, scale 0.2: -(turn rate / scale)^2, rad/s: boats that turn gently" in told
    assert "A: runs/gentle" in told and "| `team_error_m` | " in told
    assert (folder / "runs" / "gentle" / "figures" / "terms.png").is_file()


@pytest.mark.slow
def test_traffic_of_ones_own(tmp_path):
    assert 0.6 < number(r'"collision_free_episodes": ([\d.]+)', lesson(tmp_path, "traffic")) <= 1.0
