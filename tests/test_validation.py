"""Every reference table under tests/data, by the checkers that know it, in each precision (tests/validation)."""

from collections.abc import Iterator
from itertools import groupby

import pytest
from folders import REFERENCE

from tests.validation import aerosonde, contact, multirotor, rao
from tests.validation.case import Folder
from tests.validation.report import Job, jobs

LONG = ("cybership2", "hydrostatics", "otter", "wamv")  # sections that compile a model each: among the slow tests only
# Checkers that run long. test_contact.py has the legs, blocks and tips of contact's table.
SLOW = (rao.rao, aerosonde.trajectory, multirotor.series, contact.closed_forms)
INPUTS = {  # files without a check of their own: other tables or, of the turns, test_mmg.py read them
    "turn_35.csv", "turn_-20.csv",
    *(f"41010.{ending}" for ending in ("data_spec", "swdir", "swdir2", "swr1", "swr2")),
    "box_4x2x0.5_added_mass_damping.csv", "box_4x2x0.5_meta.json", "params_x500.json", "series_meta.json",
    "aerosonde.toml", "otter.toml", "unity_seed.toml",
}  # fmt: skip


def tables() -> Iterator:
    """Each table with the jobs about it, for each precision in which there are some."""
    for path, found in groupby(jobs(Folder(REFERENCE)), key=lambda job: job.path):
        about = list(found)
        slow = path.parent.name in LONG or any(job.checker.function in SLOW for job in about)
        for precision in ("f64", "f32"):
            here = [job for job in about if precision in job.checker.precisions]
            if here:
                name = f"{path.relative_to(REFERENCE).as_posix()}-{precision}"
                yield pytest.param(here, precision, id=name, marks=[pytest.mark.slow] * slow)


@pytest.mark.parametrize(("about", "precision"), tables())
def test_a_reference_table_passes(about: list[Job], precision: str):
    folder = Folder(about[0].path.parent)
    checks = [check for job in about for check in job.checks(folder, precision)]
    assert checks, "every checker declines it"
    assert not [check for check in checks if not check.passed]


def test_every_file_is_a_table_or_the_input_of_one():
    judged = {job.path for job in jobs(Folder(REFERENCE))}
    assert {path.name for path in Folder(REFERENCE).files() if path not in judged} == INPUTS
