"""No episode begins where nobody could save it: in the geometry of starts, and under the classical controllers."""

import pytest
import torch
from torch import Tensor

from rl.evaluation.episodes import Trial
from rl.learn.policy import ClassicalPolicy
from rl.mission import Mission
from rl.missions import find_mission, load_scenario
from taichi_sim.config.io import find_config
from taichi_sim.kernels.conventions import DOWN

SHIPPED = ("cruise", "paper", "lanes", "otter", "aerosonde", "escort", "landing")
REACTION = 2.0  # s

FEW = ("track.worlds=64", "sea.realisations=64")
STARTS = {
    "pillars that aircraft pass over, up to 10 m below them": ("cruise", *FEW),
    "aircraft that cannot stop, in wind": ("cruise", "obstacles.count=0", *FEW),
    "masts and traffic in their lanes": ("aerosonde", *FEW),
    "aircraft that can stop": ("lanes", *FEW),
    "boats, pillars and traffic": ("otter", *FEW),
    "boats at a vessel": ("escort", "escort.near_fraction=1.0"),
    "boats far from a vessel, aircraft above": ("escort", "escort.near_fraction=0.0"),
    "copters at a boat each": ("landing", "uav.count=3", "usv.count=3"),
}


def least_gaps(mission: Mission, team: str) -> dict[str, Tensor]:
    """Least clearance [env, vehicle] (m) of vehicles that keep their velocity for `REACTION`, from obstacles and from
    mates; from mates at once, of those that can stop.
    """
    fleet = mission.teams[team].fleet
    radius, place, velocity = fleet.model.collision_radius, fleet.position_n, fleet.velocity_n
    at = torch.stack([place + time * velocity for time in torch.linspace(0.0, REACTION, 21)])
    apart = torch.cdist(at, at) + 1e9 * torch.eye(fleet.count)
    gaps = {"mate": (apart[:1] if fleet.model.limits.stops else apart).amin((0, -1)) - 2 * radius}
    if hasattr(mission, "obstacles"):
        north, east, size, top = mission.obstacles[mission.env_world].unsqueeze(1).unbind(-1)
        beside = (torch.hypot(north - at[..., :1], east - at[..., 1:2]) - size).clamp(min=0.0)
        above = (-at[..., DOWN, None] - top).clamp(min=0.0)
        gaps["obstacle"] = torch.hypot(beside, above).amin((0, -1)) - radius
    return gaps


@pytest.mark.parametrize("start", STARTS)
def test_vehicles_that_do_nothing_meet_nothing_before_they_could_react(start):
    """By their velocities in the wind of the episode, with a metre to spare."""
    name, *overrides = STARTS[start]
    config = load_scenario(name, overrides)
    mission = find_mission(config.mission)(config, 2048, seed=3, source=find_config(name))
    near = {(team, what): gap[gap < 1.0] for team in mission.teams for what, gap in least_gaps(mission, team).items()}
    assert not any(map(len, near.values())), near


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_no_episode_is_lost_before_its_controller_could_act(name):
    """Of 1,024 episodes of an evaluation, none has ended after 2 s."""
    config = load_scenario(name)
    policies = {team: ClassicalPolicy() for team in config.acting}
    trial, lost = Trial(config, policies, 1024, 1000, source=find_config(name)), []
    for first in trial.chunks:
        mission = trial.mission(first)
        for _ in range(round(REACTION / config.decision_interval)):
            step = mission.step({team: policies[team] for team in mission.teams}, begin=False)
            for team, ended in step.endings.items():
                for why, flag in ended.items():
                    lost += [(team, why, first + env) for env in flag.any(1).nonzero().flatten().tolist()]
    assert not lost, lost[:10]
