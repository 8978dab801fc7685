"""The command `taichi-sim`, files to begin with, and what a wheel holds."""

import contextlib
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from folders import ROOT

from rl.commands import main as command
from rl.commands import starters
from rl.missions import load_scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder
from taichi_sim.models.catalogue import load_vehicle

OUTPUTS = ("--out", "--json", "--export", "--film", "--report", "--log", "--record", "--synthetic")
FEW = ("--set", "stages.first.iterations=2", "--set", "evaluation.episodes=2", "--set", "episode_duration=5")


def test_every_command_is_a_script_of_the_tree_and_is_told_of(capsys):
    with pytest.raises(SystemExit):
        command.main(["--help"])
    told = capsys.readouterr().out
    wanted = {"train", "evaluate", "sweep", "play", "report", "benchmark", "draw-sea", "aircraft"}
    assert wanted <= set(command.SCRIPTS)
    for name in (*command.SCRIPTS, *command.STARTERS):
        assert f"  {name} " in told
    with pytest.raises(SystemExit):
        command.main(["trian"])
    assert "'trian'" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(set(command.SCRIPTS) - {"train", "describe"}))
def test_commands_refuse_at_once_what_they_could_not_write(name, tmp_path, capsys):
    (tmp_path / "file").write_text("")

    def said(*words: str) -> str:
        with contextlib.suppress(SystemExit):
            command.main([name, *words])
        return "".join(capsys.readouterr())

    for given in sorted(set(re.findall(rf"^  ({'|'.join(OUTPUTS)})\b", said("--help"), re.MULTILINE))):
        run = ["paper"] if name in ("play", "odds") else []
        assert "Not a directory" in said(*run, given, str(tmp_path / "file" / "below.rrd")), given


def test_alone_it_tells_of_its_commands(capsys):
    assert command.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, (_, _, text) in command.SCRIPTS.items():
        assert any(line.split() == [name, *text.split()] for line in lines), name


def test_starters_are_whole(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words in ("new-scenario bay --like otter", "new-vehicle tug", "new-mission quay"):
        assert command.main(words.split()) == 0
    assert capsys.readouterr().out.split() == ["bay.toml", "tug.toml", "tug.py", "quay.toml", "quay.py"]
    assert load_scenario("bay.toml").name == "bay"
    assert load_vehicle(tmp_path / "tug.toml").__class__.__name__ == "Tug"
    quay = load_scenario("quay.toml")
    assert quay.mission == "quay:Quay" and list(quay.teams) == ["boats"]
    assert not any(word in file.read_text() for file in tmp_path.iterdir() for word in ("ferr", "endezvous"))


def test_a_copy_of_each_shipped_scenario_is_whole(tmp_path):
    for file in config_folder().glob("*.toml"):
        (copy,) = starters.new_scenario(f"own_{file.stem}", tmp_path, like=file.stem)
        assert load_scenario(copy).mission == load_scenario(file).mission


def test_starters_refuse_what_cannot_be_and_overwrite_nothing(tmp_path):
    for name in ("3x", "Quay", "a-b", ""):
        with pytest.raises(ConfigError, match="a name is of small letters"):
            starters.new_mission(name, tmp_path)
    for name in ("torch", "json", "random", "rl", "class"):
        with pytest.raises(ConfigError, match="which yours would hide"):
            starters.new_mission(name, tmp_path)
    (tmp_path / "quay.py").write_text("mine")
    with pytest.raises(ConfigError, match="quay.py: exists already"):
        starters.new_mission("quay", tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["quay.py"]
    with pytest.raises(ConfigError, match="shipped scenarios: .*otter"):
        starters.new_scenario("bay", tmp_path, like="nothing")


def run(folder: Path, *words: object) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command_line = list(map(str, words))
    done = subprocess.run(command_line, cwd=folder, capture_output=True, text=True, env=environment, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_wheel_does_all_that_a_checkout_does_from_an_empty_folder(tmp_path):
    """With the packages of this environment. `tools`, too general a name for site-packages, is not there."""
    wheels, place, folder = tmp_path / "wheels", tmp_path / "venv", tmp_path / "empty"
    folder.mkdir()
    run(tmp_path, sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", wheels, ROOT)
    venv.create(place, with_pip=True)
    site = Path(run(tmp_path, place / "bin" / "python", "-c", "import site; print(site.getsitepackages()[0])").strip())
    run(tmp_path, place / "bin" / "pip", "install", "--quiet", "--no-deps", next(wheels.glob("*.whl")))
    assert not (site / "tools").exists()
    here = [path for path in sys.path if path.endswith("site-packages")]
    (site / "others.pth").write_text("\n".join(here))
    tool = place / "bin" / "taichi-sim"
    run(folder, tool, "new-mission", "quay")
    run(folder, tool, "train", "--config", "quay.toml", "--out", "run", "--quiet", *FEW)
    assert "final_distance_m" in run(folder, tool, "evaluate", "run", "--quiet", "--episodes", "2")
    run(folder, tool, "play", "run", "--out", "again.rrd", "--quiet")
    run(folder, tool, "report", "run")
    assert (folder / "again.rrd").is_file() and (folder / "run" / "report.html").is_file()
    run(folder, tool, "aircraft", "aerosonde")
    made = "import gymnasium; print(gymnasium.make('rl:taichi_sim/OtterUsv-v0'))"
    assert "OtterUsv" in run(folder, place / "bin" / "python", "-c", made)
