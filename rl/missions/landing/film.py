"""What a recording shows of landings beside the vehicles: what is known of decks, heights over them, how decks move."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.overlays import Lines, Plot, Points

SIGHT, KNOWN = (255, 230, 140), (250, 120, 220)
SHOWN_HEIGHT = 10.0  # m, higher up plots are cut off


class Film:
    """Frames of the environment that is shown, one each time `take` is called."""

    def __init__(self, mission: Any):
        """Of `mission`, from now on."""
        self.mission = mission
        self._frames: list[dict[str, NDArray[np.float64]]] = []

    def take(self) -> None:
        """Keep what there is now."""
        mission, env = self.mission, self.mission.shown
        aircraft, deck = mission.aircraft, mission.boats.deck
        frame = {"deck_speed": deck.velocity[env, :, 2], "deck_tilt": deck.tilt[env], "deck": deck.place[env]}
        if aircraft is not None:
            known = aircraft.known_deck
            frame |= {
                "height": aircraft.height[env], "level": aircraft.offset[env, :, :2].norm(dim=-1),
                "known": aircraft.fleet.position_n[env] + known.to[env], "sees": (known.seen[env] == 0).double(),
                "place": aircraft.fleet.position_n[env],
            }  # fmt: skip
        self._frames.append({name: value.double().cpu().numpy().copy() for name, value in frame.items()})

    def overlays(self) -> tuple[Any, ...]:
        """All of it."""
        if not self._frames:
            return ()
        film = {name: np.stack([frame[name] for frame in self._frames]) for name in self._frames[0]}
        boats = tuple(f"{self.mission.boats.name}{k}" for k in range(film["deck_speed"].shape[1]))
        found: list[Any] = [
            Plot(name="vertical speed of decks", unit="m/s", lines=boats, values=film["deck_speed"]),
            Plot(name="tilt of decks", unit="rad", lines=boats, values=film["deck_tilt"]),
        ]
        if "height" in film:
            names = tuple(f"{self.mission.aircraft.name}{k}" for k in range(film["height"].shape[1]))
            height = np.minimum(film["height"], SHOWN_HEIGHT)
            level = np.minimum(film["level"], SHOWN_HEIGHT)
            found += [
                Plot(name="height above the deck", unit="m", lines=names, values=height),
                Plot(name="distance from the middle of the deck", unit="m", lines=names, values=level),
                Points(name="deck as known", colour=KNOWN, position_n=film["known"], radius=-3.0),
                self._sights(film),
            ]
        return tuple(found)

    def _sights(self, film: dict[str, NDArray[np.float64]]) -> Lines:
        """From each camera to the marker that it has found in this look."""
        lines = np.stack((film["place"], film["deck"]), axis=-2)
        lines = np.where((film["sees"] > 0)[..., None, None], lines, np.nan)
        return Lines(name="sight lines", colour=SIGHT, points_n=lines, radius=-0.6, where="world")
