"""Sweeps: what their files may say, which cells they mean, and that they can be interrupted."""

import csv
import json
from pathlib import Path

import pytest
from command_line import tiny_config, tiny_run
from folders import PLUGINS

from rl.evaluation import sweeps as sweeping
from rl.evaluation.sweeps import cells, count_cells, find_sweep, load_sweep
from rl.learn.policy import policies_of
from rl.missions import load_scenario
from rl.runs import folder as run_folder
from taichi_sim.config import ConfigError

TWO_AXES = """
episodes = 3
seed = 77
[[axis]]
name = "sea"
keys = ["sea.hs", "sea.tp"]
values = [[0.2, 4.0], [9.0, 4.0]]
[[axis]]
name = "team"
keys = ["*.count"]
values = [2, 3]
"""


@pytest.fixture
def file(tmp_path) -> Path:
    made = tmp_path / "two.toml"
    made.write_text(TWO_AXES)
    return made


def swept(run: Path, file: Path, kinds=("policy", "classical"), **options) -> Path:
    config, source = run_folder.load_config(run)
    found = {
        f"{name}": policies_of(kind, run, config) for name, kind in zip(("policy", "classical"), kinds, strict=True)
    }
    contest = sweeping.Contest(run, config, source, lambda overrides: load_scenario(source, (), overrides), found)
    return sweeping.run_sweep(load_sweep(file), file, contest, show_progress=False, **options)


# -- files --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("values = [2, 3]", "values = []", ("axis 'team' has no values",)),
        ('["*.count"]', "[]", ("axis 'team' has no keys",)),
        ("[9.0, 4.0]", "[9.0]", ("axis 'sea'", "1 values for 2 keys")),
        ("values = [2, 3]", "values = [2, 3]\nlabels = ['pair']", ("axis 'team' has 1 labels for 2 values",)),
        ('name = "team"', 'name = "sea"', ("two axes of one name",)),
        ("episodes", "episdoes", ("episdoes", "did you mean 'episodes'")),
        ('"sea.hs"', '"sea.hss"', ("axis 'sea': sea.hss: unknown key", "did you mean 'hs'")),
        ('"*.count"', '"*.cuont"', ("axis 'team': usv.cuont: unknown key", "did you mean 'count'")),
        ('"*.count"', '"obstacle.count"', ("unknown key", "did you mean 'obstacles'")),
        ("seed = 77", "seed = 1000", ("seed = 1000 is the evaluation's",)),
        ("seed = 77", "seed = 1", ("seed = 1 is the training's",)),
    ],
)
def test_a_mistake_in_a_sweep_is_named_and_nothing_is_made(before, after, words, file, here):
    assert before in TWO_AXES
    file.write_text(TWO_AXES.replace(before, after))
    here("rl.commands.evaluate", tiny_run(), "--sweep", file).fails("two.toml", *words)
    assert not (tiny_run() / "sweeps").exists()


def test_a_missing_sweep_is_named_with_those_there_are(here):
    here("rl.commands.evaluate", tiny_run(), "--sweep", "gone").fails("gone", "no such sweep file", "default")
    here("rl.commands.evaluate", tiny_run(), "--sweep", "default", "--json", "x.json").fails("leave out --json")


# -- cells --------------------------------------------------------------------------------------------------


def test_axes_are_varied_alone_or_against_each_other(file):
    config, sweep = tiny_config(), load_sweep(file)
    alone = list(cells(sweep, config, file))
    assert [cell.values for cell in alone[:2]] == [{}, {"sea": (0.2, 4.0)}]
    assert alone[1].overrides == ("sea.hs=0.2", "sea.tp=4.0") and alone[3].overrides == ("usv.count=2", "uav.count=2")
    grid = sweep.model_copy(update={"grid": True})
    product = [cell.values for cell in cells(grid, config, file)]
    assert product[1] == {"sea": (0.2, 4.0), "team": 3}
    assert (len(alone), len(product)) == (count_cells(sweep), count_cells(grid)) == (5, 4)


def test_values_may_have_labels():
    """A wedge of 8, told as 8; all six formations in turn, told as the seconds between."""
    file = find_sweep("teams")
    told = [(cell.values, cell.overrides) for cell in cells(load_sweep(file), tiny_config(), file)]
    assert (
        {"size of a wedge": 8},
        ("usv.formation=wedge", "uav.formation=wedge", "usv.count=8", "uav.count=8"),
    ) in told
    values, overrides = told[-1]
    assert values == {"formation changes every": 20} and "usv.formation.change_every=20.0" in overrides


def test_a_value_may_be_a_share_of_what_the_scenario_has():
    """Six obstacles a km on 4 km; 10 kt; half of the target's 12 m/s."""
    file = find_sweep("default")
    found = {text for cell in cells(load_sweep(file), tiny_config(), file) for text in cell.overrides}
    assert {"obstacles.count=24", "air.speed=5.14444", "sea.current.speed=6.0", "sea.sea_state=6"} <= found


@pytest.mark.parametrize("name", ["paper", pytest.param("cruise", marks=pytest.mark.slow), "aerosonde"])
def test_the_shipped_sweep_fits_the_shipped_scenarios(name):
    """All cells of `paper` can be loaded; in the others it is values, never keys, that may be refused."""
    config, file, refused = load_scenario(name), find_sweep("default"), []
    for cell in cells(load_sweep(file), config, file):
        assert cell.missing is None
        try:
            load_scenario(name, (), cell.overrides)
        except ConfigError as error:
            refused.append(str(error))
    assert len(refused) <= 1 and not any("unknown key" in text for text in refused)


def test_an_axis_may_be_the_variation_or_a_range(file):
    for key, value in (("variation", "2.0"), ("vary.sea.hs", "[[0.2, 0.8]]"), ("*.vary.mass", "[[40, 60]]")):
        file.write_text(f'[[axis]]\nname = "vary"\nkeys = ["{key}"]\nvalues = [{value}]\n')
        *_, last = cells(load_sweep(file), tiny_config(), file)
        assert last.missing is None
        config = load_scenario("paper", (), last.overrides)
        assert (config.variation, len(config.vary), len(config.teams["usv"].vary)) in {(2, 0, 0), (1, 1, 0), (1, 0, 1)}


def test_what_a_scenario_has_not_is_no_mistake(file):
    config = load_scenario(PLUGINS / "buoys.toml")
    for key, words in (("uav.count", "no team 'uav'"), ("obstacles.count", "mission 'buoys:Buoys' has no such key")):
        file.write_text(TWO_AXES.replace("*.count", key))
        found = list(cells(load_sweep(file), config, file))
        assert words in found[3].missing and found[1].missing is None


# -- going through them -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_pairs_its_controllers_and_tells_what_cannot_be(run, file, here):
    ending = here("rl.commands.evaluate", run, "--sweep", file)
    assert ending.status == 0, ending.err
    found = json.loads((run / "sweeps" / "two" / "sweep.json").read_text())
    own, calm, steep, pair, three = found["cells"]
    assert own["cannot_be"] == calm["cannot_be"] == three["cannot_be"] == pair["cannot_be"] == {}
    assert all("too steep" in reason for reason in steep["cannot_be"].values()) and len(steep["cannot_be"]) == 2
    assert pair["teams"] != own["teams"]
    assert three["teams"] == own["teams"]  # three vehicles are what the run has
    for of in own["teams"]["usv"], calm["teams"]["uav"]:
        for figure, (value, low, high) in of["difference"].items():
            assert value == pytest.approx(of["policy"][figure][0] - of["classical"][figure][0], rel=1e-3, abs=1e-4)
            assert low <= value <= high
    rows = list(csv.DictReader((run / "sweeps" / "two" / "sweep.csv").open()))
    assert {row["sea"] for row in rows} == {"", "0.2, 4", "9, 4"}
    assert sum("too steep" in row["cannot be"] for row in rows) == 2
    assert "Sweep two" in (run / "report.html").read_text()


def test_a_controller_compared_with_itself_differs_by_nothing(run, file):
    out = swept(run, file, ("classical", "classical"))
    for cell in json.loads((out / "sweep.json").read_text())["cells"]:
        for team in cell["teams"].values():
            for numbers in team["difference"].values():  # shares have the interval of shares alike
                assert numbers == [None] * 3 or (numbers[0] == 0.0 and numbers[1] == -numbers[2])


@pytest.mark.slow
def test_an_interrupted_sweep_goes_on_and_ends_in_the_same_bytes(run, file, monkeypatch):
    tables = [swept(run, file) / name for name in ("sweep.json", "sweep.csv")]
    whole = [table.read_bytes() for table in tables]
    (tables[0].parent / "cells.jsonl").unlink()
    measure, measured = sweeping._measure, []

    def two_of_them(cell, *rest):
        measured.append(cell)
        if len(measured) == 3:
            raise KeyboardInterrupt
        return measure(cell, *rest)

    monkeypatch.setattr(sweeping, "_measure", two_of_them)
    for table in tables:
        table.unlink()
    with pytest.raises(KeyboardInterrupt, match="2 of 5 cells .* the same command continues"):
        swept(run, file)
    with (tables[0].parent / "cells.jsonl").open("a") as lines:
        lines.write('{"key": "cut sh')  # by a kill
    swept(run, file)
    assert len(measured) == 3 + 3  # the two that were done are not measured again
    assert [table.read_bytes() for table in tables] == whole


def test_a_hundred_thousand_cells_are_told_of_and_begun(run, file, monkeypatch):
    file.write_text(
        f'seed = 77\n[[axis]]\nname = "sea"\nkeys = ["sea.direction_deg"]\nvalues = {list(range(100_000))}\n'
    )
    measured, told = [], []

    def measure(cell, *rest):
        measured.append(cell)
        if len(measured) > 10:
            raise KeyboardInterrupt
        return {"cannot_be": {}, "teams": {}}

    monkeypatch.setattr(sweeping, "_measure", measure)
    monkeypatch.setattr(sweeping.time, "perf_counter", iter((0.0, 6.0)).__next__)
    with pytest.raises(KeyboardInterrupt, match="10 of 100001 cells"):
        swept(run, file, tell=told.append)
    assert told == [
        "99998 cells left, about 2.3 days (the first 3 took 2 s each); after Ctrl-C the same command continues"
    ]
