"""Drawings of an escort in recordings: sightings, messages, estimates of the vessel.

They are footprints of the cameras on the sea, sight lines to the sighted objects, messages as arcs (lost ones in red),
each team's estimate of the vessel with its uncertainty, the circle of the aircraft, and a plot of the age of the last
news of the vessel.
"""

import math
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from rl.guidance.targets_and_errors import COURSE, DOWN, NORTH
from rl.missions.escort.aircraft import EscortAircraft, Scouts
from rl.missions.escort.config import EscortConfig, OrbitConfig
from rl.missions.escort.host import EscortHost
from rl.missions.escort.tracking import ObserverGroup, SharedTracking
from rl.perception.sightings import Sighting
from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.visualisation.recording.overlays import Ellipsoids, Lines, Overlay, Plot

Frames = Mapping[str, NDArray[np.float64]]
"""Data of the drawings: name -> [frame, ...]."""

FOOTPRINT, SIGHT, MESSAGE, LOST, BELIEVED, CIRCLE = (
    (255, 214, 90), (255, 230, 140), (90, 200, 120), (225, 60, 60), (250, 120, 220), (150, 170, 190)
)  # fmt: skip
RAYS, CROWDED = 20, 0.6  # corners of a footprint; how much they crowd at its far end
FLATTEST = 0.05  # least slope of a ray that is drawn
FARTHEST = 1500.0  # m, greatest distance of a footprint's corner
ARC, HIGH = 7, 0.18  # points of an arc; its height divided by its length
ROUND = np.linspace(0.0, 2 * math.pi, 49)


def overlays_of(
    mission: EscortHost, tracking: SharedTracking, flying: EscortAircraft | Scouts | None, env: int
) -> tuple[Overlay, ...]:
    """All drawings of environment `env` now, of one frame each."""
    radio = tracking.radio
    age = radio.heard[env, ..., -1].cpu().numpy()
    due, fresh = radio.due(int(mission.steps[env])), radio.delay + 1e-3
    now = {
        "place": tracking.place[env], "objects": tracking.objects[env], "sightings": tracking.sightings[env],
        "targets": tracking.targets[env], "sigma": tracking.sigma[env], "age": tracking.age[env],
        "vessel": mission.vessel_place[env],
    }  # fmt: skip
    if flying is not None:
        now |= {"axis": flying.camera.axis[env], "R": flying.camera.true.R_nb[env]}
    now |= {"arrived": torch.from_numpy(due & (age <= fresh)), "lost": torch.from_numpy(due & (age > fresh))}
    frame = {name: value.cpu().numpy().astype(np.float64)[None] for name, value in now.items()}
    drawn: list[Overlay] = [*mission.traffic.cylinders(env, mission.config.area)]
    drawn += [*_messages(tracking.groups, mission.config.escort, frame), *_believed(tracking.groups, frame)]
    if flying is not None:
        drawn += [_footprints(frame, flying, tracking.groups[flying.name].rows)]
        drawn += [_sights(frame, tracking.groups[flying.name].rows), _circle(frame["vessel"], flying.orbit)]
    names = tuple(f"{name}{k}" for name, g in tracking.groups.items() for k in range(g.count))
    age = np.minimum(frame["age"], 60.0)
    return (*drawn, Plot(name="age of the track of the vessel", unit="s", lines=names, values=age))


def _messages(groups: Mapping[str, ObserverGroup], parts: EscortConfig, film: Frames) -> list[Lines]:
    """Messages from each aircraft to each boat."""
    if parts.boats not in groups or parts.aircraft not in groups:
        return []
    to, of = groups[parts.boats], groups[parts.aircraft]
    boats = range(to.first, to.first + to.count)
    aircraft = range(of.first, of.first + of.count)
    share = np.linspace(0.0, 1.0, ARC)[:, None]
    arcs, flags = [], {"arrived": [], "lost": []}
    for i in boats:
        for k in aircraft:
            a, b = film["place"][:, k, None], film["place"][:, i, None]
            arc = (1 - share) * a + share * b
            high = HIGH * np.linalg.norm(b - a, axis=-1) * 4 * (share * (1 - share))[:, 0]
            arc[..., DOWN] -= high
            arcs.append(arc)
            for name, of_all in flags.items():
                of_all.append(film[name][:, i, k].astype(bool))
    points = np.stack(arcs, axis=1)
    found = []
    for name, colour in (("arrived", MESSAGE), ("lost", LOST)):
        shown = np.stack(flags[name], axis=1)
        drawn = np.where(shown[:, :, None, None], points, np.nan)
        found.append(Lines(name=f"messages/{name}", colour=colour, points_n=drawn, radius=-1.0, where="world"))
    return found


def _believed(groups: Mapping[str, ObserverGroup], film: Frames) -> list[Ellipsoids]:
    """Estimates of the vessel by the first of each team: one standard deviation, drawn at least a metre large."""
    found = []
    for name, g in groups.items():
        at = film["targets"][:, g.first : g.first + 1]
        place = at[..., NORTH : DOWN + 1]
        sigma = np.clip(film["sigma"][:, g.first : g.first + 1], 1.0, 200.0)
        axes = np.stack((sigma, sigma, np.full_like(sigma, 0.5)), axis=-1)
        found.append(
            Ellipsoids(
                name=f"vessel by {name}0", colour=BELIEVED, position_n=place, half_axes_m=axes, heading=at[..., COURSE]
            )
        )
    return found


def _footprints(film: Frames, flying: EscortAircraft | Scouts, rows: slice) -> Lines:
    """Edges of the fields of view on mean sea level."""
    place = film["place"][:, rows]
    axis = np.einsum("fvij,fvj->fvi", film["R"], film["axis"])
    half = math.radians(flying.camera.config.field_of_view_deg / 2)
    aside = np.cross(axis, np.array([0.0, 0.0, 1.0]))
    small = np.linalg.norm(aside, axis=-1, keepdims=True)
    aside = np.where(small > 1e-3, aside / np.maximum(small, 1e-3), np.array([1.0, 0.0, 0.0]))
    up = np.cross(aside, axis)
    turn = np.linspace(0.0, 2 * math.pi, RAYS + 1)
    turn -= CROWDED * np.cos(turn)
    around = np.cos(turn)[:, None] * aside[..., None, :] + np.sin(turn)[:, None] * up[..., None, :]
    rays = math.cos(half) * axis[..., None, :] + math.sin(half) * around
    far = -place[..., None, DOWN] / np.maximum(rays[..., DOWN], FLATTEST)
    points = place[..., None, :] + np.minimum(far, FARTHEST)[..., None] * rays
    points[..., DOWN] = 0.0
    points[rays[..., DOWN] < FLATTEST] = np.nan
    return Lines(name="footprints", colour=FOOTPRINT, points_n=points, radius=-1.2, on_water=True)


def _sights(film: Frames, rows: slice) -> Lines:
    """Lines from each camera to the objects of its last sighting."""
    seen = film["sightings"][:, rows, :, Sighting.VARIANCE] > 0
    place = film["place"][:, rows, None]
    place, objects = np.broadcast_arrays(place, film["objects"][:, None, :, :3])
    lines = np.stack((place, objects), axis=-2)
    lines = np.where(seen[..., None, None], lines, np.nan)
    flat = lines.reshape(len(lines), -1, 2, 3)
    return Lines(name="sight lines", colour=SIGHT, points_n=flat, radius=-0.6, where="world")


def _circle(vessel: NDArray[np.float64], orbit: OrbitConfig) -> Lines:
    """The circle about the vessel, at the height of the first aircraft."""
    round_it = orbit.radius * np.stack((np.cos(ROUND), np.sin(ROUND)), axis=-1)
    points = np.full((len(vessel), 1, len(ROUND), 3), -orbit.height)
    points[..., HORIZONTAL] = vessel[:, None, None, HORIZONTAL] + round_it
    return Lines(name="circle", colour=CIRCLE, points_n=points, radius=-0.6)
