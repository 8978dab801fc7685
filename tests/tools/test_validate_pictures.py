"""Pictures of the validation page about the aircraft and its air: they follow the tables, or say which is missing."""

import shutil

import numpy as np
import pytest
from folders import REFERENCE

from tests.validation.case import Folder
from tests.validation.plots import PICTURES, modes, trim, turbulence
from tests.validation.plots.finer import finer
from tests.validation.tables import Table, TableError, read_json

TABLE = REFERENCE / "aerosonde" / "trim_and_modes_Va25.json"
WITHOUT_TABLE = ("spectrum", "zigzag", "load_factor", "kernels", "convergence")

pytestmark = pytest.mark.usefixtures("f64")


@pytest.fixture
def folder(tmp_path):
    """A directory with the table of trims."""
    shutil.copy(TABLE, tmp_path)
    return Folder(tmp_path)


@pytest.mark.parametrize("picture", [p for p in PICTURES if p.name not in WITHOUT_TABLE], ids=lambda p: p.name)
def test_a_picture_without_its_table_says_which(picture, tmp_path):
    with pytest.raises(TableError, match="no "):
        picture.draw(Folder(tmp_path))


def test_curves_of_trim_pass_through_the_points_of_the_table(folder, monkeypatch):
    monkeypatch.setattr(trim, "AIRSPEEDS", 25)
    for axes in trim.draw(folder).axes:
        curves = [line for line in axes.lines if len(line.get_xdata()) > 9]
        marks = {line.get_color(): line for line in axes.lines if len(line.get_xdata()) == 1}
        assert {curve.get_color() for curve in curves} == set(marks)
        for curve in curves:
            Va, value = (np.asarray(x)[0] for x in marks[curve.get_color()].get_data())
            assert np.interp(Va, curve.get_xdata(), curve.get_ydata()) == pytest.approx(value, rel=0.01)


def test_crosses_of_modes_are_inside_the_circles_of_the_table(folder, monkeypatch):
    monkeypatch.setattr(modes, "STEPS", 9)
    axes = modes.draw(folder).axes[0]
    crosses = [np.array(line.get_data()).T for line in axes.lines if line.get_marker() in ("x", "+")]
    circles = np.array(
        [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "o" and len(line.get_xdata())]
    )
    given = [
        mode for key, case in read_json(TABLE).items() if key[:2] in ("A_", "B_") for mode in case["modes"].values()
    ]
    assert sum(len(c) for c in crosses) == len(given) == 10
    for cross in np.concatenate(crosses):
        assert np.linalg.norm(circles - cross, axis=1).min() < 1e-3


def test_an_aircraft_that_cannot_fly_so_fast_has_no_picture_of_modes(folder):
    file = folder.root / TABLE.name
    file.write_text(file.read_text().replace('"Va": 25.0', '"Va": 55.0'))
    with pytest.raises(TableError, match="no trim"):
        modes.draw(folder)


@pytest.mark.parametrize("row", [0, 1, 2])
def test_density_holds_the_variance(row):
    V, h, W20 = 25.0, 50.0, 7.5
    length, sigma = (x[row] for x in turbulence.scales(h, W20))
    omega = np.geomspace(1e-5, 30.0, 20001)
    x = length / V * omega[-1]
    # the part below omega, of u: 2/pi atan x; of v and w: 2/pi atan x - x / (pi (1 + x^2))
    part = 2 / np.pi * np.arctan(x) - (0 if row == 0 else x / (np.pi * (1 + x**2)))
    found = np.trapezoid(turbulence.density(row, omega, V, h, W20), omega) / sigma**2
    assert found == pytest.approx(part, abs=1e-4)


def test_rows_in_between_keep_inputs_and_go_on_in_time():
    table = Table(("t", "n"), (("1", "5"), ("2", "6"), ("3", "7")))
    dense = finer(table, 4)
    assert dense["t"].tolist() == [1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0]
    assert dense["n"].tolist() == [5.0] * 4 + [6.0] * 4 + [7.0]
