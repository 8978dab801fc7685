"""A planner as a teacher, and a critic that learns first."""

import pytest
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from tqdm import tqdm

from rl.learn.policy import OBS_GROUPS, actor_config, read_checkpoint
from rl.learn.stages import train_stages
from rl.learn.teacher import teach
from rl.missions import load_scenario, make_mission
from rl.scenario import TeacherConfig
from taichi_sim.config import ConfigError

FEW = (
    "track.worlds=8", "sea.realisations=4", "stages.usv.num_envs=8", "stages.usv.steps_per_iteration=4",
    "usv.plan.horizon=1.0", "usv.plan.every=0.5",
)  # fmt: skip
TEACHER = TeacherConfig(environments=8, decisions=12, rounds=2, epochs=60, samples=8)


def test_a_network_learns_what_the_planner_says():
    config = load_scenario("paper", FEW)
    mission = make_mission(config, 8, seed=1, teams=("usv",))
    own = mission.teams["usv"]
    options = actor_config(config.stages["usv"])
    options.pop("class_name")
    example = TensorDict({"policy": torch.zeros(1, len(own.observation_names))}, batch_size=[1])
    torch.manual_seed(0)
    actor = MLPModel(example, OBS_GROUPS, "actor", len(own.action_names), **options)
    first, later = (
        teach(mission, "usv", actor, TEACHER.model_copy(update={"epochs": n}), {}, seed=2, bar=tqdm(disable=True))[-1]
        for n in (1, 60)
    )
    assert later < 0.5 * first
    velocity = torch.tensor([1.5, -6.0]).expand(8, 3, 2)
    assert own.correction_for(velocity)[0, 0].tolist() == [0.5, -1.0]  # of 3 m/s
    alone = make_mission(load_scenario("paper", (*FEW, "usv.residual.velocity=0")), 2, seed=1, teams=("usv",))
    with pytest.raises(ConfigError, match=r"usv\.residual\.velocity: a teacher corrects velocities"):
        alone.teams["usv"].correction_for(velocity)


def test_a_stage_begins_with_its_teacher_and_the_critic_learns_first(tmp_path):
    """As long as the critic alone learns the actor stays as it was taught."""
    taught = []
    for name, iterations in (("one", 1), ("three", 3)):
        small = [f"stages.usv.teacher.{key}={value}" for key, value in TEACHER.model_dump().items()]
        overrides = (*FEW, *small, f"stages.usv.iterations={iterations}", "stages.usv.critic_first=2")
        config = load_scenario("paper", overrides)
        train_stages(
            config.model_copy(update={"stages": {"usv": config.stages["usv"]}}), tmp_path / name, show_progress=False
        )
        taught.append(read_checkpoint(tmp_path / name / "usv" / f"model_{iterations}.pt"))
    weights = [content["actor_state_dict"]["mlp.0.weight"] for content in taught]
    critics = [content["critic_state_dict"]["mlp.0.weight"] for content in taught]
    assert not critics[0].equal(critics[1])
    assert (weights[0] - weights[1]).abs().max() < 0.05 and not weights[0].equal(weights[1])
    actors = [content["actor_state_dict"]["distribution.std_param"] for content in taught]
    assert actors[0].tolist() == pytest.approx([config.stages["usv"].initial_std] * 2, abs=1e-6)
