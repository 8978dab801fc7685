"""Launching a kernel again is calling it, whatever has changed; packs outlive the Taichi program they were made for."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest
import taichi as ti
import torch
from folders import ROOT, TESTS

from taichi_sim.bench import Bench
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import Launcher
from taichi_sim.models.catalogue import load_vehicle

HERE = Path(__file__).resolve().parent
PATHS = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, TESTS, HERE)))}
array = ti.types.ndarray(ndim=1)
Given = ti.types.argpack(a=array, b=array)
Made = ti.types.argpack(c=array, d=array)


class Options(NamedTuple):
    factor: float = 1.0
    shifted: bool = False


@ti.kernel
def mix(given: Given, plain: ti.types.ndarray(ndim=1), made: Made, options: ti.template()):
    for i in plain:
        shift = 0.0
        if ti.static(options.shifted):
            shift = 100.0
        plain[i] += options.factor * given.a[i] + 10 * given.b[i] + shift
        made.c[i], made.d[i] = plain[i], 2 * made.d[i]


@ti.kernel
def scale(x: ti.types.ndarray(ndim=1), by: float):
    for i in x:
        x[i] *= by


@ti.data_oriented
class Gain:
    def __init__(self, gain):
        self.gain = gain

    @ti.kernel
    def apply(self, out: ti.types.ndarray(ndim=1), x: ti.types.ndarray(ndim=1)):
        for i in x:
            out[i] = self.gain * x[i]


@ti.func
def lost(x):
    return x + nowhere  # noqa: F821


@ti.kernel
def loses(x: ti.types.ndarray(ndim=1)):
    for i in x:
        x[i] = lost(x[i])


def tensors():
    """Five tensors."""
    random = torch.Generator().manual_seed(1)
    return torch.randn((5, 4), dtype=runtime.current().torch_dtype, generator=random).unbind()


def both(launcher, options):
    """What the launcher and a plain call make of the same numbers."""
    results = []
    for call in (launcher, mix):
        a, b, plain, c, d = tensors()
        packs = runtime.pack(Given, a=a, b=b), runtime.pack(Made, c=c, d=d)
        call(packs[0], plain, packs[1], options)
        results.append(torch.stack((a, b, plain, c, d)))
    return results


def test_a_launch_does_what_a_call_does_and_reads_what_was_written_since(f64):
    launcher = Launcher(mix)
    assert torch.equal(*both(launcher, Options()))
    a, b, plain, c, d = tensors()
    first, second = runtime.pack(Given, a=a, b=b), runtime.pack(Made, c=c, d=d)
    for k in range(3):
        a.fill_(k)
        b.fill_(2.0)
        plain.zero_()
        launcher(first, plain, second, Options())
        assert torch.equal(plain, torch.full_like(plain, k + 20.0))
        assert torch.equal(c, plain)


def test_a_launch_follows_its_tensors_and_its_templates(f64):
    launcher = Launcher(mix)
    for options in (Options(), Options(3.0), Options(3.0), Options(3.0, True), Options()):
        assert torch.equal(*both(launcher, options))


def test_a_launch_belongs_to_the_object_whose_kernel_it_is_in_any_program(f64):
    x, out = torch.ones(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    launchers = [Launcher(Gain(gain).apply) for gain in (2.0, 5.0)]
    for gain, launcher in zip((2.0, 5.0), launchers, strict=True):
        launcher(out, x)
        assert out.tolist() == [gain] * 3
    runtime.init(precision="f64", threads=2)  # what was compiled for the same tensors is gone
    for gain, launcher in zip((2.0, 5.0), launchers, strict=True):
        launcher(out, x)
        assert out.tolist() == [gain] * 3


def test_a_launch_survives_another_taichi_program():
    launcher = Launcher(mix)
    for precision in ("f32", "f64", "f32"):
        runtime.init(precision=precision, threads=1)
        ours, theirs = both(launcher, Options(2.0))
        assert ours.dtype == runtime.current().torch_dtype
        assert torch.equal(ours, theirs)


def test_a_launch_goes_from_one_set_of_tensors_to_another_and_back(f64):
    """What is bound is found again; what is launched once leaves nothing behind."""
    launcher, sets = Launcher(Gain(2.0).apply), [(torch.zeros(n).double(), torch.ones(n).double()) for n in (2, 3, 4)]
    for _ in range(2):
        for k, (out, x) in enumerate(sets):
            x += k
            launcher(out, x)
            assert torch.equal(out, 2 * x)
    kept = list(launcher._bound)
    for n in (7, 7, 5):
        out, x = torch.zeros(n).double(), torch.rand(n).double()
        launcher.once(out, x)
        assert torch.equal(out, 2 * x)
    assert launcher._bound == kept
    with pytest.raises(TypeError, match="takes 2 arguments, not 1"):
        launcher(out)


def test_a_few_vehicles_on_the_calling_thread_move_as_many_do():
    """To rounding: the two are compiled apart. With the kernel of many they move alike to the bit."""
    runtime.init(precision="f64", threads=2)
    for vehicle in ("unity_boat", "unity_aircraft"):
        few, many = Bench(vehicle, envs=2, seed=3), Bench(vehicle, envs=200, seed=3)
        action = (0.5, 0.2, 0.1)[: len(few.model.action_names)]
        torch.testing.assert_close(few.step(action, 20).state, many.step(action, 20).state[:2], rtol=0, atol=1e-11)
        launchers = [next(iter(bench.fleet._launchers.values())) for bench in (few, many)]
        assert [launcher._bound[0].serial for launcher in launchers] == [True, False]
        with runtime.loop.as_for_many():
            same = Bench(vehicle, envs=2, seed=3).step(action, 20)
        assert same.state.equal(many.state[:2])


def test_torch_has_its_threads_back_after_a_rest():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), runtime.torch_at_rest():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == before


def test_what_cannot_be_launched_is_refused(f64):
    a, b, plain, c, d = tensors()
    gappy = torch.zeros(10, dtype=torch.float64)[::2]
    launcher, gain = Launcher(mix), Launcher(Gain(2.0).apply)
    with pytest.raises(TypeError, match="takes packs, tensors and templates, not float"):
        Launcher(scale)(plain, 2.0)
    with pytest.raises(ValueError, match="contiguous"):
        gain(gappy, plain)
    with pytest.raises(ValueError, match="contiguous"):
        launcher(runtime.pack(Given, a=gappy, b=b), plain, runtime.pack(Made, c=c, d=d), Options())


AGAIN = """
import gc
from test_runtime import Given, Launcher, Made, Options, mix, runtime, tensors

def launch(packs):
    for given, plain, made, c in packs:
        Launcher(mix)(given, plain, made, Options())
        assert (c == plain).all()

kept = []
for program, precision in enumerate(("f32", "f64", "f32", "f64")):
    runtime.init(precision=precision, threads=1)
    packs = []
    for _ in range(100):
        a, b, plain, c, d = tensors()
        packs.append((runtime.pack(Given, a=a, b=b), plain, runtime.pack(Made, c=c, d=d), c))
    launch(packs)
    kept.append(packs)
    if program:
        del kept[0]  # of the program before: some have the addresses of the new ones
        gc.collect()
    launch(packs)
print("done")
"""


@pytest.mark.slow
def test_packs_of_an_ended_program_are_freed_without_harm():
    """In a process of its own: without care the last launch fails, or Python crashes at its end."""
    done = subprocess.run([sys.executable, "-c", AGAIN], capture_output=True, text=True, env=PATHS, timeout=900)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


ON_GPU = """
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import SeaConfig
from taichi_sim.kernels import runtime

ends = []
for arch in ("cpu", "cuda"):
    runtime.init(arch=arch, precision="f64")
    bench = Bench("unity_boat", sea=SeaConfig(hs=0.5, tp=4.0, realisations=2), envs=2, count=3, seed=1)
    ends.append(bench.step([0.5, 0.2], 20).state.cpu())
print((ends[0] - ends[1]).abs().max() < 1e-9)
"""


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
def test_vehicles_move_on_a_gpu_as_on_the_cpu():
    """In a process of its own, because its programs void the kernels of other tests."""
    done = subprocess.run([sys.executable, "-c", ON_GPU], capture_output=True, text=True, env=PATHS, timeout=900)
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["tensor(True)"]), done.stderr


COMPILED = """
import taichi as ti
import torch

from taichi_sim.kernels import runtime


@ti.kernel
def double(x: ti.types.ndarray(ndim=1)):
    for i in x:
        x[i] *= 2.0


runtime.init(threads=1)
runtime.Launcher(double)(torch.ones(3))
"""


@pytest.mark.slow
def test_a_process_leaves_what_it_compiled_to_the_next_one(tmp_path):
    """Although a process that was killed while it wrote has left its lock; a lock in use is respected."""
    cache, script = tmp_path / "cache", tmp_path / "double.py"
    cache.mkdir()
    script.write_text(COMPILED)
    lock = cache / "ticache.lock"

    def run():
        environment = PATHS | {"TI_OFFLINE_CACHE_FILE_PATH": str(cache)}
        done = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
        return sorted(file.name for file in cache.iterdir())

    lock.touch()
    os.utime(lock, (time.time() + 3600,) * 2)  # in use, however slowly the process starts
    assert run() == ["ticache.lock"]
    os.utime(lock, (0, 0))
    kernel, index = run()
    assert kernel.endswith(".tic")
    assert index == "ticache.tcb"
    written = (cache / kernel).stat().st_mtime_ns
    assert run() == [kernel, index]
    assert (cache / kernel).stat().st_mtime_ns == written  # read, not compiled again


@pytest.mark.parametrize("changes", [{"KEPT_KERNELS": "nothing"}, {"LONG": 0.0}], ids=["none kept", "long"])
def test_compiling_is_told_once(changes, monkeypatch, capsys):
    """Where no kernels are kept, and where one takes long; kept ones that are read are not told of."""

    @ti.kernel
    def add(x: runtime.array1, number: ti.template()):
        for i in x:
            x[i] += number

    launcher, x = runtime.Launcher(add), torch.zeros(3)
    monkeypatch.setattr(runtime, "_told", False)
    for name, value in changes.items():
        monkeypatch.setattr(runtime, name, value)
    for number in (1, 2):
        launcher(x, number)
    assert capsys.readouterr().err.count("compiling kernels") == 1
    monkeypatch.undo()
    launcher(x, 3)
    assert capsys.readouterr().err == ""
    assert x.tolist() == [6.0, 6.0, 6.0]


def test_a_fleet_goes_on_in_another_program():
    """Packs and launches are made anew: more threads, the same bits."""
    states = []
    for threads in ((1, 1), (1, 2)):
        runtime.init(threads=threads[0])
        bench = Bench("unity_aircraft", envs=8).step((0.2, 0.1, 0.0), 3)
        runtime.init(threads=threads[1])
        states.append(bench.step((-0.2, 0.4, 0.0), 3).state)
    assert torch.equal(*states)


def test_varied_numbers_have_the_precision_of_the_run():
    """A model that has served a run in double precision serves one in single precision like a new one."""

    def run(model):
        bench = Bench(model)
        bench.fleet.set_numbers({"mass": 333.3, "yaw_speed_deg": 77.7})
        return bench.step((0.3, 0.2, 0.1), 20).state

    runtime.init(precision="f32", threads=1)
    new = run(load_vehicle("unity_aircraft", 0.02, 5))
    runtime.init(precision="f64", threads=1)
    model = load_vehicle("unity_aircraft", 0.02, 5)
    assert run(model).numpy() == pytest.approx(new.numpy(), abs=1e-3)
    runtime.init(precision="f32", threads=1)
    assert torch.equal(run(model), new)


def test_an_error_in_a_kernel_shows_where_it_is():
    runtime.init(precision="f32", threads=1)
    with pytest.raises(ti.TaichiNameError, match=r"nowhere") as raised:
        loses(torch.zeros(2))
    told = str(raised.value)
    for part in (f'"{__file__}"', "x[i] = lost(x[i])\n", "return x + nowhere", " ^^^^^^^\n"):
        assert part in told


def test_a_cache_that_cannot_be_written_is_told_of_and_changes_nothing_else(tmp_path):
    (tmp_path / "file").write_text("")
    program = "from taichi_sim.kernels import runtime; runtime.init(); runtime.init(precision='f64'); print('done')"
    place = {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "file" / "cache"), "TMPDIR": str(tmp_path)}
    told = {"env": PATHS | place, "capture_output": True, "text": True, "timeout": 300}
    done = subprocess.run([sys.executable, "-c", program], **told)
    assert done.returncode == 0 and done.stdout == "done\n"
    assert done.stderr.startswith(f"warning: {place['TI_OFFLINE_CACHE_FILE_PATH']} cannot be written (Not a directory)")
    assert done.stderr.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


BOUND = """
import os, sys
import taichi as ti, torch
from taichi_sim.kernels import runtime

@ti.kernel
def work(x: ti.types.ndarray(ndim=1)):
    for i in range(x.shape[0]):
        for _ in range(20000):
            x[i] = 0.5 * x[i] + 1.0

def spent():
    threads = [int(number) for number in os.listdir("/proc/self/task")]
    return {t: int(open(f"/proc/self/task/{t}/schedstat").read().split()[0]) for t in threads}

threads = int(sys.argv[1])
runtime.init(threads=threads)
work(torch.zeros(4))
before = spent()
work(torch.zeros(20000))
worked = {t: time - before[t] for t, time in spent().items() if t != os.getpid()}
workers = sorted(worked, key=lambda t: worked[t])[-threads:]
print(sorted(sorted(os.sched_getaffinity(t)) for t in workers))
"""


@pytest.mark.slow
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")
def test_the_threads_that_work_have_a_core_each_where_they_are_as_many_as_cores(tmp_path):
    cores, script = sorted(os.sched_getaffinity(0)), tmp_path / "bound.py"
    script.write_text(BOUND)
    for threads, bound in ((len(cores), [[core] for core in cores]), (1, [cores])):
        done = subprocess.run([sys.executable, script, str(threads)], env=PATHS, capture_output=True, text=True)
        assert done.stdout == f"{bound}\n", done.stderr
