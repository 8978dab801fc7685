"""Overlays of landings in recordings: known decks, heights above decks, and motion of decks."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.missions.landing.aircraft import Aircraft
from rl.missions.landing.decks import Decks
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.visualisation.recording.overlays import Lines, Overlay, Plot, Points

SIGHT, KNOWN = (255, 230, 140), (250, 120, 220)
SHOWN_HEIGHT = 10.0  # m, higher up plots are cut off


def overlays_of(boats: Decks, aircraft: Aircraft | None, env: int) -> tuple[Overlay, ...]:
    """Return all overlays of environment `env` for the present frame."""

    def frame(value: Tensor) -> NDArray[np.float64]:
        return value[env].double().cpu().numpy()[None].copy()

    deck = boats.deck
    names = tuple(f"{boats.fleet.name}{k}" for k in range(boats.fleet.count))
    drawn: list[Overlay] = [
        Plot(name="vertical speed of decks", unit="m/s", lines=names, values=frame(deck.velocity[..., DOWN])),
        Plot(name="tilt of decks", unit="rad", lines=names, values=frame(deck.tilt)),
    ]
    if aircraft is not None:
        known, place = aircraft.known_deck, aircraft.fleet.position_n
        names = tuple(f"{aircraft.name}{k}" for k in range(aircraft.fleet.count))
        height = np.minimum(frame(aircraft.height), SHOWN_HEIGHT)
        level = np.minimum(frame(aircraft.offset[..., :2].norm(dim=-1)), SHOWN_HEIGHT)
        drawn += [
            Plot(name="height above the deck", unit="m", lines=names, values=height),
            Plot(name="distance from the middle of the deck", unit="m", lines=names, values=level),
            Points(name="deck as known", colour=KNOWN, position_n=frame(place + known.to), radius=-3.0),
            _sights(frame(place), frame(aircraft.deck.place), frame(known.seen) == 0),
        ]
    return tuple(drawn)


def _sights(place: NDArray[np.float64], deck: NDArray[np.float64], sees: NDArray[np.bool_]) -> Lines:
    """Sight lines from each camera to its marker, where it has found the marker in this look."""
    lines = np.where(sees[..., None, None], np.stack((place, deck), axis=-2), np.nan)
    return Lines(name="sight lines", colour=SIGHT, points_n=lines, radius=-0.6, where="world")
