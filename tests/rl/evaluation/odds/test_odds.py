"""Odds of endings in the simulator (rl/evaluation/odds): a closed form, direct simulation, threads, refusals."""

import gc
import json
import math
import re

import numpy as np
import pytest
import torch
from command_line import command as run_command
from scipy import stats

from rl.commands import odds as command
from rl.evaluation.odds import splitting
from rl.evaluation.odds.estimate import Answer, Part, Pilot, Question, check
from rl.evaluation.odds.paths import EpisodePaths
from rl.evaluation.odds.splitting import HAPPENED, Levels, Repeat, find_levels, pooled, repeat
from rl.evaluation.report.odds import row
from rl.evaluation.store import load_odds, save_odds
from rl.mission import Mission
from rl.missions import load_scenario
from rl.missions.formation.team import TeamTask
from rl.runs.folder import RunError
from rl.team import Team

STEPS, INTERVAL, CURRENT, MEMORY = 60, 0.1, 0.3, 2.0  # decisions, s, m/s, s
ENVS = 300


class Drifter(Team):
    """A boat on a straight course, which a random current sets to a side, passes a post at the end of its episode."""

    radius = 0.35  # m, of boat and post together

    def observe(self):
        return {"aside": self.mission.aside.view(-1, 1, 1) / 10}

    def reward(self, ended):
        return torch.zeros_like(self.fleet.state[..., 0])

    def endings(self):
        left = (self.steps < self.mission.config.episode_steps).unsqueeze(1)
        return {"collided": (self.mission.miss().abs() < self.radius).unsqueeze(1) & ~left}

    def importance(self, ending):
        return IMPORTANCE[self.mission.kind](self.mission).unsqueeze(1)


class Drifting(Mission):
    """A post stands `post` (m) to starboard of the course."""

    Team = Drifter
    post, kind = 1.0, "expected"

    def prepare(self):
        self.aside = self.remember(torch.zeros(self.num_envs, dtype=torch.float64))

    def begin(self, envs, **where):
        place = torch.zeros((len(envs), 1, 2))
        self.place("usv", envs, place, torch.zeros((len(envs), 1)))
        self.aside[envs] = 0.0

    def move(self, due):
        self.aside += self.world.around.current[:, 1].double() * INTERVAL

    def miss(self):
        return self.post - self.aside

    @classmethod
    def one_each(cls, config, episodes):
        return config


IMPORTANCE = {  # of a drifting boat
    "expected": lambda m: -_lacking(m) / TO_COME[m.steps.clamp(max=STEPS)],
    "place": lambda m: -m.miss().abs(),
    "poor": lambda m: m.aside.abs().round() + 0.1 * torch.sin(40.0 * m.aside),
}


def _to_come(left):
    """Standard deviation (m) of the way that an AR(1) current of known value sets a boat in `left` decisions."""
    kept = np.exp(-INTERVAL / MEMORY)
    moved = (1 - kept ** np.arange(1, left + 1)) / (1 - kept)  # decisions, by one innovation
    return CURRENT * INTERVAL * math.sqrt((1 - kept**2) * (moved**2).sum())


def _lacking(mission):
    """How far (m) from a hit the boat will be if nothing random happens any more."""
    left = 1 - torch.exp(-(STEPS - mission.steps) * INTERVAL / MEMORY)
    return ((mission.miss() - mission.world.around.current[:, 1] * MEMORY * left).abs() - Drifter.radius).clamp(min=0.0)


LEAST = 0.02  # m, below which no spread counts
TO_COME = torch.tensor([max(_to_come(STEPS - done), LEAST) for done in range(STEPS + 1)])


def drifting(seed, post=1.0, kind="expected", envs=ENVS, mission=None):
    overrides = (
        "usv.count=1", f"episode_duration={STEPS * INTERVAL}", f"decision_interval={INTERVAL}", f"dt={INTERVAL}",
        f"sea.current={{speed=0.0, direction_deg=90, std={CURRENT}, time_constant={MEMORY}}}", "sea.components=1",
        "sea.hs=0.0", "sea.realisations=1", "evaluation.settle=1",
    )  # fmt: skip
    mission = (mission or Drifting)(load_scenario("paper", overrides), envs, seed=seed, teams=("usv",))
    mission.post, mission.kind = post, kind
    return mission


def still(team):
    return torch.zeros_like(team.fleet.action)


def paths(seed, **options):
    return EpisodePaths(drifting(seed, **options), {"usv": still}, "usv", "collided")


def spread():
    """Standard deviation (m) of where the boat is at the end: the sum of an AR(1) process from its own distribution."""
    apart = np.abs(np.subtract.outer(np.arange(STEPS), np.arange(STEPS)))
    return CURRENT * INTERVAL * math.sqrt(np.exp(-INTERVAL / MEMORY * apart).sum())


def closed_form(post):
    edges = np.array([post + Drifter.radius, post - Drifter.radius]) / spread()
    return float(stats.norm.sf(edges[1]) - stats.norm.sf(edges[0]))


def estimate(post, kind="expected", effort=400, repeats=20, seed=1, envs=ENVS):
    rng = np.random.default_rng(seed)
    own = paths(seed, post=post, kind=kind, envs=envs)
    found = find_levels(own, effort, rng)
    done = []
    for number in range(repeats):
        own.mission.reseed(seed + 1000 * (number + 1))
        done.append(repeat(own, found.levels, effort, rng))
    return pooled(done, found.levels, found.cost), done


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigmas", "gain", "effort", "envs"), [(3.0, 1, 300, 300), (3.85, 20, 300, 64), (5.0, 1000, 600, 64)]
)
def test_a_boat_in_noise_hits_a_post_as_often_as_the_normal_distribution_says(sigmas, gain, effort, envs):
    post = sigmas * spread()
    odds, _ = estimate(post, effort=effort, envs=envs)
    assert odds.low < closed_form(post) < odds.high and odds.relative < 0.2
    assert odds.direct(odds.relative) * STEPS > gain * odds.cost


@pytest.mark.slow
def test_any_importance_gives_the_same_odds():
    post = 3.0 * spread()
    found = {kind: estimate(post, kind, effort=300)[0] for kind in IMPORTANCE}
    assert all(odds.low < closed_form(post) < odds.high for odds in found.values())
    assert found["expected"].relative < found["place"].relative < found["poor"].relative


class Doomed(Drifter):
    """Now and then a boat hits something at the end, whatever happens before."""

    def endings(self):
        over = (self.steps >= self.mission.config.episode_steps).unsqueeze(1)
        return {"collided": self.mission.doomed.unsqueeze(1) & over}


class Dooming(Drifting):
    Team = Doomed

    def prepare(self):
        super().prepare()
        self.doomed = self.remember(torch.zeros(self.num_envs, dtype=torch.bool))

    def begin(self, envs, **where):
        super().begin(envs)
        self.doomed[envs] = self.draw(DOOM, len(envs)) == 0


DOOM = 500  # episodes, of which one is doomed


def test_a_failure_that_is_decided_at_the_start_has_no_figure():
    own = paths(3, kind="place", mission=Dooming)
    rng, levels = np.random.default_rng(0), (-1.0, -0.3, HAPPENED)
    done = [repeat(own, levels, 200, rng) for _ in range(8)]
    odds = pooled(done, levels)
    assert odds.p > 0 and odds.decided and odds.low is None and odds.high is None
    assert odds.ancestors == len({(k, a) for k, one in enumerate(done) for a in one.weights.nonzero()[0]}) < 10


def test_repeats_are_planned_until_enough_beginnings_carry_the_result():
    def answer(carry, repeats=20):  # each repeat has the same p; of so many repeats together, `carry` beginnings do
        weights = np.zeros((repeats, 100))
        weights[:carry, 0] = 1e-4 / carry
        parts = [Part(k, Repeat((0.1, 0.1), row, (), 1.0, np.zeros(0)), {}, None) for k, row in enumerate(weights)]
        return Answer(None, Pilot(Levels((0.0, HAPPENED), 0.0), 1.0, 1, True), 100, parts)

    assert answer(5).odds.decided and abs(answer(5).more(0.9) - 40) <= 1 and abs(answer(2).more(0.9) - 130) <= 1
    assert not answer(16).odds.decided and answer(16).more(0.9) == 0 and answer(16).more(0.05) > 40


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_threads_change_no_digit(threads):
    from taichi_sim.kernels import runtime

    runtime.init(threads=threads)
    levels = find_levels(own := paths(2, post=3.0 * spread(), envs=64), 100, np.random.default_rng(0))
    one = repeat(own, levels.levels, 100, np.random.default_rng(1))
    FOUND.setdefault("threads", (levels, one.shares, one.weights.tolist()))
    assert FOUND["threads"] == (levels, one.shares, one.weights.tolist())
    assert len(levels.levels) > 1 and one.p > 0


FOUND: dict = {}


@pytest.fixture
def small(monkeypatch):
    from rl.evaluation.odds import estimate

    for name, value in {"POOL": 4, "SLOTS": 32, "REPEATS": 3, "MOST": 3}.items():
        monkeypatch.setattr(estimate, name, value)


SHORT = ("--set", "episode_duration=8", "--set", "evaluation.settle=1", "--controller", "classical", "--threads", "1")


def missions_held() -> int:
    """Missions in memory."""
    return sum(issubclass(type(one), Mission) for one in gc.get_objects())


@pytest.mark.slow
def test_the_command_tells_keeps_and_repeats(small, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(splitting, "COMMON", 1.0)
    given = ["otter", "--team", "usv", "--of", "lost", "--set", "usv.lost_distance=9", *SHORT, "--effort", "64"]
    told, before = tmp_path / "odds.json", missions_held()
    command.main([*given, "--relative", "0.5", "--quiet", "--json", str(told)])
    assert missions_held() <= before + 1  # those of all repeats are gone
    text, figures = capsys.readouterr().out, json.loads(told.read_text())["usv"]
    assert "usv lost in otter, classical:" in text and "95 % interval" in text
    assert figures["probability"] == pytest.approx(np.mean(figures["repeats"]))
    assert (
        len(figures["levels"]) > 1 and figures["low"] < figures["probability"] < figures["high"] and figures["complete"]
    )
    out = tmp_path / "failure.rrd"
    command.main([*given, "--again", str(told), "--out", str(out), "--quiet"])
    assert out.stat().st_size > 1000 and str(out) in capsys.readouterr().out


@pytest.mark.slow
def test_processes_change_no_digit(tmp_path):
    told = []
    for number in (1, 2):
        file = tmp_path / f"{number}.json"
        given = ["otter", "--team", "usv", "--of", "lost", "--set", "usv.lost_distance=9", *SHORT, "--effort", 32]
        ending = run_command("rl.commands.odds", *given, "--quiet", "--processes", number, "--json", file)
        assert ending.status == 0, ending.err
        told.append(file.read_bytes())
    assert told[0] == told[1]


def test_a_run_keeps_its_odds_and_its_report_shows_them(tmp_path):
    """One row for each question: an answer replaces that of the same question."""
    told = {
        "team": "usv", "ending": "lost", "controller": "policy", "probability": 2e-5, "low": 1e-5, "high": 4e-5,
        "per_hour": 8e-4, "beginnings": 10240, "levels": [-1.0, "lost"],
        "conditions": [{"condition": "current, m/s", "begins": 0.3, "ends": 0.4,
                         "ratio": 2.0, "low": 1.5, "high": 3.0}],
    }  # fmt: skip
    for p, overrides in ((1e-5, ()), (2e-5, ()), (None, ("sea.hs=2",))):
        save_odds(tmp_path, {**told, "probability": p}, None, overrides)
    first, second = (row(of) for of in load_odds(tmp_path))
    assert first == ["usv lost, policy", "2.00e-05 (1.00e-05 to 4.00e-05)", "0.0008", "10240",
                     "current, m/s 0.3 to 0.4: 2"]  # fmt: skip
    assert second[:3] == ["usv lost, policy --set sea.hs=2", "no figure: decided at the start", "-"]


def test_what_has_no_odds_is_refused_by_name(small, monkeypatch):
    config = load_scenario("otter", ("episode_duration=8", "evaluation.settle=1", "track.worlds=4"))
    margins = TeamTask.margins
    monkeypatch.setattr(TeamTask, "margins", lambda team: {**margins(team), "far": 2.0 - team.distance})

    class Remembering:
        remembers = True

    def asked(policy=still, team="usv", ending="collided"):
        return lambda: check(Question(config, {"usv": policy}, team, ending, 1))

    cases = {
        "--of sunk: usv of 'otter' ends as collided, lost, left, far": asked(ending="sunk"),
        "--team uav: there are usv": asked(team="uav"),
        "usv: a Remembering has a memory": asked(policy=Remembering()),
        "episodes of 'otter' begin so": asked(ending="far"),
        "--relative 1.5: must be below 1": lambda: command.main(["otter", "--relative", "1.5", *SHORT]),
    }
    for text, call in cases.items():
        with pytest.raises(RunError, match=re.escape(text)):
            call()
    with pytest.raises(SystemExit):
        command.main(["otter", "--relative", "0"])
