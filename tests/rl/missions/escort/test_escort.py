"""The escort: who knows what by whom, what is refused, and that whoever escorts meets the same vessel."""

import functools
import math

import numpy as np
import pytest
import torch
from gym_envs import ESCORT, gymnasium_accepts
from parallel_checks import pettingzoo_accepts
from phases import due
from refusal import assert_says

import taichi_sim as ts
from rl.adapters.batched import BatchedEnv
from rl.evaluation.episode_recording import record_episode
from rl.evaluation.episodes import judge_episodes
from rl.guidance.shapes import escort_offsets
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario, make_mission
from rl.missions.escort.circling import BOATS_HEARD_OF, CIRCLE_SCALE, FAR_SCALE, HEARD_OF, SLOW_SCALE
from rl.missions.escort.mission import Escort
from rl.perception.chart import AGE
from rl.perception.radio import NEVER
from rl.perception.sightings import Sighting
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder
from taichi_sim.kernels.rotation import HEADING_COS
from taichi_sim.visualisation.recording.overlays import Lines, Plot

SMALL = ("escort.worlds=8", "sea.realisations=4", "sea.components=6", "episode_duration=40")
EMPTY = ("obstacles.count=0", "obstacles.moving=0")
CALM = ("variation=0", "sea.sea_state=1", 'air.turbulence="none"', *EMPTY)


def escort(*overrides: str, envs: int = 4, seed: int = 3, teams=None) -> Escort:
    return make_mission(load_scenario("escort", (*SMALL, *overrides)), envs, seed=seed, teams=teams)


@functools.cache
def whole() -> Escort:
    """One escort for all tests that begin with `reset`."""
    return escort()


def sail(mission: Escort, steps: int, each=None) -> None:
    policies = {name: ClassicalPolicy() for name in mission.teams}
    for _ in range(steps):
        step = mission.step(policies, begin=False)
        if each:
            each(step)


@pytest.mark.slow  # one more world to compile
def test_the_vessel_does_the_same_whoever_escorts_it():
    """With other boats, none, scouts, or no messages: its way is drawn, not made."""
    ways = []
    for overrides, teams in (((), None), (("usv.count=2", 'usv.formation="ring"'), ("usv",)), ((), ("uav",))):
        mission = escort(*CALM, "course.every=4", *overrides, teams=teams)
        mission.reseed(5)
        mission.begin_each()
        courses = []
        sail(mission, 60, lambda step, m=mission, c=courses: c.append(m._script._steered.clone()))
        ways.append(torch.stack(courses))
    assert float((ways[0][-1] - ways[0][0]).abs().max()) > 0.3  # it does turn
    torch.testing.assert_close(ways[0][0], ways[1][0])
    torch.testing.assert_close(ways[0][0], ways[2][0])


@pytest.mark.slow
def test_an_action_that_is_refused_moves_no_script_and_no_other_team():
    """Nor what classical controllers remember: everything that is saved stays as it is."""
    env = BatchedEnv("escort", 2, teams="uav", others={"usv": "classical"}, overrides=SMALL)
    env.reset(seed=2)
    right = torch.zeros(2, env.vehicles["uav"], len(env.action_names["uav"]))
    env.step({"uav": right})
    before = env.mission.snapshot().values
    wrong = right.clone()
    wrong[1, 2, 0] = torch.nan
    for given in ({"uav": wrong}, {"uav": right[:, :, :1]}, {}, {"uav": right, "usv": right}):
        with pytest.raises(ts.ActionError):
            env.step(given)
        with pytest.raises(ts.ActionError):
            env.mission.step(given)
    after = env.mission.snapshot().values
    assert after.keys() == before.keys()
    for path, value in before.items():
        assert torch.equal(value, after[path]) if isinstance(value, torch.Tensor) else value == after[path], path


def test_a_world_without_its_mission_says_what_its_script_needs():
    with pytest.raises(ConfigError, match=r"vessel\.script: .* 'escort'.*rl\.BatchedEnv.*without 'vessel'"):
        ts.World.from_scenario("escort", 2, overrides=SMALL[1:3])
    assert list(ts.World.from_scenario("escort", 2, overrides=SMALL[1:3], teams=("usv",)).teams) == ["usv"]


@pytest.mark.slow
def test_an_episode_that_begins_leaves_no_trace_in_others_and_has_none_of_its_own_past():
    """Boats that learn a drift, and aircraft that see little and search."""
    env, paths = BatchedEnv("escort", 3, overrides=(*SMALL, "uav.camera.field_of_view_deg=5")), []
    for _ in range(2):
        env.reset(seed=11)
        path, generator = [env.state()], torch.Generator().manual_seed(1)
        for _ in range(15):
            env.step({team: 2 * torch.rand((3, 3, 2), generator=generator) - 1 for team in env.vehicles})
            path.append(env.state())
        env.reset(envs=torch.tensor([1]))
        assert torch.equal(env.state()[[0, 2]], path[-1][[0, 2]])
        paths.append(torch.stack(path))
    assert torch.equal(*paths)


def test_names_fit_what_is_observed():
    for team in whole().teams.values():
        assert len(team.observation_names) == team.observations().shape[-1]
        assert team.privileged is not None


def test_who_sees_what():
    """At first nobody sees the vessel; aircraft find it, boats hear of it and know better than the cue said."""
    mission = escort("obstacles.moving=0")
    mission.begin_each()
    tracking = mission.tracking
    assert not bool(tracking.sees("usv").any())
    cue = (tracking.targets[:, 0, :2] - mission.vessel_place).norm(dim=-1)
    sail(mission, 125)
    assert bool(tracking.sees("uav").any(-1).all())
    assert not bool(tracking.sees("usv").any())
    assert float(tracking.age.max()) <= mission.config.escort.stale
    off = (tracking.targets[..., :2] - mission.vessel_place.unsqueeze(1)).norm(dim=-1)
    assert float(off.max()) < 8.0 < float(cue.mean())
    assert float(tracking.sigma.max()) < 5.0


def test_without_messages_boats_keep_to_the_cue():
    mission = escort('escort.reports="none"', "course.turn_deg=0")
    mission.begin_each()
    sail(mission, 100)
    tracking = mission.tracking
    boats = tracking.of("usv", tracking.age)
    assert float(boats.min()) == pytest.approx(60.0 + 20.0, abs=0.3)  # nothing but the cue, and that has aged
    assert float(tracking.of("uav", tracking.age).min()) < 1.0
    assert float(tracking.radio.heard[..., -1].min()) >= NEVER


def test_scouts_tell_while_there_are_no_aircraft():
    mission = escort(teams=("usv",))
    mission.begin_each()
    assert mission.scouts is not None and set(mission.teams) == {"usv"}
    sail(mission, 190)
    place = mission.scouts.views.position_n
    apart = (place[..., :2] - mission.vessel_place.unsqueeze(1)).norm(dim=-1)
    torch.testing.assert_close(apart, torch.full_like(apart, mission.scouts.orbit.radius), atol=15.0, rtol=0)
    assert float(mission.tracking.of("usv", mission.tracking.age).max()) < 3.0


@pytest.mark.slow  # half a minute of sailing
def test_boats_close_in_and_errors_are_of_the_truth():
    mission = escort(*CALM, "escort.start_distance=[30,40]", "course.speed=[1.0,1.0]", "course.turn_deg=0")
    mission.begin_each()
    boats = mission.teams["usv"]
    sail(mission, 350)
    slot = torch.atan2(mission.vessel_velocity[:, 1], mission.vessel_velocity[:, 0])
    c, s = slot.cos().unsqueeze(-1), slot.sin().unsqueeze(-1)
    ahead, starboard = boats.offsets.unbind(-1)
    place = torch.stack((c * ahead - s * starboard, s * ahead + c * starboard), dim=-1)
    off = (boats.fleet.position_n[..., :2] - mission.vessel_place.unsqueeze(1) - place).norm(dim=-1)
    torch.testing.assert_close(off, boats.distance, atol=0.02, rtol=0)
    assert float(boats.distance.median()) < 5.0
    assert bool(mission.arrived.all())


def test_boats_far_from_the_vessel_use_all_their_thrust():
    """They ask for 1.05 of the top speed, 2 k n^2 / D11 = 3.0864 m/s; on course, the greater thrust is all there is."""
    mission = whole()
    mission.reset()
    boats = mission.boats
    assert boats is not None
    asked = boats.controller.wanted(boats.known).velocity.norm(dim=-1)  # there is no drift yet
    assert float(asked.max()) == pytest.approx(1.05 * 3.0864, rel=1e-4)
    sail(mission, 50)
    wanted = boats.controller.wanted(boats.known).velocity
    heading = boats.fleet.derived[..., HEADING_COS : HEADING_COS + 2]
    off = 1 - (wanted * heading).sum(-1) / wanted.norm(dim=-1)
    ready = (boats.distance > 100) & (wanted.norm(dim=-1) > 3.0864) & (off < 0.005)
    t = boats.fleet.model.params.thrusters
    surge, yaw = boats.controller(boats.known)[ready].unbind(-1)
    greater = 0.5 * (surge + 1) * t.thrust_max + 0.5 * yaw.abs() * (t.thrust_max - t.thrust_min)
    assert ready.any() and (greater > 0.999 * t.thrust_max).all()


def test_charted_obstacles_are_evaded_before_they_are_seen():
    """What stands beyond the lookouts' range is on the boats' list because aircraft have told them."""
    mission = escort("obstacles.moving=0", "usv.lookout.obstacle_range=1.0", "usv.lookout.vessel_range=1.0")
    mission.begin_each()
    found = []

    def keep(step):
        known = mission.teams["usv"].known.sensor.obstacles
        found.append(known[known[..., 8] >= 0])

    sail(mission, 100, keep)
    rows = torch.cat(found)
    assert len(rows) > 20
    looks = mission.tracking.of("usv", mission.tracking.sightings)[..., Sighting.VARIANCE]
    assert not bool((looks > 0).any())


def gap_errors(angle: torch.Tensor, present: torch.Tensor, turn: float) -> torch.Tensor:
    """Plain reference: row i of `angle`, `present` [.., n, n] is how aircraft i knows all of them."""
    own = angle.diagonal(dim1=-2, dim2=-1).unsqueeze(-1)
    ahead = torch.remainder(turn * (angle - own), 2 * math.pi)
    others = present & ~torch.eye(angle.shape[-1], dtype=torch.bool)
    nearest = ahead.masked_fill(~others, 2 * math.pi).amin(-1)
    behind = 2 * math.pi - ahead.masked_fill(~others, 0.0).amax(-1)
    return torch.where(others.any(-1), 0.5 * (nearest - behind), 0.0)


def test_aircraft_measure_and_observe_what_plain_torch_does():
    """Also where messages are old, lost, or of boats that nobody has heard."""
    mission = whole()
    mission.reseed(5)
    mission.begin_each()
    sail(mission, 8)
    team, tracking = mission.teams["uav"], mission.tracking
    known, rows, boats = team.measured, tracking.groups["uav"].rows, tracking.groups["usv"].rows
    generator, heard = torch.Generator().manual_seed(1), tracking.radio.heard
    heard[..., -1] = torch.randint(1, 5, heard.shape[:3], generator=generator) * HEARD_OF * 0.9
    heard[0, ..., -1] = NEVER
    turn, radius = team.orbit.turn, team.orbit.radius
    team._errors.measure(due(mission.num_envs))
    known.circle.listen(due(mission.num_envs))

    x = team.fleet.position_n - torch.cat((mission.vessel_place, torch.zeros(4, 1)), dim=-1).unsqueeze(1)
    off = torch.hypot(x[..., :2].norm(dim=-1) - radius, x[..., 2] - team.down)
    torch.testing.assert_close(team.distance, off)
    angle = torch.atan2(x[..., 1], x[..., 0]).unsqueeze(-2).expand(-1, 3, -1)
    torch.testing.assert_close(
        team.gap_error, gap_errors(angle, torch.ones(4, 3, 3, dtype=torch.bool), turn), atol=1e-5, rtol=0
    )
    apart = (team.fleet.position_n.unsqueeze(2)[..., :2] - mission.boats.fleet.position_n.unsqueeze(1)[..., :2]).norm(
        dim=-1
    )
    near = torch.hypot(apart, team.fleet.position_n[..., 2:]) < mission.config.radio.range
    torch.testing.assert_close(team.in_range, near.float().mean(-1))

    place, old = known.fleet.position_n, heard[:, rows, rows, -1]
    centre = tracking.of("uav", tracking.targets)[..., :2]
    there = heard[:, rows, rows, :2] + old.unsqueeze(-1) * heard[:, rows, rows, 3:5] - centre.unsqueeze(2)
    own = torch.atan2(*(place[..., :2] - centre).flip(-1).unbind(-1))
    angle = torch.where(torch.eye(3, dtype=torch.bool), own.unsqueeze(-1), torch.atan2(there[..., 1], there[..., 0]))
    torch.testing.assert_close(known.gap_error, gap_errors(angle, old < HEARD_OF, turn), atol=1e-5, rtol=0)
    said, fresh = heard[:, rows, boats], (heard[:, rows, boats, -1:] < BOATS_HEARD_OF).float()
    mean = (fresh * said[..., :2]).sum(2) / fresh.sum(2).clamp(min=1.0)
    far = (fresh * (said[..., :2] - place[..., None, :2])).norm(dim=-1).amax(-1, keepdim=True)
    torch.testing.assert_close(known.boats, (mean, far))
    assert bool((far > 0).any()) and bool((far == 0).any())

    def squashed(v, scale):
        return v / (v.abs() + scale)

    def own_frame(v):
        return (v.unsqueeze(-2) @ known.fleet.R_nb).squeeze(-2)

    terms, level = team.observe(), torch.zeros(4, 3, 1)
    to, c, s = torch.cat((centre, level), dim=-1) - place, known.target.cos, known.target.sin
    v = known.centre_velocity
    circle = torch.stack((to[..., :2].norm(dim=-1) - radius, team.down - place[..., 2]), dim=-1)
    group = torch.where(far > 0, torch.cat((mean, level), dim=-1) - place, 0.0)
    distance = group.norm(dim=-1, keepdim=True)
    wanted = {
        "down": known.fleet.down_b,
        "vessel": own_frame(to / to.norm(dim=-1, keepdim=True)),
        "vessel_velocity": squashed(
            torch.stack((c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]), dim=-1), SLOW_SCALE
        ),
        "circle": squashed(circle, CIRCLE_SCALE),
        "gap": known.gap_error.unsqueeze(-1) / math.pi,
        "view": team.sees.unsqueeze(-1).float(),
        "boats": own_frame(group / distance.clamp(min=1.0)),
        "boats_distance": squashed(torch.cat((distance, far), dim=-1), FAR_SCALE),
        "surroundings": known.sensor.signals,
        "previous_action": team.action,
        "wind": squashed(own_frame(torch.stack([known.fleet.reading(n) for n in team.fleet.model.air], dim=-1)), 10.0),
    }
    for name, value in wanted.items():
        torch.testing.assert_close(terms[name], value, atol=2e-6, rtol=1e-5, msg=name)


def test_the_direction_to_the_vessel_has_length_1_and_fades_within_a_metre():
    mission = whole()
    mission.begin_each()
    team = mission.teams["uav"]
    place, targets = team.measured.fleet.state[..., :3], mission.tracking.of("uav", mission.tracking.targets)
    for distance, length in ((0.0, 0.0), (0.5, 0.5), (1.2, 1.0), (50.0, 1.0)):
        place[..., :2], place[..., 2] = targets[..., :2], -distance  # straight above
        direction = team.observe()["vessel"]
        torch.testing.assert_close(direction, length * team.measured.fleet.down_b, atol=1e-4, rtol=0)


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_gaps_are_even_at_even_phases_and_push_towards_them(turn):
    mission = whole()
    mission.begin_each()
    team = mission.teams["uav"]
    angle = turn * torch.tensor([[0.0, 2 * math.pi / 3, 4 * math.pi / 3]]).repeat(4, 1)
    angle[1, 1] -= turn * 0.3  # behind its place: it has to speed up, the others to wait or to go on
    team.fleet.state[..., 0] = mission.vessel_place[:, :1] + 100 * angle.cos()
    team.fleet.state[..., 1] = mission.vessel_place[:, 1:] + 100 * angle.sin()
    numbers = team._errors._true.members["numbers"]
    before = numbers.clone()
    numbers[1] = turn
    team._errors.measure(due(4))
    numbers.copy_(before)
    torch.testing.assert_close(team.gap_error[0], torch.zeros(3), atol=1e-5, rtol=0)
    torch.testing.assert_close(team.gap_error[1], torch.tensor([-0.15, 0.3, -0.15]), atol=1e-5, rtol=0)


@pytest.mark.parametrize("shape", ["abreast", "astern", "wedge", "echelon", "ring"])
@pytest.mark.parametrize("count", [1, 3, 8])
def test_slots_keep_their_distance_from_the_vessel_and_each_other(shape, count):
    offsets = torch.cat((torch.zeros(1, 2, dtype=torch.float64), escort_offsets(shape, count, 10.0)))
    assert float(torch.pdist(offsets).min()) >= 10.0 - 1e-9


def test_the_judge_counts_arrivals_and_views():
    config = load_scenario("escort", (*SMALL, *EMPTY, "escort.start_distance=[30,60]", "evaluation.settle_after=5"))
    result = judge_episodes(
        config, {n: ClassicalPolicy() for n in ("usv", "uav")}, episodes=6, seed=2, show_progress=False
    ).result
    boats, aircraft = result["teams"]["usv"], result["teams"]["uav"]
    assert boats["never_arrives"] == 0.0 and 2.0 < boats["time_to_arrive_s"] <= boats["time_to_arrive_p90_s"] < 40.0
    assert boats["in_camera"] is None and aircraft["time_to_arrive_s"] is None
    assert 0.5 < aircraft["in_camera_always"] <= 1.0 and aircraft["energy_per_metre_J"] > 3.0
    assert boats["energy_per_metre_J"] > 10.0 and boats["leader_error_rms_m"] < 15.0


def test_episodes_that_never_arrive_count_in_full():
    config = load_scenario("escort", (*SMALL, "escort.start_distance=[400,500]", "episode_duration=5"))
    result = judge_episodes(config, {"usv": ClassicalPolicy()}, episodes=4, seed=2, show_progress=False).result
    boats = result["teams"]["usv"]
    assert boats["never_arrives"] == 1.0 and boats["mean_time_to_arrive_s"] == pytest.approx(5.0)
    assert boats["time_to_arrive_s"] is None and boats["leader_error_rms_m"] is None


def made(*overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        escort(*overrides, envs=1)
    return str(caught.value)


TWO_ISLANDS = "obstacles.fixed=[{north=300,east=0,radius=280,height=5},{north=-300,east=0,radius=280,height=5}]"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("vary={}", "air.speed=24.0"), ["air.speed", "m/s", "circle"]),
        (("uav.orbit.radius=60",), ["uav.orbit.radius", "downwind"]),
        (("uav.count=8", "uav.orbit.radius=3", "uav.orbit.height_step=0"), ["uav.orbit.radius", "8 aircraft"]),
        (("usv.spacing=2.0",), ["usv.spacing", "touch"]),
        (('usv.vehicle="aerosonde"', 'usv.medium="air"'), ["usv.vehicle", "water"]),
        (('vessel.vehicle="unity_boat"',), ["vessel.vehicle", "script"]),
        (("course.speed=[0.8,9.0]",), ["course.speed", "can go"]),
        ((TWO_ISLANDS,), ["obstacles.fixed", "boats would begin"]),
    ],
)
def test_what_cannot_be_is_refused_with_its_numbers(overrides, words):
    assert_says(made(*overrides), *words)


OTHERS = (
    ("uav.count=1", "course.evasive=true"), ("uav.count=5", "usv.count=8", "radio.range=1.0"),
    ('uav.camera.mount="fixed"', 'uav.camera.surface="waves"', "usv.lookout.crests=true"),
)  # fmt: skip


@pytest.mark.parametrize("overrides", OTHERS)
def test_other_escorts_sail(overrides):
    mission = escort(*overrides, envs=2)
    mission.begin_each()
    sail(mission, 4)
    for team in mission.teams.values():
        assert bool(team.observations().isfinite().all())
    assert bool((mission.tracking.chart.tracks[..., 0, AGE] < NEVER).all())


def test_an_evasive_vessel_runs_from_boats():
    mission = escort(*CALM, "course.evasive=true", "escort.start_distance=[25,30]", teams=("usv",))
    mission.begin_each()
    sail(mission, 200)
    away = mission.vessel_place.unsqueeze(1) - mission.boats.fleet.position_n[..., :2]
    near, which = away.norm(dim=-1).min(dim=-1)
    away = away[torch.arange(4), which] / near.unsqueeze(-1)
    sailed = mission.vessel_velocity / mission.vessel_velocity.norm(dim=-1, keepdim=True)
    assert float((away * sailed).sum(-1).median()) > 0.7
    assert float(mission.vessel_velocity.norm(dim=-1).median()) > 1.5  # as fast as it may


def test_a_vessel_that_outruns_the_boats_is_allowed_and_said():
    with pytest.warns(UserWarning, match="arrive only while"):
        escort('usv.vehicle="wamv"', "course.speed=[1.0,2.8]", envs=1, teams=("usv",))


def test_an_escort_without_aircraft(tmp_path):
    """Nobody flies, and nobody stands in for them."""
    text = (config_folder() / "escort.toml").read_text()
    begin, end = text.index("[uav]"), text.index("[stages.boats]")
    again = text.index("[stages.aircraft]"), text.index("[stages.boats_again]")
    (tmp_path / "alone.toml").write_text(text[:begin] + text[end : again[0]] + text[again[1] :])
    mission = make_mission(load_scenario(tmp_path / "alone.toml", SMALL), 2, seed=1, source=tmp_path / "alone.toml")
    mission.begin_each()
    sail(mission, 5)
    assert mission.scouts is None and set(mission.teams) == {"usv"}


def test_a_recording_shows_who_sees_and_tells_what():
    """Every aircraft's messages to every boat are drawn, arrived or lost, and end there."""
    config = load_scenario("escort", SMALL)
    policies = {name: ClassicalPolicy() for name in ("usv", "uav")}
    episode = record_episode(config, policies, seed=3, duration=6.0)
    assert set(episode.teams) == {"usv", "uav", "vessel"}
    drawn = {overlay.name: overlay for overlay in episode.overlays}
    arrived, lost = drawn["messages/arrived"], drawn["messages/lost"]
    assert isinstance(arrived, Lines) and isinstance(lost, Lines)
    there = [np.isfinite(lines.points_n[..., 0, 0]) for lines in (arrived, lost)]
    assert there[0].shape[1] == 9 and not (there[0] & there[1]).any()
    assert (there[0] | there[1])[2:].all()  # each is one or the other, from the first that could be there on
    assert 0.02 < there[1][2:].mean() < 0.25  # a tenth is lost
    boats = episode.teams["usv"].position_n
    ends = arrived.points_n[:, ::3, -1]  # of the first aircraft's, at each boat
    seen = np.isfinite(ends[..., 0])
    np.testing.assert_allclose(ends[seen], boats[seen], atol=1e-3)
    prints = drawn["footprints"]
    assert isinstance(prints, Lines) and np.nanmax(np.abs(prints.points_n[..., 2])) == 0.0
    ages = drawn["age of the track of the vessel"]
    assert isinstance(ages, Plot) and ages.lines == ("usv0", "usv1", "usv2", "uav0", "uav1", "uav2")


def test_gymnasium_and_pettingzoo_accept_it():
    gymnasium_accepts("taichi_sim/EscortUsv-v0")
    pettingzoo_accepts("escort", ESCORT)
