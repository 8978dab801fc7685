"""Several processes that work as one: what they share, what they tell each other, what happens when one is lost."""

import csv
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from command_line import ROOT, TEAMS, command, content, iterations, server, sets

from rl.commands import shared
from rl.evaluation.episodes import judge_episodes
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario
from rl.runs import ranks, signals, torchrun
from rl.runs.folder import RunError

ENVS, STEPS, VEHICLES = 12, 8, 3
SMALL = (
    "stages={}",  # two small ones of PPO in place of the shipped recipe
    *(
        f"stages.{team}.{setting}"
        for team in TEAMS
        for setting in (f'team="{team}"', f"num_envs={ENVS}", f"steps_per_iteration={STEPS}", "checkpoint_interval=3")
    ),
    "track.worlds=4",
    "sea.realisations=4",
    "episode_duration=3",
    "evaluation.episodes=4",
    "evaluation.settle=1",
)
PATIENCE = 900  # s


def both(count: int) -> list[str]:
    """Overrides by which both stages have so many iterations."""
    return sets(*SMALL, *(f"stages.{team}.iterations={count}" for team in TEAMS))


def start(out: Path, *arguments: object, script: str = "train") -> subprocess.Popen:
    words = [sys.executable, "-m", "rl.commands.main", script, *map(str, arguments), "--quiet"]
    words += ["--out", str(out)] if script == "train" else []
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def children(pid: int) -> list[int]:
    found = subprocess.run(["ps", "--ppid", str(pid), "-o", "pid="], capture_output=True, text=True, check=False)
    return [int(word) for word in found.stdout.split()]


def wait_for(out: Path, team: str, rows: int, running: subprocess.Popen) -> None:
    file, begin = out / team / "progress.csv", time.monotonic()
    while time.monotonic() - begin < PATIENCE and running.poll() is None:
        if file.is_file() and len(file.read_text().splitlines()) > rows:
            return
        time.sleep(0.02)
    raise AssertionError(f"{team} does not get to iteration {rows}: {running.communicate()}")


def assert_whole(out: Path, count: int) -> None:
    """Every iteration once, each with all environments."""
    for team in TEAMS:
        assert iterations(out, team) == list(range(count))
        with (out / team / "progress.csv").open(newline="") as file:
            steps = [int(row["agent_steps"]) for row in csv.DictReader(file)]
        assert steps == [(k + 1) * ENVS * STEPS * VEHICLES for k in range(count)]
    assert (out / "summary.json").is_file() and not list(out.rglob("*.part*"))


def talk(rank: int, count: int, port: int, pipe) -> None:
    """One of `count` processes: what each function gives it."""
    here = {"RANK": rank, "WORLD_SIZE": count, "LOCAL_RANK": rank, "LOCAL_WORLD_SIZE": count, "MASTER_PORT": port}
    os.environ |= {key: str(value) for key, value in here.items()} | {"MASTER_ADDR": "127.0.0.1"}

    def fails(of: int) -> int:
        if rank == of:
            raise RunError(f"wrong on {rank}")
        return rank

    said: list = [ranks.envs_each(5)]
    with ranks.joined():
        said.append(ranks.broadcast(lambda: f"from {rank}"))
        said.append(ranks.gather(lambda: rank * 10))
        said.append(ranks.mean({"a": float(rank), "b": 1.0}))
        said.append(ranks.greatest(rank))
        numbers = torch.arange(40_000.0) * (rank + 1)
        ranks.average_(numbers)
        said.append(numbers[[0, 1, 39_999]].tolist())
        for call, of in ((ranks.broadcast, 0), (ranks.gather, 1)):
            try:
                call(lambda of=of: fails(of))
            except RunError as error:
                said.append([str(error), *getattr(error, "__notes__", [])])
    pipe.send(said)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_what_ranks_tell_each_other_and_what_one_raises_all_raise(count):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    context = server()
    pipes = [context.Pipe(duplex=False) for _ in range(count)]
    running = [context.Process(target=talk, args=(rank, count, port, pipes[rank][1])) for rank in range(count)]
    for process in running:
        process.start()
    for process in running:
        process.join(PATIENCE)
    first, *others = (pipe[0].recv() for pipe in pipes)
    half = (count - 1) / 2
    same = [{"a": half, "b": 1.0}, count - 1, [0.0, half + 1, 39_999 * (half + 1)]]
    same += [["wrong on 0"], ["wrong on 1", f"on rank 1 of {count}"]]
    assert first == [-(-5 // count), "from 0", [10 * rank for rank in range(count)], *same]
    assert others == [[-(-5 // count), "from 0", [], *same]] * (count - 1)


def test_a_rank_that_judges_for_itself_waits_for_no_other(monkeypatch):
    """Ranks of a sweep judge other cells at the same time; there is no other rank here to wait for."""
    config = load_scenario("lanes", SMALL)
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("RANK", "1")
    outcome = judge_episodes(config, {"usv": ClassicalPolicy()}, episodes=3, seed=5, show_progress=False)
    assert {len(values) for values in outcome.episodes["usv"].values()} == {3}
    assert ranks.here() == (1, 2, 0, 1)


def test_how_many_processes_there_are(monkeypatch, capsys):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2, 3})
    assert torchrun.process_count(None, 0, 512) == 4
    assert torchrun.process_count(None, 0, 300) == 2  # none of them with too few environments
    assert (
        torchrun.process_count(None, 2, 512)
        == torchrun.process_count(None, 0, 512, "cuda")
        == torchrun.process_count(None, 0, 8)
        == 1
    )
    assert torchrun.process_count(6, 0, 512) == 6
    assert "6 processes share 4 cores" in capsys.readouterr().err
    with pytest.raises(RunError, match="--processes 1000: allowed are 1 to 32; this machine has 4 cores"):
        torchrun.process_count(1000, 0, 5000)
    with pytest.raises(RunError, match="allowed are 1 to 3; a stage has 3 environments"):
        torchrun.process_count(4, 0, 3)
    assert torchrun.process_count(4, 0, 2, enough=1) == 2  # of episodes or cells there may be fewer
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "x")
    assert torchrun.process_count(None, 0, 512) == 1  # it is one of several


def test_a_signal_is_noted_once_and_raised_the_second_time():
    with signals.deferred():
        os.kill(os.getpid(), signal.SIGTERM)
        assert signals.pending() == signal.SIGTERM
        with pytest.raises(signals.Terminated):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)
    assert signals.pending() == 0
    with signals.sigterm_as_interrupt(), pytest.raises(signals.Terminated) as raised:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert signals.status(raised.value) == 143 and signals.status(KeyboardInterrupt()) == 130


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_run_survives_a_worker_killed_at_any_moment(seed, tmp_path):
    draw, out, count = random.Random(seed), tmp_path / "run", 9
    running = start(out, "--config", "paper", *both(count), "--processes", 2)
    wait_for(out, draw.choice(TEAMS), draw.randrange(1, count), running)
    os.kill(draw.choice(children(running.pid)), signal.SIGKILL)
    _, err = running.communicate(timeout=PATIENCE)
    assert running.returncode == 0, err
    assert "was killed (SIGKILL): all start again from the last checkpoint (1 of 20)" in err
    assert_whole(out, count)
    for stage in json.loads((out / "summary.json").read_text())["stages"]:
        assert stage["processes"] == 2 and stage["environments"] == ENVS


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_all_with_one_message_and_fewer_may_go_on(number, status, tmp_path):
    out = tmp_path / "run"
    running = start(out, "--config", "paper", *both(30), "--processes", 2)
    wait_for(out, "usv", 4, running)
    workers = children(running.pid)
    os.kill(running.pid, number)
    _, err = running.communicate(timeout=PATIENCE)
    assert running.returncode == status
    assert err.count("continue with: taichi-sim train --out") == 1 and "Traceback" not in err
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    done = len(iterations(out, "usv"))
    assert (out / "usv" / f"model_{done}.pt").is_file()  # nothing is lost
    ending = command("rl.train", "--out", out, "--resume", "--processes", "1")
    assert ending.status == 0, ending.err
    assert_whole(out, 30)
    of_usv = json.loads((out / "summary.json").read_text())["stages"][0]
    assert [batch["processes"] for batch in of_usv["batches"]] == [2, 1]
    assert of_usv["batches"][1]["since_iteration"] == done


@pytest.mark.slow
def test_figures_are_the_same_bits_on_any_number_of_processes(run, tmp_path):
    files = []
    for number in (1, 2, 3):
        file = tmp_path / f"{number}.json"
        running = start(run, run, "--episodes", 600, "--json", file, "--processes", number, script="evaluate")
        _, err = running.communicate(timeout=PATIENCE)
        assert running.returncode == 0, err
        kept = {name: data for name, data in content(run / "evaluation").items() if name.startswith("policy")}
        files.append((file.read_bytes(), kept))
    assert files[0] == files[1] == files[2]


def node(out: Path, log: Path, port: int, *arguments: object) -> subprocess.Popen:
    """torchrun on one of two machines, each with one process."""
    engine = [
        "--nnodes=1:2", "--nproc-per-node=1", "--max-restarts=9", "--rdzv-backend=c10d", "--rdzv-id=both",
        f"--rdzv-endpoint=127.0.0.1:{port}", "--rdzv-conf=last_call_timeout=5", "--local-addr=127.0.0.1",
    ]  # fmt: skip
    words = [sys.executable, "-m", "torch.distributed.run", *engine, str(ROOT / "rl" / "train.py"), "--quiet"]
    words += ["--out", str(out), "--config", "paper", *map(str, arguments)]
    environment = os.environ | {"TORCH_DISABLE_SHARE_RDZV_TCP_STORE": "1"}  # docs/scaling.md says why
    with log.open("a") as file:
        return subprocess.Popen(words, stdout=file, stderr=file, env=environment, start_new_session=True)


def until_it_listens(port: int) -> None:
    begin = time.monotonic()
    while time.monotonic() - begin < PATIENCE:
        with socket.socket() as attempt:
            if attempt.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise AssertionError(f"nobody listens at {port}")


def kill(running: subprocess.Popen) -> None:
    for pid in (*children(running.pid), running.pid):
        os.kill(pid, signal.SIGKILL)
    running.wait()


@pytest.mark.slow
def test_of_two_machines_one_may_go_and_come_again(tmp_path):
    out, count = tmp_path / "run", 60
    nodes = [node(out, tmp_path / "0.log", 29533, *both(count))]
    until_it_listens(29533)  # who comes first has what both agree on: the other one may go
    nodes.append(node(out, tmp_path / "1.log", 29533, *both(count)))
    try:
        wait_for(out, "usv", 5, nodes[0])
        kill(nodes[1])
        nodes[1] = node(out, tmp_path / "1.log", 29533, *both(count))
        assert nodes[0].wait(PATIENCE) == 0, (tmp_path / "0.log").read_text()
        assert_whole(out, count)
    finally:
        for running in nodes:
            if running.poll() is None:
                kill(running)


@pytest.mark.slow
def test_machines_with_different_scenarios_are_refused_before_training(tmp_path):
    out = tmp_path / "run"
    nodes = [node(out, tmp_path / f"{k}.log", 29544, *both(3), "--set", f"sea.hs=0.{k + 3}") for k in range(2)]
    for running in nodes:
        begin = time.monotonic()
        while running.poll() is None and time.monotonic() - begin < 90:
            said = "".join((tmp_path / f"{k}.log").read_text() for k in range(2))
            if re.search("process 1 of 2 has another scenario than process 0: they differ in sea", said):
                break
            time.sleep(0.1)
        else:
            raise AssertionError("not refused")
    for running in nodes:
        if running.poll() is None:
            kill(running)
    assert not out.exists()


def test_a_process_that_differs_is_named_with_what_differs():
    config = load_scenario("paper")
    other = load_scenario("paper", ["sea.hs=0.9", "usv.count=4"])
    same = ("abc", config, {"torch": "2.13.0", "taichi": "1.7.4"})
    shared._refuse_differences([same, same])
    with pytest.raises(RunError, match="process 1 of 2 has another scenario than process 0: they differ in sea, usv"):
        shared._refuse_differences([same, ("abd", other, same[2])])
    with pytest.raises(RunError, match="process 2 of 3 has torch 2.12.0, process 0 has 2.13.0: all processes need"):
        shared._refuse_differences([same, same, ("abc", config, same[2] | {"torch": "2.12.0"})])
