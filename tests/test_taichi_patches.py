"""Changes of Taichi (kernels/taichi_patches.py): the list is whole, and without them the figures are the same."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parent.parent
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
    return {f"{n} {key}": value for n, owner in owners for key, value in vars(owner).items() if callable(value)}


before = attributes()
from taichi_sim.applications.bench import Bench
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

from taichi_sim.applications.bench import Bench
from taichi_sim.config import SeaConfig
from taichi_sim.kernels import runtime

runtime.init(threads=1)
sea = SeaConfig(hs=0.5, tp=4.0, realisations=2)
states = [Bench(name, sea=sea, envs=20, dt=0.02, substeps=5, seed=3).step((0.5, 0.2), 20).state
          for name in ("otter", "unity_boat")]
torch.save(states, sys.argv[1])
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
    files = [ROOT / "tests" / "physics" / f"test_{name}.py" for name in PHYSICS]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-q", "-k", "not f64", *files]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=PATHS | SWITCH, timeout=3000)
    assert done.returncode == 0, done.stdout
