"""Numbers from logs: known numbers come back, what data do not tell is said, and bad logs are told."""

import csv

import numpy as np
import pytest

from taichi_sim.commands import fit as command
from taichi_sim.fit.estimate import fit
from taichi_sim.fit.log import LogError, read_log
from taichi_sim.fit.synthetic import write_logs
from taichi_sim.vehicles import load_vehicle

pytestmark = pytest.mark.usefixtures("f64")
FACTORS = {"X_u": 1.15, "N_r": 0.9, "surge_force_max": 0.92, "yaw_moment_max": 1.1}


@pytest.fixture(scope="module")
def logs(f64, tmp_path_factory):
    return write_logs("otter_3dof", FACTORS, tmp_path_factory.mktemp("logs"), count=3, seconds=40.0, seed=4)


def test_known_numbers_come_back_within_their_intervals(logs):
    model = load_vehicle("otter_3dof")
    found = fit("otter_3dof", [read_log(file, model) for file in logs], dict.fromkeys(FACTORS, 0.4))
    true = found.nominal * list(FACTORS.values())
    assert found.values == pytest.approx(true, rel=0.05)
    assert found.told.all()
    half = 0.5 * (found.high - found.low)
    assert (np.abs(found.values - true) < 2.0 * half).all()  # four deviations
    assert found.sigma == pytest.approx([0.1, 0.1, np.radians(0.5), np.radians(0.2)], rel=0.15)
    assert found.after < 1.2 < found.before


def _changed(source, target, change):
    with source.open() as file:
        rows = list(csv.DictReader(file))
    rows = change(rows) or rows
    with target.open("w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(rows)
    return target


def _each(key, function):
    def change(rows):
        for row in rows:
            row[key] = function(row)

    return change


def _swapped(rows):
    for row in rows:
        row["north"], row["east"] = row["east"], row["north"]


BAD = {
    "degrees": (_each("heading", lambda r: np.degrees(float(r["heading"]))), "heading changes .* looks like degrees"),
    "rates": (_each("yaw_rate", lambda r: np.degrees(float(r["yaw_rate"]))), "looks like degrees per second"),
    "port": (_each("yaw_rate", lambda r: -float(r["yaw_rate"])), "turns against yaw_rate"),
    "frame": (_swapped, "north and east are exchanged"),
    "nan": (_each("east", lambda r: "nan" if r["t"].startswith("3.") else r["east"]), "line .*: east = nan"),
    "word": (_each("t", lambda r: "noon"), "t is not a number"),
    "back": (_each("t", lambda r: -float(r["t"])), "it must increase"),
    "action": (_each("yaw", lambda r: 3.0), "yaw goes to 3"),
    "lacking": (lambda rows: [{k: v for k, v in row.items() if k != "yaw"} for row in rows], "no column yaw"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_logs_are_told(name, logs, tmp_path):
    change, told = BAD[name]
    with pytest.raises(LogError, match=told):
        read_log(_changed(logs[0], tmp_path / "bad.csv", change), load_vehicle("otter_3dof"))


def test_a_gap_parts_a_log(logs, tmp_path):
    file = _changed(logs[0], tmp_path / "gap.csv", lambda rows: rows[:150] + rows[220:])
    assert [p.stop - p.start for p in read_log(file, load_vehicle("otter_3dof")).parts] == [150, 180]


def test_what_data_do_not_tell_is_said_and_kept(tmp_path):
    """A boat that never turned says nothing of its yaw damping."""
    files = write_logs("otter_3dof", {"X_u": 1.1}, tmp_path, count=1, seconds=40.0)
    straight = _changed(files[0], tmp_path / "straight.csv", _each("yaw", lambda r: 0.0))

    def ahead(rows):
        for k, row in enumerate(rows):
            row.update(north=0.05 * k, east=0.0, heading=0.0, yaw_rate=1e-5 * (k % 3), yaw=0.0)

    _changed(files[0], straight, ahead)
    found = fit("otter_3dof", [read_log(straight, load_vehicle("otter_3dof"))], {"X_u": 0.4, "N_rr": 0.4})
    assert list(found.told) == [True, False] and found.values[1] == pytest.approx(found.nominal[1], rel=0.2)


def test_the_command_makes_logs_fits_them_and_writes_a_file(capsys, tmp_path):
    words = ["otter_3dof", "--synthetic", str(tmp_path), "--factor", "X_u=1.2", "--count", "2"]
    assert command.main(words) == 0
    files = capsys.readouterr().out.split()
    out = tmp_path / "mine.toml"
    assert command.main(["otter_3dof", *files, "--numbers", "X_u,surge_force_max", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "95 % interval" in told and "current" in told and "1 is the noise" in told
    assert load_vehicle(out).params.X_u == pytest.approx(1.2 * load_vehicle("otter_3dof").params.X_u, rel=0.03)
    assert "sha256" in out.read_text() and "95 %:" in out.read_text()


@pytest.mark.parametrize(("words", "told"), [
    ("otter_3dof", "no logs"),
    ("otter_3dof nolog.csv", "No such file"),
    ("otter_3dof --synthetic x --factor X_u", "expected KEY=NUMBER"),
    ("otter", "no logs"),
    ("otter --synthetic x", "name what to fit by --numbers"),
])  # fmt: skip
def test_bad_input_is_told(words, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command.main(words.split()) == 2
    assert told in capsys.readouterr().err
