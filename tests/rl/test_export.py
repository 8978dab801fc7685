"""The tables of an evaluation give back what its judge measured."""

import json

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

SHORT = ("--episodes", "3", "--controller", "classical", "--set", "evaluation.settle=1", "--set", "episode_duration=4")


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_exported_motion_gives_the_figures_of_an_evaluation(here, run, tmp_path, suffix):
    file, told = tmp_path / f"episodes{suffix}", tmp_path / "figures.json"
    ending = here("rl.commands.evaluate", run, *SHORT, "--json", told, "--export", file)
    assert ending.status == 0, ending.stderr
    read = pyarrow.parquet.read_table if suffix == ".parquet" else pyarrow.csv.read_csv
    rows = {name: np.asarray(values) for name, values in read(file).to_pydict().items()}
    beside = read(tmp_path / f"episodes_conditions{suffix}").to_pydict()
    of_each = {name: np.asarray(values) for name, values in beside.items()}
    figures = json.loads(told.read_text())["teams"]["usv"]
    usv = rows["team"] == "usv"
    assert usv.sum() == of_each["usv.decisions"].sum() * (1 + rows["vehicle"][usv].max())
    leads = usv & (rows["vehicle"] == 0) & (rows["time_s"] > 1 + 1e-6)
    error = rows["distance_from_slot_m"][leads].astype(float)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(figures["leader_error_rms_m"], rel=1e-4)
    rewards = [rows["reward"][usv & (rows["episode"] == k)].astype(float).sum() for k in of_each["episode"]]
    assert np.divide(rewards, 1 + rows["vehicle"][usv].max()) == pytest.approx(of_each["usv.reward"], rel=1e-4)
    assert (np.hypot(rows["north_m"], rows["east_m"]) > 0).all() and (of_each["sea.hs"] > 0).all()
    one = usv & (rows["vehicle"] == 0) & (rows["episode"] == 0)
    way = np.hypot(np.diff(rows["north_m"][one].astype(float)), np.diff(rows["east_m"][one].astype(float))).sum()
    speed = np.hypot(rows["surge_m_s"][one].astype(float), rows["sway_m_s"][one].astype(float)).mean()
    assert way == pytest.approx(speed * np.ptp(rows["time_s"][one]), rel=0.15)


def test_tables_have_a_suffix_that_is_known(here, run, tmp_path):
    ending = here("rl.commands.evaluate", run, *SHORT, "--export", tmp_path / "a.xlsx")
    ending.fails("--export", ".parquet or .csv", status=2)
