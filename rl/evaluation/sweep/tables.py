"""A finished sweep as JSON and CSV in the run's folder; interruptions do not change a byte."""

import csv
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from rl.runs import folder as run_folder
from rl.runs.records import CellRow, SweepAbout

JSON, CSV = "sweep.json", "sweep.csv"


def write_tables(out: Path, about: SweepAbout, rows: Sequence[CellRow]) -> None:
    """Write `about` and the cells' `rows` (run.py) to `sweep.json`, and the same to `sweep.csv`."""
    run_folder.write_json(out / JSON, {**about, "cells": list(rows)})
    part = out / f"{CSV}.part"
    with part.open("w", newline="", encoding="utf-8") as file:
        names = [axis["name"] for axis in about["axes"]]
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, "team", "controller", "figure", "value", "low", "high", "cannot be"])
        for row in rows:
            values = [value_text(row["values"].get(name, "")) for name in names]
            writer.writerows([*values, *line] for line in _lines(row, about["opponent"]))
    os.replace(part, out / CSV)


def value_text(value: object) -> str:
    """The value of an axis as printed."""
    if isinstance(value, list | tuple):
        return ", ".join(map(value_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def named(who: str, opponent: str) -> str:
    """The name in tables of a controller, or of the "difference" from its `opponent`."""
    return f"policy - {opponent}" if who == "difference" else who


def _lines(row: CellRow, opponent: str) -> Iterator[list[str | float]]:
    """A line for each figure of a cell, and for each controller that could not run."""
    for who, reason in row["cannot_be"].items():
        yield ["", named(who, opponent), "", "", "", "", " ".join(reason.split())]
    for team, of_team in row["teams"].items():
        for who, figures in of_team.items():
            for figure, numbers in figures.items():
                yield [team, named(who, opponent), figure, *("" if x is None else x for x in numbers), ""]
