"""Finds `rl` and `tools`: beside taichi_sim in a checkout, inside it in an installation.

Names as general as `rl` and `tools` may belong to another project's packages, so the wheel does not install them into
site-packages but into the folder `_bundle` of taichi_sim. `import taichi_sim` puts that folder at the end of the search
path; the command `taichi-sim` puts it at the beginning.
"""

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def bundle() -> Path:
    """Folder that holds `rl`, `tools` and `docs`."""
    inside = PACKAGE / "_bundle"
    return inside if (inside / "rl").is_dir() else PACKAGE.parent


def find_rl(*, first: bool = False) -> None:
    """Make our `rl` importable, after any other package of that name, or before it if `first`."""
    place = str(bundle())
    if first:
        sys.path.insert(0, place)
    elif place not in sys.path:
        sys.path.append(place)
