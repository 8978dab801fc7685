"""Chooses the mesh of a vehicle: its model's own surface, else a boat or an aircraft of its size."""

import numpy as np

from taichi_sim.recording.aircraft import aircraft
from taichi_sim.recording.episode import Body, TeamTrack
from taichi_sim.recording.meshes import KEEL, METAL, Mesh, boat
from taichi_sim.recording.palette import Colour
from taichi_sim.recording.vessel import flat_shaded, normals, vessel

LEVEL = 0.5  # least vertical component of the normal of a face that is visible from above or below


def body_mesh(team: TeamTrack, colour: Colour) -> Mesh:
    """Mesh of a vehicle of `team`, in its colour."""
    if team.body is None:
        return boat(team.size_m, colour) if team.on_water else aircraft(team.size_m, team.airframe, colour)
    return vessel(team.body, team.size_m, colour, team.deck) if team.on_water else _flown(team.body, colour)


def _flown(body: Body, colour: Colour) -> Mesh:
    """Mesh of an aircraft's surface, in its colour from above and dark from below, so that a bank is visible from
    either side.
    """
    faces = np.asarray(body.vertices_b, dtype=np.float64)[body.triangles]
    down = normals(faces)[:, 2]
    over, under = down < -LEVEL, down > LEVEL
    shades = ((over, colour), (under, KEEL), (~(over | under), METAL))
    return Mesh.join(*(flat_shaded(faces[which], shade) for which, shade in shades))
