"""What `tools/validate.py` reads from names and files of hulls, and its page."""

import shutil

import numpy as np
import pytest
from folders import REFERENCE

from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from tests.validation import document, froude_krylov
from tests.validation.box import Box
from tests.validation.otter_numbers import current, shaft_command
from tests.validation.parameters import refined
from tests.validation.report import validate


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("straight_n80", (80, 80)),
        ("turning_n90_n-50", (90, -50)),
        ("turning_from_n80_to_n100_n60", (100, 60)),
        ("turning_n100_n60_from_n80", (100, 60)),
        ("straight_n72.5_from_zero_attitude", (72.5, 72.5)),
        ("decay_heave", None),
        ("drift_current_0.3mps_120deg", None),
    ],
)
def test_shaft_speeds_are_read_from_the_name(name, expected):
    assert shaft_command(name) == expected


def test_the_current_is_read_from_the_name():
    assert current("drift_current_0.3mps_120deg") == pytest.approx((-0.15, 0.3 * np.sqrt(0.75)))
    assert current("rhs_samples_current_0.5mps_toward_90deg") == pytest.approx((0.0, 0.5))
    assert current("rhs_samples_no_current") == (0.0, 0.0)


def test_rounded_numbers_are_refined_and_others_kept():
    assert refined([1.234568, 2.0], [1.2345678, 2.1]) == [1.2345678, 2.0]


def _copy(folder, *names):
    for name in names:
        shutil.copy(REFERENCE / name, folder)


def _edit_column(file, column, factor):
    header, *rows = (line.split(",") for line in file.read_text().splitlines())
    at = header.index(column)
    for row in rows:
        row[at] = repr(float(row[at]) * factor)
    file.write_text("\n".join(",".join(row) for row in (header, *rows)) + "\n")


def test_a_wrong_acceleration_fails(tmp_path):
    _copy(tmp_path, "otter/rhs_samples_no_current.csv", "params/otter.toml")
    _edit_column(tmp_path / "rhs_samples_no_current.csv", "d_q", 1 + 1e-4)
    failed = {check.quantity for check in validate(tmp_path).checks if not check.passed}
    assert failed == {"d_q, relative"}


def test_a_parameter_in_the_directory_counts(tmp_path):
    _copy(tmp_path, "otter/rhs_samples_no_current.csv", "params/otter.toml")
    file = tmp_path / "otter.toml"
    file.write_text(file.read_text().replace("G44 = 967.266192", "G44 = 970.0"))
    failed = {check.quantity for check in validate(tmp_path).checks if not check.passed}
    assert "d_p, relative" in failed and "d_u, relative" not in failed


def test_a_table_that_every_checker_declines_has_no_check(tmp_path):
    _copy(tmp_path, "otter/crossflow_drag_samples.csv")
    (tmp_path / "rhs_samples_other.csv").write_text("a,b\n1,2\n")
    (tmp_path / "summary_other.json").write_text('{"a": 1}')
    report = validate(tmp_path)
    assert report.passed
    assert report.unchecked == ["rhs_samples_other.csv", "summary_other.json"]


@pytest.mark.slow
def test_froude_krylov_heave_in_finite_depth(f64):
    depth = 3.0
    box = Box(4.0, 2.0, 0.5, KG=0.6, mass=4100.0)
    omega, direction = np.array([1.0, 2.0, 3.0]), np.deg2rad([0.0, 30.0, 90.0])
    F = froude_krylov.load(box, omega, direction, depth)
    k = omega**2 / GRAVITY
    for _ in range(500):  # the fixed point of the dispersion relation
        k = omega**2 / GRAVITY / np.tanh(k * depth)
    sinc = np.sinc(k * np.cos(direction) * 2.0 / np.pi) * np.sinc(k * np.sin(direction) / np.pi)
    heave = RHO_SEA * GRAVITY * 8.0 * np.cosh(k * (depth - 0.5)) / np.cosh(k * depth) * sinc
    assert F[:, 2].real == pytest.approx(heave, rel=0.01)
    assert np.abs(F[:, 2].imag).max() < 1e-3 * heave.max()


@pytest.mark.slow
def test_page_has_sections_figures_and_pictures(tmp_path, monkeypatch):
    tables = tmp_path / "reference" / "hydrostatics"
    tables.mkdir(parents=True)
    _copy(tables, "hydrostatics/gz_wall_sided.csv", "hydrostatics/box_4x2x0.5.json")
    _edit_column(tables / "gz_wall_sided.csv", "righting_moment_Nm", 1.1)
    monkeypatch.setattr(document, "PICTURES", [p for p in document.PICTURES if p.name in ("response", "righting")])
    report = validate(tables.parent)
    missing = document.write(report, tables.parent, tmp_path / "docs" / "page.md")
    text = (tmp_path / "docs" / "page.md").read_text()
    assert "## Hydrostatics" in text and "1 failed" in text
    assert "**righting_moment_Nm, relative: 9.1e-02, failed**" in text
    assert (
        "![righting](page/righting.png)" in text and (tmp_path / "docs" / "page" / "righting.png").stat().st_size > 9999
    )
    assert missing == ["response: no box_*_rao.csv"] and "response.png" not in text
