"""Reads a stage's training history, progress.csv."""

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_history(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns of a stage's progress.csv; a blank is NaN.

    Raises:
        ValueError: if a cell is not a number.
    """
    with Path(path).open(newline="") as file:
        reader = csv.DictReader(file, restval="")
        rows = list(reader)
        names = reader.fieldnames or []
    return {name: np.array([float(row[name]) if row[name] else math.nan for row in rows]) for name in names}
