"""Station keeping: the way to the quay, the keeper, the judge, the rectangle beside the quay, mistakes in the file."""

import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from refusal import assert_says

from rl.evaluation.episodes import judge_episodes
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario, make_mission
from rl.missions.station.judge import StationJudge
from rl.missions.station.keeper import Craft
from rl.missions.station.mission import Station
from rl.planning.planner import PlanConfig, Planner
from rl.team import ControllerError
from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import load_vehicle

CALM = ("variation=0", "sea.hs=0", "sea.current.speed=0", "sea.current.std=0", "air.speed=0", "air.std=0",
        "sea.realisations=2", "sea.components=4", "usv.vary={}", "usv.sensors={}")  # fmt: skip
SHORT = ("station.hold=31", "episode_duration=120", "station.distance=[12,14]")


def station(*overrides: str, envs: int = 3) -> Station:
    mission = make_mission(load_scenario("station", (*CALM, *SHORT, *overrides)), envs, seed=3)
    assert isinstance(mission, Station)
    return mission


@functools.cache
def shared() -> Station:
    return station()


def test_the_place_goes_to_the_berth_without_a_jump_in_speed():
    mission = shared()
    mission.reset()
    s, dt, slots = mission.config.station, mission.config.decision_interval, []
    for k in range(mission.config.episode_steps + 1):
        mission.steps.fill_(k)
        slots.append(mission.slot)
    place, rate, push = (torch.stack([getattr(slot, key) for slot in slots])[:, :, 0] for key in slots[0]._fields)
    hold = round(s.hold / dt)
    assert torch.equal(place[: hold + 1], place[:1].expand(hold + 1, -1, -1)) and not rate[: hold + 1].any()
    assert torch.equal(place[-1], place[-2]) and not rate[-1].any()
    middle = (place[1:] - place[:-1]) / dt
    torch.testing.assert_close(middle, (rate[1:] + rate[:-1]) / 2, atol=2e-3, rtol=0.0)
    moving = push.abs().sum(-1) > 0  # its acceleration jumps as it sets out and arrives
    inner = moving[1:] & moving[:-1]
    torch.testing.assert_close(
        ((rate[1:] - rate[:-1]) / dt)[inner], ((push[1:] + push[:-1]) / 2)[inner], atol=2e-3, rtol=0.0
    )
    assert rate[..., :2].norm(dim=-1).amax(0).numpy() == pytest.approx(s.speed, rel=0.01)
    bearing, away = mission.quay[:, 0].unbind(-1)
    north, east, heading = place[-1].unbind(-1)
    side = away - bearing.cos() * north - bearing.sin() * east - mission.teams["usv"].fleet.model.size[1] / 2
    assert side.numpy() == pytest.approx(s.clear, abs=1e-4)
    assert (heading - bearing).cos().abs().max() < 1e-5  # along the quay


def test_the_gap_is_that_of_the_corner_nearest_to_the_quay():
    mission = shared()
    generator = torch.Generator().manual_seed(1)
    place, heading = 8 * torch.rand((3, 1, 2), generator=generator) - 4, 6.3 * torch.rand((3, 1), generator=generator)
    mission.place("usv", torch.arange(3), place, heading)
    team = mission.teams["usv"]
    length, beam, _ = team.fleet.model.size
    for env in range(3):
        c, s = math.cos(heading[env]), math.sin(heading[env])
        (bearing, away), (north, east) = mission.quay[env, 0].tolist(), place[env, 0].tolist()
        corners = [(north + c * x - s * y, east + s * x + c * y) for x in (-length / 2, length / 2)
                   for y in (-beam / 2, beam / 2)]  # fmt: skip
        nearest = min(away - math.cos(bearing) * n - math.sin(bearing) * e for n, e in corners)
        assert float(team.gap[env]) == pytest.approx(nearest, abs=1e-4)


def test_on_a_calm_sea_the_keeper_keeps_place_and_docks():
    config = load_scenario("station", (*CALM, *SHORT, "station.hold=60", "episode_duration=150"))
    policies = {"usv": ClassicalPolicy()}
    outcome = judge_episodes(config, policies, episodes=4, seed=5, show_progress=False)
    found = {key: figure or 0.0 for key, figure in outcome.result["teams"]["usv"].items()}
    assert found["success_rate"] == found["kept_share"] == 1.0, found
    assert found["error_rms_m"] < 0.1 and found["heading_error_rms_deg"] < 0.3, found
    assert abs(found["least_gap_m"] - 1.0) < 0.2, found  # station.clear


@pytest.mark.slow
def test_the_keepers_integral_carries_a_steady_load():
    """A current across: after two minutes the boat lies on its place, though a proportional law would leave it off."""
    mission = station("sea.current.speed=0.3", "station.hold=200", "episode_duration=200", envs=4)
    team, off = mission.teams["usv"], []
    for _ in range(900):
        mission.step({"usv": ClassicalPolicy()}, begin=False)
        off.append(float(team.distance.max()))
    assert max(off[250:500]) > 3 * max(off[-50:]) and max(off[-50:]) < 0.05


def test_a_fork_goes_on_under_its_keeper():
    mission = shared()
    mission.reset()
    for _ in range(5):
        mission.step({"usv": ClassicalPolicy()}, begin=False)
    fork = mission.fork(torch.arange(3))
    seen = [each.step({"usv": ClassicalPolicy()}, begin=False).observations["usv"] for each in (mission, fork)]
    assert torch.equal(*seen)
    step = mission.step({"usv": Planner(PlanConfig(samples=4, horizon=2.0, every=1.0))}, begin=False)
    assert bool(step.reward["usv"].isfinite().all())  # plans correct what the keeper wants


def judged(off: np.ndarray, turn: np.ndarray, gap: np.ndarray, failed: np.ndarray):
    """Figures of episodes [step, episode], of which 30 s are settled, to 90 s on station."""
    config = load_scenario("station")
    of_each = {key: np.zeros(off.shape[1]) for key in ("reward", "action_changes")}
    seen = SimpleNamespace(
        rows=np.stack((off, turn, gap)), failed=failed, collided=np.zeros((off.shape[1], 1), bool),
        measured=np.isfinite(off).sum(0).astype(float), **of_each,
    )  # fmt: skip
    episodes = StationJudge.episodes([seen], config)  # pyright: ignore[reportArgumentType]
    return episodes, StationJudge.pooled(episodes)


def test_the_judge_counts_the_time_in_which_place_and_heading_are_kept():
    steps = np.arange(1, 901) * 0.2  # s
    off, turn, gap = np.full((900, 4), 0.3), np.full((900, 4), 2.0), np.where(steps[:, None] > 150, 1.2, 15.0)
    gap = np.repeat(gap, 4, axis=1)
    off[steps <= 30] = 9.0  # it is still on its way
    off[(steps > 40) & (steps <= 46), 0] = 0.6  # a tenth of the time
    turn[(steps > 40) & (steps <= 55), 1] = -5.5  # a quarter
    gap[steps > 150, 2] = 15.0  # it stays where it was
    off[steps > 60, 3] = np.nan  # its episode has ended
    turn[steps > 60, 3] = gap[steps > 60, 3] = np.nan
    episodes, figures = judged(off, turn, gap, np.array([False, False, False, True]))
    assert episodes["kept_share"] == pytest.approx([0.9, 0.75, 1.0, 0.5])
    assert episodes["docked"].tolist() == [1.0, 1.0, 0.0, 0.0] and figures["success_rate"] == 0.0
    assert figures["heading_error_rms_deg"] == pytest.approx(
        math.sqrt((75 * 5.5**2 + (300 * 3 + 150 - 75) * 2.0**2) / 1050)
    )
    nothing = {key: value[3:] for key, value in episodes.items()} | {"on": np.zeros(1)}
    assert np.isnan(StationJudge.pooled(nothing)["error_rms_m"])
    assert episodes["error_rms_m"][0] == pytest.approx(math.sqrt(0.9 * 0.09 + 0.1 * 0.36))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("usv.count=2", ("usv.count = 2", "must be 1")),
        ("station.hold=20", ("station.hold = 20", "evaluation.settle")),
        ("station.start=20", ("station.start = 20", "station.lost")),
        ("usv.control.bandwith=1", ("bandwith", "did you mean 'bandwidth'")),
    ],
)
def test_what_does_not_fit_is_refused_by_its_key(override, words):
    with pytest.raises(ConfigError) as error:
        make_mission(load_scenario("station", (*CALM, override)), 1, seed=1).teams["usv"].make_controller()
    assert_says(str(error.value), *words)


def test_a_craft_that_cannot_push_to_a_side_has_no_keeper():
    craft = Craft.of(load_vehicle("cybership2", 0.05, 4, actions="surge_sway_yaw"))
    assert craft is not None and craft.most == (2.0, 1.5, 1.5) and craft.inertia[0] == pytest.approx(25.8)
    mission = station("usv.vehicle=otter", envs=1)
    with pytest.raises(ControllerError, match="no classical controller"):
        mission.step({"usv": ClassicalPolicy()})
