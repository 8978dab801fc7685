"""Where what is not physics lies: `rl` and `tools`, beside this package in a checkout, inside it when it was installed.

The wheel does not put packages of such general names into site-packages, where another project's may lie: they are in
the folder `_bundle` of this package, which is looked into after everything else (`import taichi_sim` sees to that), and
by the command `taichi-sim` before everything else.
"""

import importlib
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent


def bundle() -> Path:
    """The folder that holds `rl`, `tools` and `docs`."""
    inside = HERE / "_bundle"
    return inside if (inside / "rl").is_dir() else HERE.parent


def find_rl(*, first: bool = False) -> None:
    """Make `import rl` find ours: after anybody else's of that name, or before."""
    place = str(bundle())
    if first:
        sys.path.insert(0, place)
    elif place not in sys.path:
        sys.path.append(place)


def of_rl(module: str, name: str) -> Any:
    """Something of `rl`, which this package does not know.

    Raises:
        ImportError: saying so, if another project's `rl` is in the way.
    """
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        other = getattr(sys.modules.get("rl"), "__file__", None)
        if error.name is None or not error.name.startswith("rl") or other is None:
            raise
        raise ImportError(f"{other} is not the rl of taichi-sim, before which it comes in sys.path") from None
