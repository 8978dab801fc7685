"""Changes of Taichi (kernels/taichi_patches.py): the list is whole, and without them the figures are the same."""

import os
import subprocess
import sys

import pytest
import torch
from folders import ROOT

PATHS = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
SWITCH = {"TAICHI_SIM_NO_PATCHES": "1"}

CHANGES = """
import sys

import taichi
import taichi.lang.matrix_ops  # Taichi imports it late


def attributes():
    modules = [(n, m) for n, m in list(sys.modules.items()) if n.split(".")[0] == "taichi"]
    classes = {c: f"{c.__module__}.{c.__name__}" for _, m in modules for c in vars(m).values()
               if isinstance(c, type) and c.__module__.startswith("taichi.")}
    owners = modules + [(name, c) for c, name in classes.items()]
    return {f"{n} {key}": value for n, owner in owners for key, value in vars(owner).items()
            if callable(value) or key == "textwrap"}


before = attributes()
from taichi_sim.bench import Bench
from taichi_sim.kernels import runtime
from taichi_sim.kernels.taichi_patches import PATCHES

runtime.init(threads=1)
Bench("unity_aircraft").step((0.2, 0.1, 0.0), 1)
after = attributes()
for name in sorted(after):
    if after[name] is not before.get(name):
        print("changed", name)
for owner, name, new in PATCHES:
    path = owner.__name__ if owner.__class__ is type(sys) else f"{owner.__module__}.{owner.__name__}"
    new = new.__func__ if isinstance(new, staticmethod) else new
    assert (getattr(owner, name) is new) == runtime.PATCHED
    print("listed", path, name)
"""

STEPS = """
import sys

import torch

from taichi_sim.bench import Bench
from taichi_sim.config import SeaConfig
from taichi_sim.kernels import runtime

runtime.init(threads=1)
sea = SeaConfig(hs=0.5, tp=4.0, realisations=2)
states = [Bench(name, sea=sea, envs=20, dt=0.02, substeps=5, seed=3).step((0.5, 0.2), 20).state
          for name in ("otter", "unity_boat")]
torch.save(states, sys.argv[1])
"""


ASSIGNMENTS = """
import taichi as ti
import torch

from taichi_sim.kernels import runtime

runtime.init(threads=1)


@ti.func
def pair(a, b):
    a += 1.0
    return a, b


@ti.func
def shifted(v: ti.template()):
    v[0] += 10.0
    return v


@ti.kernel
def assigned(out: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    for _ in range(1):
        x = out[0]
        y = x  # a copy
        y += 2.0
        a, b = pair(x, y)
        a, b = b, a  # exchanged
        p, q = x * 2.0, y * 2.0
        p = q = p + q  # both
        v = ti.Vector([x, y, p])
        w = v
        w[1] = -1.0
        r, s, t = w + v
        u = shifted(v)
        u[0] += 100.0
        one, two = ti.static(1.0, 2.0)
        for n in range(2):
            z = x + n
            x = z
        numbers = [x, y, a, b, p, q, v[0], v[1], w[0], w[1], r, s, t, u[0], one, two]
        for k in ti.static(range(16)):
            out[k + 1] = numbers[k]


out = torch.zeros(17)
out[0] = 3.0
assigned(out)
print(*out[1:].tolist())
"""


def run(program, *arguments, **environment):
    """What a program prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True, text=True, env=PATHS | environment, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("switch", [{}, pytest.param(SWITCH, marks=pytest.mark.slow)], ids=["on", "off"])
def test_the_list_has_every_change(switch):
    """By what Taichi's modules and classes hold before and after a vehicle has moved; none with the switch."""
    found = [line.split(" ", 1) for line in run(CHANGES, **switch)]
    listed, changed = ({name for what, name in found if what == kind} for kind in ("listed", "changed"))
    assert listed
    assert changed == (set() if switch else listed)


@pytest.mark.slow
def test_a_cache_serves_both(tmp_path):
    """The same bits from a cache with the kernels of another setting as from an empty one."""
    states = []
    for cache, switch in (("shared", {}), ("shared", SWITCH), ("own", SWITCH)):
        file = tmp_path / "states.pt"
        run(STEPS, file, TI_OFFLINE_CACHE_FILE_PATH=str(tmp_path / cache), **switch)
        states.append(torch.load(file))
    for patched, after_patched, alone in zip(*states, strict=True):
        assert torch.equal(after_patched, alone)
        assert torch.allclose(patched, alone, rtol=1e-5, atol=1e-5)


PHYSICS = (
    "hull_lanes", "hull_6dof_loads", "hull_6dof_robustness", "unity_boat", "unity_aircraft", "fixed_wing_reference",
    "multirotor_reference", "position"
)  # fmt: skip


@pytest.mark.slow
def test_the_physics_is_the_same_without_the_changes():
    """Tests of vehicles in single precision, where the changes matter."""
    files = [file for name in PHYSICS for file in (ROOT / "tests" / "taichi_sim").rglob(f"test_{name}.py")]
    assert len(files) == len(PHYSICS)
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-k", "not f64", *files]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=PATHS | SWITCH, timeout=3000)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("switch", [{}, pytest.param(SWITCH, marks=pytest.mark.slow)], ids=["on", "off"])
def test_an_assignment_is_what_it_is_in_python(switch, tmp_path):
    """Copies of numbers and vectors, exchanges, several targets, values of functions, a variable of a loop."""
    file = tmp_path / "assignments.py"  # Taichi reads the source of a kernel
    file.write_text(ASSIGNMENTS)
    *_, found = run("import runpy, sys; runpy.run_path(sys.argv[1])", file, **switch)
    x, y, a, b, both = 3.0 + 0.0 + 1.0, 5.0, 5.0, 4.0, 2 * 3.0 + 2 * 5.0
    v, w = (3.0 + 10.0, 5.0), (3.0, -1.0)
    summed = 3.0 + 3.0, 5.0 - 1.0, both + both
    assert list(map(float, found.split())) == [x, y, a, b, both, both, *v, *w, *summed, v[0] + 100.0, 1.0, 2.0]
