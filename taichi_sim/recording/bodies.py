"""The body drawn for a vehicle: the model's own where it has one, else a boat or an aircraft of its size."""

import numpy as np

from taichi_sim.recording.aircraft import aircraft
from taichi_sim.recording.episode import Body, TeamTrack
from taichi_sim.recording.meshes import Mesh, boat
from taichi_sim.recording.palette import Colour
from taichi_sim.recording.vessel import flat_shaded, vessel


def body_mesh(team: TeamTrack, colour: Colour) -> Mesh:
    """The body of a vehicle of `team`, in its colour."""
    if team.body is None:
        return boat(team.size_m, colour) if team.on_water else aircraft(team.size_m, team.airframe, colour)
    return vessel(team.body, team.size_m, colour) if team.on_water else _plain(team.body, colour)


def _plain(body: Body, colour: Colour) -> Mesh:
    """A surface as it is, in one colour."""
    return flat_shaded(np.asarray(body.vertices_b, dtype=np.float64)[body.triangles], colour)
