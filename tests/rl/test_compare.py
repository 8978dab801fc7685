"""tools/compare.py: runs against the classical controller, alone and together."""

import shutil

import pytest
from command_line import sets


@pytest.mark.slow
def test_runs_are_compared_with_the_classical_controller_alone_and_together(here, run, tmp_path):
    other = shutil.copytree(run, tmp_path / "other")
    ending = here("tools.compare", run, other, "--episodes", 6, "--seed", 5, *sets("evaluation.settle=0"))
    assert ending.status == 0, ending.err
    head, _, *rows = ending.out.strip().splitlines()
    assert head.count("|") == 6
    names = [row.split("|")[1].strip() for row in rows]
    assert names == [f"`paper`, {team}, {name}" for team in ("usv", "uav") for name in ("run", "other", "all")]
    cells = [row.split("|")[2:6] for row in rows]
    assert cells[0] == cells[1]  # the same policy on the same episodes
    alone, together = (cells[k][0].split(":")[0] for k in (0, 2))
    assert alone == together  # their pool has the same figures, twice as many episodes
    assert all(" / " in cell and "(" in cell for row in cells for cell in row)


def test_a_run_without_a_policy_is_named(here, tmp_path):
    here("tools.compare", tmp_path).fails("not a run folder")
