"""tools/compare.py: runs against the classical controller, alone and together."""

import json
import shutil

import pytest
from command_line import sets


@pytest.mark.slow
def test_runs_are_compared_with_the_classical_controller_alone_and_together(here, run, tmp_path):
    other, third = (shutil.copytree(run, tmp_path / name) for name in ("other", "third"))
    ending = here("tools.compare", run, other, third, "--episodes", 6, "--seed", 5, *sets("evaluation.settle=0"))
    assert ending.status == 0, ending.err
    head, _, *rows = ending.out.strip().splitlines()
    assert head.count("|") == 6
    names = [row.split("|")[1].strip() for row in rows]
    assert names == [f"`paper`, {team}, {name}" for team in ("usv", "uav") for name in ("run", "other", "third", "all")]
    cells = [row.split("|")[2:6] for row in rows]
    assert cells[0] == cells[1]  # the same policy on the same episodes
    alone, together = (cells[k][0].split(":")[0] for k in (0, 3))
    assert alone == together  # their pool has the same figures, twice as many episodes
    assert all(" / " in cell and "(" in cell for row in cells for cell in row)


def rows_of(text: str, team: str) -> dict[str, list[str]]:
    """Cells of a team's table, by figure."""
    lines = text[text.index(f"| {team}, ") :].split("\n\n")[0].strip().splitlines()[2:]
    return {line.split("|")[1].strip(" `"): [cell.strip() for cell in line.split("|")[2:6]] for line in lines}


def test_a_run_is_compared_with_another_on_the_same_episodes(here, run, tmp_path):
    """Kept evaluations are used; of the same policy nothing differs. Ratios are of figures that are never negative."""
    other = shutil.copytree(run, tmp_path / "other")
    ending = here("tools.compare", run, other)
    assert ending.status == 0, ending.err
    assert ending.out.count("its last evaluation") == 2 and "judged now" not in ending.out
    rows = rows_of(ending.out, "usv")
    own = json.loads((run / "evaluation" / "policy.json").read_text())["teams"]["usv"]
    assert rows["team_error_m"][0].split()[0] == f"{own['team_error_m']:.3g}"
    assert all(row[0] == row[1] for row in rows.values())
    assert rows["team_error_m"][2].split()[0] == "0" and rows["team_error_m"][3].split()[0] == "1"
    assert rows["least_gap_m"][3] == "-" and rows["success_rate"][3] == "-"
    assert rows["leader_error_p95_m"][2:] == ["-", "-"]


def test_groups_are_compared_on_episodes_that_are_judged_again_where_they_differ(here, run, tmp_path):
    """Two copies of a run are one: the same difference to the classical controller, with the same interval."""
    other, calm = shutil.copytree(run, tmp_path / "other"), ("--episodes", 3, "--seed", 5)
    alone, both = (here("tools.compare", *calm, *side, "--", "classical") for side in ([run], [run, other]))
    assert alone.status == both.status == 0, alone.err + both.err
    assert both.out.count("judged now") == 3
    one, two = rows_of(alone.out, "usv"), rows_of(both.out, "usv")
    assert one["team_error_m"] == two["team_error_m"] and "to" in one["team_error_m"][2]
    text = (other / "config.toml").read_text()
    (other / "config.toml").write_text(text.replace("depth = ", "depth = 1").replace("hs = ", "hs = 1"))
    moved = here("tools.compare", run, other)
    assert moved.status == 0, moved.err
    assert "other learned in another scenario" in moved.out and moved.out.count("judged now") == 1


def test_a_side_without_runs_is_refused(here, run):
    assert "a side has no run" in here("tools.compare", run, "--").err


def test_a_run_without_a_policy_is_named(here, tmp_path):
    here("tools.compare", tmp_path).fails("not a run folder")
