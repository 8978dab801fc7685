"""Actors act as in training wherever they came from, and those with a memory forget where an episode begins."""

from pathlib import Path

import pytest
import torch
from command_line import TINY, onnx_session
from rsl_rl.models import MLPModel, RNNModel
from tensordict import TensorDict

from rl.learn.actor import Actor
from rl.learn.export import TORCHSCRIPT
from rl.learn.policy import TrainedPolicy, load_policy
from rl.learn.policy_sources import read_onnx
from rl.learn.runner import OBS_GROUPS, actor_config
from rl.learn.stages import train_stages
from rl.missions import load_scenario, make_mission
from rl.runs import folder as run_folder
from rl.scenario import StageConfig
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder

UNITS, ENVS, DECISIONS = 8, 5, 14
MEMORY = (f"stages.usv.gru={UNITS}", "stages.usv.mini_batches=4", "usv.count=2", "episode_duration=0.6")


def trained(folder: Path, *overrides: str) -> Path:
    """A run of the boats alone."""
    config = load_scenario("paper", (*TINY, *MEMORY, *overrides))
    config = config.model_copy(update={"stages": {"usv": config.stages["usv"]}})
    run_folder.create(folder, config, config_folder() / "paper.toml")
    train_stages(config, folder, source=config_folder() / "paper.toml", show_progress=False)
    return folder


@pytest.fixture(scope="module")
def recurrent(tmp_path_factory) -> Path:
    """A trained run."""
    return trained(tmp_path_factory.mktemp("recurrent") / "run")


def model_of(stage: StageConfig, actor: Actor) -> MLPModel:
    """rsl-rl's model of a stage with the weights of `actor`."""
    options, rows = actor_config(stage), TensorDict({"policy": torch.zeros(1, actor.inputs)}, [1])
    kind = {kind.__name__: kind for kind in (MLPModel, RNNModel)}[options.pop("class_name")]
    model = kind(rows, OBS_GROUPS, "actor", len(actor.distribution["std_param"]), **options)
    model.load_state_dict(actor.state_dict(), strict=True)
    return model


@pytest.mark.parametrize("activation", ["elu", "relu", "tanh"])
def test_an_actor_is_the_model_of_its_training_to_the_bit(activation):
    stage, rows = StageConfig(team="usv", activation=activation, hidden_dims=(32, 16)), torch.randn(100, 7)
    actor = Actor(stage, 7, 2)
    assert actor(rows).equal(model_of(stage, actor)(TensorDict({"policy": rows}, [100])))


def boats(run: Path):
    """A mission of the run, whose environments are at different times of their episodes, and the policy."""
    config, source = run_folder.load_config(run)
    mission = make_mission(config, ENVS, seed=3, teams=["usv"], source=source)
    return mission, load_policy(run, config, "usv")


def test_it_acts_as_in_training_over_episodes_and_so_do_its_files(recurrent):
    """rsl-rl's own memory, reset as in training, is the reference."""
    mission, policy = boats(recurrent)
    (other, same), team = boats(recurrent), mission.teams["usv"]
    model = model_of(mission.config.stages["usv"], same.actor)
    onnx, session = read_onnx(recurrent / "usv" / "policy.onnx"), onnx_session(recurrent / "usv" / "policy.onnx")
    script, kept = torch.jit.load(recurrent / "usv" / TORCHSCRIPT), torch.zeros(2 * ENVS, UNITS)
    begun, moved = 0, torch.zeros(())
    for number in range(DECISIONS):
        if number == 2:  # one episode begins before the others end
            mission.reset([1])
            other.reset([1])
            model.reset(torch.arange(2 * ENVS).div(2, rounding_mode="floor") == 1)
            kept[2:4] = 0.0
        rows = team.observations().flatten(0, 1)
        wanted = model(TensorDict({"policy": rows}, [2 * ENVS])).detach().clamp(-1, 1)
        named = {"obs": rows.numpy(), "memory": kept.numpy()}
        by_runtime = torch.from_numpy(session.run(None, named)[0])
        by_script, kept = script(rows, kept)
        for found in (policy(team).flatten(0, 1), onnx(other.teams["usv"]).flatten(0, 1), by_script, by_runtime):
            torch.testing.assert_close(found, wanted, atol=2e-6, rtol=0)
        fresh = policy.act(team.observations()).flatten(0, 1)
        moved = moved.maximum((fresh - wanted).abs().max())
        over = mission.step({"usv": wanted.view(ENVS, 2, -1)}).over
        other.step({"usv": wanted.view(ENVS, 2, -1)})
        model.reset(over.repeat_interleave(2).long())
        kept[over.repeat_interleave(2)] = 0.0
        begun += int(over.sum())
    assert begun >= ENVS and moved > 1e-3  # episodes began; what was kept matters


def test_copies_of_an_episode_have_its_memory(recurrent):
    mission, policy = boats(recurrent)
    for _ in range(3):
        mission.step({"usv": policy}, begin=False)
    saved, fork = mission.snapshot(), mission.fork([2, 4])
    acted = policy(mission.teams["usv"])
    torch.testing.assert_close(policy(fork.teams["usv"]), acted[[2, 4]])
    mission.restore(saved)
    assert policy(mission.teams["usv"]).equal(acted)


def test_training_goes_on_from_a_memory_of_as_many_units(recurrent, tmp_path, capsys):
    trained(tmp_path / "on", f"stages.usv.start_from='{recurrent}'")
    told = capsys.readouterr().err
    config, _ = run_folder.load_config(tmp_path / "on")
    begun, was = (TrainedPolicy.load(file, config.stages["usv"]) for file in (
        tmp_path / "on" / "usv" / "model_0.pt", recurrent / "usv" / f"model_{config.stages['usv'].iterations}.pt"
    ))  # fmt: skip
    each = begun.num_observations
    assert f"memory ({each} of {each} observations), layer 1, layer 2, layer 3 (2 of 2 actions); critic taken" in told
    seen = torch.randn(4, 2, each)
    assert begun.act(seen).equal(was.act(seen))
    trained(tmp_path / "exported", f"stages.usv.start_from='{recurrent / 'usv' / 'policy.onnx'}'", "stages.usv.gru=0")
    assert "no layer: all begin anew; critic anew" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (("stages.usv.mini_batches=9",), "mini_batches at most 8"),
        (("stages.usv.planning.samples=8",), "planning improves none"),
        (("stages.again.team=usv", "stages.again.gru=4"), "stages.again.gru = 4: usv goes on with the networks"),
    ],
)
def test_what_has_no_memory_is_refused(overrides, told):
    with pytest.raises(ConfigError, match=told):
        load_scenario("paper", (*TINY, *MEMORY, *overrides))
