"""What a run needs besides a table's columns, and whether the columns agree with it and with each other.

A table whose inputs are wrong or missing says nothing about the physics: an InputsMissingError names what is wrong,
and the report has it as inputs missing instead of as an error of many metres.

The JSON of a table's own name beside it, NAME.json or NAME_meta.json (of NAME_converged.csv too), may hold
`initial_state`, by column or in the columns' order, and `wind`, the steady velocity of the air (NED, m/s).
"""

import re
from typing import Any

import numpy as np

from tests.validation.case import Case
from tests.validation.tables import InputsMissingError, Table, TableError, read_json

OF_A_RUN = re.compile(r"_(converged|euler_dt\d+(\.\d+)?|dt\d+(\.\d+)?)$")  # what a name says of the integrator
SAME_STATE = 1e-6  # of the largest magnitude of a state, by which it may differ between two files
SAME_AIR = 1e-5  # m/s and rad, by which air data may differ from the velocities beside them
SAME_WAY = 0.01  # of the way made, by which the track may differ from the velocities'


def beside(case: Case) -> dict[str, Any]:
    """The JSON of the table's name beside it; empty where there is none."""
    stem = case.path.stem
    names = [f"{base}{end}.json" for base in (stem, OF_A_RUN.sub("", stem)) for end in ("", "_meta")]
    path = next((p for p in map(case.path.with_name, names) if p.is_file()), None)
    data = read_json(case.folder.use(path)) if path else {}
    return data if isinstance(data, dict) else {}


def check_start(case: Case, table: Table, names: tuple[str, ...]) -> None:
    """Compare the first row with the `initial_state` beside the table, if there is one.

    Raises:
        InputsMissingError: if they are not the same state.
    """
    given = beside(case).get("initial_state")
    if isinstance(given, list) and len(given) == len(names):
        given = dict(zip(names, given, strict=True))
    if given is None:
        return
    if not isinstance(given, dict):
        raise TableError(f"key 'initial_state' is neither an object nor a list of {', '.join(names)}")
    for name in names:
        if name in given:
            first, expected = table[name][0], float(given[name])
            allowed = SAME_STATE * max(1.0, abs(expected)) + table.resolution(name)[0]
            if abs(first - expected) > allowed:
                raise InputsMissingError(
                    f"inputs missing: column {name!r} begins at {first:g}, 'initial_state' beside it at {expected:g}"
                )


def wind_of(case: Case, table: Table) -> np.ndarray:
    """Velocity of the air (NED, m/s) at each row [row, 3]: columns wn, we, wd, or `wind` beside the table, or none."""
    if "wn" in table:
        return np.stack([table[c] for c in ("wn", "we", "wd")], axis=1)
    given = beside(case).get("wind", (0.0, 0.0, 0.0))
    try:
        return np.broadcast_to(np.array(given, dtype=np.float64).reshape(3), (len(table), 3)).copy()
    except ValueError:
        raise TableError("key 'wind' is not three numbers: north, east, down, m/s") from None


def check_air(table: Table, v_r: np.ndarray) -> None:
    """Compare the columns Va (m/s), alpha, beta (rad) that there are with velocities relative to the air [row, 3].

    Raises:
        InputsMissingError: if they are not of the same air: the table was flown in another wind.
    """
    u, v, w = v_r.T
    air = {"Va": np.linalg.norm(v_r, axis=1), "alpha": np.arctan2(w, u), "beta": np.arctan2(v, np.hypot(u, w))}
    for name, ours in air.items():
        if name in table:
            away = np.abs(ours - table[name])
            away = away if name == "Va" else np.abs((away + np.pi) % (2 * np.pi) - np.pi)
            wrong = np.flatnonzero(away > SAME_AIR + 2 * table.resolution(name))
            if wrong.size:
                row = wrong[0]
                raise InputsMissingError(
                    f"inputs missing: column {name!r} is {table[name][row]:g} in row {row + 2}, where u, v, w and the "
                    f"wind give {ours[row]:g}: columns wn, we, wd of the wind it was flown in are missing or wrong"
                )


def check_way(table: Table, position: np.ndarray, velocity_n: np.ndarray) -> None:
    """Compare the way from first to last of positions [row, 3] (m) with that of velocities over ground [row, 3] (m/s).

    Raises:
        InputsMissingError: if they are not of the same flight: the velocities are not over ground.
    """
    dt = np.diff(table["t"])[:, None]
    way = (0.5 * (velocity_n[1:] + velocity_n[:-1]) * dt).sum(axis=0)
    length = float((0.5 * np.linalg.norm(velocity_n[1:] + velocity_n[:-1], axis=1) * dt[:, 0]).sum())
    gap = float(np.linalg.norm(position[-1] - position[0] - way))
    if gap > SAME_WAY * length:
        raise InputsMissingError(
            f"inputs missing: the positions go {gap:.3g} m elsewhere than u, v, w over ground: columns wn, we, wd of "
            "the wind are missing, or velocities are relative to the air"
        )
