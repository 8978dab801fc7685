"""`tools/validate.py`: what it prints, writes and refuses, and tables that are wrong."""

import json
import shutil
import subprocess
import sys

import pytest
from folders import REFERENCE, ROOT

from tests.validation.report import NothingToCheckError, validate
from tests.validation.tables import read_csv
from tools.validate import main

DISPERSION = "dispersion_g9.81.csv"


@pytest.fixture
def tables(tmp_path):
    """A directory with one cheap table."""
    shutil.copy(REFERENCE / "waves" / DISPERSION, tmp_path)
    return tmp_path


def _edit(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def _failed(folder):
    return [check for check in validate(folder).checks if not check.passed]


def _tool(*arguments):
    command = [sys.executable, str(ROOT / "tools" / "validate.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=_environment(), timeout=900)


def _environment():
    import os

    return os.environ | {"PYTHONPATH": str(ROOT)}


def test_tool_writes_json_and_prints(tables):
    (tables / "other.csv").write_text("a,b\n1,2\n")
    result = _tool("--reference", tables, "--json", tables / "out.json")
    assert result.returncode == 0, result.stderr
    assert "0 failed" in result.stdout and "other.csv" in result.stdout
    data = json.loads((tables / "out.json").read_text())
    assert set(data) == {"checks", "unchecked"}
    assert data["unchecked"] == ["other.csv"]
    for check in data["checks"]:
        assert set(check) == {"table", "quantity", "precision", "error", "tolerance", "passed"}
        assert check["table"] == DISPERSION and check["precision"] == "f64"
        assert check["passed"] is True and check["error"] <= check["tolerance"]


def test_tool_fails_on_a_wrong_value(tables, capsys):
    _edit(tables / DISPERSION, "4.02430352746", "4.02433352746")
    assert main(["--reference", str(tables), "--json", str(tables / "out.json")]) == 1
    assert "FAIL" in capsys.readouterr().out
    failed = [c for c in json.loads((tables / "out.json").read_text())["checks"] if not c["passed"]]
    assert [c["quantity"] for c in failed] == ["k"]


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("group_speed", "group_velocity", "'group_speed' is missing"),
        ("4.02430352746", "four", "'k', row 2: 'four'"),
        ("4.02430352746", "nan", "'k', row 2: 'nan'"),
        ("4.02430352746,", "", "row 2 has"),
    ],
)
def test_a_malformed_table_is_a_failed_check_that_says_where(old, new, named, tables):
    _edit(tables / DISPERSION, old, new)
    (check,) = [check for check in _failed(tables) if check.error is None]
    assert check.table == DISPERSION
    assert named in check.quantity


@pytest.mark.parametrize("text", ["", "omega,depth_m\n", "\x00\xff"])
def test_a_file_that_is_no_table_is_a_failed_check(text, tables):
    (tables / DISPERSION).write_text(text, encoding="latin-1")
    assert [check.table for check in _failed(tables)] == [DISPERSION]


def test_a_sea_without_its_components_is_a_failed_check(tmp_path):
    shutil.copy(REFERENCE / "waves" / "sea6_deep_gerstner_queries.csv", tmp_path)
    failed = _failed(tmp_path)
    assert {check.precision for check in failed} == {"f64", "f32"}
    assert all("sea6_deep.json is missing" in check.quantity for check in failed)


def test_a_sea_too_steep_is_a_failed_check(tmp_path):
    for name in ("sea6_deep.json", "sea6_deep_gerstner_queries.csv"):
        shutil.copy(REFERENCE / "waves" / name, tmp_path)
    _edit(tmp_path / "sea6_deep.json", "0.302159", "30.2159")
    assert any("too steep" in check.quantity for check in _failed(tmp_path))


def test_missing_and_empty_directories_are_errors(tmp_path, capsys):
    with pytest.raises(NothingToCheckError, match="no such directory"):
        validate(tmp_path / "nowhere")
    (tmp_path / "other.csv").write_text("a\n1\n")
    with pytest.raises(NothingToCheckError, match="no table that a checker knows"):
        validate(tmp_path)
    assert main(["--reference", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_columns_are_found_by_short_names_and_brackets_may_hold_commas(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text("a(worst, if > 1),b=c/d,e\n1,2,3\n4,5,0.60001\n")
    table = read_csv(file)
    assert table["a"].tolist() == [1, 4] and table["b"].tolist() == [2, 5] and "c" not in table
    assert table.resolution("e") == pytest.approx([5e-6, 5e-7])
