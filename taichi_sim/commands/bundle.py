"""Finds `rl` and `tools`: beside taichi_sim in a checkout, inside it when it was installed.

The wheel does not put packages of such general names into site-packages, where another project's may lie: they are in
the folder `_bundle` of taichi_sim, which is looked into after everything else (`import taichi_sim` sees to that), and
by the command `taichi-sim` before everything else.
"""

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> Path:
    """Folder that holds `rl`, `tools` and `docs`."""
    inside = PACKAGE / "_bundle"
    return inside if (inside / "rl").is_dir() else PACKAGE.parent


def find_rl(*, first: bool = False) -> None:
    """Make our `rl` importable: after any other package of that name, or before it (`first`)."""
    place = str(bundle())
    if first:
        sys.path.insert(0, place)
    elif place not in sys.path:
        sys.path.append(place)
