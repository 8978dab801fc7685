"""Colours and names of vehicles, the same in a recording and in a figure. No line is white or black."""

Colour = tuple[int, int, int]

LEADERS: dict[str, Colour] = {"usv": (213, 94, 0), "uav": (140, 60, 190)}
FOLLOWERS = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (140, 109, 49),
    (128, 128, 128),
)
"""Colour-blind-safe (Okabe and Ito, but for the last two): each leader has its own, followers take turns."""
TARGET = (214, 39, 120)
TRACK = {"usv": (250, 176, 84), "uav": (186, 140, 216)}
ALARM = (224, 36, 36)
CHECKPOINT = (255, 200, 60)
OBSTACLE = (150, 84, 66)
FRAME = (96, 120, 140)
WATER = (150, 222, 226)  # lines that lie on the water
CURRENT = (0, 150, 170)
WIND = (250, 205, 70)
AIRSPEED = (72, 196, 255)
GROUND_SPEED = (120, 214, 96)
BORESIGHT = (206, 64, 56)  # where the nose points
PLUMB = (176, 204, 212)  # from an aircraft down to the sea
LOADS: dict[str, Colour] = {
    "blue": (60, 130, 246),
    "green": (52, 199, 89),
    "red": (235, 64, 52),
    "yellow": (250, 205, 70),
    "violet": (200, 110, 230),
}
"""Load arrows, in the order in which a model names its forces."""


def vehicle_colour(team: str, vehicle: int) -> Colour:
    """RGB of a vehicle's body, trail, slot and plots."""
    return LEADERS[team] if vehicle == 0 else FOLLOWERS[(vehicle - 1) % len(FOLLOWERS)]


def vehicle_name(team: str, vehicle: int) -> str:
    """What a reader calls a vehicle."""
    return f"{team.upper()} leader" if vehicle == 0 else f"{team.upper()} {vehicle}"
