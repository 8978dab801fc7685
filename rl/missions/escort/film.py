"""Overlays of an escort's recording: sightings, messages, and knowledge of the vessel.

They show footprints of the cameras on the sea, sight lines to the objects found, messages as arcs (lost ones in red),
the vessel as each team believes it to be with its uncertainty, the circle, and a plot of the age of the tracks.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rl.course.traffic import BOTTOM, EAST, NORTH, RADIUS, TOP
from rl.perception.camera import LOOK_VARIANCE
from taichi_sim.recording.overlays import Cylinders, Ellipsoids, Lines, Plot

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

TRAFFIC, FOOTPRINT, SIGHT, MESSAGE, LOST, BELIEVED, CIRCLE = (
    (196, 120, 40), (255, 214, 90), (255, 230, 140), (90, 200, 120), (225, 60, 60), (250, 120, 220), (150, 170, 190)
)  # fmt: skip
RAYS, CROWDED = 20, 0.6  # corners of a footprint; how much they crowd at its far end
FLATTEST = 0.05  # least slope of a ray that is drawn
FARTHEST = 1500.0  # m, greatest distance of a footprint's corner
ARC, HIGH = 7, 0.18  # points of an arc; its height divided by its length
ROUND = np.linspace(0.0, 2 * math.pi, 49)


class EscortFilm:
    """Collects frames of the shown environment and makes overlays of them."""

    def __init__(self, mission: "Escort"):
        """Collect from now on."""
        self.mission = mission
        self._frames: list[dict[str, NDArray]] = []

    def take(self) -> None:
        """Collect a frame."""
        mission, env = self.mission, self.mission.shown
        picture, radio = mission.picture, mission.picture.radio
        age = radio.heard[env, ..., -1].cpu().numpy()
        due, fresh = radio.due(int(mission.steps[env])), radio.delay + 1e-3
        flying = mission.flying
        frame = {
            "place": picture.place[env], "things": picture.things[env], "looks": picture.looks[env],
            "targets": picture.targets[env], "sigma": picture.sigma[env], "age": picture.age[env],
            "vessel": mission.vessel_place[env], "bodies": mission.bodies.table[env],
        }  # fmt: skip
        if flying is not None:
            frame |= {"axis": flying.camera.axis[env], "R": flying.camera.true.R_nb[env]}
        taken = {name: value.cpu().numpy().astype(np.float64) for name, value in frame.items()}
        self._frames.append(taken | {"arrived": due & (age <= fresh), "lost": due & (age > fresh)})

    def overlays(self) -> tuple[Any, ...]:
        """The overlays of all frames."""
        if not self._frames:
            return ()
        film = {name: np.stack([frame[name] for frame in self._frames]) for name in self._frames[0]}
        mission = self.mission
        found: list[Any] = [self._traffic(film["bodies"]), *self._messages(film), *self._believed(film)]
        if mission.flying is not None:
            found += [self._footprints(film), self._sights(film), self._circle(film["vessel"])]
        names = tuple(f"{name}{k}" for name, g in mission.picture.groups.items() for k in range(g.own.state.shape[1]))
        age = np.minimum(film["age"], 60.0)
        found.append(Plot(name="age of the track of the vessel", unit="s", lines=names, values=age))
        return tuple(found)

    def _traffic(self, bodies: NDArray[np.float64]) -> Cylinders:
        film = bodies[:, :, 1:]
        place = np.stack((film[:, NORTH], film[:, EAST], -0.5 * (film[:, BOTTOM] + film[:, TOP])), axis=-1)
        place[np.abs(place[..., 0]) > self.mission.config.area] = np.nan
        size = np.stack((film[:, RADIUS], film[:, TOP] - film[:, BOTTOM]), axis=-1)
        return Cylinders(name="traffic", colour=TRAFFIC, position_n=place, size_m=size)

    def _messages(self, film: dict[str, NDArray[np.float64]]) -> list[Lines]:
        """Arcs from each aircraft to each boat."""
        groups, parts = self.mission.picture.groups, self.mission.config.escort
        if parts.boats not in groups or parts.aircraft not in groups:
            return []
        to, of = groups[parts.boats], groups[parts.aircraft]
        boats = range(to.first, to.first + to.own.state.shape[1])
        aircraft = range(of.first, of.first + of.own.state.shape[1])
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
        """Ellipsoids of one standard deviation around the vessel as each team's first vehicle knows it; at least 1 m
        wide.
        """
        found = []
        for name, g in self.mission.picture.groups.items():
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
        """Where the edges of each field of view meet mean sea level."""
        flying = self.mission.flying
        g = self.mission.picture.groups[flying.name]
        place = film["place"][:, g.first : g.first + g.own.state.shape[1]]
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
        """Lines from each camera to the objects that it has found."""
        g = self.mission.picture.groups[self.mission.flying.name]
        seen = film["looks"][:, g.first : g.first + g.own.state.shape[1], :, LOOK_VARIANCE] > 0
        place = film["place"][:, g.first : g.first + g.own.state.shape[1], None]
        place, things = np.broadcast_arrays(place, film["things"][:, None, :, :3])
        lines = np.stack((place, things), axis=-2)
        lines = np.where(seen[..., None, None], lines, np.nan)
        flat = lines.reshape(len(lines), -1, 2, 3)
        return Lines(name="sight lines", colour=SIGHT, points_n=flat, radius=-0.6, where="world")

    def _circle(self, vessel: NDArray[np.float64]) -> Lines:
        """The circle about the vessel, at the height of the first aircraft."""
        orbit = self.mission.flying.orbit
        points = np.empty((len(vessel), 1, len(ROUND), 3))
        points[..., 0] = vessel[:, None, None, 0] + orbit.radius * np.cos(ROUND)
        points[..., 1] = vessel[:, None, None, 1] + orbit.radius * np.sin(ROUND)
        points[..., 2] = -orbit.height
        return Lines(name="circle", colour=CIRCLE, points_n=points, radius=-0.6)
