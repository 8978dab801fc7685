"""The benchmark: tasks are frozen, scores lie between the levels, and what cannot be scored is refused."""

import json
from typing import cast

import numpy as np
import pytest
import torch
from test_headroom import bound, episodes

from rl.evaluation import benchmark
from rl.evaluation.benchmark import Task, frozen, open_task, read_tasks, score, task_file, team_score, told
from rl.evaluation.headroom import Bound
from rl.learn.policy import ClassicalPolicy
from rl.learn.policy_interface import interface_of
from rl.missions import load_scenario, make_mission
from rl.missions.formation.judge import FormationJudge
from taichi_sim.config.io import config_folder, find_config
from taichi_sim.kernels import runtime

TASK = Task(scenario="lanes", teams=("usv",), figure="team_error_m", digest="-")


@pytest.mark.parametrize("name", read_tasks())
def test_a_task_is_what_was_frozen(name):
    """Never mend this by a new digest: a task that others have cited gets a new version."""
    task = read_tasks()[name]
    assert frozen(task) == task.digest
    _, config, levels = open_task(name)
    kind = benchmark.mission_class(config, task.source).Judge
    assert levels.keys() == set(task.teams) <= set(config.trained)
    for level in levels.values():
        assert {task.figure, task.safe} <= kind.pooled(level.classical).keys()


def scored(learned: float, oracle: float | None = 1.0, collided: int = 0):
    level = cast(Bound, bound(2.0, 1.0 if oracle is None else oracle))
    level = level._replace(oracle={}) if oracle is None else level
    own = episodes(learned) | {"collided": (np.arange(40) < collided).astype(float)}
    return team_score(TASK, FormationJudge, level, own)


def test_the_classical_controller_scores_0_the_oracle_100_and_collisions_mark_a_score():
    for learned, wanted in ((2.0, 0), (1.0, 100), (1.5, 50), (2.5, -50)):
        found = scored(learned)["score"]
        assert found is not None and found == pytest.approx((wanted, wanted, wanted), abs=1e-9)
    assert told("lanes-v2", TASK, "usv", scored(1.25), 40).startswith("lanes-v2, usv: 75 (75 to 75); 40 episodes")
    for collided, unsafe in ((0, False), (1, True)):
        found = scored(1.5, collided=collided)
        assert found["unsafe"] == unsafe == (", unsafe;" in told("x", TASK, "usv", found, 40))


def test_without_an_oracle_there_is_a_ratio_and_no_score():
    found = scored(1.0, oracle=None)
    assert found["score"] is None and found["ratio"] == pytest.approx((0.5, 0.5, 0.5))
    assert "no score (no oracle has run); 0.50 (0.50 to 0.50) times" in told("x", TASK, "usv", found, 40)


def small_task(monkeypatch, tmp_path, here) -> None:
    """In place of the frozen tasks: 3 short episodes of lanes."""
    folder = tmp_path / "configs"
    (folder / "benchmark").mkdir(parents=True)
    text = (config_folder() / "lanes.toml").read_text()
    text = text.replace("episode_duration = 60.0", "episode_duration = 4.0").replace("settle = 20.0", "settle = 1.0")
    (folder / "lanes.toml").write_text(text)
    (folder / "vehicles").symlink_to(config_folder() / "vehicles")
    for module in ("rl.evaluation.benchmark", "rl.evaluation.headroom"):
        monkeypatch.setattr(f"{module}.config_folder", lambda: folder)
    task_file().write_text('[small-v1]\nscenario = "lanes"\nteams = ["usv"]\nfigure = "team_error_m"\ndigest = "-"\n')
    done = here("tools.oracle", folder / "lanes.toml", "--classical", "--team", "usv", "--episodes", 3)
    assert done.status == 0, done.err
    task_file().write_text(task_file().read_text().replace('"-"', f'"{frozen(read_tasks()["small-v1"])}"'))


def run_score(here, *arguments):
    return here("rl.commands.score", *arguments)


def test_a_task_is_scored_by_one_command(here, tmp_path, monkeypatch):
    small_task(monkeypatch, tmp_path, here)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def still(rows):\n    return 0 * rows[:, :2]\n")
    ending = run_score(here, "small-v1", "--policy", "mine:still", "--json", "score.json")
    assert ending.status == 0, ending.err
    assert "mine:still: names no observations" in ending.err
    # a correction of nothing is the classical controller
    assert ending.out == "small-v1, usv: no score (no oracle has run); 1.00 (1.00 to 1.00) times the classical " \
        "team_error_m; 3 episodes\n"  # fmt: skip
    stored = json.loads((tmp_path / "score.json").read_text())
    assert stored["task"] == "small-v1" and stored["digest"] == read_tasks()["small-v1"].digest
    assert stored["teams"]["usv"]["episodes"] == 3 == len(stored["teams"]["usv"]["of_each_episode"]["collided"])
    (tmp_path / "configs" / "lanes.toml").write_text(
        (tmp_path / "configs" / "lanes.toml").read_text().replace("decision_interval = 0.1", "decision_interval = 0.2")
    )
    run_score(here, "small-v1", "--policy", "mine:still").fails("small-v1", "has changed since the task was frozen")


def test_what_cannot_be_scored_is_refused(here):
    run_score(here, "otter-v2", "--policy", "x.onnx").fails("otter-v2: no such task, did you mean 'otter-v1'?")
    run_score(here, "otter-v1", "--policy", "gone.onnx").fails("gone.onnx: not a network in ONNX")
    run_score(here, "otter-v1", "--policy", "x.onnx", "--controller", "honest").fails("--policy x.onnx", "leave one")
    ending = run_score(here, "otter-v1", "--policy", "x.onnx", "--episodes", "8")
    assert ending.status == 2 and "unrecognized arguments: --episodes 8" in ending.err  # episodes are frozen


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({task.scenario for task in read_tasks().values()} | {"escort"}))
def test_every_observation_is_described(name):
    config, source = load_scenario(name), find_config(name)
    mission = make_mission(benchmark.mission_class(config, source).one_each(config, 1), 1, seed=0, source=source)
    for team in (mission.teams[team] for team in config.trained):
        assert team.layout.keys() <= team.meanings.keys(), (team.name, team.layout.keys() - team.meanings.keys())
        interface = interface_of(team)
        assert tuple(interface["observations"]) == team.observation_names
        assert tuple(interface["actions"]) == team.action_names


@pytest.mark.slow
def test_describe_prints_a_task_as_text_and_json(here):
    text = here("rl.commands.describe", "otter-v1").out
    assert text.startswith("usv: 3 vehicles, a decision every 0.2 s") and "encounters" in text
    described = json.loads(here("rl.commands.describe", "otter-v1", "--json").out)
    assert len(described["usv"]["actions"]) == 2 and "78 observations" in text
    assert len(described["usv"]["observations"]) == 78


@pytest.mark.slow
@pytest.mark.parametrize("name", read_tasks())
def test_figures_of_a_task_repeat_to_the_digit_on_any_number_of_threads(name):
    """And the classical controller, run anew, is at its kept level, to rounding between machines."""
    task, config, levels = open_task(name)
    found = []
    for threads in (1, 2):
        runtime.init(threads=threads)
        torch.set_num_threads(threads)
        found.append(score(task, config, levels, {team: ClassicalPolicy() for team in task.teams}))
    assert found[0] == found[1]
    json.dumps(found[0], allow_nan=False)  # what has no number is null
    for scored in found[0].values():
        assert scored["ratio"].value == pytest.approx(1.0, abs=0.03) and not scored["unsafe"]
