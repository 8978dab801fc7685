"""The tables of an evaluation give back what its judge measured, those of a recording what an evaluation tells."""

import json

import numpy as np
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet
import pytest
import rerun as rr

from taichi_sim.visualisation.recording.rrd import APPLICATION

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


def test_a_recording_holds_the_table_of_its_episode(here, run, tmp_path):
    """Two episodes side by side: the first is another controller's."""
    file, out = tmp_path / "side by side.rrd", tmp_path / "recorded.parquet"
    one = ("--episodes", "1", *SHORT[2:], "--export", tmp_path / "episodes.parquet")
    done = [here("rl.commands.evaluate", run, *one), here("rl.commands.play", run, *SHORT[2:], "--beside", "policy",
                                                          "--out", file)]  # fmt: skip
    done.append(here("rl.commands.export", file, "--out", out))
    assert not any(ending.status for ending in done), done
    wanted, whole = pyarrow.parquet.read_table(one[-1]), pyarrow.parquet.read_table(out)
    beside, recorded = (whole.filter(pyarrow.compute.equal(whole["episode"], k)) for k in (0, 1))
    order = [(name, "ascending") for name in ("time_s", "team", "vehicle")]
    wanted, recorded = wanted.sort_by(order), recorded.sort_by(order)
    assert {*wanted.schema.names} == {*recorded.schema.names} and len(recorded) == len(wanted) == len(beside) > 100
    for name in wanted.schema.names[1:]:
        values = [table[name].to_pylist() for table in (wanted, recorded)]
        if isinstance(values[0][0], float):
            one, other = (np.array(of, float) for of in values)
            np.testing.assert_allclose(one, other, atol=2e-5, err_msg=name)
        else:
            assert values[0] == values[1], name
    assert not beside["action_yaw"].equals(recorded["action_yaw"])
    drawn = pyarrow.parquet.read_table(tmp_path / "episodes_conditions.parquet").to_pylist()[0]
    told = pyarrow.parquet.read_table(tmp_path / "recorded_conditions.parquet").to_pylist()
    assert [row["recording"] for row in told] == ["trained", "classical"]
    assert told[1].items() - {"episode": 1, "recording": "classical"}.items() <= drawn.items() and told[1]["sea.hs"] > 0


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda content: b"", "cannot be read"),
        (lambda content: b"# a text\n" * 9, "cannot be read"),
        (lambda content: content[: len(content) // 2], "cannot be read"),
        (lambda content: content[:-1], "it is cut off"),
        (None, "not a recording of this package"),
    ],
)
def test_what_is_no_whole_recording_is_refused_by_name(damage, told, here, tmp_path):
    file, out = tmp_path / "wrong.rrd", tmp_path / "table.csv"
    name = "other" if damage is None else APPLICATION
    with rr.RecordingStream(name, recording_id="1") as stream:
        stream.save(file)
        stream.log("plots/heave", rr.Scalars(1.0))
    if damage is not None:
        file.write_bytes(damage(file.read_bytes()))
    here("rl.commands.export", file, "--out", out).fails("wrong.rrd", told)
    assert not out.exists()


def test_a_recording_without_tables_is_told(here, tmp_path):
    with rr.RecordingStream(APPLICATION, recording_id="1") as stream:
        stream.save(tmp_path / "old.rrd")
        stream.log("plots/heave", rr.Scalars(1.0))
    here("rl.commands.export", tmp_path / "old.rrd", "--out", tmp_path / "t.csv").fails("old.rrd", "no table in it")


def test_tables_have_a_suffix_that_is_known(here, run, tmp_path):
    ending = here("rl.commands.evaluate", run, *SHORT, "--export", tmp_path / "a.xlsx")
    ending.fails("--export", ".parquet or .csv", status=2)
