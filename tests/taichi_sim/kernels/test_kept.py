"""Kernels found in the cache without reading them (kernels/kept.py): the key is of all that a kernel is made from."""

import importlib
import linecache
import os
import shutil
import subprocess
import sys
from types import FunctionType
from typing import Any, cast

import numpy as np
import pytest
import taichi as ti
import torch
from folders import ROOT
from taichi.lang import impl

from rl.learn.policy import policies_of
from rl.missions import find_mission, load_scenario, make_mission
from taichi_sim.kernels import kept, runtime
from taichi_sim.models.catalogue import load_vehicle

PATHS = os.environ | {"PYTHONPATH": str(ROOT)}
NUMBERS = "FACTOR = 2.0\nTABLE = (1.0, 2.0)\n\n\nclass Shape:\n    order = 3\n"
WAVE = """
import taichi as ti

from drawing import numbers


def power(shape):
    return shape.order


def cube(shape):
    return shape.order**3


@ti.func
def height(x, shape: ti.template()):
    return numbers.FACTOR * x + numbers.TABLE[1] + ti.static(power(numbers.Shape)) + shape.gain + shape.rows[0, 1]


@ti.kernel
def draw(x: ti.types.ndarray(ndim=1), shape: ti.template()):
    for i in x:
        x[i] = height(x[i], shape)
"""
SCRIPT = """
import os
import sys
from pathlib import Path

import numpy as np
import torch

from taichi_sim.kernels import kept, runtime

kept.OURS = (*kept.OURS, "drawing")
from drawing import numbers, wave

numbers.FACTOR = float(sys.argv[1])
found, look = [], kept._kept


def kept_(made):
    found.append(look(made))
    if sys.argv[2:]:  # somebody empties the cache just then
        for file in Path(os.environ["TI_OFFLINE_CACHE_FILE_PATH"]).glob("*.tic"):
            file.unlink()
    return found[-1]


kept._kept = kept_
shape = numbers.Shape()
shape.gain, shape.rows = 10.0, np.array([[0.0, 20.0]])
x = torch.ones(3)
first = not list(Path(os.environ["TI_OFFLINE_CACHE_FILE_PATH"]).glob("*.tic"))
runtime.init(threads=1 if first else 2)
runtime.Launcher(wave.draw)(x, shape)
again = torch.ones(3)
runtime.Launcher(wave.draw)(again, shape)
assert again.equal(x)
print(found, x.tolist())
"""


def _write(folder):
    place = folder / "drawing"
    place.mkdir()
    for name, text in {"__init__": "", "numbers": NUMBERS, "wave": WAVE}.items():
        (place / f"{name}.py").write_text(text)
        os.utime(place / f"{name}.py", (0, 0))
    return place


@pytest.fixture
def drawing(tmp_path, monkeypatch):
    """The digest of a kernel of a package of ours, and its modules."""
    place = _write(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(kept, "OURS", (*kept.OURS, "drawing"))

    def load():
        linecache.clearcache()
        for name in [name for name in sys.modules if name.partition(".")[0] == "drawing"]:
            del sys.modules[name]
        importlib.invalidate_caches()
        shutil.rmtree(place / "__pycache__", ignore_errors=True)
        return importlib.import_module("drawing.wave")

    class Drawing:
        folder = place
        wave = load()
        template = None

        def digest(self):
            if self.template is None:
                self.template = self.shape()
            return kept.digest(self.wave.draw._primal, (), (self.template,))

        def shape(self):
            shape = self.wave.numbers.Shape()
            shape.gain, shape.rows = 10.0, np.array([[0.0, 20.0]])
            return shape

        def edit(self, name, old, new, when=0):
            text = (place / name).read_text()
            assert old in text
            (place / name).write_text(text.replace(old, new))
            os.utime(place / name, (when, when))
            self.wave, self.template = load(), None

    yield Drawing()
    sys.modules.pop("drawing", None)


CHANGES = {
    "the kernel's text": lambda d, patch: d.edit("wave.py", "x[i] = height(", "x[i] += height("),
    "text of a function it calls": lambda d, patch: d.edit("wave.py", "return shape.order", "return 2 * shape.order"),
    "text of a module of numbers": lambda d, patch: d.edit("numbers.py", "FACTOR = 2.0", "FACTOR = 2.5"),
    "a comment there": lambda d, patch: d.edit("numbers.py", "order = 3", "order = 3  # cubic"),
    "a number, from outside": lambda d, patch: patch.setattr(d.wave.numbers, "FACTOR", 2.5),
    "a tuple, from outside": lambda d, patch: patch.setattr(d.wave.numbers, "TABLE", (1.0, 2.5)),
    "a function, from outside": lambda d, patch: patch.setattr(d.wave, "power", d.wave.cube),
    "a class's number": lambda d, patch: patch.setattr(d.wave.numbers.Shape, "order", 4),
    "an object's number": lambda d, patch: patch.setattr(d.template, "gain", 11.0),
    "an object's array": lambda d, patch: patch.setattr(d.template, "rows", np.array([[0.0, 21.0]])),
    "its type": lambda d, patch: patch.setattr(d.template, "rows", np.array([[0.0, 20.0]], np.float32)),
    "a setting": lambda d, patch: patch.setattr(impl.current_cfg(), "opt_level", 2),
    "the threads": lambda d, patch: patch.setattr(impl.current_cfg(), "cpu_max_num_threads", 7),
    "vectors kept whole": lambda d, patch: patch.setattr(impl.current_cfg(), "real_matrix_scalarize", False),
    "Taichi's version": lambda d, patch: patch.setattr(ti, "__version__", (1, 7, 5)),
    "torch's version": lambda d, patch: patch.setattr(torch, "__version__", "2.99"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_whatever_a_kernel_is_made_from_changes_its_digest(change, drawing, monkeypatch):
    before = drawing.digest()
    assert before
    assert drawing.digest() == before
    drawing.template = drawing.shape()
    assert drawing.digest() == before  # another object of the same numbers
    change(drawing, monkeypatch)
    assert drawing.digest() != before


def test_a_runs_copy_of_a_vehicle_has_its_digest(tmp_path):
    """So has one of other last bits in a table that the host alone reads: they depend on numpy's threads."""
    for file in (ROOT / "configs" / "vehicles").glob("otter.*"):
        shutil.copy(file, tmp_path)
    models = [cast(Any, load_vehicle(file)) for file in ("otter", tmp_path / "otter.toml")]
    models[1].radiation.diffraction.resampled *= 1 + 1e-15
    one, other = (kept.digest(model._step._primal, (model,), ()) for model in models)
    assert one and one == other
    for file in tmp_path.iterdir():
        file.write_bytes(file.read_bytes() + b"\n")
    assert kept.digest(models[1]._step._primal, (models[1],), ()) != one  # by its content, not its name


def test_no_digest_where_code_is_not_known(drawing, monkeypatch):
    monkeypatch.setattr(drawing.wave, "power", np.sin)
    assert drawing.digest()  # of a package that its version stands for
    monkeypatch.setattr(drawing.wave, "power", test_no_digest_where_code_is_not_known)
    assert drawing.digest() is None
    assert kept.unkeyed["drawing.wave.draw"].endswith("test_kept is code of others")
    drawing.edit("numbers.py", "FACTOR = 2.0", "FACTOR = 2.5", when=kept.BEGIN + 1)
    assert drawing.digest() is None
    assert kept.unkeyed["drawing.wave.draw"].endswith("numbers.py has changed")


def test_a_kernel_of_others_is_compiled_as_ever():
    @ti.kernel
    def double(x: ti.types.ndarray(ndim=1)):  # pyright: ignore
        for i in x:
            x[i] *= 2.0

    x = torch.ones(3)
    runtime.Launcher(double)(x)
    assert x.tolist() == [2.0] * 3
    assert any(name.endswith(double.__qualname__) for name in kept.unkeyed)


@pytest.fixture
def run(tmp_path):
    """Runs SCRIPT with a cache and arguments; what it prints."""
    _write(tmp_path)
    (tmp_path / "script.py").write_text(SCRIPT)

    def run(cache, *arguments):
        environment = PATHS | {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / cache)}
        command = [sys.executable, tmp_path / "script.py", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert done.returncode == 0
        return done.stdout, done.stderr.replace(f"{tmp_path / cache}", "")

    compiling = "compiling kernels, a minute or so for each kind of vehicle; they are kept in \n"
    assert run("cache", "2") == ("[False] [37.0, 37.0, 37.0]\n", compiling)
    return run


def test_a_kept_kernel_is_found_but_not_with_another_number(run):
    """By any number of threads. Of what Taichi prints, nothing is seen."""
    assert run("cache", "2") == ("[True] [37.0, 37.0, 37.0]\n", "")
    assert run("cache", "3") == ("[False] [38.0, 38.0, 38.0]\n", "")


@pytest.mark.slow
def test_a_damaged_kernel_is_made_anew(run, tmp_path):
    """So is one that is removed while it is read; its process keeps nothing, and ends as others do."""
    for damage in ("short", "empty", "removed"):
        shutil.copytree(tmp_path / "cache", tmp_path / damage)
        (kernel,) = (tmp_path / damage).glob("*.tic")
        if damage != "removed":
            kernel.write_bytes(kernel.read_bytes()[:1000] if damage == "short" else b"")
    assert run("short", "2") == run("empty", "2") == ("[False] [37.0, 37.0, 37.0]\n", "")
    assert run("removed", "2", "while it is read") == ("[True, False] [37.0, 37.0, 37.0]\n", "")
    assert not list((tmp_path / "removed").glob("*.tic"))


@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(file.stem, marks=[pytest.mark.slow] * (file.stem != "paper"))
        for file in sorted((ROOT / "configs").glob("*.toml"))
    ],
)
def test_all_python_that_a_kernel_is_made_by_is_in_its_digest(scenario, monkeypatch):
    """Functions of ours that run while Taichi reads the kernels of a mission are those that the digest has followed."""
    followed, missed = set(), set()
    end, build, look = kept._Walk.end, kept.build_stmts, kept._kept

    def remember(walk):
        functions = [value for _, value in walk._seen.values() if isinstance(value, FunctionType)]
        followed.update(code for function in functions for code in kept._codes(function.__code__))
        return end(walk)

    def watched(context, body):
        called = set()
        sys.setprofile(lambda frame, event, arg: called.add(frame.f_code))
        try:
            build(context, body)
        finally:
            sys.setprofile(None)
        missed.update(
            (code.co_filename, code.co_qualname)
            for code in called - followed
            if code.co_filename.startswith((f"{ROOT}/taichi_sim", f"{ROOT}/rl"))
            and code.co_filename not in (*kept.FRONT_END, runtime.__file__)
        )
        followed.clear()

    monkeypatch.setattr(kept._Walk, "end", remember)
    monkeypatch.setattr(kept, "build_stmts", watched)
    monkeypatch.setattr(kept, "_kept", lambda made: look(made) and False)
    config = load_scenario(scenario)
    mission = make_mission(find_mission(config.mission).one_each(config, 32), 32, seed=0)
    for _ in range(2):
        mission.step(policies_of("classical", ROOT, config))
    assert missed == set()
    assert not [name for name in kept.unkeyed if name.partition(".")[0] in kept.OURS]
