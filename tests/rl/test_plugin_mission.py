"""A mission of somebody else's, by the contract alone: two teams of one kind learn in turn, a script steers a third."""

import inspect
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from command_line import onnx_session, sets
from folders import PLUGINS
from refusal import assert_says

from rl.adapters.gymnasium import TeamVectorEnv
from rl.evaluation.episodes import judge_episodes, one_episode_each
from rl.judge import Judge
from rl.learn.history import read_history
from rl.learn.policy import CheckpointError, TrainedPolicy, load_policy, policies_of
from rl.learn.stages import train_stages
from rl.missions import load_scenario, make_mission
from rl.runs import folder as run_folder
from rl.runs import main_job
from rl.scenario import Scenario
from taichi_sim.config.io import config_folder, vehicle_file
from taichi_sim.world import World

FILE = PLUGINS / "buoys.toml"
NORTH = 0


@pytest.fixture(scope="module")
def config():
    return load_scenario(FILE)


@pytest.fixture(scope="module")
def trained(config, tmp_path_factory) -> Path:
    """A run folder, from where everything is found again without the scenario's own folder."""
    out = tmp_path_factory.mktemp("runs") / "buoys"
    run_folder.create(out, config, FILE)
    copy, source = run_folder.load_config(out)
    train_stages(copy, out, source=source, show_progress=False)
    return out


def test_a_run_keeps_no_file_in_place_of_another_of_its_name(tmp_path):
    """The teams of a run would all have the vehicle, or the module, that was copied last."""
    text = (config_folder() / "vehicles" / "unity_boat.toml").read_text()
    for name, more in (("one", ""), ("two", "\n"), ("three", "\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "boat.toml").write_text(text + more)

    def create(boats: str, scouts: str) -> None:
        vehicles = [f"{team}.vehicle={tmp_path}/{of}/boat.toml" for team, of in (("boats", boats), ("scouts", scouts))]
        run_folder.create(tmp_path / "run", load_scenario(FILE, vehicles), FILE)

    with pytest.raises(run_folder.RunError, match="two.boat.toml: another boat.toml is a file of this scenario, too"):
        create("one", "two")
    assert not (tmp_path / "run").exists()
    create("two", "three")  # the same in two places


def test_a_training_reads_the_copies_in_its_folder(here, tmp_path, monkeypatch):
    """All its processes do, and exchange objects of their classes; other files may change meanwhile."""
    boat = shutil.copy(config_folder() / "vehicles" / "unity_boat.toml", tmp_path / "my_boat.toml")
    seen: list[Scenario] = []
    monkeypatch.setattr(main_job, "run_main_job", lambda config, out, **options: seen.append(config))
    out = tmp_path / "run"
    assert here("rl.train", "--config", FILE, "--out", out, *sets(f"boats.vehicle={boat}")).status == 0
    assert Path(inspect.getfile(type(seen[0]))) == out / "buoys.py"
    assert vehicle_file(seen[0].teams["boats"], out / "config.toml") == out / "vehicles" / "my_boat.toml"


def ferry(mission) -> float:
    """How far north (m) the ferry is in the first environment."""
    return float(mission.world.teams["ferry"].position_n[0, 0, NORTH])


def test_a_team_is_a_section_with_a_vehicle_and_a_mission_adds_its_keys(config):
    assert list(config.teams) == ["boats", "scouts", "ferry"]
    assert config.trained == ("boats", "scouts") and config.scripted == ("ferry",)
    assert load_scenario(FILE, ["buoy_distance=7"]).buoy_distance == 7.0


def test_teams_learn_in_turn_and_the_mission_logs_what_it_says(trained):
    assert (trained / "buoys.py").is_file()
    for team, iterations in (("boats", 2), ("scouts", 1)):
        history = read_history(trained / team / "progress.csv")
        assert history["iteration"].tolist() == list(range(iterations))
        assert 0 < history["distance"][0] < 100
        assert (trained / team / "policy.onnx").is_file()
    assert not (trained / "ferry").exists()


@pytest.mark.parametrize("kind", ["policy", "classical"])
def test_scripted_teams_get_no_policy(kind, trained, config):
    assert list(policies_of(kind, trained, config)) == ["boats", "scouts"]


def test_the_default_judge_measures_every_team_but_the_scripted_one(trained):
    config, source = run_folder.load_config(trained)
    policies = policies_of("policy", trained, config)
    result = judge_episodes(config, policies, episodes=3, seed=5, source=source, show_progress=False).result
    assert list(result["teams"]) == ["boats", "scouts"]
    for figures in result["teams"].values():
        assert set(figures) == set(Judge.definitions)
        assert figures["collision_free_episodes"] == 1.0 and "success_rate" not in figures
        assert -5.0 < figures["reward_per_step"] < 0.0


def test_a_scripted_team_is_simulated_beside_whichever_teams_take_part(config):
    """From the same place at the beginning of every episode, as far, whoever else is there."""
    sailed = []
    for teams in (None, ("scouts",)):
        mission = make_mission(config, 2, seed=1, teams=teams, source=FILE)
        assert "ferry" not in mission.teams and "ferry" in mission.world.teams
        for _ in range(2):
            start = ferry(mission)
            for _ in range(10):
                mission.step({name: torch.zeros_like(team.action) for name, team in mission.teams.items()})
            sailed.append((start, ferry(mission) - start > 1.0))
            mission.reset()
    assert sailed == [(0.0, True)] * 4


def test_a_scripted_team_is_simulated_in_an_evaluation(config):
    mission = one_episode_each(config, ("boats",), 2, seed=1, source=FILE)
    assert list(mission.teams) == ["boats"] and list(mission.world.scripts) == ["ferry"]


@pytest.mark.parametrize("other", ["absent", "constant", "trained"])
def test_gymnasium_steps_a_team_while_the_script_acts(other, request):
    given = request.getfixturevalue("trained") if other == "trained" else other
    env = TeamVectorEnv("scouts", 2, scenario=FILE, other=given)
    assert list(env.task.teams) == (["scouts"] if other == "absent" else ["boats", "scouts"])
    observed, _ = env.reset(seed=1)
    assert observed.shape == (2, 2 + 2 + 3)
    before = ferry(env.task)
    for _ in range(3):
        _, reward, terminated, truncated, infos = env.step(np.zeros(env.action_space.shape, np.float32))
    assert (reward < 0).all() and not (terminated | truncated).any()
    assert set(infos) >= {"reward_vehicle", "diverged", "capsized"}
    assert ferry(env.task) > before


def test_gymnasium_does_not_act_for_a_script():
    with pytest.raises(ValueError, match="a script acts for 'ferry'; allowed are boats, scouts"):
        TeamVectorEnv("ferry", 2, scenario=FILE)


def test_a_bare_world_steps_its_scripts_without_the_mission():
    world = World.from_scenario(FILE, 2, ("boats.count=1",), teams=("ferry",))
    for _ in range(10):
        world.step()
    assert float(world.teams["ferry"].position_n[0, 0, NORTH]) > 0.1


# -- what a policy was trained on ---------------------------------------------------------------------------------


SEEN = ["buoy.0", "buoy.1", "heading.0", "heading.1", "velocity.0", "velocity.1", "velocity.2"]
DONE = ["acceleration", "yaw"]


def test_a_checkpoint_names_what_its_policy_observes_and_commands(trained, config):
    assert load_policy(trained, config, "boats").signature == {"observations": SEEN, "actions": DONE}


def test_exported_networks_carry_the_names(trained):
    extra = {"signature.json": ""}
    torch.jit.load(str(trained / "boats" / "policy.pt"), _extra_files=extra)
    assert json.loads(extra["signature.json"]) == {"observations": SEEN, "actions": DONE}
    metadata = onnx_session(trained / "boats" / "policy.onnx").get_modelmeta().custom_metadata_map
    assert {key: json.loads(value) for key, value in metadata.items()} == {"observations": SEEN, "actions": DONE}


@pytest.fixture
def other_actions(tmp_path) -> str:
    """Override the boats by a vessel that takes three forces."""
    text = (config_folder() / "vehicles" / "otter_3dof.toml").read_text()
    file = tmp_path / "three_forces.toml"
    file.write_text(text.replace('"acceleration_yaw"', '"surge_sway_yaw"'))
    return f"boats.vehicle={file}"


def refused(run: Path, override: str) -> str:
    """The message with which an evaluation of a run's policies in another scenario is refused."""
    config, source = run_folder.load_config(run, [override], FILE)
    policies = policies_of("policy", run, config)
    with pytest.raises(CheckpointError) as caught:
        judge_episodes(config, policies, episodes=1, seed=5, source=source, show_progress=False)
    return str(caught.value)


def test_what_a_policy_was_not_trained_on_is_refused_by_name(trained, other_actions):
    file = trained / "boats" / "model_2.pt"
    assert_says(
        refused(trained, "blind=true"), file, "observations", "it was trained on 'velocity', which boats has not"
    )
    assert_says(
        refused(trained, other_actions), file, "actions", "it was trained on 'acceleration', which boats has not",
        "boats has 'surge', 'sway', which it was not trained on",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("observations", "said"),
    [
        (SEEN[:4], "boats has 'velocity', which it was not trained on"),
        ([*SEEN, "gap"], "it was trained on 'gap', which boats has not"),
        ([*SEEN[:4], "velocity.0", "velocity.1"], "trained on 2 numbers of 'velocity', boats has 3"),
        ([*SEEN[2:], *SEEN[:2]], "their order differs"),
    ],
)
def test_each_difference_of_observations_is_told(observations, said, trained, config):
    actor = load_policy(trained, config, "boats").actor
    team = SimpleNamespace(name="boats", observation_names=tuple(SEEN), action_names=tuple(DONE))
    TrainedPolicy(actor, {"observations": SEEN, "actions": DONE}).check(team)
    with pytest.raises(CheckpointError, match="policy: its observations differ") as caught:
        TrainedPolicy(actor, {"observations": observations, "actions": DONE}).check(team)
    assert_says(str(caught.value), said)
