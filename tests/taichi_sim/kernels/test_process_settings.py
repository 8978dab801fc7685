"""Settings of the process under living objects: they change no number, or the objects are refused by name."""

import ast
import contextlib
import copy
import os
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from folders import ROOT

import rl
import taichi_sim as ts
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import ProgramError

SMALL = ("sea.realisations=2", "sea.components=4")
FEW = (*SMALL, "track.worlds=2")


def boats(envs=4):
    return ts.World.from_scenario("paper", envs, overrides=SMALL, teams=("usv",))


def still(world):
    return {"usv": np.zeros((world.num_envs, 3, 2))}


@contextlib.contextmanager
def doubles():
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


def halves():
    return torch.autocast("cpu", dtype=torch.bfloat16)


@contextlib.contextmanager
def nowhere():
    torch.set_default_device("meta")
    try:
        yield
    finally:
        torch.set_default_device(None)


def rolled(scenario, steps=6):
    """All that an environment gives in two episodes, and a copy of it, and a bench."""
    pools = ("sea.realisations=2",) if scenario in ("escort", "landing") else ("sea.realisations=2", "track.worlds=2")
    env = rl.BatchedEnv(scenario, 2, overrides=pools)
    found = [*env.reset(seed=3).values()]
    for step in range(steps):
        given = {t: np.full((2, n, len(env.action_names[t])), 0.3) for t, n in env.vehicles.items()}
        stepped = env.step(given)
        found += [*stepped.observations.values(), *stepped.rewards.values(), env.state()]
        if step == 2:
            found += env.reset(envs=[1]).values()
    found += [team.fleet.state.clone() for team in env.mission.fork([1, 0]).teams.values()]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["lanes", "otter", "escort", "landing", "aerosonde"])
def test_settings_of_torch_change_no_number(scenario):
    """To the bit, in dtype too; and what is made in inference mode works outside, on the other side as well."""
    expected = rolled(scenario)
    for setting in (doubles, nowhere, torch.inference_mode, halves):
        with setting():
            found = rolled(scenario)
        assert len(found) == len(expected)
        for mine, right in zip(found, expected, strict=True):
            assert mine.dtype == right.dtype and torch.equal(mine, right), setting


def test_products_keep_their_precision_under_autocast():
    ones = torch.ones(2, 2)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        with runtime.own_settings():
            assert (ones @ ones).dtype == torch.float32
        assert (ones @ ones).dtype == torch.bfloat16


def test_what_is_made_in_inference_mode_works_outside():
    with torch.inference_mode():
        world = boats()
        world.step(still(world))
        world.renew([1])
    fleet = world.teams["usv"]
    world.place("usv", [1, 2], fleet.state[[2, 0]])
    world.step(still(world))
    fleet.state[..., 0] += 1.0
    assert torch.get_default_dtype() == torch.float32


def test_threads_take_turns():
    """Made in one thread and stepped in others; two at once, in one world or in two: as in one thread."""
    alone, shared, other = boats(), [], boats()

    def make():
        shared.append(boats())

    def go(world):
        for _ in range(10):
            world.step(still(world))

    def at_once(*calls):
        threads = [threading.Thread(target=target, args=given) for target, *given in calls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    at_once((make,))
    at_once((go, shared[0]), (go, shared[0]), (go, other))
    for _ in range(20):
        alone.step(still(alone))
    assert torch.equal(shared[0].teams["usv"].state, alone.teams["usv"].state)
    assert other.time.tolist() == pytest.approx([1.0] * 4)
    assert torch.get_num_threads() == 1


def test_a_world_names_what_copies_it():
    world = boats(1)
    for kind in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match=r"fork\(envs\).*snapshot\(\)"):
            kind(world)


FORK = """
import os, sys
import rl
import taichi_sim as ts
from taichi_sim.kernels.runtime import ProgramError

def child(use):
    pid = os.fork()
    if not pid:
        try:
            use()
        except ProgramError as error:
            print(error, file=sys.stderr)
            sys.exit(7)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

def world():
    return ts.World.from_scenario("paper", 2, teams=("usv",))

ts.init(threads=2)
bench = ts.Bench("unity_boat", envs=1000)
bench.put()
uses = [bench.put, bench.fleet.update, lambda: bench.step((0, 0)), world, lambda: ts.init(precision="f64")]
print([child(use) for use in uses], child(sys.exit))
bench.put()
"""

ASYNCHRONOUS = """
import sys
import gymnasium, rl
if __name__ == "__main__":
    envs = gymnasium.make_vec(
        "taichi_sim/UsvFormation-v0", num_envs=2, vectorization_mode="async", vector_kwargs={"context": sys.argv[1]},
        overrides=["track.worlds=2", "sea.realisations=2"],
    )
    print(envs.reset(seed=1)[0].shape[0], envs.step(envs.action_space.sample())[1].shape)
    envs.close()
"""


def run(file, code, *arguments):
    file.write_text(code)
    settings = {
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "TI_OFFLINE_CACHE_CLEANING_POLICY": "never",  # else `OWN` does, at 100 MiB, of what other tests compiled
    }
    return subprocess.run(
        [sys.executable, file, *arguments], capture_output=True, text=True, timeout=240, env=os.environ | settings
    )


def test_a_forked_process_is_refused_by_name_and_ends(tmp_path):
    """In a process of its own: whatever a child uses it is told what to do; it can end; the parent goes on."""
    done = run(tmp_path / "forks.py", FORK)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[7, 7, 7, 7, 7] 0"
    assert done.stderr.count("'spawn' or 'forkserver'") == 5


OWN = """
import numpy as np
import taichi as ti
import taichi_sim as ts

def boats():
    return ts.World.from_scenario("paper", 2, teams=("usv",))

def step(world):
    world.step({"usv": np.zeros((2, 3, 2))})

def refused(use, *given):
    try:
        use(*given)
    except ts.ProgramError as error:
        return str(error).split(",")[0]

def field():
    made = ti.field(ti.f32, 3)
    made[1] = 3.0
    return made

@ti.kernel
def double(x: ti.template()):
    for i in x:
        x[i] *= 2.0

ti.init(arch=ti.cpu)
mine = field()
said = [refused(boats), refused(ts.init)]
assert mine[1] == 3.0
ti.reset()
world = boats()
step(world)
mine = field()  # beside a world's
double(mine)
step(world)
assert mine[1] == 6.0
ti.init(arch=ti.cpu)
mine = field()
said += [refused(use, *given) for use, *given in ((step, world), (world.snapshot,), (boats,), (ts.init,))]
assert mine[1] == 3.0
for _ in range(2):
    ti.reset()
    said.append(refused(step, world))
    ts.init()
    step(world)
print(said)
"""


def test_a_taichi_program_of_ones_own_neither_ends_nor_is_ended_by_a_world(tmp_path):
    """In a process of its own; what is refused says whose program has ended, or runs."""
    done = run(tmp_path / "own.py", OWN)
    assert done.returncode == 0, done.stderr
    ours, theirs = "the Taichi program of this was ended by ti.init or ti.reset", "a Taichi program runs that"
    told = ast.literal_eval(done.stdout.splitlines()[-1])
    for text, cause in zip(told, (theirs, theirs, ours, ours, ours, theirs, ours, ours), strict=True):
        assert text.startswith(cause), told


@pytest.mark.slow
def test_gymnasiums_processes_work_if_they_are_spawned(tmp_path):
    """Forked ones end at once with the message, and the command with them."""
    file = tmp_path / "vector.py"
    done = run(file, ASYNCHRONOUS, "spawn")
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["2 (2,)"]), done.stderr
    done = run(file, ASYNCHRONOUS, "fork")
    assert done.returncode == 1
    assert "vector_kwargs={'context': 'spawn'}" in done.stderr


def test_objects_of_another_precision_are_refused_and_nothing_moves():
    runtime.init(precision="f32", threads=1)
    world, bench, env = boats(), ts.Bench("unity_boat"), rl.BatchedEnv("paper", 1, teams="usv", overrides=FEW)
    fleet, other = world.teams["usv"], boats()
    world.step(still(world))
    other.step(still(other))
    before = fleet.state.clone(), world.time.clone(), env.mission.steps.clone()
    runtime.init(precision="f64", threads=1)
    try:
        for use in (
            lambda: world.step(still(world)),
            lambda: bench.step((0.1, 0.1)),
            lambda: env.step({"usv": np.zeros((1, 3, 2))}),
            lambda: env.reset(seed=1),
            lambda: env.mission.reset(),
            lambda: env.mission.teams["usv"].observations(),
        ):
            with pytest.raises(ProgramError, match=r"precision 'f32', and Taichi .* 'f64': make it anew, .*ts\.init"):
                use()
    finally:
        runtime.init(precision="f32", threads=1)
    for now, then in zip((fleet.state, world.time, env.mission.steps), before, strict=True):
        assert torch.equal(now, then)
    for each in (world, other):  # the first has outlived another program
        each.step(still(each))
    assert torch.equal(fleet.state, other.teams["usv"].state)
