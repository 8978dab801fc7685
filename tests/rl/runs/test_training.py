"""What a run leaves behind, and that training and evaluation are the same again for the same seed."""

import csv
import hashlib
import json
import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import ITERATIONS, TEAMS, TINY, command, content, onnx_session, sets, tiny_config, tiny_run
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader

from rl.commands import shared
from rl.commands.play import main as play
from rl.evaluation.checkups import check_stage
from rl.evaluation.episodes import judge_episodes
from rl.learn.env import MissionEnv
from rl.learn.policy import policies_of
from rl.learn.runner import StageRunner
from rl.learn.stages import train_stages
from rl.missions import load_scenario
from rl.missions.formation.judge import FormationJudge
from rl.missions.formation.mission import Formation
from rl.runs import folder as run_folder
from rl.train import main as train
from taichi_sim.config.io import config_folder

ROWS = 3 * 8  # vehicles times environments


@pytest.fixture(scope="module")
def trained() -> Path:
    return tiny_run()


def policies(run: Path):
    return policies_of("policy", run, run_folder.load_config(run)[0])


def history(file: Path) -> list[dict[str, str]]:
    """Return the rows of progress.csv without the times."""
    with file.open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "wall_time_s"} for row in csv.DictReader(stream)]


# -- what is left behind ------------------------------------------------------------------------------------


def test_the_summary_holds_times_stages_and_evaluation(trained):
    summary = json.loads((trained / "summary.json").read_text())
    assert {"wall_time_s", "stages", "evaluation"} <= set(summary)
    assert summary["wall_time_s"] > 0
    assert [stage["team"] for stage in summary["stages"]] == list(TEAMS)
    for stage in summary["stages"]:
        assert set(stage) == {
            "name", "team", "iterations", "agent_steps", "wall_time_s", "agent_steps_per_s", "processes",
            "environments",
        }  # fmt: skip
        assert (stage["processes"], stage["environments"]) == (1, 8)
        assert stage["iterations"] == ITERATIONS
        assert stage["agent_steps"] == ITERATIONS * ROWS * 8
        assert stage["agent_steps_per_s"] == pytest.approx(stage["agent_steps"] / stage["wall_time_s"], rel=0.01)
    assert sum(stage["wall_time_s"] for stage in summary["stages"]) < summary["wall_time_s"]


def test_the_evaluation_holds_every_figure_of_both_teams(trained):
    evaluation = json.loads((trained / "summary.json").read_text())["evaluation"]
    assert set(evaluation) == {
        "controller", "scenario", "seed", "episodes", "teams", "worst_episode", "median_episode",
    }  # fmt: skip
    assert evaluation["controller"] == "policy" and evaluation["scenario"] == "paper"
    assert (evaluation["seed"], evaluation["episodes"]) == (1000, 4)
    assert list(evaluation["teams"]) == list(TEAMS)
    for figures in evaluation["teams"].values():
        assert set(figures) == set(FormationJudge.definitions) == {
            "leader_error_rms_m", "leader_error_p95_m", "follower_error_rms_m", "follower_error_p95_m", "team_error_m",
            "cross_track_rms_m", "evasions_per_hour", "least_gap_m", "collisions_per_hour", "collision_free_episodes",
            "action_change_rms", "success_rate",
        }  # fmt: skip
        assert all(math.isfinite(value) for value in figures.values())
        assert 0 <= figures["success_rate"] <= figures["collision_free_episodes"] <= 1


def test_the_files_are_there(trained):
    for team in TEAMS:
        found = {p.name for p in (trained / team).iterdir()}
        assert found >= {"policy.onnx", "policy.pt", "progress.csv", f"model_{ITERATIONS}.pt"}
        assert any("tfevents" in name for name in found)
        rows = history(trained / team / "progress.csv")
        assert [row["iteration"] for row in rows] == [str(i) for i in range(ITERATIONS)]
        assert [int(row["agent_steps"]) for row in rows] == [(i + 1) * ROWS * 8 for i in range(ITERATIONS)]
    figures = list((trained / "figures").glob("*.png"))
    assert len(figures) == 7 and all(p.read_bytes().startswith(b"\x89PNG") for p in figures)
    assert not list(trained.rglob("*.part*"))


def test_the_configuration_is_kept_with_its_vehicles(trained):
    kept = load_scenario(trained / "config.toml")
    assert kept == tiny_config()
    for team in TEAMS:
        name = f"{kept.teams[team].vehicle}.toml"
        assert (trained / "vehicles" / name).read_text() == (config_folder() / "vehicles" / name).read_text()


def test_meta_says_what_a_result_depends_on(trained):
    meta = json.loads((trained / "meta.json").read_text())
    assert meta["seed"] == 1 and meta["scenario_file"] == "paper.toml"
    assert all(meta["packages"][name] for name in ("taichi", "torch", "rsl-rl-lib", "numpy", "taichi-sim"))
    assert meta["python"] and meta["machine"]["cpus"] >= 1
    assert meta["git_commit"] is None or len(meta["git_commit"].removesuffix("+changes")) == 40


def test_the_recordings_are_whole(trained, tmp_path):
    out = tmp_path / "mine.rrd"
    status = shared.run(play, [str(trained), "--out", str(out), "--duration", "2", "--quiet", "--threads", "1"])
    assert status == 0
    for file, root, steps in (
        (trained / "episode.rrd", "/untrained", 30),
        (trained / "episode.rrd", "/trained", 30),
        (out, "", 20),
    ):
        for team in TEAMS:
            chunks = RrdReader(file).stream().filter(content=f"{root}/world/{team}/vehicle_0", is_static=False)
            taken = {step for chunk in chunks for step in chunk.to_record_batch().column("step").to_pylist()}
            assert len(taken) == steps


def test_an_episode_is_a_bag_of_ros_2(trained, tmp_path):
    out = tmp_path / "mine.mcap"
    common = ["--duration", "1", "--quiet", "--threads", "1"]
    assert shared.run(play, [str(trained), "--out", str(out), "--origin", "-33.8", "151.2", *common]) == 0
    with AnyReader([out]) as reader:
        told = {topic: of.msgcount for topic, of in reader.topics.items() if topic.endswith("/fix")}
        connection, _, data = next(m for m in reader.messages() if m[0].topic == "/usv_0/fix")
        assert reader.deserialize(data, connection.msgtype).latitude == pytest.approx(-33.8, abs=0.02)
    assert told == {f"/{team}_{vehicle}/fix": 10 for team in TEAMS for vehicle in range(3)}


# -- policies -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("team", TEAMS)
def test_exported_networks_act_as_the_policy(team, trained):
    policy = policies(trained)[team]
    generator = torch.Generator().manual_seed(3)
    seen = 3 * torch.randn((1000, policy.num_observations), generator=generator)
    expected = policy.act(seen.unsqueeze(1)).squeeze(1)
    assert expected.abs().max() <= 1 and expected.std() > 0
    script = torch.jit.load(str(trained / team / "policy.pt"))
    torch.testing.assert_close(script(seen), expected, rtol=0, atol=1e-5)
    session = onnx_session(trained / team / "policy.onnx")
    (name,) = [i.name for i in session.get_inputs()]
    for rows in (1, 7, 1000):
        (actions,) = session.run(None, {name: seen[:rows].numpy()})
        np.testing.assert_allclose(actions, expected[:rows], rtol=0, atol=1e-5)


def fingerprint(policy) -> str:
    digest = hashlib.sha256()
    for key, tensor in sorted(policy.actor.state_dict().items()):
        digest.update(key.encode() + tensor.numpy().tobytes())
    return digest.hexdigest()


def test_a_run_keeps_the_policies_with_which_its_training_began(trained):
    before = policies_of("untrained", trained, run_folder.load_config(trained)[0])
    assert list(before) == list(TEAMS)
    assert all(fingerprint(before[team]) != fingerprint(policies(trained)[team]) for team in TEAMS)


def test_the_frozen_policy_does_not_change_while_the_other_team_learns(trained, tmp_path):
    config = tiny_config()
    usv = policies(trained)["usv"]
    seen = torch.randn((50, 3, usv.num_observations), generator=torch.Generator().manual_seed(3))
    weights, actions = fingerprint(usv), usv.act(seen)
    env = MissionEnv(Formation(config, 8, seed=2), "uav", {"usv": usv})
    learner = StageRunner(env, config.stages["uav"], tmp_path, logger="none")
    before = {k: v.clone() for k, v in learner.alg.get_policy().state_dict().items()}
    learner.train(show_progress=False)
    assert not list(tmp_path.glob("*tfevents*")) and (tmp_path / f"model_{ITERATIONS}.pt").is_file()
    after = learner.alg.get_policy().state_dict()
    assert any(not torch.equal(before[k], after[k]) for k in before)
    assert fingerprint(usv) == weights
    assert torch.equal(usv.act(seen), actions)


def test_checkups_run_all_policies_of_a_stage_on_the_same_episodes(trained, tmp_path):
    """Equal weights have equal figures; a run that lost its checkups holds them again from its checkpoints."""
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    config, source = run_folder.load_config(run)
    file = run / "uav" / "checkups.csv"
    rows = history(file)
    assert [(row["controller"], int(row["iteration"])) for row in rows] == [
        ("classical", 0), ("policy", 0), ("policy", 1), ("policy", 3), ("policy", 4),
    ]  # fmt: skip
    assert set(FormationJudge.plotted) < set(rows[0]) and rows[1] != rows[4]
    check_stage(config, run, "uav", source=source, show_progress=False)  # held already
    assert history(file) == rows
    file.unlink()
    shutil.copy(run / "uav" / "model_4.pt", run / "uav" / "model_1.pt")
    check_stage(config, run, "uav", source=source, show_progress=False)
    again = history(file)
    assert again[:2] == rows[:2] and again[3:] == rows[3:]
    own = ("iteration", "agent_steps")
    assert [{k: v for k, v in row.items() if k not in own} for row in (again[2],)] == [
        {k: v for k, v in rows[4].items() if k not in own}
    ]


def test_a_logger_that_is_not_installed_is_named_with_its_extra(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "wandb", None)
    assert shared.run(train, ["--logger", "wandb", "--out", str(tmp_path / "out")]) == 1
    assert 'wandb is not installed: pip install "taichi-sim[wandb]"' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# -- the same again -----------------------------------------------------------------------------------------


def fresh(folder: Path, *overrides: str) -> Path:
    config = load_scenario("paper", (*TINY, *overrides))
    run_folder.create(folder, config, config_folder() / "paper.toml")
    return folder


def test_training_is_the_same_again_for_the_same_seed(trained, tmp_path):
    run = fresh(tmp_path / "again")
    train_stages(run_folder.load_config(run)[0], run, show_progress=False)
    other = fresh(tmp_path / "other", "seed=2")
    first = run_folder.load_config(other)[0]
    first = first.model_copy(update={"stages": {"usv": first.stages["usv"]}})
    train_stages(first, other, show_progress=False)
    for team in TEAMS:
        assert history(run / team / "progress.csv") == history(trained / team / "progress.csv")
        assert fingerprint(policies(run)[team]) == fingerprint(policies(trained)[team])
    assert history(other / "usv" / "progress.csv") != history(run / "usv" / "progress.csv")


@pytest.mark.slow
def test_evaluation_is_the_same_on_any_number_of_threads_and_again(trained, tmp_path):
    wanted = ["--episodes", 40, "--seed", 5, "--set", "episode_duration=4"]
    texts = []
    for threads in (1, 2):
        file = tmp_path / f"{threads}.json"
        ending = command("rl.commands.evaluate", trained, "--threads", threads, "--json", file, *wanted)
        assert ending.status == 0, ending.err
        assert not ending.out
        texts.append(file.read_text())
    assert texts[0] == texts[1]
    config, source = run_folder.load_config(trained, ["episode_duration=4"])
    again = judge_episodes(config, policies(trained), episodes=40, seed=5, source=source, show_progress=False).result
    assert again == json.loads(texts[0])


def test_evaluation_leaves_the_run_as_it_was(trained, tmp_path):
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    before = content(run)
    config, source = run_folder.load_config(run)
    for kind in ("policy", "classical"):
        result = judge_episodes(
            config, policies_of(kind, run, config), episodes=2, seed=1, controller=kind, source=source,
            show_progress=False,
        ).result  # fmt: skip
        assert result["controller"] == kind and set(result["teams"]) == set(TEAMS)
    assert content(run) == before


# -- one team only ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("team", TEAMS)
def test_one_team_alone_is_trained_judged_and_recorded(team, tmp_path):
    paper = (config_folder() / "paper.toml").read_text()
    head, _, rest = paper.partition("[stages.usv]")
    tail = rest[rest.index("[evaluation]") :]
    scenario = tmp_path / "one.toml"
    scenario.write_text(f'{head}[stages.only]\nteam = "{team}"\n\n{tail}')
    own = [text.replace(f"stages.{team}", "stages.only") for text in TINY]
    own = [text for text in own if not text.startswith(("stages={}", "stages.usv", "stages.uav"))]
    out = tmp_path / "run"
    ending = command("rl.train", "--config", scenario, "--out", out, *sets(*own))
    assert ending.status == 0, ending.err
    summary = json.loads((out / "summary.json").read_text())
    assert [(s["name"], s["team"]) for s in summary["stages"]] == [("only", team)]
    assert list(summary["evaluation"]["teams"]) == [team]
    assert (out / "episode.rrd").is_file() and (out / team / "policy.onnx").is_file()
    assert not (out / ("uav" if team == "usv" else "usv")).exists()


@pytest.mark.slow
def test_one_vehicle_a_team_has_no_followers_to_judge(tmp_path):
    out = tmp_path / "run"
    ending = command("rl.train", "--config", "paper", "--out", out, *sets(*TINY, "usv.count=1", "uav.count=1"))
    assert ending.status == 0, ending.err
    for figures in json.loads((out / "summary.json").read_text())["evaluation"]["teams"].values():
        assert figures["follower_error_rms_m"] is None and figures["follower_error_p95_m"] is None
        assert figures["leader_error_rms_m"] > 0
