"""Colours of recordings and figures. No line is white or black."""

from collections.abc import Mapping
from itertools import cycle
from typing import NamedTuple

Colour = tuple[int, int, int]


class Livery(NamedTuple):
    """The colours of one team."""

    first: Colour  # of vehicle 0: body, trail, plots
    track: Colour  # of the path that its target follows

    def of(self, vehicle: int) -> Colour:
        """RGB colour of a vehicle's body, trail, slot and plots."""
        return self.first if vehicle == 0 else FOLLOWERS[(vehicle - 1) % len(FOLLOWERS)]


FIRST = {"water": Livery((213, 94, 0), (250, 176, 84)), "air": Livery((140, 60, 190), (186, 140, 216))}
"""Liveries of the first team on the water and of the first in the air."""
OTHERS = (
    Livery((0, 104, 88), (116, 196, 178)),
    Livery((150, 30, 60), (222, 134, 154)),
    Livery((40, 70, 170), (144, 166, 232)),
    Livery((110, 116, 20), (196, 200, 110)),
)
"""Liveries of all other teams, which take turns."""
FOLLOWERS: tuple[Colour, ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (140, 109, 49),
    (128, 128, 128),
)
"""Colour-blind-safe (Okabe and Ito, but for the last two): of the vehicles behind the first, which take turns."""
TARGET = (214, 39, 120)
ALARM, GOOD = (224, 36, 36), (40, 160, 72)
CHECKPOINT = (255, 200, 60)
OBSTACLE = (150, 84, 66)
FRAME = (96, 120, 140)
WATER = (150, 222, 226)  # lines that lie on the water
CURRENT = (0, 150, 170)
WIND = (250, 205, 70)
AIRSPEED = (72, 196, 255)
GROUND_SPEED = (120, 214, 96)
BORESIGHT = (206, 64, 56)  # line along the nose
PLUMB = (176, 204, 212)  # line from an aircraft down to the sea
LOADS: dict[str, Colour] = {
    "blue": (60, 130, 246),
    "green": (52, 199, 89),
    "red": (235, 64, 52),
    "yellow": (250, 205, 70),
    "violet": (200, 110, 230),
}
"""Load arrows, in the order in which a model names its forces."""


def liveries(media: Mapping[str, str]) -> dict[str, Livery]:
    """The colours of each team, by its place among the teams; `media` is name -> "water" or "air", in order."""
    first, others = dict(FIRST), cycle(OTHERS)
    return {name: first.pop(medium) if medium in first else next(others) for name, medium in media.items()}
