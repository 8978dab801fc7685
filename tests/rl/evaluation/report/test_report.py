"""The report of a run, and the episodes that it shows, run again."""

import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
from command_line import TEAMS, forget, tiny_run
from small_missions import make

from rl.evaluation import episodes as evaluation
from rl.evaluation.conditions import conditions_of
from rl.evaluation.episode_log import End, Ended, Excerpt, TeamLog, load_log, save_log
from rl.evaluation.episode_recording import record_episode
from rl.evaluation.report import episodes as shown_part
from rl.evaluation.report import write_report
from rl.evaluation.report.failures import correlation, failures
from rl.evaluation.store import EvaluationConditions, StoredEvaluation, load_evaluation, read_run
from rl.judge import Judge
from rl.learn.policy import policies_of
from rl.runs import folder as run_folder


class Links(HTMLParser):
    """Everything that a page asks for, and whether its elements are closed in order."""

    VOID = ("meta", "link", "img", "br")

    def __init__(self, page: str):
        super().__init__()
        self.found, self.open = [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action")]
        self.found += [tag] if tag in ("script", "link", "iframe", "object") else []
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, (tag, self.getpos())


@pytest.mark.slow
def test_the_main_jobs_report_is_one_file_that_asks_for_nothing():
    page = (tiny_run() / "report.html").read_text()
    links = Links(page)
    assert not links.open and page.count("<svg") >= 4
    (strip,) = [link for link in links.found if not link.startswith("#")]
    assert strip.startswith("data:image/webp;base64,") and 10_000 < len(strip) < 4_000_000
    page = page.replace(strip, "")
    assert "http" not in page and "url(" not in re.sub(r"url\(#\w+\)", "", page)
    assert len(page) < 2_000_000
    for words in ("policy - classical", "leader_error_rms_m", "4 iterations", "worst episode", "No vehicle collided"):
        assert words in page, words
    assert "currentColor" in page and "#22313F" not in page.split("</style>")[1]  # is read on dark too


@pytest.mark.slow
def test_a_recording_is_linked_where_there_is_one(run, here):
    assert f"taichi-sim play {run} --worst" in write_report([run]).read_text()
    assert here("rl.commands.play", run, "--worst").status == 0
    links = Links(write_report([run]).read_text())
    assert [link for link in links.found if not link.startswith(("#", "data:"))] == ["worst.rrd"]
    assert (run / "worst.rrd").is_file()


def test_a_report_says_what_is_missing_and_how_to_make_it(run, here):
    """And what changed with another vehicle than the scenario's."""
    forget(run, "uav")
    config = run / "config.toml"
    config.write_text(config.read_text().replace("replaced = []", 'replaced = ["usv.spacing: 6.0 -> 9.0, by length"]'))
    ending = here("rl.commands.report", run)
    assert ending.status == 0, ending.err
    page = (run / "report.html").read_text()
    for words in ("training is not finished", f"taichi-sim odds {run} --of collided",
                  f"taichi-sim evaluate {run}", "--sweep default", "--resume",
                  "<li>usv.spacing: 6.0 -&gt; 9.0, by length</li>"):  # fmt: skip
        assert words in page, words


@pytest.mark.slow
def test_two_runs_stand_side_by_side(run, tmp_path, here):
    other = shutil.copytree(run, tmp_path / "other")
    config = other / "config.toml"
    config.write_text(config.read_text().replace("hs = 0.5", "hs = 0.6"))
    ending = here("rl.commands.report", run, other)
    assert ending.status == 0, ending.err
    page = (run / "report-and-other.html").read_text()
    assert "run: policy - other: policy" in page and "Collisions: other" in page
    assert "The scenarios differ in sea:" in page
    assert "+0</b>" not in page and "+0 <i>(0 to 0)</i>" in page  # a run differs from its copy by nothing


def test_an_episode_that_was_judged_is_run_again(run, monkeypatch):
    """In whichever chunk it was: the same distances from the slots at every moment."""
    monkeypatch.setattr(evaluation, "CHUNK", 3)
    config, source = run_folder.load_config(run)
    policies = policies_of("classical", run, config)  # none of whose vehicles ends early
    options = {"seed": 7, "source": source, "show_progress": False}
    outcome = evaluation.judge_episodes(config, policies, episodes=7, excerpts=True, **options)
    errors = [np.fmax(of["leader_error_rms_m"], of["follower_error_rms_m"]) for of in outcome.episodes.values()]
    for name, rank in (("worst", -1), ("median", 3)):
        number = outcome.result[f"{name}_episode"]
        episode = record_episode(config, policies, number=(number, 7), **options)
        time = episode.time_s > config.evaluation.settle + 1e-6
        for team in TEAMS:
            shown = outcome.shown[name].teams[team].series["distance from slot (m)"]
            np.testing.assert_allclose(episode.teams[team].error_m, shown, rtol=0, atol=1e-4)
            rms = np.sqrt((episode.teams[team].error_m[time, 0] ** 2).mean())
            assert rms == pytest.approx(outcome.episodes[team]["leader_error_rms_m"][number], abs=1e-4)
        assert np.argsort(np.maximum(*errors))[rank] == number  # none collided or failed


def test_the_worst_is_of_the_last_evaluation_and_under_its_conditions(run, here):
    here("rl.commands.play", run, "--worst", "--set", "sea.hs=1").fails("leave out")
    here("rl.commands.play", run, "--worst", "--median").fails("not allowed", status=2)
    assert here("rl.commands.evaluate", run, "--set", "sea.hs=0.8", "--episodes", "3").status == 0
    found = load_evaluation(run, "policy")
    assert found is not None and str(found.conditions) == "--set sea.hs=0.8" and found.result["episodes"] == 3
    assert len(found.of_each["sea.hs"]) == 3 and np.allclose(found.of_each["sea.hs"], 0.8, rtol=1e-4)
    assert here("rl.commands.play", run, "--worst").status == 0
    assert (run / "worst.rrd").is_file()
    here("rl.commands.play", run, "--episode", "3").fails("--episode 3", "episodes 0 to 2")
    assert here("rl.commands.play", run, "--episode", "2").status == 0
    assert (run / "episode-2.rrd").is_file()
    shutil.rmtree(run / "evaluation")
    here("rl.commands.play", run, "--worst").fails("no evaluation of 'policy'", "taichi-sim evaluate")


def test_collided_comes_before_failed_and_failed_before_a_large_error():
    kind = evaluation.find_mission("formation").Judge
    errors = {f"{who}_error_rms_m": np.array([0.1, 9.0, 0.2, np.nan, 0.3]) for who in ("leader", "follower")}
    of_team = errors | {"collided": np.array([0, 0, 2, 0, 0.0]), "failed": np.array([0, 0, 1, 1, 0.0])}
    assert evaluation.choose(kind, {"boats": of_team}) == {"worst": 2, "median": 1}
    calm = of_team | {"collided": np.zeros(5), "failed": np.zeros(5)}
    assert evaluation.choose(kind, {"boats": calm, "others": calm})["worst"] == 3  # it could not even be measured


def test_where_no_error_is_measured_the_worst_of_those_that_failed_is_paid_least():
    of_team = {"collided": np.array([0, 0, 2, 0, 0.0]), "failed": np.array([0, 0, 1, 1, 0.0])}
    of_team |= {"reward": np.array([9.0, 8.0, 7.0, 1.0, 6.0]), "decisions": np.ones(5)}
    assert evaluation.choose(Judge, {"boats": of_team}) == {"worst": 2, "median": 4}
    calm = of_team | {"collided": np.zeros(5)}
    assert evaluation.choose(Judge, {"boats": calm})["worst"] == 3


def test_five_seconds_before_a_collision_are_kept(run, tmp_path):
    """Boats that go round at full speed meet each other."""
    import torch

    close = ["usv.spacing=6.5", "usv.start_distance=5", "obstacles.off_ways=false"]
    config, source = run_folder.load_config(run, ["episode_duration=20", *close])

    def turns(team):
        action = torch.ones((team.mission.num_envs, team.fleet.count, len(team.action_names)))
        action[:, ::2, -1] = -1.0
        return action

    outcome = evaluation.judge_episodes(
        config, {"usv": turns}, episodes=6, seed=3, source=source, show_progress=False, excerpts=True
    )
    assert 0 < len(outcome.crashes) <= 12
    for crash in outcome.crashes:
        assert outcome.episodes["usv"]["collided"][crash.before.episode] >= len(crash.vehicles)
        gap = crash.before.teams["usv"].series["gap to anything (m)"]
        assert crash.before.time_s[-1] == pytest.approx(crash.time_s)
        assert crash.before.time_s[0] > max(0.0, crash.time_s - 5.0)
        assert (gap[-1, list(crash.vehicles)] < 0).all() and (gap[:-1, list(crash.vehicles)] >= 0).all()
    save_log(tmp_path / "log.npz", outcome.shown, outcome.crashes)
    shown, crashes = load_log(tmp_path / "log.npz")
    assert [(c.team, c.vehicles, c.time_s) for c in crashes] == [
        (c.team, c.vehicles, c.time_s) for c in outcome.crashes
    ]
    assert shown["worst"].events == outcome.shown["worst"].events
    np.testing.assert_array_equal(
        shown["worst"].teams["usv"].position_n, outcome.shown["worst"].teams["usv"].position_n
    )


def test_the_conditions_of_an_episode_are_those_that_its_vehicles_feel():
    varied = ("vary.sea.hs=[0.2, 1.0]", "vary.air.speed=[2.0, 8.0]", "usv.vary.mass={factor=[0.8, 1.2]}",
              "vary.sea.current.direction_deg=[-90.0, 90.0]", "sea.current.speed=0.3")  # fmt: skip
    task = make(*varied, "sea.realisations=16", envs=16)
    found, world = conditions_of(task), task.world
    north, east = world.current.steady.double().T
    np.testing.assert_allclose(found["sea.hs"], world.sea.components.hs[world.env_sea], rtol=1e-4)
    np.testing.assert_allclose(found["air.speed"], world.wind.mean[:, :2].norm(dim=-1), rtol=1e-4)
    np.testing.assert_allclose(found["sea.current.direction_deg"], np.degrees(np.arctan2(east, north)) % 360, rtol=1e-3)
    np.testing.assert_allclose(found["usv.mass"], world.teams["usv"].vary["mass"], rtol=1e-4)
    assert np.ptp(found["usv.mass"], axis=1).min() > 0 and np.ptp(found["sea.tp"]) > 0


def test_a_report_names_the_condition_that_an_error_grows_with(run):
    """Errors grow with the sea; beyond 1 m, episodes fail; the wind has nothing to do with it."""
    generator, n = np.random.default_rng(8), 64
    hs, wind, mass = generator.uniform(0.1, 2.0, n), generator.uniform(2.0, 9.0, n), generator.normal(80.0, 5.0, (n, 3))
    numbers = {f"{who}_error_rms_m": np.where(hs < 1.5, hs**2, np.nan) for who in ("leader", "follower")}
    numbers |= {"collided": (hs > 1.5).astype(float), "failed": (hs > 1.5).astype(float), "succeeded": (hs < 1.0) * 1.0}
    last = int(np.flatnonzero(hs > 1.5)[-1])
    result = {"controller": "policy", "scenario": "paper", "seed": 1, "episodes": n, "teams": {},
              "worst_episode": last, "median_episode": 0}  # fmt: skip
    of = StoredEvaluation(result, EvaluationConditions(), {"usv": numbers},
                          {"sea.hs": hs, "air.speed": wind, "usv.mass": mass},
                          [End(last, 12.34, "usv", 2, "collided")])  # fmt: skip
    found = read_run(run)._replace(evaluations={"policy": of})
    page = failures(found)
    assert "12.3 s: usv 2 hit an obstacle or a team mate" in page
    assert f"{(hs >= 1.0).sum()} of 64 episodes without success" in page and page.count("--episode ") == 8
    assert page.count("<svg") == 1 and not Links(f"<p>{page}</p>").open
    listed = page.partition("Rank correlations")[2]
    assert listed.index("sea.hs") < min(listed.index("mass"), listed.index("air.speed"))
    assert correlation(hs, numbers["leader_error_rms_m"]) == pytest.approx(1.0)
    assert correlation(-hs, numbers["collided"]) < -0.6 and abs(correlation(wind, hs**2)) < 0.3
    assert np.isnan(correlation(hs, np.ones(n)))


def going_north(moments: int) -> Excerpt:
    """A boat and an aircraft at 3 m/s and 20 m/s; the aircraft ends after 0.5 s."""
    time, teams = 0.1 * np.arange(moments), {}
    for name, medium, speed in (("usv", "water", 3.0), ("uav", "air", 20.0)):
        place = np.zeros((moments, 1, 3))
        place[:, 0, 0] = speed * time
        teams[name] = TeamLog(medium, place, np.zeros((moments, 1, 1)), ("thrust",), {})
    return Excerpt(0, time, teams, (Ended(0.5, "uav", 0, "is lost"),), np.empty((0, 4)), {})


@pytest.mark.parametrize(("moments", "speeds"), [(11, (3.0, 20.0)), (1, (0.0, 0.0))])
def test_time_series_show_speeds_and_the_end_of_a_teams_own_vehicles(moments, speeds, monkeypatch):
    """Of one moment alone, an episode that ended at once, no speed is known."""
    drawn = []
    monkeypatch.setattr(shown_part, "svg", lambda figure, name: drawn.append(figure) or "")
    shown_part._series({"worst": going_north(moments)})
    for axes, speed, ends in zip(drawn[0].axes, speeds, ((), (0.5,)), strict=True):
        motion, *marks = axes.lines
        assert motion.get_ydata() == pytest.approx(np.full(moments, speed))
        assert tuple(mark.get_xdata()[0] for mark in marks) == ends
