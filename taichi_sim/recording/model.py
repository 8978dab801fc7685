"""What a vehicle model (taichi_sim/vehicle.py) provides for a recording: surface, loads, instruments."""

import numpy as np

from taichi_sim.recording.episode import Airframe, Array, Body, Force, Platform, Signal
from taichi_sim.vehicle import Vehicle


def columns_of(model: Vehicle) -> int:
    """Number of named columns of the model's auxiliary state."""
    return len(model.aux_names)


def body_of(model: Vehicle) -> Body | None:
    """The model's own surface, or None if it has none."""
    surface = model.body()
    return None if surface is None else Body(*surface)


def airframe_of(model: Vehicle) -> Airframe | None:
    """Proportions of an aircraft, or None for other vehicles."""
    return None if model.airframe is None else Airframe(*model.airframe)


def deck_of(model: Vehicle) -> Platform | None:
    """The deck on which others land, or None if there is none."""
    return None if model.deck is None else Platform(model.deck.centre, model.deck.half)


def air_of(model: Vehicle, aux: Array) -> Array | None:
    """Velocity of the air met [T, V, 3] (m/s, n) from the named columns `aux` [T, V, n]; None if there is none."""
    if model.air is None:
        return None
    return np.stack([_column(model, aux, column) for column in model.air], axis=-1)


def forces_of(model: Vehicle, aux: Array) -> dict[str, Force]:
    """Forces (N) from the named columns `aux` [T, V, n]."""
    return {
        name: Force(origin, np.stack([_column(model, aux, column) for column in columns], axis=-1))
        for name, (origin, columns) in model.forces.items()
    }


def signals_of(model: Vehicle, aux: Array) -> dict[str, Signal]:
    """Plots from the named columns `aux` [T, V, n]."""
    return {
        name: Signal(columns, unit, np.stack([_column(model, aux, column) for column in columns], axis=-1))
        for name, (unit, columns) in model.signals.items()
    }


def _column(model: Vehicle, aux: Array, name: str | None) -> Array:
    """The column `name` [T, V] of `aux`; zeros if `name` is None."""
    if name is None:
        return np.zeros_like(aux[..., 0])
    if name not in model.aux_names:
        raise ValueError(f"{type(model).__name__}: no column {name!r} in aux_names {model.aux_names}")
    return aux[..., model.aux_names.index(name)]
