"""What a recording shows of an escort beside the vehicles: who sees and tells what, and what is made of it.

Footprints of the cameras on the sea, sight lines to what they have found, messages as arcs (lost ones in red), the
vessel where each team believes it to be, with its uncertainty, the circle and the aircraft's phases on it, and the age
of what is known as a plot.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rl.course.traffic import BOTTOM, EAST, NORTH, RADIUS, TOP
from rl.perception.camera import LOOK_VARIANCE
from taichi_sim.recording.overlays import Cylinders, Ellipsoids, Lines, Plot

TRAFFIC, FOOTPRINT, SIGHT, MESSAGE, LOST, BELIEVED, CIRCLE = (
    (196, 120, 40), (255, 214, 90), (255, 230, 140), (90, 200, 120), (225, 60, 60), (250, 120, 220), (150, 170, 190)
)  # fmt: skip
RAYS, CROWDED = 20, 0.6  # corners of a footprint, and how much they crowd where it is far away, and so most stretched
FLATTEST = 0.05  # slope of a ray, below which it meets the sea nowhere near
FARTHEST = 1500.0  # m, of a footprint's corner from the aircraft
ARC, HIGH = 7, 0.18  # points of an arc; its height over its length
ROUND = np.linspace(0.0, 2 * math.pi, 49)


class Film:
    """Frames of the environment that is shown, one each time `take` is called."""

    def __init__(self, mission: Any):
        """Of `mission`, from now on."""
        self.mission = mission
        self._frames: list[dict[str, NDArray[np.float64]]] = []

    def take(self) -> None:
        """Keep what there is now."""
        mission, env = self.mission, self.mission.shown
        tracking, radio = mission.tracking, mission.tracking.radio
        age = radio.heard[env, ..., -1].cpu().numpy()
        due, fresh = radio.due(int(mission.steps[env])), radio.delay + 1e-3
        flying = mission.flying
        frame = {
            "place": tracking.place[env], "objects": tracking.objects[env], "sightings": tracking.sightings[env],
            "targets": tracking.targets[env], "sigma": tracking.sigma[env], "age": tracking.age[env],
            "vessel": mission.vessel_place[env], "bodies": mission.bodies.table[env],
        }  # fmt: skip
        if flying is not None:
            frame |= {"axis": flying.camera.axis[env], "R": flying.camera.true.R_nb[env]}
        taken = {name: value.cpu().numpy().astype(np.float64) for name, value in frame.items()}
        self._frames.append(taken | {"arrived": due & (age <= fresh), "lost": due & (age > fresh)})

    def overlays(self) -> tuple[Any, ...]:
        """All of it."""
        if not self._frames:
            return ()
        film = {name: np.stack([frame[name] for frame in self._frames]) for name in self._frames[0]}
        mission = self.mission
        found: list[Any] = [self._traffic(film["bodies"]), *self._messages(film), *self._believed(film)]
        if mission.flying is not None:
            found += [self._footprints(film), self._sights(film), self._circle(film["vessel"])]
        names = tuple(f"{name}{k}" for name, g in mission.tracking.groups.items() for k in range(g.count))
        age = np.minimum(film["age"], 60.0)
        found.append(Plot(name="age of what is known of the vessel", unit="s", lines=names, values=age))
        return tuple(found)

    def _traffic(self, bodies: NDArray[np.float64]) -> Cylinders:
        film = bodies[:, :, 1:]
        place = np.stack((film[:, NORTH], film[:, EAST], -0.5 * (film[:, BOTTOM] + film[:, TOP])), axis=-1)
        place[np.abs(place[..., 0]) > self.mission.config.area] = np.nan
        size = np.stack((film[:, RADIUS], film[:, TOP] - film[:, BOTTOM]), axis=-1)
        return Cylinders(name="traffic", colour=TRAFFIC, position_n=place, size_m=size)

    def _messages(self, film: dict[str, NDArray[np.float64]]) -> list[Lines]:
        """From each aircraft to each boat."""
        groups, parts = self.mission.tracking.groups, self.mission.config.escort
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
                arc[..., 2] -= high
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

    def _believed(self, film: dict[str, NDArray[np.float64]]) -> list[Ellipsoids]:
        """By the first of each team: one standard deviation, at least a metre to be seen."""
        found = []
        for name, g in self.mission.tracking.groups.items():
            at = film["targets"][:, g.first : g.first + 1]
            place = np.stack((at[..., 0], at[..., 1], np.zeros_like(at[..., 0])), axis=-1)
            sigma = np.clip(film["sigma"][:, g.first : g.first + 1], 1.0, 200.0)
            axes = np.stack((sigma, sigma, np.full_like(sigma, 0.5)), axis=-1)
            found.append(
                Ellipsoids(
                    name=f"vessel by {name}0", colour=BELIEVED, position_n=place, half_axes_m=axes, heading=at[..., 3]
                )
            )
        return found

    def _footprints(self, film: dict[str, NDArray[np.float64]]) -> Lines:
        """Where the edge of each field of view meets mean sea level."""
        flying = self.mission.flying
        g = self.mission.tracking.groups[flying.name]
        place = film["place"][:, g.rows]
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
        far = -place[..., None, 2] / np.maximum(rays[..., 2], FLATTEST)
        points = place[..., None, :] + np.minimum(far, FARTHEST)[..., None] * rays
        points[..., 2] = 0.0
        points[rays[..., 2] < FLATTEST] = np.nan
        return Lines(name="footprints", colour=FOOTPRINT, points_n=points, radius=-1.2, on_water=True)

    def _sights(self, film: dict[str, NDArray[np.float64]]) -> Lines:
        """From each camera to what it has found in this look."""
        g = self.mission.tracking.groups[self.mission.flying.name]
        seen = film["sightings"][:, g.rows, :, LOOK_VARIANCE] > 0
        place = film["place"][:, g.rows, None]
        place, objects = np.broadcast_arrays(place, film["objects"][:, None, :, :3])
        lines = np.stack((place, objects), axis=-2)
        lines = np.where(seen[..., None, None], lines, np.nan)
        flat = lines.reshape(len(lines), -1, 2, 3)
        return Lines(name="sight lines", colour=SIGHT, points_n=flat, radius=-0.6, where="world")

    def _circle(self, vessel: NDArray[np.float64]) -> Lines:
        """About the vessel, at the height of the first aircraft."""
        orbit = self.mission.flying.orbit
        points = np.empty((len(vessel), 1, len(ROUND), 3))
        points[..., 0] = vessel[:, None, None, 0] + orbit.radius * np.cos(ROUND)
        points[..., 1] = vessel[:, None, None, 1] + orbit.radius * np.sin(ROUND)
        points[..., 2] = -orbit.height
        return Lines(name="circle", colour=CIRCLE, points_n=points, radius=-0.6)
