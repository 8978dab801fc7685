"""Landings: on a calm sea everybody lands, how an episode ends is what has happened, and forks do the same."""

import functools
import math
from types import SimpleNamespace

import pytest
import torch
from phases import due
from refusal import assert_says

from rl.evaluation.episodes import judge_episodes
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario, make_mission
from rl.missions.landing.boats import Message
from rl.missions.landing.config import PilotConfig
from rl.missions.landing.foresight import BLOWN, Foresight
from rl.missions.landing.judge import OUTCOMES
from rl.missions.landing.known_deck import KnownDeck
from rl.missions.landing.marker import Look
from rl.missions.landing.mission import Landing
from rl.missions.landing.pilots import ABOVE, HIGH, MARGIN, SAMPLED, Pilot
from rl.planning.planner import HonestPlanner, PlanConfig
from rl.step import BEGINS, GOES_ON
from taichi_sim.config import ConfigError
from taichi_sim.kernels.rotation import DERIVED_SIZE, VELOCITY_N

CALM = (
    "variation=0", "sea.sea_state=1", "sea.realisations=4", "air.speed=1", "landing.distance=[8, 12]",
    "landing.height=[6, 8]", "episode_duration=30",
)  # fmt: skip


def landing(*overrides: str, envs: int = 4, teams=("uav",)) -> Landing:
    return make_mission(load_scenario("landing", (*CALM, *overrides)), envs, seed=3, teams=teams)


@functools.cache
def shared() -> Landing:
    """One mission for all tests that begin with `reset`."""
    return landing()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["glide", "forecast"])
def test_on_a_calm_sea_pilots_land_softly_in_the_middle(kind):
    config = load_scenario("landing", (*CALM, f"uav.pilot.kind={kind}"))
    result = judge_episodes(config, {"uav": ClassicalPolicy()}, episodes=4, seed=5, show_progress=False)
    figures = result.result["teams"]["uav"]
    assert figures["success_rate"] == 1.0, figures
    assert figures["touch_error_p95_m"] < 0.2 and figures["touch_speed_p95_m_s"] < 0.9, figures
    ends = sum(figures[name] for name in OUTCOMES[1:])
    assert ends == 0.0 and figures["time_to_land_p95_s"] < 25.0


@pytest.mark.slow
def test_it_has_landed_after_standing_and_not_before():
    mission = shared()
    mission.reset()
    team, touched, landed = mission.teams["uav"], torch.full((4,), math.nan), torch.full((4,), math.nan)
    for k in range(mission.config.episode_steps):
        step = mission.drive({"uav": team.controller(team)}, begin=False)
        now = mission.config.decision_interval * (k + 1)
        touched[team.standing[:, 0] & touched.isnan()] = now
        landed[step.endings["uav"]["landed"][:, 0] & landed.isnan()] = now
    assert torch.allclose(landed - touched, torch.full((4,), mission.config.landing.stand - 0.1), atol=0.11)
    assert float(team.drifted.max()) < 0.05  # its rotors idle: it stays where it stands
    (c, s), (a, b) = team.fleet.heading, mission.boats.deck.heading
    quarters = 4 * (torch.atan2(s, c) - torch.atan2(b, a))  # it stands square to the deck, any side ahead
    assert float(quarters.cos().min()) > math.cos(4 * math.radians(6))


def test_a_policy_that_asks_for_all_sink_there_is_touches_softly():
    """Its sink over the deck is limited by the height, so a bad policy is late or off the middle, but not hard."""
    mission = shared()
    mission.reset()
    team, down = mission.teams["uav"], torch.tensor((0.0, 0.0, 1.0)).expand(4, 1, 3)
    for _ in range(mission.config.episode_steps):
        mission.step({"uav": down}, begin=False)
        if bool(team.touched.all()):
            break
    assert bool(team.touched.all()) and float(team.touch_speed.max()) < 0.75


@pytest.mark.parametrize(
    ("override", "aside", "least"), [("uav.correction.level=12", 1.0, ABOVE), ("uav.marker.loss=1", 0.0, HIGH)]
)
def test_beside_the_middle_and_blind_a_policy_stays_above_the_deck(override, aside, least):
    """At most 1.8 m/s aside at the deck holds it 0.9 m off the middle."""
    mission = landing(override)
    mission.reset()
    team, asked = mission.teams["uav"], torch.tensor((0.0, aside, 1.0)).expand(4, 1, 3)
    heights = []
    for _ in range(150):
        mission.step({"uav": asked}, begin=False)
        heights.append(float(team.known_height.min()))
    assert min(heights) > least - 0.3 and not bool(team.touched.any())


def test_plans_of_a_landing_count_a_landing_and_its_failures():
    mission = shared()
    mission.reset()
    team = mission.teams["uav"]
    ended, weights = torch.ones((4, 1), dtype=torch.bool), {k: paid.term.weight for k, paid in team.paid_by.items()}
    none, failed = team.plan_cost(~ended), team.plan_cost(ended)
    assert torch.allclose(failed - none, torch.full((4, 1), weights["failed"]))
    team.stood = torch.full_like(team.stood, mission.config.landing.stand)
    assert torch.allclose(team.plan_cost(ended) - none, torch.full((4, 1), -weights["landed"]))


def test_an_honest_planner_believes_what_the_aircraft_know():
    """A model of its own, in which decks are where they are known to be, aircraft where they measure themselves, and
    what is foreseen of a deck that has sailed on for a while comes about.
    """
    mission = shared()
    mission.reset()
    team, planner = mission.teams["uav"], HonestPlanner(PlanConfig(samples=4, rounds=1, horizon=1.0, every=0.9), seed=1)
    for _ in range(60):
        action = planner(team)
        mission.step({"uav": action}, begin=False)
    assert bool(action.values.isfinite().all()) and planner.planned >= 4 * 6
    planner.bind(team)
    believed = planner._believed
    believed.believe(team)
    mine, known = believed.teams["uav"], team.known_deck
    assert mine.fleet.state[..., 3:].equal(team.own.state[..., 3:]) and not mine.fleet.state.equal(team.fleet.state)
    assert torch.allclose(mine.known_deck.to, known.to, atol=2e-3)
    assert torch.allclose(mine.known_deck.velocity, known.velocity, atol=1e-3)
    before, way = mission.boats.deck.place.clone(), believed.boats.deck.place.clone()
    for _ in range(10):
        believed.drive({"uav": mine.controller(mine)}, begin=False)
        mission.drive({"uav": team.controller(team)}, begin=False)
    moved, foreseen = mission.boats.deck.place - before, believed.boats.deck.place - way
    assert float((foreseen - moved).norm(dim=-1).mean()) < min(0.25, 0.5 * float(moved.norm(dim=-1).mean()))
    assert float((mine.fleet.velocity_n - team.fleet.velocity_n).abs().mean()) < 0.35
    ways = believed.ways
    last = ways.ahead - 1 - int((believed.steps - ways.since)[0])
    end, beyond = (ways.foreseen(last + more) for more in (0, 10))  # a deck goes on as it goes at the end
    gone = (beyond[..., :3] - end[..., :3]).norm(dim=-1)
    assert torch.allclose(gone, 10 * mission.config.decision_interval * end[..., 7:10].norm(dim=-1), rtol=1e-3)
    assert torch.equal(beyond[..., 3:], end[..., 3:])


def test_a_fork_lands_as_its_source_does_to_the_bit():
    mission = shared()
    mission.reset()
    team = mission.teams["uav"]
    for _ in range(60):
        mission.drive({"uav": team.controller(team)}, begin=False)
    fork = mission.fork([1], copies=2)
    other = fork.teams["uav"]
    for _ in range(40):
        for m in (mission, fork):
            m.step({"uav": torch.full((m.num_envs, 1, 3), 0.1)}, begin=False)
    assert torch.equal(other.fleet.state[:, 0], team.fleet.state[1, 0].expand(2, -1))
    assert torch.equal(other.observations()[0], team.observations()[1])


def test_what_a_pilot_remembers_moves_on_once_a_decision():
    """A fork, which asks again, is not ahead of its source."""
    for kind in ("descend", "forecast"):
        mission = landing(f"uav.pilot.kind={kind}", envs=2)
        team = mission.teams["uav"]
        for _ in range(9):
            mission.drive({"uav": team.controller(team)}, begin=False)
        first = team.wanted
        before = {name: value.clone() for name, value in vars(team.pilot).items() if isinstance(value, torch.Tensor)}
        learnt = None if team.pilot.model is None else team.pilot.model.count.clone()
        assert torch.equal(team.pilot.wanted(), first)
        assert all(torch.equal(getattr(team.pilot, name), value) for name, value in before.items())
        assert learnt is None or torch.equal(team.pilot.model.count, learnt)


def test_a_pilot_foresees_the_deck_until_it_has_touched(monkeypatch):
    """From where it waits it comes down as it does over a deck at rest; then some time to spare, in whole samples."""
    monkeypatch.setattr(Pilot, "_lift", lambda self: torch.zeros(1))
    monkeypatch.setattr(Pilot, "_deck_falls", lambda self: torch.zeros(1))
    sample = SAMPLED * 0.05
    for numbers in ({}, {"wait": 3.0, "sink": 0.5, "steep": 0.2}):
        like, deck = SimpleNamespace(state=torch.zeros(1, 1, 3)), SimpleNamespace(above=torch.zeros(1))
        pilot = Pilot(PilotConfig(kind="forecast", **numbers), like, deck, None, 0.0, torch.zeros(1), 0.05)
        height, takes, dt = torch.tensor([pilot.config.wait]), 0.0, 0.01
        while float(height) > 0:
            deck.above = height
            height = height - dt * pilot._matched(torch.zeros(1))
            takes += dt
        assert takes + MARGIN - 0.02 < pilot.ahead.shape[-1] * sample < takes + MARGIN + sample + 0.02


def test_the_wind_of_a_model_follows_a_gust_by_63_percent_in_the_time_of_its_average(monkeypatch):
    """Where an episode begins it is known at once; while legs touch, the lean says nothing of it."""
    gust, dt = torch.tensor([10.0, 0.0, 0.0]).expand(3, 1, 3), 0.1
    known = SimpleNamespace(velocity=gust, mean=gust, attitude=gust)
    touches, steps = torch.tensor([[False], [True], [False]]), torch.zeros(3, dtype=torch.int64)
    team = SimpleNamespace(known_deck=known, touches=touches, steps=steps)
    foresight = Foresight(torch.zeros(3), dt)
    monkeypatch.setattr(foresight, "_wind_of", lambda team: torch.zeros_like(gust))
    foresight.notice(team)
    monkeypatch.setattr(foresight, "_wind_of", lambda team: gust)
    for _ in range(round(BLOWN / dt)):
        steps[:2] += 1
        foresight.notice(team)
    wind = foresight.wind[:, 0, 0].tolist()
    assert wind == pytest.approx([10 * (1 - math.exp(-1)), 0.0, 10.0], abs=0.2)


def test_the_deck_is_known_as_well_as_messages_and_looks_allow():
    """Of a deck in steady motion, exact messages of which are late, everything is known exactly."""
    dt, late = 0.1, 0.2
    like = torch.zeros(1, 1, 13)
    known, v, own_v = KnownDeck(like, dt, 1), like.new_tensor((1.0, -0.5, 0.0)), like.new_tensor((2.0, 0.0, 0.0))
    nothing, off = torch.zeros(1, 1, Look.SIZE), like.new_tensor((0.4, 0.0, 0.0))

    def measure(k: int, which: int, look: torch.Tensor, error: torch.Tensor | float = 0.0) -> None:
        own = SimpleNamespace(state=like.clone(), derived=torch.zeros(1, 1, DERIVED_SIZE))
        own.state[..., :3], own.derived[..., VELOCITY_N] = own_v * (k * dt) + error, own_v
        heard = torch.zeros(1, 2, 2, Message.SIZE + 1)  # by the aircraft, from its boat
        heard[0, 1, 0, :3], heard[0, 1, 0, 3:6], heard[0, 1, 0, -1] = v * (k * dt - late), v, late
        known.measure(due(1, which), own, look, heard)  # pyright: ignore[reportArgumentType]

    for k in range(40):
        measure(k, GOES_ON if k else BEGINS, nothing)
        assert torch.allclose(known.to, (v - own_v) * (k * dt), atol=1e-4)
    assert float(known.seen) > 3.0 and torch.allclose(known.velocity, v, atol=1e-5)
    for k in range(40, 80):  # satellite navigation errs, the marker does not
        to = (v - own_v) * (k * dt)
        measure(k, GOES_ON, torch.cat((to, to.new_tensor((1e-4,)))).view(1, 1, Look.SIZE), off)
    assert torch.allclose(known.to, to, atol=0.02)


def test_rotors_let_go_only_over_the_deck_and_upright(monkeypatch):
    mission = shared()
    mission.reset()
    team = mission.teams["uav"]
    monkeypatch.setattr(type(team), "touches", property(lambda team: torch.ones(4, 1, dtype=torch.bool)))
    known = team.known_deck
    deck, still = mission.boats.deck, torch.zeros_like(known.to)
    level = deck._replace(R=torch.eye(3).expand_as(deck.R), heading=(torch.ones(4, 1), torch.zeros(4, 1)))
    known.suppose(level, still, still, still)
    c, s = torch.tensor([1.0, 1.0, 1.0, math.cos(0.2)]), torch.tensor([0.0, 0.0, 0.0, math.sin(0.2)])
    R = torch.eye(3).repeat(4, 1, 1, 1)  # the last one leans by 11 degrees
    R[:, 0, 0, 0], R[:, 0, 0, 2], R[:, 0, 2, 0], R[:, 0, 2, 2] = c, s, -s, c
    monkeypatch.setattr(team, "own", SimpleNamespace(R_nb=R, heading=(torch.ones(4, 1), torch.zeros(4, 1))))
    half, legs = mission.boats.fleet.model.deck.half, team.fleet.model.legs.points  # pyright: ignore
    room = half[1] - max(abs(point[1]) for point in legs)
    known.to[1, 0, 1], known.to[2, 0, 1] = room - 0.01, room + 0.01
    assert team.lets_go.flatten().tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("uav.marker.axis_deg=150", "the camera looks up"),
        ("usv.count=2", "uav.count = 1: must be usv.count = 2"),
        ("landing.aircraft=usv", "must be two teams"),
        ("landing.height=[9, 3]", "the first must not be above the second"),
    ],
)
def test_scenarios_that_cannot_be_flown_are_refused(override, told):
    with pytest.raises(ConfigError) as caught:
        load_scenario("landing", [override])
    assert_says(str(caught.value), told)


def test_aircraft_that_begin_in_one_place_are_refused():
    with pytest.raises(ConfigError, match=r"landing.distance = \[0.0, 0.0\].*two aircraft would begin in one place"):
        landing("usv.count=2", "uav.count=2", "landing.apart=1.5", "landing.distance=[0, 0]", "landing.height=[8, 8]")


def test_vehicles_that_cannot_land_are_refused():
    with pytest.raises(ConfigError, match="must be a multirotor_6dof with"):
        landing("uav.vehicle=aerosonde", 'uav.medium="air"')
