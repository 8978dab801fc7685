"""Watching a training, and an episode that is played: nothing of it changes, and a port in use is told in time."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from command_line import TINY, command, sets
from small_missions import make

from rl.learn.env import MissionEnv
from rl.learn.policy import checkpoints
from rl.runs import watch as watching
from rl.runs.watch import TrainingView
from taichi_sim.visualisation.recording.live import Live


@pytest.fixture
def port() -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    yield port


def env() -> MissionEnv:
    """A training's environment, whose episodes are over soon, of the same bits each time."""
    mission = make("episode_duration=2")
    mission.reseed(3)
    return MissionEnv(mission, "usv", {"uav": lambda team: torch.zeros_like(team.action)})


def test_a_training_that_is_watched_goes_as_it_would(port, monkeypatch):
    monkeypatch.setattr(watching, "STAGE_S", 0.5)
    monkeypatch.setattr(watching, "SHARE", 1e6)
    watched, alone = env(), env()
    generators = [torch.Generator().manual_seed(4) for _ in range(2)]
    shown = []

    def show(part, **when):
        shown.append(part)
        Live.show(live, part, **when)

    with Live("test", port=port, viewer=False, everywhere=True) as live:
        monkeypatch.setattr(live, "show", show)
        watched.watch = watcher = TrainingView(live)
        for _ in range(60):  # three episodes at least
            for one, generator in ((watched, generators[0]), (alone, generators[1])):
                one.step(2 * torch.rand(one.num_envs, one.num_actions, generator=generator) - 1)
            watcher._next = 0.0  # it does not wait to show the next
        assert not watcher._off
    for name in ("usv", "uav"):
        assert torch.equal(watched.mission.teams[name].fleet.state, alone.mission.teams[name].fleet.state)
    assert torch.equal(watched.mission.generator.get_state(), alone.mission.generator.get_state())
    frames = sum(len(part.time_s) for part in shown)
    assert 50 <= frames <= 60
    begins = [part for part in shown if part.time_s[0] < 0.15]
    assert len(begins) >= 3  # each episode from its begin
    assert {event.name for event in begins[0].teams.values()} == {"usv", "uav"}
    assert begins[0].teams["usv"].reward is not None


def test_a_fault_of_the_view_does_not_end_the_training(port, monkeypatch, capsys):
    one = env()
    with Live("test", port=port, viewer=False) as live:
        monkeypatch.setattr(live, "plot", lambda *_: 1 / 0)
        one.watch = TrainingView(live)
        for _ in range(2):
            one.step(torch.zeros(one.num_envs, one.num_actions))
    assert capsys.readouterr().err.count("--watch has stopped: ZeroDivisionError") == 1


def test_a_port_in_use_is_told_before_any_work(here, run, port, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        here("rl.train", "--watch", "--port", port, "--out", tmp_path / "new").fails(f"port {port}", "--port")
        assert not (tmp_path / "new").exists()
        here("rl.commands.play", run, "--live", "--port", port).fails(f"port {port}", "--port")
    beyond = here("rl.commands.play", run, "--live", "--port", 70_000)
    assert beyond.status == 2 and "--port: 70000: allowed are 1 to 65535" in beyond.err


def test_an_episode_is_shown_while_it_is_played(here, run, port):
    short = ("--duration", "2", "--out")
    before = here("rl.commands.play", run, *short, run / "before.rrd")
    ending = here("rl.commands.play", run, *short, run / "live.rrd", "--live", "--speed", "50", "--port", port)
    assert (ending.status, ending.err) == (0, "")
    assert f"rerun rerun+http://127.0.0.1:{port}/proxy" in ending.out
    assert abs((run / "live.rrd").stat().st_size - (run / "before.rrd").stat().st_size) < 2000
    assert before.status == 0


@pytest.mark.slow
def test_a_training_that_is_watched_leaves_the_same_checkpoints(tmp_path, port):
    for name, options in (("alone", ()), ("watched", ("--watch", "--port", port))):
        ending = command("rl.train", "--config", "paper", "--out", tmp_path / name, *sets(*TINY), *options)
        assert ending.status == 0, ending.err
    for team in ("usv", "uav"):
        pair = [checkpoints(Path(tmp_path / name / team)) for name in ("alone", "watched")]
        assert len(pair[0]) == len(pair[1]) == 3
        for one, other in zip(*pair, strict=True):
            assert _same(*(torch.load(file, weights_only=True) for file in (one, other)))


def _same(one, other) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(_same, one, other))
    return torch.equal(one, other) if torch.is_tensor(one) else one == other
