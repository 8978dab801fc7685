"""Drawings of encounters in recordings: hulls in the colours of their roles, safety domains, tracks as known, the
route.
"""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.missions.encounter.bodies import Body, Track
from rl.missions.encounter.pairs import Pair, Pairs, Role
from rl.missions.encounter.team import OwnShips
from taichi_sim.visualisation.recording.overlays import Arrows, Ellipsoids, Lines, Overlay, Plot, Points

COLOURS = {
    Role.NONE: ("others", (150, 165, 180)), Role.HEAD_ON: ("head-on", (230, 80, 70)),
    Role.GIVE_WAY: ("give way", (240, 160, 40)), Role.STAND_ON: ("stand on", (70, 170, 90)),
    Role.OVERTAKING: ("overtaking", (190, 120, 220)), Role.OVERTAKEN: ("overtaken", (90, 160, 230)),
}  # fmt: skip
HULLS, OFFSETS = "hulls/", "offsets and gap"  # names of drawings
DOMAIN, KNOWN, ROUTE = (235, 220, 160), (250, 120, 220), (120, 200, 255)
VECTOR = 30.0  # s that a velocity is drawn for
CORNERS = np.array([[0.5, 0.0], [0.3, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.3, -0.5], [0.5, 0.0]])  # of an outline


def outlines(bodies: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outlines [body, corner, 3] (m, NED) of bodies [body, Body]."""
    ahead, aside = CORNERS[:, 0] * bodies[:, Body.LENGTH, None], CORNERS[:, 1] * bodies[:, Body.BEAM, None]
    c, s = bodies[:, Body.COS, None], bodies[:, Body.SIN, None]
    north, east = bodies[:, Body.NORTH, None], bodies[:, Body.EAST, None]
    return np.stack((north + c * ahead - s * aside, east + s * ahead + c * aside, np.zeros_like(ahead)), axis=-1)


def overlays_of(teams: OwnShips, bodies: Tensor, pairs: Pairs, route: Tensor, env: int) -> tuple[Overlay, ...]:
    """All drawings of environment `env` now, of one frame each."""
    count, part = teams.fleet.count, teams.part
    now = bodies[env].double().cpu().numpy()
    role = pairs.of(Pair.ROLE)[env, 0].cpu().numpy()
    drawn: list[Overlay] = []
    hulls = outlines(now)
    for code, (name, colour) in COLOURS.items():
        shown = np.where((role == int(code))[:, None, None], hulls, np.nan)[count:]
        drawn.append(Lines(name=f"{HULLS}{name}", colour=colour, points_n=shown[None], radius=-2.0))
    flat = np.zeros((1, len(now), 3))
    place, velocity = flat.copy(), flat.copy()
    place[0, :, :2], velocity[0, :, :2] = now[:, : Body.V_NORTH], VECTOR * now[:, Body.V_NORTH : Body.COS]
    name = f"velocity times {VECTOR:.0f} s"
    drawn.append(Arrows(name=name, colour=(210, 215, 225), origin_n=place, vector_n=velocity))
    domain = np.stack((now[:, Body.LENGTH] / 2 + part.clear, now[:, Body.BEAM] / 2 + part.clear, np.ones(len(now))), -1)
    heading = np.arctan2(now[:, Body.SIN], now[:, Body.COS])
    drawn.append(Ellipsoids(name="safety domains", colour=DOMAIN, position_n=place[:, count:],
                            half_axes_m=domain[None, count:], heading=heading[None, count:]))  # fmt: skip
    tracks = teams.tracks[env, 0].double().cpu().numpy()
    known = np.zeros((1, len(tracks), 3))
    known[0, :, :2] = np.where((tracks[:, Track.AGE] >= 0)[:, None], tracks[:, : Track.V_NORTH], np.nan)
    drawn.append(Points(name="tracks", colour=KNOWN, position_n=known))
    begun = route[env].double().cpu().numpy()
    way = np.array([0.0, 2 * part.speed * part.tcpa[1]])
    line = np.zeros((1, count, 2, 3))
    line[0, ..., 0] = begun[:, :1] + way * np.cos(begun[:, 2:])
    line[0, ..., 1] = begun[:, 1:2] + way * np.sin(begun[:, 2:])
    drawn.append(Lines(name="route", colour=ROUTE, points_n=line, radius=-1.0, where="map"))
    gap = min(float(pairs.gap[env, 0]), part.corridor)
    values = np.array([[np.degrees(float(teams.offsets[env, 0, 0])), gap]])
    drawn.append(Plot(name=OFFSETS, unit="", lines=("offset of course, deg", "gap, m"), values=values))
    return tuple(drawn)
