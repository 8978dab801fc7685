"""The benchmark tool runs and writes every figure; how large they are is not tested."""

import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from folders import ROOT

from rl.commands import shared
from taichi_sim.applications.trials.step_error import INTERVAL
from taichi_sim.models.catalogue import MODELS
from tools.benchmark import peer_lines
from tools.benchmarking import peers
from tools.benchmarking.mission import Stopwatch, scenario_cases
from tools.benchmarking.physics import measured_vehicles, shipped_vehicles
from tools.benchmarking.timing import Case, measure

TOOL = ROOT / "tools" / "benchmark.py"


def positive(value) -> bool:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Return what `--quick --json` prints and writes."""
    folder = tmp_path_factory.mktemp("benchmark")
    command = [sys.executable, str(TOOL), "--quick", "--threads", "1", "--json", str(folder / "new" / "b.json")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=900)
    assert done.returncode == 0, done.stderr
    assert [p.name for p in (folder / "new").iterdir()] == ["b.json"]
    return done.stdout, json.loads((folder / "new" / "b.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("group", ["environment", "inference", "learning"])
def test_agent_steps_are_measured(group, quick):
    rows = quick[1][group]
    assert rows
    for row in rows:
        assert set(row) == {"num_envs", "agent_steps_per_s", "real_time_factor"}
        assert all(positive(value) for value in row.values())
        agents = 3 if group == "learning" else 6
        assert row["real_time_factor"] == pytest.approx(row["agent_steps_per_s"] / agents * 0.1)


@pytest.mark.slow
def test_high_fidelity_scenarios_are_measured():
    cases = scenario_cases(4, "sea.realisations=4")
    assert [case.label for case in cases] == ["lanes", "cruise, boats", "cruise, aircraft", "escort", "escort, crests"]
    measure(cases, seconds=1e-3, repetitions=1, show_progress=False)
    assert all(positive(case.rate) for case in cases)


def test_every_boat_is_to_be_measured_in_two_seas():
    measured = measured_vehicles(quick=False)
    assert {file for file, _, _ in measured} == set(shipped_vehicles())
    otters = [(n, bool(changes)) for file, n, changes in measured if file.stem == "otter"]
    assert sorted(otters) == [(16, False), (16, True), (32, False), (32, True)]  # with memory, and constant


@pytest.mark.slow
def test_a_vehicle_of_every_model_is_measured_alone(quick):
    rows = quick[1]["physics"]
    found = {(row["vehicle"], row["components"]) for row in rows}
    assert found == {(file.stem, n) for file, n, _ in measured_vehicles(quick=True)}
    assert len(found) == len(MODELS)
    assert all(positive(row["vehicle_substeps_per_s"]) for row in rows)
    assert all(row["panels"] is None or positive(row["panels"]) for row in rows)


@pytest.mark.slow
def test_the_parts_of_a_step_are_named(quick):
    parts = quick[1]["parts"]
    kernels = {"usv kernel", "uav kernel", "sea phases", "sensing"}
    assert set(parts) >= kernels | {"geometry", "rewards", "observations", "endings", "resets"}
    assert all(math.isfinite(ms) for ms in parts.values())
    assert all(positive(parts[name]) for name in kernels)


@pytest.mark.slow
def test_machine_and_peers_are_described(quick):
    result = quick[1]
    assert set(result) == {
        "environment", "inference", "learning", "scenarios", "physics", "parts", "learning_parts", "picture_ms",
        "peers", "machine", "method",
    }  # fmt: skip
    machine = result["machine"]
    assert machine["cpu"] and positive(machine["cores"]) and machine["threads"] == 1
    assert machine["python"] and machine["packages"]["taichi"]
    for peer in result["peers"]:
        assert positive(peer["step_s"]) and positive(peer["vehicle_seconds_per_s"])
    for slow, fast in result["method"]["spread"].values():
        assert slow <= 1 <= fast


@pytest.mark.slow
def test_the_table_shows_every_group(quick):
    text = quick[0]
    for word in ("environment", "inference", "learning", "unity_boat", "sea phases", "resets", "peers", "slowest"):
        assert word in text


def test_a_simulator_is_measured_at_the_step_of_1_percent(monkeypatch):
    """A peer of Euler's method, whose error grows as the step: x' = u - x, u new at every command."""
    asked, cores = peers.commands(6), os.sched_getaffinity(0)

    def moved(dt: float):
        x, found, steps = np.zeros(asked.shape[1:]), [], round(INTERVAL / dt)
        for command in asked:
            for _ in range(steps):
                x = x + dt * (command - x)
            found.append(np.pad(x, ((0, 0), (0, 3))))
        return np.array(found)

    peer = peers.Contestant("Euler", "1", moved, lambda step, seconds: 1000.0)
    monkeypatch.setattr(peers, "RIVALS", ((lambda: peer, "unity_boat"),))
    monkeypatch.setattr(peers, "ours", lambda vehicle: peer._replace(name=vehicle))
    first, second = peers.measure_peers(seconds=0.0)
    share = first["errors"][0.02] / first["errors"][0.01]
    assert share == pytest.approx(2.0, abs=0.06)
    step = first["step_s"]
    assert first["errors"][0.02] * step / 0.02 == pytest.approx(0.01, rel=0.1)
    assert first["vehicle_seconds_per_s"] == pytest.approx(1000.0 * step) == second["vehicle_seconds_per_s"]
    assert os.sched_getaffinity(0) == cores
    assert peer_lines([first])[1].split()[:2] == ["Euler", "1"] and peer_lines([]) == ["peers: none installed"]


def test_repetitions_of_cases_take_turns():
    order = []
    cases = [Case("g", name, lambda name=name: order.append(name), work=1, calls=1) for name in "ab"]
    measure(cases, seconds=1e-9, repetitions=3, show_progress=False)
    assert "".join(order).endswith("ababab")
    assert all(len(case.seconds) == 3 and positive(case.rate) for case in cases)


def test_a_watched_method_inside_another_counts_for_the_outer_one():
    class Body:
        def inner(self):
            return 1

        def outer(self):
            return self.inner() + 1

    body, stopwatch = Body(), Stopwatch()
    stopwatch.watch(body, "inner", "in")
    stopwatch.watch(body, "outer", "out")
    assert body.outer() == 2
    spent = stopwatch.read()
    assert spent["in"] == 0 and spent["out"] > 0
    assert stopwatch.read() == {"in": 0, "out": 0}


@pytest.mark.parametrize("arguments", [["--threads", "0"], ["--seconds", "-1"], ["--what"]])
def test_bad_arguments_are_refused(arguments, capsys):
    from tools import benchmark

    with pytest.raises(SystemExit) as ending:
        benchmark.main(arguments)
    assert ending.value.code == 2
    assert arguments[0] in capsys.readouterr().err


@pytest.mark.slow
def test_two_checkouts_are_compared_case_by_case(tmp_path):
    """With itself: the same cases, and ratios about one."""
    out = tmp_path / "ratios.json"
    command = [sys.executable, TOOL, "--against", ROOT, "--quick", "--json", out]
    result = subprocess.run([*command, "--only", "environment", "one environment"], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    rows = json.loads(out.read_text())
    assert [row["case"] for row in rows] == [
        "environment, 1", "environment, 16", "one environment, Gymnasium, usv", "one environment, Gymnasium, uav",
    ]  # fmt: skip
    assert all(0.1 < row["ratio"] < 10 for row in rows)
    assert "times as fast" in result.stdout


def test_a_folder_without_a_benchmark_cannot_be_compared(tmp_path, capsys):
    from tools import benchmark

    assert shared.run(benchmark.main, ["--against", str(tmp_path)]) == 1
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / 'tools' / 'benchmark.py'}: no such file")
