"""Public names of `taichi_sim` and `rl`, as Python and as type checkers see them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rl
import taichi_sim as ts


@pytest.mark.parametrize("package", [ts, rl], ids=lambda package: package.__name__)
def test_type_checkers_see_the_names_that_there_are(package):
    stub = ast.parse(Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    (listed,) = (node.value for node in stub.body if isinstance(node, ast.Assign))
    seen = ast.literal_eval(listed)  # what a stub does not list, type checkers do not see
    homes = {alias.name: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert seen == sorted(homes) == package.__all__
    assert homes == package._HOME
    assert all(hasattr(package, name) for name in dir(package))
    assert not [name for name in dir(package) if name.startswith("_") and not name.startswith("__")]


@pytest.mark.parametrize(
    ("package", "without"),
    [
        ("taichi_sim", ("rl", "torch", "gymnasium")),
        ("rl", ("taichi", "torch", "rsl_rl")),
        # what acts and is judged: rsl-rl and what it imports take as long to import as torch
        ("rl.learn.policy_sources, rl.evaluation.store, rl.runs.watch", ("rsl_rl", "tensordict", "matplotlib")),
    ],
)
def test_importing_it_imports_no_more_than_its_names(package, without):
    code = f"import sys, {package}; print(*({{name.partition('.')[0] for name in sys.modules}} & {{*{without!r}}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
