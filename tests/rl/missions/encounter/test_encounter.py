"""Encounters: hulls, roles, tracks, SB-MPC, traffic, situations, scores."""

import math

import numpy as np
import pytest
import taichi as ti
import torch

from rl.evaluation.episodes import judge_episodes
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario, make_mission
from rl.missions.encounter.avoidance import CANDIDATES, Plans, SbmpcGains
from rl.missions.encounter.bodies import Body, Track, rectangle_gap
from rl.missions.encounter.config import CASES, EncounterConfig
from rl.missions.encounter.judge import RULES, scores
from rl.missions.encounter.pairs import Pair, Role
from rl.missions.encounter.situations import IMAZU, IMAZU_DIGEST
from rl.missions.encounter.traffic import Behaviour, Sailing
from taichi_sim.bench import Bench
from taichi_sim.errors import UserError
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_heading
from taichi_sim.kernels.runtime import array2

# One wave component, and 35 own ships or more: one kernel of theirs serves all tests.
SMALL = ("sea.components=1", "sea.realisations=4")
CALM = ("sea.hs=0", "sea.components=1", "sea.realisations=1", "sea.current.speed=0", "air.speed=0", "vary={}")
EXACT = ("ais.loss=0", "ais.place_noise=0", "ais.speed_noise=0", "ais.carried=1", "radar.misses=0",
         "radar.range_noise=0", "radar.range_share=0", "radar.bearing_noise_deg=0", "radar.period=1")  # fmt: skip


@ti.kernel
def _gaps(out: array2, a: array2, b: array2):
    for n in range(a.shape[0]):
        at, to = ti.Vector([a[n, 0], a[n, 1]]), ti.Vector([b[n, 0], b[n, 1]])
        ac, as_, bc, bs = ti.cos(a[n, 2]), ti.sin(a[n, 2]), ti.cos(b[n, 2]), ti.sin(b[n, 2])
        out[n, 0] = rectangle_gap(at, ac, as_, a[n, 3], a[n, 4], to, bc, bs, b[n, 3], b[n, 4])


def _boundary(row, points=100):
    """Points [.., 2] all over a rectangle (north, east, heading, length, beam), its inside, too."""
    side = np.linspace(-0.5, 0.5, points // 10)
    x, y = np.meshgrid(side * row[3], side * row[4])
    edge = np.linspace(-0.5, 0.5, points)
    ends = np.full(points, 0.5)
    x = np.concatenate((x.ravel(), edge * row[3], edge * row[3], ends * row[3], -ends * row[3]))
    y = np.concatenate((y.ravel(), ends * row[4], -ends * row[4], edge * row[4], edge * row[4]))
    c, s = math.cos(row[2]), math.sin(row[2])
    return np.stack((row[0] + c * x - s * y, row[1] + s * x + c * y), axis=-1)


def test_gaps_of_hulls_are_those_of_their_points():
    runtime.current()
    rng = np.random.default_rng(1)
    rows = rng.uniform((-8, -8, -4, 1, 0.5), (8, 8, 4, 12, 4), size=(2, 40, 5))
    rows[1, :10, :2] = rows[0, :10, :2]  # crosses: no corner inside, and yet they overlap
    rows[:, :10, 3:], rows[1, :10, 2] = (12.0, 1.0), rows[0, :10, 2] + 1.5
    out = torch.zeros((40, 1))
    _gaps(out, *torch.from_numpy(rows).float())
    for a, b, gap in zip(*rows, out[:, 0].tolist(), strict=True):
        near = np.linalg.norm(_boundary(a)[:, None] - _boundary(b), axis=-1).min()
        assert gap <= near + 1e-4 and gap >= near - 0.4
    assert out[:10].abs().max() == 0.0


def test_a_steered_ship_turns_and_stops_as_its_file_says():
    bench = Bench("merchant_ship", dt=0.1, envs=1)
    L, top = bench.model.params.length, bench.model.limits.speeds[2]
    assert top == pytest.approx(0.25 * math.sqrt(9.81 * L), rel=1e-3)
    bench.fleet.state[..., 7] = top
    bench.fleet.update()
    places = []
    for _ in range(3000):
        heading = 2 * math.atan2(float(bench.state[0, 0, 6]), float(bench.state[0, 0, 3]))
        bench.step((math.remainder(heading + 1.5, 2 * math.pi) / math.pi, 1.0))
        places.append(bench.state[0, 0, :2].clone())
    east = torch.stack(places)[:, 1]
    assert float(east.max() - east.min()) == pytest.approx(2 * L / 0.5, rel=0.01)  # steady diameter
    bench = Bench("merchant_ship", dt=0.1, envs=1)
    bench.fleet.state[..., 7] = top
    bench.fleet.update()
    bench.step((0.0, -1.0), times=6000)
    assert float(bench.state[0, 0, 0]) == pytest.approx(8 * L, rel=0.01)


@pytest.fixture(scope="module")
def calm():
    """Own ships on calm water among exactly known ships, in 64 environments."""
    return make_mission(load_scenario("encounter", (*CALM, *EXACT, "usv.control.close=400")), 64, seed=2)


def _meet(mission, rows):
    """Begin with one ship a row in environment 0 ..: (bearing, course, distance, speed); others far away. The own ship
    goes north.
    """
    own, ships, n = mission.teams["usv"].fleet, mission.ships, mission.num_envs
    mission.reset()
    mission.route.zero_()
    mission.place("usv", torch.arange(n), torch.zeros((n, 1, 2)), torch.zeros((n, 1)), 2.0)
    place = torch.full((n, ships.count, 2), -8e3)
    place[:, :, 1] = 500.0 * torch.arange(ships.count)
    course, speed = torch.full((n, ships.count), math.pi), torch.ones((n, ships.count))
    for e, (bearing, psi, far, fast) in enumerate(rows):
        b = math.radians(bearing)
        place[e, 0] = far * torch.tensor([math.cos(b), math.sin(b)])
        course[e, 0], speed[e, 0] = math.radians(psi), fast
    mission.place("traffic", torch.arange(n), place, course, speed)
    mission.world.scripts["traffic"].start(torch.arange(n), course, speed)
    mission.world.scripts["traffic"].ships[..., Sailing.BEHAVIOUR] = float(Behaviour.KEEPS)
    mission.measure_anew()
    return own


MEETINGS = {
    "head-on": ((0, 180, 300, 2.0), Role.HEAD_ON),
    "from starboard": ((30, -120, 300, 2.0), Role.GIVE_WAY),
    "from port": ((-30, 120, 300, 2.0), Role.STAND_ON),
    "ahead and slow": ((0, 0, 90, 0.5), Role.OVERTAKING),
    "astern and fast": ((180, 0, 300, 6.0), Role.OVERTAKEN),
    "across the stern": ((180, 30, 300, 6.0), Role.NONE),
    "far away": ((90, 180, 5000, 2.0), Role.NONE),
}


def test_roles_are_those_of_the_rules_and_sb_mpc_acts_by_them(calm):
    _meet(calm, [row for row, _ in MEETINGS.values()])
    for _ in range(40):
        step = calm.step({"usv": lambda team: torch.zeros((64, 1, 2))}, begin=False)
        assert not step.endings["usv"]["diverged"].any()
        if bool((calm.pairs.of(Pair.KIND)[:5, 0, 1] > 0).all()):
            break
    found = calm.pairs.of(Pair.KIND)[: len(MEETINGS), 0, 1]
    assert found.tolist() == [int(role) for _, role in MEETINGS.values()]
    team = calm.teams["usv"]
    offsets = team.controller.offsets(team)[: len(MEETINGS), 0]
    by = dict(zip(MEETINGS, offsets.tolist(), strict=True))
    assert by["head-on"][0] > 0 and by["from starboard"][0] > 0  # to starboard: rules 14 and 15
    assert by["far away"] == [0.0, 1.0] and by["across the stern"] == [0.0, 1.0]


def test_who_gives_way_meets_one_who_stands_on():
    """Roles of two own ships towards each other: head-on both, or one gives way, or one overtakes."""
    other = {Role.HEAD_ON: Role.HEAD_ON, Role.GIVE_WAY: Role.STAND_ON, Role.OVERTAKING: Role.OVERTAKEN}
    other |= {b: a for a, b in other.items()}
    config = load_scenario("encounter", (*CALM, "usv.count=2", "encounter.ships=[1, 1]", "traffic.count=1"))
    mission = make_mission(config, 128, seed=3)
    calm = torch.zeros((128, 2, 2))
    for _ in range(90):
        mission.step({"usv": calm}, begin=False)
    kind = mission.pairs.of(Pair.KIND)
    a, b = kind[:, 0, 1], kind[:, 1, 0]
    both = (a > 0) & (b > 0)
    right = sum(other[Role(int(x))] == Role(int(y)) for x, y in zip(a[both], b[both], strict=True))
    assert int(both.sum()) > 50 and right >= 0.95 * int(both.sum())  # the rest lies on the edge of two sectors


def test_tracks_of_exact_sensors_are_the_truth(calm):
    calm.reset()
    team = calm.teams["usv"]
    for _ in range(15):
        calm.step({"usv": torch.zeros((64, 1, 2))}, begin=False)
    tracks, bodies = team.tracks[:, 0, 1:], calm.bodies[:, 1:]
    near = (bodies[..., :2] - calm.bodies[:, :1, :2]).norm(dim=-1) < 1200
    off = (tracks[..., : Track.V_NORTH] - bodies[..., : Body.V_NORTH]).norm(dim=-1)
    fast = (tracks[..., Track.V_NORTH : Track.LENGTH] - bodies[..., Body.V_NORTH : Body.COS]).norm(dim=-1)
    straight = calm.world.scripts["traffic"].ships[..., Sailing.OFFSET] == 0
    assert off[near & straight].max() < 1.0 and fast[near & straight].max() < 0.5
    assert (tracks[..., Track.LENGTH] - bodies[..., Body.LENGTH]).abs().max() < 1e-3  # told by AIS


def test_errors_of_tracks_are_as_large_as_the_filter_says():
    """Mean normalised squared error of ships that keep their course: 2, and below for the filter allows for turns."""
    config = load_scenario("encounter", (*CALM, "encounter.behaviours={keeps=1,obeys=0,late=0,port=0,stops=0}"))
    mission = make_mission(config, 256, seed=4)
    for _ in range(60):
        mission.step({"usv": torch.zeros((256, 1, 2))}, begin=False)
    team = mission.teams["usv"]
    tracks, bodies = team.tracks[:, 0, 1:], mission.bodies[:, 1:]
    off = (tracks[..., :2] - bodies[..., :2]).square().sum(-1) / tracks[..., Track.P_PP]
    known = team.tracking.known[:, 0, 1:] & (tracks[..., Track.AGE] < 5)
    assert 0.5 < float(off[known].mean()) < 2.6


def test_imazu_ships_meet_at_one_time():
    assert len(IMAZU) == len(CASES["imazu"]) == 19 == len(set(map(frozenset, IMAZU)))
    assert IMAZU_DIGEST == "600f8aae74c1a70d"
    config = load_scenario("imazu", ("encounter.course_deg=0",))
    mission = make_mission(config, 19, seed=1)
    mission.begin_each()
    ships = mission.world.scripts["traffic"].ships
    meeting = torch.tensor([6.173 * 1800, 0.0])
    for case, start in enumerate(IMAZU):
        for k, (course, share) in enumerate(start):
            v = mission.bodies[case, 1 + k, Body.V_NORTH : Body.COS]
            there = mission.bodies[case, 1 + k, : Body.V_NORTH] + 1800 * v
            assert torch.allclose(there, meeting, atol=3.0)
            assert float(ships[case, k, Sailing.SPEED]) == pytest.approx(share * 6.173, rel=1e-5)
            assert math.cos(float(ships[case, k, 0]) - math.radians(course)) == pytest.approx(1.0, abs=1e-5)


def test_behaviours_are_drawn_as_danger_comes_and_futures_branch():
    config = load_scenario("encounter", (*CALM, "encounter.behaviours={keeps=1,obeys=1,late=0,port=1,stops=1}"))
    mission = make_mission(config, 4, seed=5)
    ships = mission.world.scripts["traffic"].ships
    assert not ships[..., Sailing.BEHAVIOUR].any()
    futures = mission.fork([0], copies=36, noise="own")
    same = mission.fork([0], copies=36)
    for _ in range(200):
        for branch in (futures, same):
            branch.step({"usv": torch.zeros((36, 1, 2))}, begin=False)
    drawn = futures.world.scripts["traffic"].ships[..., Sailing.BEHAVIOUR]
    assert set(drawn.flatten().tolist()) >= {float(Behaviour.KEEPS), float(Behaviour.PORT)}
    assert torch.equal(same.bodies[0], same.bodies[1])


def test_an_encounter_goes_on_as_it_was_saved():
    mission = make_mission(load_scenario("encounter", SMALL), 36, seed=6)
    act = {"usv": lambda team: team.classical(team.controller)}
    for _ in range(30):
        mission.step(act)
    saved, ends = mission.snapshot(), []
    for _ in range(2):
        mission.restore(saved)
        for _ in range(20):
            step = mission.step(act)
        ends.append((step.observations["usv"], mission.pairs.table.clone(), mission.bodies.clone()))
    assert all(torch.equal(a, b) for a, b in zip(*ends, strict=True))


def test_a_planner_believes_the_tracks_and_its_ships_keep_on():
    config = load_scenario("encounter", (*SMALL, "usv.count=2", "ais.carried=0.5", "radar.range=300"))
    mission = make_mission(config, 32, seed=7)
    team, act = mission.teams["usv"], {"usv": lambda team: team.classical(team.controller)}
    for _ in range(40):
        mission.step(act, begin=False)
    model = mission.imagined(team)
    model.believe(team)
    assert torch.equal(model.teams["usv"].fleet.state, team.fleet.state)
    assert torch.equal(model.pairs.table, mission.pairs.table)
    tracks = team.tracks[:, :, 2:]
    age = torch.where(tracks[..., Track.AGE] < 0, torch.inf, tracks[..., Track.AGE])
    track = tracks.gather(1, age.argmin(1)[:, None, :, None].expand(-1, 1, -1, tracks.shape[-1]))[:, 0]
    known = age.amin(1).isfinite()
    assert known.any() and not known.all()
    for _ in range(11):
        ships = model.bodies[:, 2:]
        assert torch.allclose(ships[..., Body.LENGTH][known], track[..., Track.LENGTH][known])
        off = (ships[..., : Body.V_NORTH] - track[..., : Track.V_NORTH]).norm(dim=-1)
        assert off[known].max() < 0.2 and off[~known].min() > 1e4
        model.step(act, begin=False)
        track[..., :2] += track[..., 2:4]
    assert (model.teams["usv"].tracks[:, 0, 2:, : Track.V_NORTH] - model.bodies[:, 2:, :2])[known].abs().max() < 0.1


def test_encounters_that_an_episode_ends_before_have_no_score():
    """But for those that an early turn has ended."""
    number = []
    for duration in (25, 330):
        config = load_scenario("encounter", (*SMALL, f"episode_duration={duration}", "encounter.tcpa=[100, 200]"))
        found = judge_episodes(config, {"usv": ClassicalPolicy()}, episodes=36, seed=3, show_progress=False)
        number.append(sum(found.episodes["usv"][f"{rule}_n"].sum() for rule in RULES))
    assert number[0] <= 0.1 * number[1] and number[1] > 30


def test_candidates_of_nobody_cost_only_their_effort(calm):
    _meet(calm, [])
    team = calm.teams["usv"]
    fan, best = Plans(SbmpcGains())(team)
    assert fan.shape == (64, 1, CANDIDATES, 2) and not fan[..., 0].any()
    assert torch.equal(best[:, 0], torch.tensor([0.0, 1.0]).expand(64, 2))


def _pair(**columns):
    row = np.zeros(int(Pair.SIZE))
    row[Pair.RANGE], row[Pair.NEAR], row[Pair.NEAR_RANGE], row[Pair.ACTED] = 300.0, 60.0, 60.0, 300.0
    row[Pair.STARBOARD] = math.radians(35)
    for name, value in columns.items():
        row[Pair[name]] = value
    return row


def test_scores_fall_with_each_fault():
    part = EncounterConfig()
    port = -math.pi / 2
    good = {"KIND": Role.HEAD_ON, "CONTACT": port, "BEARING": port}
    cases = [
        (_pair(**good), 1.0),
        (_pair(**good, STARBOARD=0.0, PORT=0.7), 0.4),  # to port
        (_pair(**good, ACTED=180.0), 0.9),  # at half of the range
        (_pair(**good, STARBOARD=0.0, ACTED=0.0), 0.0),  # nothing done
        (_pair(KIND=Role.GIVE_WAY, CONTACT=-2.4, BEARING=port), 1.0),  # astern of it
        (_pair(KIND=Role.GIVE_WAY, CONTACT=0.0, BEARING=2.0), 0.0),  # ahead of it, nose to nose
        (_pair(KIND=Role.OVERTAKING, CONTACT=port, BEARING=port), 1.0),
        (_pair(KIND=Role.STAND_ON, CONTACT=port, BEARING=port), 1.0),
        (_pair(KIND=Role.STAND_ON, CONTACT=port, BEARING=port, EARLY=math.radians(20)), 0.5),
        (_pair(KIND=Role.STAND_ON, CONTACT=port, BEARING=port, NEAR=0.0), 0.5),
    ]
    found = scores(np.stack([row for row, _ in cases]), part)
    assert found == pytest.approx([score for _, score in cases], abs=1e-6)


REFUSED = {
    "encounter.speed=40": "encounter.speed",
    "encounter.near=80": "near",
    "encounter.tcpa=[0, 100]": "tcpa",
    "encounter.ships=[1, 9]": "encounter.ships",
    "encounter.own=traffic": "own",
    "usv.count=13": "usv.count",
    "traffic.correction={}": "traffic.correction",
    "encounter.own=nobody": "encounter.own",
    "ais.transponder=C": "ais.transponder",
    "ais.silent=9000": "ais",  # beyond its range
    "encounter.cases=[3]": "encounter",  # of `drawn`
    "encounter.behaviours={keeps=0,obeys=0,late=0,port=0,stops=0}": "encounter.behaviours",
    "traffic.vehicle=otter": "traffic",
    "usv.vehicle=merchant_ship": "usv.vehicle",
    "usv.control={horison=3}": "horison",
    "traffic.vary.length=[400,400]": "encounter.tcpa",
    "encounter.set=clock": "encounter.set",  # with ships that are too slow for it
}


@pytest.mark.parametrize("override", REFUSED)
def test_refusals_name_the_key(override):
    beside = {"length": "encounter.tcpa=[10,12]", "clock": "traffic.vary.length=[5,5]"}
    short = [text for word, text in beside.items() if word in override]
    with pytest.raises(UserError, match=REFUSED[override].replace(".", r"\.")):
        make_mission(load_scenario("encounter", (override, *short)), 2, seed=1)


def test_a_helm_holds_a_tanker_on_an_offset_by_its_rudder():
    mission = make_mission(load_scenario("imazu", ("usv.correction={}", "encounter.course_deg=0")), 2, seed=1)
    team = mission.teams["usv"]
    for _ in range(120):
        mission.drive({"usv": team.sail(torch.tensor([[[0.5, 1.0]], [[-0.5, 1.0]]]))}, begin=False)
    headings = torch_heading(team.fleet.quaternion_nb)[:, 0]
    assert torch.allclose(headings, torch.tensor([0.5, -0.5]), atol=math.radians(2))
    assert (team.fleet.velocity_n[:, 0, :2].norm(dim=-1) - 6.173).abs().max() < 0.5
