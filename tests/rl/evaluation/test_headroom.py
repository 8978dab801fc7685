"""Headroom: the share of the way to an oracle, on kept episodes that are used only where they are the scenario's."""

import json
import os
import socket

import numpy as np
import pytest
from command_line import server

from rl.evaluation.headroom import (
    Bound,
    digest,
    headroom,
    judge_on_bounds,
    read_bounds,
    read_levels,
    run_bound,
    write_bounds,
)
from rl.evaluation.store import load_headroom, save_headroom
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario
from rl.missions.formation.judge import FormationJudge
from rl.runs import ranks
from taichi_sim.config.io import config_folder

RNG = np.random.default_rng(3)
FEW = ("track.worlds=4", "sea.realisations=4", "episode_duration=3", "evaluation.settle=1")


def episodes(leader, count: int = 40) -> dict[str, np.ndarray]:
    """Numbers of episodes whose leader's error is `leader` [episode] m, the followers' twice that."""
    one = np.ones(count)
    return {
        "leader_error_rms_m": leader * one, "follower_error_rms_m": 2 * leader * one, "leader_s": 40 * one,
        "follower_s": 80 * one, "evasions": one, "vehicle_hours": one, "least_gap_m": one, "collided": 0 * one,
        "failed": 0 * one, "succeeded": one, "reward": one, "decisions": one, "hours": one, "action_changes": one,
    }  # fmt: skip


def bound(classical, oracle) -> Bound:
    return Bound(("usv",), 5, episodes(classical), episodes(oracle), 0.5)


def test_a_policy_halfway_takes_half_with_an_interval_that_narrows_with_agreement():
    spread = RNG.uniform(0.5, 1.5, 40)
    found = headroom(FormationJudge, episodes(1.5 * spread), bound(2.0 * spread, 1.0 * spread))["leader_error_rms_m"]
    assert found == pytest.approx((0.5, 0.5, 0.5))
    noisy = headroom(FormationJudge, episodes(1.5 * RNG.permutation(spread)), bound(2.0 * spread, 1.0 * spread))
    low, high = noisy["leader_error_rms_m"][1:]
    assert low < 0.45 < 0.55 < high
    for learned, share in ((2.0, 0.0), (1.0, 1.0), (2.5, -0.5)):
        found = headroom(FormationJudge, episodes(learned * spread), bound(2.0 * spread, 1.0 * spread))
        assert found["follower_error_rms_m"].value == pytest.approx(share)


def test_several_runs_count_together():
    two = {key: np.concatenate((episodes(1.5)[key], episodes(1.0)[key])) for key in episodes(1.0)}
    found = headroom(FormationJudge, two, bound(2.0, 1.0), times=2)["leader_error_rms_m"]
    assert found.value == pytest.approx(2 - np.sqrt((1.5**2 + 1.0) / 2))


def test_bounds_are_read_back_where_the_episodes_are_the_same(tmp_path):
    config, file = load_scenario("lanes"), tmp_path / "lanes.json"
    made = bound(2.0, np.nan)
    write_bounds(file, config, {"usv": made})
    again = read_bounds(config, file)["usv"]
    assert again.beside == ("usv",) and again.seed == 5 and again.episodes == 40
    np.testing.assert_array_equal(again.oracle["leader_error_rms_m"], made.oracle["leader_error_rms_m"])
    for same in (
        "seed=9",
        "stages.usv.iterations=3",
        "usv.residual.velocity=1",
        "usv.terms.fine.weight=0",
        "uav.count=2",
    ):
        assert digest(load_scenario("lanes", (same,)), "usv") == digest(config, "usv")
    for other in ("sea.hs=1", "usv.control.horizon=4", "obstacles.count=3", "usv.count=5"):
        assert read_bounds(load_scenario("lanes", (other,)), file) == {}
    assert read_bounds(config, tmp_path / "none.json") == {}


def test_a_kept_oracle_is_of_its_scenario_as_shipped():
    for file in (config_folder() / "oracle").glob("*.json"):
        assert read_levels(load_scenario(file.stem)).keys() == json.loads(file.read_text())["teams"].keys(), file


def test_a_run_keeps_what_its_policies_did_on_an_oracles_episodes(tmp_path):
    assert load_headroom(tmp_path) == {}
    for learned in (1.0, np.nan):  # the second evaluation replaces the first
        save_headroom(tmp_path, {"usv": episodes(learned), "uav": episodes(2.0)})
        again = load_headroom(tmp_path)
        assert again.keys() == {"usv", "uav"}
        for name, numbers in episodes(learned).items():
            np.testing.assert_array_equal(again["usv"][name], numbers)


def test_an_oracle_and_the_classical_controller_do_the_same_episodes():
    config = load_scenario(
        "lanes", (*FEW, "usv.plan.samples=8", "usv.plan.rounds=1", "usv.plan.horizon=1", "usv.plan.every=0.5")
    )
    found = run_bound(config, "usv", episodes=3, seed=2, show_progress=False)
    assert found.beside == ("usv",) and found.episodes == 3 and found.price > 0
    assert found.classical.keys() == found.oracle.keys()


def judge(rank: int, count: int, port: int, pipe) -> None:
    """One of `count` processes that judge two teams on their bounds; it sends what it gets."""
    here = {"RANK": rank, "WORLD_SIZE": count, "LOCAL_RANK": rank, "LOCAL_WORLD_SIZE": count, "MASTER_PORT": port}
    os.environ |= {key: str(value) for key, value in here.items()} | {"MASTER_ADDR": "127.0.0.1"}
    config = load_scenario("lanes", FEW)
    bounds = {team: Bound((team,), 2, episodes(1.0, 3), episodes(1.0, 3), 0.1) for team in ("usv", "uav")}
    with ranks.joined():
        found = judge_on_bounds(bounds, config, {team: ClassicalPolicy() for team in bounds})
        ranks.broadcast(lambda: None)  # which waits for all
    pipe.send({team: numbers["leader_error_rms_m"].tolist() for team, numbers in found.items()})


@pytest.mark.slow
def test_processes_judge_on_bounds_together_as_one_does():
    context, found = server(), {}
    for count in (1, 2):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        pipes = [context.Pipe(duplex=False) for _ in range(count)]
        running = [context.Process(target=judge, args=(rank, count, port, pipes[rank][1])) for rank in range(count)]
        for process in running:
            process.start()
        for process in running:
            process.join(600)
        assert [process.exitcode for process in running] == [0] * count
        found[count] = [pipe[0].recv() for pipe in pipes]
    assert found[1][0].keys() == {"usv", "uav"} and all(len(of) == 3 for of in found[1][0].values())
    assert found[2] == [found[1][0], {}]
