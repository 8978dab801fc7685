"""Columns, by name, of the tables that perception writes. Kernels and torch code use them alike; SI, NED."""


class Obstacle:
    """An obstacle near a vehicle, as the vehicle senses it (`Nearby.obstacles`).

    DISTANCE to its surface; NORTH, EAST, DOWN of the unit vector to its axis; velocity; RADIUS; LEVEL, the horizontal
    distance to its surface, negative above or below it; NUMBER, -1 if there is none.
    """

    DISTANCE, NORTH, EAST, DOWN, V_NORTH, V_EAST, RADIUS, LEVEL, NUMBER, SIZE = range(10)


class Mate:
    """A team mate near a vehicle (`Nearby.team_mates`): DISTANCE to its origin, unit vector, NUMBER, velocity."""

    DISTANCE, NORTH, EAST, DOWN, NUMBER, V_NORTH, V_EAST, SIZE = range(8)


class Object:
    """An object that observers can see: place, velocity, radius; the truth."""

    NORTH, EAST, DOWN, V_NORTH, V_EAST, RADIUS, SIZE = range(7)


class Sighting:
    """A sighting of an object: measured place and variance (m^2, each way); a variance below 0: not seen."""

    NORTH, EAST, VARIANCE, SIZE = range(4)


class Message:
    """The first numbers of every message: place and velocity of its sender, as the sender measures them."""

    PLACE, VELOCITY = slice(0, 3), slice(3, 6)
    V_NORTH, SIZE = 3, 6


class SightingReport:
    """The last sighting of an object in a message: place, variance, AGE (s; below 0: not seen yet)."""

    NORTH, EAST, VARIANCE, AGE, SIZE = range(5)
