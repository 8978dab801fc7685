"""The commands as a user meets them: bad input ends in a clear message and makes nothing."""

import subprocess
import sys

import pytest
from command_line import TIMEOUT, TINY, Ending, sets

from rl.evaluation.episodes import told
from rl.missions import load_scenario
from rl.missions.formation.judge import FormationJudge
from taichi_sim.config.io import config_folder


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("usv.cuont=5", ("usv.cuont", "did you mean 'count'")),
        ("storm.hs=1", ("storm", "unknown key")),
        ("escort.worlds=2", ("escort", "belongs to the mission escort, and this scenario's is Formation")),
        ("usv.lost_distance=1e300", ("usv.lost_distance = 1e+300", "less than or equal to 1000000000000000")),
        ("usv.terms.fine.scale=1e-300", ("fine.scale = 1e-300", "allowed are 1e-30 to 1e+15")),
        ("sea.tp=nan", ("sea.tp",)),
        ("usv.vehicle=submarine", ("submarine", "unity_boat")),
        ("usv.vehicle=/nowhere/boat.toml", ("/nowhere/boat.toml", "no such vehicle file")),
        ("usv.vehicle=cruise", ("'cruise'", "a scenario, not a vehicle")),
        ("stages.usv.team=tug", ("stages.usv.team", "'tug'")),
    ],
)
def test_a_wrong_key_or_value_is_named_and_nothing_is_made(override, words, here, tmp_path):
    here("rl.train", "--config", "paper", "--out", tmp_path / "new", "--set", override).fails(*words)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('name = "x"\n[usv\n', ("not valid TOML", "line 2")),
        ('name = "x"\n', ("there is no team", "has a vehicle")),
        ("\xff\xfe", ("cannot be read",)),
        ("", ("name: missing",)),
    ],
)
def test_a_malformed_scenario_is_named(text, words, here, tmp_path):
    (tmp_path / "mine.toml").write_bytes(text.encode("latin-1"))
    here("rl.train", "--config", tmp_path / "mine.toml", "--out", tmp_path / "new").fails("mine.toml", *words)
    assert not (tmp_path / "new").exists()


def test_a_missing_scenario_is_named_with_those_there_are(here, tmp_path):
    ending = here("rl.train", "--config", tmp_path / "gone.toml", "--out", tmp_path / "new")
    ending.fails("gone.toml", "no such configuration file", "paper")


def test_an_episode_too_short_to_judge_is_refused_before_training(here, tmp_path):
    ending = here("rl.train", "--config", "paper", "--out", tmp_path / "new", *sets(*TINY, "evaluation.settle=3"))
    ending.fails("episode_duration", "evaluation.settle")
    assert not list(tmp_path.rglob("*.pt"))


def test_a_scenario_without_stages_is_refused(here, tmp_path):
    paper = (config_folder() / "paper.toml").read_text()
    (tmp_path / "mine.toml").write_text("\n".join(line for line in paper.split("[stages.usv]")[0].splitlines()) + "\n")
    here("rl.train", "--config", tmp_path / "mine.toml", "--out", tmp_path / "new").fails("stages", "nothing to train")


@pytest.mark.slow
def test_a_run_that_is_not_evaluated_ends_with_training_and_is_evaluated_on_resumption(here, tmp_path):
    ending = here("rl.train", "--config", "paper", "--out", tmp_path / "new", "--no-evaluation", *sets(*TINY))
    assert ending.status == 0 and "--resume" in ending.out, ending.err
    made = {file.name for file in (tmp_path / "new").iterdir()} - {".lock"}
    assert made == {"config.toml", "meta.json", "usv", "uav", "vehicles"}
    assert (tmp_path / "new" / "usv" / "policy.onnx").is_file()
    assert not (tmp_path / "new" / "usv" / "checkups.csv").exists()
    assert here("rl.train", "--out", tmp_path / "new", "--resume").status == 0
    assert (tmp_path / "new" / "summary.json").is_file() and (tmp_path / "new" / "usv" / "checkups.csv").is_file()


def test_a_sea_too_steep_is_refused(here, tmp_path):
    ending = here("rl.train", "--config", "paper", "--out", tmp_path / "new", *sets(*TINY, "sea.hs=10", "sea.tp=6"))
    ending.fails("too steep", "sea.hs")


@pytest.mark.parametrize("arguments", [["--threads", "0"], ["--seed", "-1"], ["--seed", "x"], ["--what"], ["word"]])
def test_bad_arguments_are_refused(arguments, here):
    ending = here("rl.train", *arguments)
    assert ending.status == 2 and "usage:" in ending.err
    assert arguments[0] in ending.err


@pytest.mark.parametrize("module", ["rl.commands.evaluate", "rl.commands.play", "rl.commands.report"])
def test_what_is_not_a_run_is_named(module, here, tmp_path):
    here(module, tmp_path / "gone").fails("gone", "not a run folder")
    here(module, tmp_path).fails(str(tmp_path), "not a run folder")


def test_evaluate_help_defines_every_figure():
    from rl.commands.evaluate import parser

    text = parser().format_help()
    for key, definition in FormationJudge.definitions.items():
        assert f"{key}:" in text and definition in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("train", ["--set", "usv.cuont=5"], "usv.cuont"),
        ("evaluate", ["gone"], "not a run folder"),
        ("play", ["gone"], "not a run folder"),
    ],
)
def test_the_commands_themselves_end_with_the_message_and_status(name, arguments, words, tmp_path):
    """By default the same messages and statuses are tested in this process, and tiny_run is a script that ends well."""
    script = [sys.executable, "-m", "rl.commands.main", name, *arguments]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, timeout=TIMEOUT)
    Ending(done.returncode, done.stdout, done.stderr).fails(words)
    assert not list(tmp_path.iterdir())


def test_a_team_without_measured_time_is_reported():
    nothing = dict.fromkeys(FormationJudge.definitions, None) | {"collision_free_episodes": 0.5, "success_rate": 0.0}
    text = told({"episodes": 2, "controller": "policy", "teams": {"usv": nothing}}, load_scenario("paper"))
    assert "usv" in text and "50.0 %" in text
