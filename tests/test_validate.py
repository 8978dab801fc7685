import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.validation import aerosonde, multirotor, rao
from tests.validation.registry import CHECKERS
from tests.validation.report import NothingToCheckError, validate
from tests.validation.tables import read_csv

ROOT = Path(__file__).parents[1]

REFERENCE = ROOT / "tests" / "data" / "reference"
DISPERSION = "dispersion_g9.81.csv"
SECTIONS = sorted(p.name for p in REFERENCE.iterdir() if p.name != "params")
LONG = ("cybership2", "hydrostatics", "otter", "wamv")  # compile a model each: among the slow tests only
SLOW = (rao.rao, aerosonde.trajectory, multirotor.series)  # checkers that run long
BESIDE_LATER = {"box_4x2x0.5_meta.json", "box_4x2x0.5_added_mass_damping.csv", "series_meta.json"}  # of slow ones
EXPECTED = {
    "waves": {
        ("sea6_deep_gerstner_queries.csv", "f64"),
        ("sea8_depth6_airy_velocity_pressure.csv", "f32"),
    },
    "unity": {("boat_m100_L6_B2.5_script_dt0.02.csv", "f64"), ("aircraft_script_dt0.02.csv", "f64")},
    "otter": {("rhs_samples_no_current.csv", p) for p in ("f64", "f32")},
    "hydrostatics": {("froude_krylov_box.csv", "f64"), ("gerstner_exact_pressure_lambda20_a0.5.csv", "f32")},
    "wamv": {("surge_step_500N_m211.csv", "f32"), ("buoyancy_per_point.csv", "f64")},
    "cybership2": {("rhs_samples.csv", "f64"), ("summary.json", "f32")},
    "dryden": {("dryden_discrete.csv", "f64")},
    "buoys": {("41010.spec", "f64")},
    "multirotor": {("x500_rhs_samples_C.csv", "f32"), ("trims.json", "f64"), ("closed_forms_x500.json", "f64")},
    "aerosonde": {
        ("rhs_samples_A.csv", "f32"),
        ("trim_and_modes_Va25.json", "f64"),
        ("mavsim_solution_code_elevator_doublet_A_dt0.01.csv", "f64"),
    },
}


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


@pytest.mark.usefixtures("f64")  # each starts in double precision
@pytest.mark.parametrize("section", [s for s in SECTIONS if s not in LONG])
def test_reference_tables_pass_in_both_precisions(section):
    quick = [checker for checker in CHECKERS if checker.function not in SLOW]
    later = {
        p.name
        for p in (REFERENCE / section).iterdir()
        for c in CHECKERS
        if c.function in SLOW and c.match(p) is not None
    }
    report = validate(REFERENCE / section, quick)
    assert not [check for check in report.checks if not check.passed]
    assert {(check.table, check.precision) for check in report.checks} >= EXPECTED.get(section, set())
    assert set(report.unchecked) <= later | BESIDE_LATER


@pytest.mark.slow
@pytest.mark.parametrize("section", SECTIONS)
def test_reference_tables_pass_slow_ones_too(section):
    report = validate(REFERENCE / section)
    assert not [check for check in report.checks if not check.passed]
    assert report.unchecked == []


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


def test_tool_fails_on_a_wrong_value(tables):
    _edit(tables / DISPERSION, "4.02430352746", "4.02433352746")
    result = _tool("--reference", tables, "--json", tables / "out.json")
    assert result.returncode == 1
    assert "FAIL" in result.stdout
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


def test_missing_and_empty_directories_are_errors(tmp_path):
    with pytest.raises(NothingToCheckError, match="no such directory"):
        validate(tmp_path / "nowhere")
    (tmp_path / "other.csv").write_text("a\n1\n")
    with pytest.raises(NothingToCheckError, match="no table that a checker knows"):
        validate(tmp_path)
    result = _tool("--reference", tmp_path / "nowhere")
    assert result.returncode == 2
    assert "nowhere" in result.stderr and "Traceback" not in result.stderr


def test_columns_are_found_by_short_names_and_brackets_may_hold_commas(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text("a(worst, if > 1),b=c/d,e\n1,2,3\n4,5,0.60001\n")
    table = read_csv(file)
    assert table["a"].tolist() == [1, 4] and table["b"].tolist() == [2, 5] and "c" not in table
    assert table.resolution("e") == pytest.approx([5e-6, 5e-7])
