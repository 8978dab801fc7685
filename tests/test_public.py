"""`import taichi_sim as ts`: its public names, as Python and as type checkers see them."""

import ast
import subprocess
import sys
from pathlib import Path

import taichi_sim as ts


def test_type_checkers_see_the_names_that_there_are():
    stub = ast.parse(Path(ts.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    (listed,) = (node.value for node in stub.body if isinstance(node, ast.Assign))
    seen = ast.literal_eval(listed)  # what a stub does not list, type checkers do not see
    assert seen == ts.__all__
    assert all(hasattr(ts, name) for name in dir(ts))
    assert not [name for name in dir(ts) if name.startswith("_") and not name.startswith("__")]
    assert {"World", "Sea", "Wind", "Bench", "load_vehicle", "SeaConfig", "parallel_env", "batched_env"} <= set(seen)


def test_importing_it_imports_no_missions_and_no_learning():
    code = "import sys, taichi_sim; print(*(name for name in sys.modules if name.partition('.')[0] in ('rl', 'torch')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
