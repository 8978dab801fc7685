"""What a vehicle model may say of itself to a recording. Every attribute is optional; a model needs none.

medium: "water" or "air"
    What it moves in: boats ride the water, aircraft fly.
aux_names: tuple[str, ...]
    Names of the first columns of its auxiliary state; the attributes below refer to them.
airframe: tuple[chord, tail]
    Of an aircraft: its wing's mean chord (m), and whether it has a tail.
air: tuple[str, str, str]
    Columns of the velocity of the air that it meets (north, east, down, m/s).
body(self) -> tuple[vertices, triangles]
    Its surface: vertices [N, 3] (m, b) and the corners [F, 3] of triangles, counter-clockwise from outside.
forces: dict[str, tuple[origin, columns]]
    Load arrows: name -> where it attacks (m, b), and the columns of its x, y and z (N, b; None is zero).
    Names that begin alike up to the first "_" share a colour: thrust_left, thrust_right.
signals: dict[str, tuple[unit, columns]]
    Plots: name -> SI unit ("" for a ratio) and the columns that share the plot.
"""

from typing import Any

import numpy as np

from taichi_sim.recording.episode import Airframe, Array, Body, Force, Medium, Signal


def medium_of(model: Any) -> Medium:
    """What the model moves in."""
    return getattr(model, "medium", None) or ("water" if model.team == "usv" else "air")


def columns_of(model: Any) -> int:
    """How many columns of the auxiliary state the model has named."""
    return len(getattr(model, "aux_names", ()))


def body_of(model: Any) -> Body | None:
    """The model's own surface, or None."""
    return Body(*model.body()) if hasattr(model, "body") else None


def airframe_of(model: Any) -> Airframe | None:
    """Proportions of an aircraft, or None."""
    return Airframe(*model.airframe) if hasattr(model, "airframe") else None


def air_of(model: Any, aux: Array) -> Array | None:
    """[T, V, 3] velocity of the air met (m/s, n) out of the named columns `aux` [T, V, n], or None."""
    columns = getattr(model, "air", None)
    return None if columns is None else np.stack([_column(model, aux, column) for column in columns], axis=-1)


def forces_of(model: Any, aux: Array) -> dict[str, Force]:
    """Forces (N) out of the named columns `aux` [T, V, n]."""
    return {
        name: Force(origin, np.stack([_column(model, aux, column) for column in columns], axis=-1))
        for name, (origin, columns) in getattr(model, "forces", {}).items()
    }


def signals_of(model: Any, aux: Array) -> dict[str, Signal]:
    """Plots out of the named columns `aux` [T, V, n]."""
    return {
        name: Signal(columns, unit, np.stack([_column(model, aux, column) for column in columns], axis=-1))
        for name, (unit, columns) in getattr(model, "signals", {}).items()
    }


def _column(model: Any, aux: Array, name: str | None) -> Array:
    """[T, V] of one column; zeros for None."""
    if name is None:
        return np.zeros_like(aux[..., 0])
    if name not in model.aux_names:
        raise ValueError(f"{type(model).__name__}: no column {name!r} in aux_names {model.aux_names}")
    return aux[..., model.aux_names.index(name)]
