"""A measured sea in a scenario: where its file is found, what it takes back, and what a run keeps of it."""

import shutil
from pathlib import Path

import pytest
from folders import REFERENCE
from refusal import assert_says, refusal

from rl.missions import load_scenario
from rl.runs import folder
from taichi_sim.config import SeaConfig
from taichi_sim.config.io import load_world
from taichi_sim.randomisation.conditions import realise
from taichi_sim.surroundings.sea import sea_size

BUOY = REFERENCE / "buoys" / "41010.data_spec"
TIME = '"2020-06-08 02:50"'


@pytest.fixture
def beside(scenario, tmp_path):
    """A scenario with a measured sea, and its files beside it."""
    for file in BUOY.parent.iterdir():
        shutil.copy(file, tmp_path)
    return scenario(end=f"[sea]\nspectrum = '41010.data_spec'\nrecord = {TIME}\nrealisations = 4\n")


def test_a_file_is_found_beside_the_scenario_and_by_its_own_path(beside, scenario):
    config = load_scenario(beside)
    assert Path(config.sea.spectrum) == beside.with_name("41010.data_spec") and config.sea.components == 32
    assert load_world(beside).sea.spectrum == config.sea.spectrum
    assert load_scenario(scenario(), [f"sea.spectrum={BUOY}"]).sea.spectrum == str(BUOY)
    message = refusal(scenario(end="[sea]\nspectrum = 'nowhere.data_spec'\n"))
    assert_says(message, "little.toml", "sea.spectrum = 'nowhere.data_spec'", "no such file")


SIZED = """[sea]
hs = 0.5
tp = 4.0
components = 16
[vary]
"sea.hs" = [0.2, 1.0]
"sea.direction_deg" = [0, 90]
"air.speed" = [1, 2]
"""


def test_an_override_takes_another_size_back(scenario):
    config = load_scenario(scenario(end=SIZED), [f"sea.spectrum={BUOY}"])
    assert config.sea.hs is None and config.sea.components == 32 and set(config.vary) == {"air.speed"}


def test_another_size_takes_a_measured_sea_back(beside):
    back = load_scenario(beside, ["sea.hs=1", "sea.tp=5"])
    assert (back.sea.spectrum, back.sea.hs, back.sea.record) == ("jonswap", 1.0, None)
    assert load_scenario(beside, ["sea.record=all"]).sea.record == "all"


@pytest.mark.parametrize(
    ("end", "parts"),
    [
        ("[sea]\nspectrum = 'jonswop'\n", ("sea.spectrum = 'jonswop'", "did you mean 'jonswap'", "file of a measured")),
        ("[sea]\nspectrum = '41010.data_spec'\nhs = 1.0\ntp = 5.0\n", ("a size of its own", "remove hs and tp")),
        ("[sea]\nspectrum = '41010.data_spec'\n[vary]\nsea.hs = [0, 1]\n", ("vary.sea.hs", "record = 'all'")),
        ("[sea]\nspectrum = '41010.data_spec'\n[vary]\nsea.direction_deg = [0, 1]\n", ("vary.sea.direction_deg",)),
    ],
)
def test_what_contradicts_a_measured_sea_is_refused(beside, scenario, end, parts):
    assert_says(refusal(scenario(end=end)), *parts)


def test_conditions_are_those_of_the_records(beside):
    config = load_scenario(beside, ["sea.record=all", "sea.realisations=5"])
    sea, found = realise(config, seed=3)
    assert found.hs == pytest.approx(sea.components.hs) and found.hs[0] == found.hs[4] != found.hs[1]
    assert found.tp[0] == pytest.approx(1 / 0.13) and sea_size(config.sea).hs == pytest.approx(found.hs[:4].mean())


def test_a_run_keeps_the_files_and_reads_them_again(beside, tmp_path):
    (tmp_path / "flow.csv").write_text("time,speed,direction_deg\n0,0.4,20\n", encoding="utf-8")
    (tmp_path / "breeze.csv").write_text("time,speed,direction_deg\n0,4,20\n", encoding="utf-8")
    own = ["sea.current.series=flow.csv", "stages={}", "stages.usv.team=usv", "stages.usv.set.air.series=breeze.csv"]
    config = load_scenario(beside, own)
    folder.create(tmp_path / "run", config, beside)
    (tmp_path / "breeze.csv").unlink()
    for file in tmp_path.glob("41010.*"):
        file.unlink()
    (tmp_path / "flow.csv").unlink()
    again, _ = folder.load_config(tmp_path / "run")
    assert Path(again.sea.spectrum).parent == tmp_path / "run" / "measured" / "sea.spectrum"
    assert Path(again.sea.current.series).is_file()
    told = Path(again.stages["usv"].set["air.series"])
    assert told == tmp_path / "run/measured/stages.usv.set.air.series/breeze.csv" and told.is_file()
    sea, _ = realise(again, seed=1)
    size = sea_size(SeaConfig(spectrum=str(BUOY), record=TIME.strip('"')))
    assert sea.components.hs == pytest.approx([size.hs] * 4)
