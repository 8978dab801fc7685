"""Numbers from logs: known numbers come back, what data do not tell is said, and bad logs are told."""

import csv
from pathlib import Path

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
    assert not found.odd  # logs of one boat agree
    held = [track for track in found.tracks if track.by_file is not None]
    assert len(held) == len(found.tracks) // 5
    by_fit, by_file = (np.std(np.concatenate([(t.measured - m)[:, 0] for t, m in zip(held, motions, strict=True)]))
                       for motions in ([t.fitted for t in held], [t.by_file for t in held]))  # fmt: skip
    assert by_fit < 0.12 < by_file  # north, m: only the noise is left


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(tmp_path):
    """Numbers drawn about the file's, ten logs of 60 s for each draw. docs/fit.md has more cases, by the same code."""
    cases, model = 16, load_vehicle("otter_3dof")
    keys = command.numbers_of(model, "", "otter_3dof")
    prior = {key: command.PRIORS.get(key, command.PRIOR) for key in keys}
    inside = np.empty((cases, len(keys)), dtype=bool)
    for case in range(cases):
        drawn = np.random.default_rng(1000 + case).normal(size=len(keys)) * np.minimum(list(prior.values()), 0.25)
        factors = dict(zip(keys, np.exp(drawn), strict=True))
        files = write_logs("otter_3dof", factors, tmp_path / str(case), seed=case)
        found = fit("otter_3dof", [read_log(file, model) for file in files], prior)
        true = found.nominal * np.exp(drawn)
        inside[case] = (found.low <= true) & (true <= found.high)
        near = np.abs(found.values / true - 1.0)
        assert (near[[keys.index(k) for k in ("mass", "surge_force_max", "X_u")]] < 0.08).all(), case
        assert not found.odd, case
    assert 0.85 < inside.mean() <= 0.99


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


def _all_degrees(rows):
    for row in rows:
        row["heading"] = np.degrees(float(row["heading"])) % 360
        row["yaw_rate"] = np.degrees(float(row["yaw_rate"]))


def _enu(rows):
    """Heading counter-clockwise from east, and so the yaw rate."""
    for row in rows:
        row["heading"], row["yaw_rate"] = 0.5 * np.pi - float(row["heading"]), -float(row["yaw_rate"])


def _straight(rows, heading=0.0):
    for k, row in enumerate(rows):
        row.update(north=0.05 * k, east=0.0, heading=heading, yaw_rate=1e-5 * (k % 3), yaw=0.0)


BAD = {
    "all in degrees": (_all_degrees, "heading looks like degrees, by the course over ground: name .* heading_deg"),
    "enu": (_enu, "counted from east .ENU."),
    "enu, straight": (lambda rows: _straight(rows, 0.5 * np.pi), "lies 90 degrees to port of the heading, .* .ENU."),
    "milliseconds": (_each("t", lambda r: 1000 * float(r["t"])), "samples are 100 s apart: is t in other units"),
    "empty": (_each("north", lambda r: ""), "line 2: north is not a number"),
    "degrees": (_each("heading", lambda r: np.degrees(float(r["heading"]))), "heading looks like degrees"),
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
    straight = _changed(files[0], tmp_path / "straight.csv", _straight)
    found = fit("otter_3dof", [read_log(straight, load_vehicle("otter_3dof"))], {"X_u": 0.4, "N_rr": 0.4})
    assert list(found.told) == [True, False] and found.values[1] == pytest.approx(found.nominal[1], rel=0.2)


def test_logs_of_two_boats_are_told_apart(tmp_path, capsys):
    """Two logs of one boat, and one of a boat of half its drag."""
    one, two = (write_logs("otter_3dof", {"X_u": f}, tmp_path / str(f), count=2, seconds=20.0) for f in (1.0, 0.5))
    other = two[0].rename(tmp_path / "other.csv")
    assert command.main(["otter_3dof", *map(str, one), str(other), "--numbers", "X_u"]) == 0
    told = capsys.readouterr().out
    assert "would not ask for such different numbers" in told
    assert "log0.csv: X_u +" in told and "log1.csv: X_u +" in told and "other.csv: X_u -" in told


def test_too_few_samples_are_told(tmp_path, capsys):
    file = write_logs("otter_3dof", {"X_u": 1.0}, tmp_path, count=1, seconds=12.0)[0]
    few = _changed(file, tmp_path / "few.csv", lambda rows: rows[::10])
    assert command.main(["otter_3dof", str(few)]) == 2
    assert "measured values for 19 unknowns" in capsys.readouterr().err
    assert command.main(["otter_3dof", str(few), "--window", "60"]) == 2
    assert "no log has 60 s without a gap" in capsys.readouterr().err
    (tmp_path / "flight.bin").write_bytes(b"\xa3\x95\x80\xff")
    assert command.main(["otter_3dof", str(tmp_path / "flight.bin")]) == 2
    assert "this is no text; a CSV" in capsys.readouterr().err


def test_the_command_makes_logs_fits_them_and_writes_a_file(capsys, tmp_path):
    words = ["otter_3dof", "--synthetic", str(tmp_path), "--factor", "X_u=1.2", "--count", "2"]
    assert command.main(words) == 0
    files = capsys.readouterr().out.split()
    out, page = tmp_path / "mine.toml", tmp_path / "fit.html"
    numbers = ["--numbers", "X_u,surge_force_max"]
    assert command.main(["otter_3dof", *files, *numbers, "--out", str(out), "--report", str(page)]) == 0
    html = page.read_text()
    assert all(Path(file).name in html for file in files) and html.count("<svg") == 2 + len(files)
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
