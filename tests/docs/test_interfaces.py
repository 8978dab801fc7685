"""docs/interfaces.md: its examples, run as they are written, from a folder outside the repository."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from folders import ROOT

PAGE = ROOT / "docs" / "interfaces.md"
BLOCK = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXAMPLES = dict(BLOCK.findall(PAGE.read_text(encoding="utf-8")))
JUDGED = re.compile(r"^(before|after): reward (\S+), (\S+) m", re.MULTILINE)

pytestmark = pytest.mark.slow


def run(folder: Path, name: str, *arguments: str) -> str:
    """Output of an example, which must end well."""
    (folder / name).write_text(EXAMPLES[name], encoding="utf-8")
    done = subprocess.run([sys.executable, name, *arguments], cwd=folder, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_example_is_run():
    assert set(EXAMPLES) == {
        "gymnasium_boats.py", "pettingzoo_escort.py", "batched_escort.py", "sb3_boats.py", "skrl_boats.py",
        "sb3_export.py", "skrl_export.py",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gymnasium_boats.py", "m from their slots"),
        ("pettingzoo_escort.py", r"'uav_2': \(65,\)\}\n.*\n\['usv_0', 'usv_1', 'usv_2'\]"),
        ("batched_escort.py", r"mean reward \{'usv': .*, 'uav': .*\}"),
    ],
)
def test_environments_step(tmp_path, name, told):
    assert re.search(told, run(tmp_path, name))


@pytest.mark.parametrize(
    ("name", "package", "steps"),
    [("sb3_boats.py", "stable_baselines3", "400000"), ("skrl_boats.py", "skrl", "3000")],
)
def test_boats_learn_to_follow(tmp_path, name, package, steps):
    """On unseen tracks and seas, the same before and after, boats that drift 30 m off end within 3 m of their slots."""
    pytest.importorskip(package)
    told = JUDGED.findall(run(tmp_path, name, steps))
    reward, distance = ({when: float(found[k]) for when, *found in told} for k in (0, 1))
    assert reward["after"] > reward["before"] + 1.0
    assert distance["before"] > 20.0
    assert distance["after"] < 3.0


@pytest.mark.parametrize(
    ("library", "package", "steps"), [("sb3", "stable_baselines3", "2048"), ("skrl", "skrl", "24")]
)
def test_policies_of_other_libraries_are_scored(tmp_path, library, package, steps):
    """After hardly any training, which is told as it is: no better than the classical controller."""
    pytest.importorskip(package)
    (tmp_path / f"{library}_boats.py").write_text(EXAMPLES[f"{library}_boats.py"], encoding="utf-8")
    run(tmp_path, f"{library}_export.py", steps)
    words = ("score", "paper-v1", "--policy", f"usv={library}.onnx", "--quiet")
    done = subprocess.run(
        [sys.executable, "-m", "rl.commands.main", *words], cwd=tmp_path, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "names no observations" in done.stderr
    times = re.match(r"paper-v1, usv: no score .*; (\S+) \(.* times the classical team_error_m", done.stdout)
    assert times and (times[1] == "-" or float(times[1]) > 1)  # -: all lost before errors count
