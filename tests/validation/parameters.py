"""Where a vehicle's published numbers are: in the reference directory, in `params` beside it, or in its own file."""

from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.config.io import config_folder
from tests.validation.case import Case
from tests.validation.tables import read_toml

LAST_DIGIT = 0.51e-6  # half a unit of the sixth decimal, to which published numbers are printed


def published(case: Case, name: str) -> dict[str, Any] | None:
    """Content of the file `name` (otter.toml) with published numbers, or None where there is none."""
    root = case.folder.root
    found = (*sorted(root.rglob(name)), root.parent / "params" / name)
    path = next((p for p in found if p.is_file()), None)
    return read_toml(case.folder.use(path)) if path else None


def shipped(name: str) -> dict[str, Any]:
    """Content of the vehicle file `name` of this package, without its model."""
    data = read_toml(config_folder() / "vehicles" / name)
    return {key: value for key, value in data.items() if key != "model"}


def refined(printed, full) -> Any:
    """`printed` numbers, and in place of those that are `full` rounded to six decimals the latter; lists or numbers."""
    values, exact = np.asarray(printed, dtype=np.float64), np.asarray(full, dtype=np.float64)
    return np.where(np.abs(values - exact) <= LAST_DIGIT, exact, values).tolist()


def only(folder: Path, pattern: str) -> Path | None:
    """The one file in `folder` of that pattern, None where there is none or more."""
    found = sorted(folder.glob(pattern))
    return found[0] if len(found) == 1 else None
