"""What is packaged: every package of the tree and the shipped scenarios, so that an install works anywhere."""

import tomllib

from folders import ROOT


def test_every_package_is_listed():
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {
        ("rl._bundle." if top == "tools" else "") + ".".join(file.parent.relative_to(ROOT).parts)
        for top in ("taichi_sim", "rl", "tools")
        for file in (ROOT / top).rglob("__init__.py")
    }
    assert listed == found | {
        "rl._bundle.docs",
        "taichi_sim.configs",
        "taichi_sim.configs.oracle",
        "taichi_sim.configs.sweeps",
        "taichi_sim.configs.vehicles",
    }
