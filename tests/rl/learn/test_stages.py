"""Stages that go on from others: a team trained again, on other conditions, or from the weights of another run."""

import json
import math
from pathlib import Path

import pytest
import torch
from command_line import ITERATIONS, TINY, forget, iterations, sets

from rl.evaluation.episodes import judge_episodes
from rl.learn.history import read_rows
from rl.learn.policy import TrainedPolicy, checkpoints, read_checkpoint
from rl.learn.policy_sources import RowPolicy, policies_from, shipped_files, shipped_policies
from rl.learn.ppo import STEP
from rl.learn.stages import train_stages
from rl.learn.start_from import exported_weights
from rl.missions import load_scenario, make_mission
from rl.runs import folder as run_folder
from rl.scenario import at_stage
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder

AGAIN = (
    'stages.again.team="usv"', "stages.again.iterations=3", "stages.again.num_envs=4",
    "stages.again.steps_per_iteration=8", "stages.again.checkpoint_interval=1",
    "stages.again.initial_std=0.25", "stages.again.set.sea.hs=1.0",
    "stages.again.set.usv.count=2",
)  # fmt: skip


def begun(folder: Path, *overrides: str) -> Path:
    run_folder.create(folder, load_scenario("paper", (*TINY, *overrides)), config_folder() / "paper.toml")
    return folder


def weights(file: Path) -> dict[str, torch.Tensor]:
    return read_checkpoint(file)["actor_state_dict"]


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor], *but: str) -> bool:
    return all(torch.equal(one[key], other[key]) for key in one if key not in but)


def test_a_team_is_trained_again_after_another_and_its_history_goes_on(run, tmp_path):
    """The first two stages are those of the shared tiny run, whose files they begin with."""
    out = begun(tmp_path / "out", *AGAIN)
    for team in ("usv", "uav"):
        (run / team).rename(out / team)
    config, source = run_folder.load_config(out)
    first = {team: weights(out / team / f"model_{ITERATIONS}.pt") for team in ("usv", "uav")}
    results = train_stages(config, out, source=source, show_progress=False)
    assert [(r["name"], r["team"], r["iterations"]) for r in results] == [
        ("usv", "usv", ITERATIONS), ("uav", "uav", ITERATIONS), ("again", "usv", 3),
    ]  # fmt: skip
    assert [r["agent_steps"] for r in results] == [ITERATIONS * 8 * 24, ITERATIONS * 8 * 24, 3 * 8 * 4 * 2]
    assert iterations(out, "usv") == list(range(ITERATIONS + 3))
    assert checkpoints(out / "usv")[-1].name == f"model_{ITERATIONS + 3}.pt"
    assert same(weights(out / "uav" / f"model_{ITERATIONS}.pt"), first["uav"])  # it acted, frozen
    assert not same(weights(checkpoints(out / "usv")[-1]), first["usv"])
    usv = weights(out / "usv" / "model_5.pt")  # after one iteration more: near where it began, exploring anew
    assert same(weights(out / "usv" / f"model_{ITERATIONS}.pt"), first["usv"])
    assert abs(usv["distribution.std_param"] - 0.25).max() < 0.02
    assert max((usv[key] - first["usv"][key]).abs().max() for key in usv if key.startswith("mlp")) < 0.05
    again = train_stages(config, out, source=source, show_progress=False)  # all is done: nothing is trained
    assert again == results and iterations(out, "usv") == list(range(ITERATIONS + 3))


def test_a_stage_in_which_a_team_is_trained_again_is_killed_and_goes_on(run, tmp_path):
    out = begun(tmp_path / "out", *AGAIN)
    for team in ("usv", "uav"):
        (run / team).rename(out / team)
    config, source = run_folder.load_config(out)
    train_stages(config, out, source=source, show_progress=False)
    whole = weights(out / "usv" / "model_5.pt")
    for number in (6, 7):
        (out / "usv" / f"model_{number}.pt").unlink(missing_ok=True)
    train_stages(config, out, source=source, show_progress=False)
    assert iterations(out, "usv") == list(range(ITERATIONS + 3))
    assert same(weights(out / "usv" / "model_5.pt"), whole)
    assert json.dumps(train_stages(config, out, source=source, show_progress=False)).count('"usv"') == 3


def test_a_stage_trains_on_what_it_sets():
    config = load_scenario("paper", (*TINY, *AGAIN))
    assert at_stage(config, "usv") is config
    there = at_stage(config, "again")
    assert (there.sea.hs, there.usv.count, there.uav.count) == (1.0, 2, 3)
    assert config.sea.hs == 0.5 and there.stages == config.stages


def test_training_starts_from_the_weights_of_another_run(run, tmp_path):
    forget(run, "uav")
    out = begun(tmp_path / "out", f'stages.usv.start_from="{run}"')
    assert same(weights(out / "usv" / "model_0.pt"), weights(run / "usv" / f"model_{ITERATIONS}.pt"))
    config, source = run_folder.load_config(out)
    one = config.model_copy(update={"stages": {"usv": config.stages["usv"]}})
    train_stages(one, out, source=source, show_progress=False)
    assert iterations(out, "usv") == list(range(ITERATIONS))
    begin, later = weights(out / "usv" / "model_0.pt"), weights(out / "usv" / "model_1.pt")
    assert 0 < max((later[key] - begin[key]).abs().max() for key in begin if key.startswith("mlp")) < 0.05


BOATS_ALONE = ('stages.usv.start_from="pretrained"', "stages.usv.hidden_dims=[64,64]", "usv.count=3")


def boats_trained(out: Path) -> None:
    config, source = run_folder.load_config(out)
    train_stages(config.model_copy(update={"stages": {"usv": config.stages["usv"]}}), out, source=source,
                 show_progress=False)  # fmt: skip


def test_a_shipped_policy_is_trained_further(tmp_path, capsys):
    """Its actor is that of the exported file, whose names and actions it has."""
    out = begun(tmp_path / "out", *BOATS_ALONE)
    boats_trained(out)
    assert "3 of 3" not in (told := capsys.readouterr().err)
    assert "usv starts from pretrained: layer 1 (65 of 65 observations), layer 2, layer 3 (2 of 2 actions)" in told
    assert "critic anew" in told
    config, source = run_folder.load_config(out)
    mission = make_mission(config, 4, seed=1, teams=["usv"], source=source)
    began = TrainedPolicy.load(out / "usv" / "model_0.pt", config.stages["usv"])
    torch.testing.assert_close(began(mission.teams["usv"]), shipped_policies("paper")["usv"](mission.teams["usv"]))
    begin, later = weights(out / "usv" / "model_0.pt"), weights(out / "usv" / "model_1.pt")
    assert 0 < max((later[key] - begin[key]).abs().max() for key in begin if key.startswith("mlp")) < 0.1


def test_a_policy_of_other_observations_starts_with_the_weights_that_fit(tmp_path, capsys):
    """At first it acts as if the new observation were not there."""
    function = "usv.observe.turn='seen:turn'"
    (tmp_path / "seen.py").write_text("def turn(team):\n    return team.fleet.angular_velocity_b[..., 2:]\n")
    (tmp_path / "paper.toml").write_text((config_folder() / "paper.toml").read_text())
    config = load_scenario(tmp_path / "paper.toml", [*TINY, *BOATS_ALONE, function, "usv.observe.without=['role']"])
    out = tmp_path / "out"
    run_folder.create(out, config, tmp_path / "paper.toml")
    assert (out / "seen.py").is_file()
    boats_trained(out)
    assert "layer 1 (64 of 65 observations), layer 2, layer 3 (2 of 2 actions); at weight 0: turn" in (
        capsys.readouterr().err
    )
    whole = exported_weights(shipped_files("paper")["usv"])
    names, first = whole["infos"]["observations"], weights(out / "usv" / "model_0.pt")["mlp.0.weight"]
    assert not first[:, -1].any()
    kept = [k for k, name in enumerate(names) if name != "role"]
    assert first[:, :-1].equal(whole["actor_state_dict"]["mlp.0.weight"][:, kept])


def test_layers_of_another_size_begin_anew(tmp_path, capsys):
    out = begun(tmp_path / "out", BOATS_ALONE[0], "stages.usv.hidden_dims=[64,8]")
    boats_trained(out)
    assert "layer 1 (65 of 65 observations); anew: 2 of 3 layers" in capsys.readouterr().err


def test_a_finished_run_goes_on_for_longer_and_at_another_rate(here, run):
    more = ("stages.usv.iterations=1", "stages.uav.iterations=1")
    here("rl.train", "--out", run, "--resume", *sets(*more)).fails("stages.usv.iterations = 1", "has completed")
    given = (f"stages.uav.iterations={ITERATIONS + 2}", "stages.uav.learning_rate=1e-5")
    done = here("rl.train", "--out", run, "--resume", "--no-evaluation", "--threads", "1", *sets(*given))
    assert done.status == 0, done.err
    assert iterations(run, "uav") == list(range(ITERATIONS + 2)) and iterations(run, "usv") == list(range(ITERATIONS))
    config, _ = run_folder.load_config(run)
    assert config.stages["uav"].iterations == ITERATIONS + 2
    rates = [float(row["learning_rate"]) for row in read_rows(run / "uav" / "progress.csv")]
    steps = math.log(rates[ITERATIONS] / 1e-5, STEP)  # it adapts from the new rate; from 1e-3 it would miss by a third
    assert steps == pytest.approx(round(steps), abs=0.01)
    assert json.loads((run / "meta.json").read_text())["continued_with"] == list(given)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (['stages.again.team="usv"', "stages.again.hidden_dims=[32]"], ["stages.again.hidden_dims", "stages.usv"]),
        (['stages.again.team="usv"', 'stages.again.start_from="x"'], ["start_from", "stages.usv"]),
        (["stages.usv.set.sea.hss=1"], ["stages.usv.set", "did you mean 'hs'"]),
        (["stages.usv.set.variation=-1"], ["stages.usv.set", "variation", "0"]),
        (["stages.usv.set.evaluation.episodes=1"], ["stages.usv.set", "evaluation", "whole run"]),
        (['stages.usv.joint=["usw"]'], ["stages.usv.joint[0]", "did you mean 'usv'"]),
        (['stages.usv.joint=["usv"]'], ["stages.usv.joint", "twice"]),
        (['stages.usv.joint=["uav"]', "stages.uav.hidden_dims=[9]"], ["stages.uav.hidden_dims", "stages.usv"]),
        (['stages.usv.keep="better"'], ["stages.usv.keep", "nothing to compare", "start_from"]),
        (['stages.usv.frozen=["uav"]'], ["stages.usv.frozen", "uav", "no stage before"]),
        (['stages.uav.frozen=["uav"]'], ["stages.uav.frozen", "learns"]),
        (['stages.uav.frozen=["usv=pretrained"]'], ["stages.uav.frozen", "a given policy, and a stage that trains it"]),
        (['stages.uav.frozen=["usw=pretrained"]'], ["stages.uav.frozen", "did you mean 'usv'"]),
        (['stages.uav.frozen=["usv","usv"]'], ["stages.uav.frozen", "names a team twice"]),
        (["stages={}", "stages.a.team='uav'", 'stages.a.frozen=["usv=x.onnx"]'], ["stages.a.frozen", "pretrained"]),
    ],
)
def test_stages_that_cannot_be_are_refused(overrides, words):
    with pytest.raises(ConfigError) as refused:
        load_scenario("paper", overrides)
    for word in words:
        assert word in str(refused.value)


GIVEN = [*(text for text in TINY if not text.startswith("stages.usv")), 'stages.uav.frozen=["usv=pretrained"]']


@pytest.mark.slow
def test_a_team_acts_by_a_policy_of_the_package_that_no_stage_trains(here, tmp_path):
    """Aircraft of the paper learn while its boats act by the shipped policy, in training and in what follows it."""
    out = tmp_path / "out"
    done = here("rl.train", "--config", "paper", "--out", out, "--threads", "1", *sets(*GIVEN))
    assert done.status == 0, done.err
    config, _ = run_folder.load_config(out)
    assert config.trained == ("uav",) and config.acting == ("usv", "uav") and not (out / "usv").exists()
    acting = policies_from([str(out)], config)
    assert isinstance(acting["usv"], RowPolicy) and isinstance(acting["uav"], TrainedPolicy)
    told = json.loads((out / "summary.json").read_text())["evaluation"]["teams"]["usv"]
    both = {"usv": shipped_policies("paper")["usv"], "uav": acting["uav"]}
    judged = judge_episodes(config, both, episodes=4, seed=config.evaluation.seed, show_progress=False)
    assert told["team_error_m"] == pytest.approx(judged.result["teams"]["usv"]["team_error_m"])


def test_a_policy_of_the_package_that_is_not_there_is_named_before_anything_is_made(here, tmp_path):
    out = tmp_path / "out"
    here("rl.train", "--config", "paper", "--out", out, *sets(*GIVEN, "name='mine'")).fails("usv=pretrained", "mine")
    assert not out.exists()


def test_a_start_that_is_not_there_is_named_before_anything_is_made(here, tmp_path):
    out = tmp_path / "out"
    for place, word in (("nowhere", "no such run"), (tmp_path, "no trained usv policy")):
        ending = here("rl.train", "--config", "paper", "--out", out, *sets(*TINY, f'stages.usv.start_from="{place}"'))
        ending.fails("stages.usv.start_from", word)
        assert not out.exists()


JOINT = (
    'stages.together.team="uav"', 'stages.together.joint=["usv"]', "stages.together.iterations=2",
    "stages.together.num_envs=4", "stages.together.steps_per_iteration=8", "stages.together.checkpoint_interval=1",
    'stages.together.keep="better"',
)  # fmt: skip


def test_teams_learn_at_the_same_time_and_the_stage_is_dropped_where_it_made_them_worse(run, tmp_path):
    out = begun(tmp_path / "out", *JOINT)
    for team in ("usv", "uav"):
        (run / team).rename(out / team)
    config, source = run_folder.load_config(out)
    last = {team: out / team / f"model_{ITERATIONS + 2}.pt" for team in ("usv", "uav")}
    before = {team: weights(out / team / f"model_{ITERATIONS}.pt") for team in last}
    results = train_stages(config, out, source=source, show_progress=False)  # nobody judges: kept
    joint = {team: weights(file) for team, file in last.items()}
    assert all(not same(joint[team], before[team]) for team in last)
    assert results[-1]["agent_steps"] == 2 * 2 * 8 * 4 * 3 and "verdict" not in results[-1]
    assert iterations(out, "usv") == iterations(out, "uav") == list(range(ITERATIONS + 2))

    for team in last:  # killed when the leader's had not been written, and its mate's had
        (out / team / f"model_{ITERATIONS + 2}.pt").unlink()
    (out / "uav" / f"model_{ITERATIONS + 1}.pt").unlink()
    judged = []

    def worse(policies):
        judged.append(policies)
        return float(len(judged))

    results = train_stages(config, out, source=source, judged=worse, show_progress=False)
    assert [iterations(out, team) for team in last] == 2 * [list(range(ITERATIONS + 2))]
    assert results[-1]["verdict"] == {"kept": False, "loss_before": 1.0, "loss": 2.0}
    assert all(same(weights(last[team]), before[team]) for team in last)
    assert not same(judged[1]["usv"].actor.state_dict(), before["usv"])
    again = train_stages(config, out, source=source, judged=worse, show_progress=False)
    assert again == results and len(judged) == 2
