"""No episode begins where nobody could save it: in the geometry of starts, and under the classical controllers."""

import pytest
import torch
from torch import Tensor

from rl.evaluation.episodes import Trial
from rl.evaluation.headroom import as_stored
from rl.learn.policy import ClassicalPolicy
from rl.mission import Mission
from rl.missions import find_mission, load_scenario
from rl.missions.formation.slots import offsets_of, unit_offsets
from taichi_sim.config.io import find_config
from taichi_sim.kernels.conventions import DOWN

SHIPPED = ("cruise", "paper", "lanes", "otter", "aerosonde", "escort", "landing", "station", "route", "encounter",
           "imazu")  # fmt: skip
REACTION = 2.0  # s

FEW = ("track.worlds=64", "sea.realisations=64")
STARTS = {
    "pillars that aircraft pass over, up to 10 m below them": ("cruise", *FEW),
    "aircraft that cannot stop, in wind": ("cruise", "obstacles.count=0", *FEW),
    "masts and traffic in their lanes": ("aerosonde", *FEW),
    "aircraft that can stop": ("lanes", *FEW),
    "boats, pillars and traffic": ("otter", *FEW),
    "boats at a vessel": ("escort", "escort.near_fraction=1.0", *FEW[1:], "escort.worlds=64"),
    "boats far from a vessel, aircraft above": ("escort", "escort.near_fraction=0.0"),
    "copters at a boat each": ("landing", "uav.count=3", "usv.count=3", *FEW[1:]),
}


def least_gaps(mission: Mission, team: str) -> dict[str, Tensor]:
    """Least clearance [env, vehicle] (m) of vehicles that keep their velocity for `REACTION`, from obstacles and from
    mates.
    """
    fleet = mission.teams[team].fleet
    radius, place, velocity = fleet.model.collision_radius, fleet.position_n, fleet.velocity_n
    at = torch.stack([place + time * velocity for time in torch.linspace(0.0, REACTION, 21)])
    apart = torch.cdist(at, at) + 1e9 * torch.eye(fleet.count)
    spare = 1.5 * fleet.model.limits.stops  # m, that mates which can stop need less: waves move each of them, too
    gaps = {"mate": apart.amin((0, -1)) - 2 * radius + spare}
    if hasattr(mission, "obstacles"):
        north, east, size, top = mission.obstacles[mission.env_world].unsqueeze(1).unbind(-1)
        beside = (torch.hypot(north - at[..., :1], east - at[..., 1:2]) - size).clamp(min=0.0)
        above = (-at[..., DOWN, None] - top).clamp(min=0.0)
        gaps["obstacle"] = torch.hypot(beside, above).amin((0, -1)) - radius
    return gaps


SELDOM = "aircraft that cannot stop, in wind", "aircraft that can stop", "boats far from a vessel, aircraft above"


@pytest.mark.parametrize(
    "start", [pytest.param(start, marks=[pytest.mark.slow] if start in SELDOM else []) for start in STARTS]
)
def test_vehicles_that_do_nothing_meet_nothing_before_they_could_react(start):
    """By their velocities in the wind of the episode, with a metre to spare."""
    name, *overrides = STARTS[start]
    config = load_scenario(name, overrides)
    mission = find_mission(config.mission)(config, 120, seed=3, source=find_config(name))
    for _ in range(17):
        for team in mission.teams:
            near = {what: gap[gap < 1.0] for what, gap in least_gaps(mission, team).items()}
            assert not any(map(len, near.values())), (team, near)
        mission.reset()


def nearest_on_the_way(mission: Mission, team: str, duration: float) -> Tensor:
    """Least clearance [world, start] (m) from obstacles of vehicles that glide to their slots in `duration` (s)."""
    starts, config, radius = mission.starts, mission.config, mission.teams[team].fleet.model.collision_radius
    offsets = offsets_of(unit_offsets(config.formations[team]), starts.formations[team]).float()
    at = torch.arange(mission.tracks.worlds).unsqueeze(1).expand(starts.progress.shape)
    found, off = torch.full(starts.progress.shape, torch.inf), None
    for time in torch.linspace(0.0, 15.0, 40).tolist():
        place = mission.tracks.at(at, starts.progress + config.pace(team).speed * time)
        to_n = torch.polar(torch.ones_like(place.course), place.course).unsqueeze(-1)  # complex: north + i east
        slot = torch.view_as_complex(place.position).unsqueeze(-1) + torch.view_as_complex(offsets) * to_n
        if off is None:
            off = (torch.view_as_complex(starts.states[team][..., :2].contiguous()) - slot) / to_n
        glides = torch.view_as_real(slot + max(0.0, 1.0 - time / duration) * off * to_n)
        gap = torch.cdist(glides.flatten(1, 2), mission.obstacles[..., :2]) - mission.obstacles[:, None, :, 2] - radius
        found = torch.minimum(found, gap.amin(-1).view(glides.shape[:3]).amin(-1))
    return found


@pytest.mark.parametrize(("name", "team"), [("cruise", "usv"), ("paper", "uav")])
def test_no_obstacle_beside_the_lanes_is_in_the_way_to_them(name, team):
    """And all other starts are those that stored episodes have."""
    config = load_scenario(name, FEW)
    new, old = (
        find_mission(config.mission)(of, 8, seed=3, source=find_config(name), teams=(team,))
        for of in (config, as_stored(config))
    )
    for duration in (5.0, 15.0):
        assert nearest_on_the_way(new, team, duration).min() > 2.0
        assert nearest_on_the_way(old, team, duration).min() < 1.0
    same = new.starts.progress == old.starts.progress
    assert 0.6 < same.float().mean() < 0.95 and torch.equal(
        new.starts.states[team][same], old.starts.states[team][same]
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_no_episode_is_lost_before_its_controller_could_act(name):
    """Of 4,096 episodes of an evaluation, none has ended after 2 s."""
    config = load_scenario(name)
    policies = {team: ClassicalPolicy() for team in config.acting}
    trial, lost = Trial(config, policies, 4096, 2000, source=find_config(name)), []
    for first in trial.chunks:
        mission = trial.mission(first)
        for _ in range(round(REACTION / config.decision_interval)):
            step = mission.step({team: policies[team] for team in mission.teams}, begin=False)
            for team, ended in step.endings.items():
                for why, flag in ended.items():
                    lost += [(team, why, first + env) for env in flag.any(1).nonzero().flatten().tolist()]
    assert not lost, lost[:10]
