"""Routes of waypoints as tracks: geometry, the formats of three programs, and what no track can be made of."""

import json

import numpy as np
import pytest
import torch

from rl.guidance.course.route import Fence, Route, laid, read_route
from rl.missions import load_scenario
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.mission import Formation
from rl.missions.formation.worlds import generate_worlds
from taichi_sim.config import ConfigError

RADIUS = 12.0  # m
SURVEY = np.array([(0, 0), (300, 0), (300, 60), (0, 60), (0, 120), (300, 120), (340, -80)], float)  # north, east, m
CROSSED = np.array([(0, 0), (200, 200), (200, 0), (0, 200)], float)  # a figure of eight
HOME = (59.9, 10.7)  # deg


@pytest.mark.parametrize("points", [SURVEY, SURVEY[::-1], CROSSED], ids=["survey", "reversed", "crossed"])
def test_a_track_is_legs_and_arcs_that_meet_smoothly(points, tmp_path):
    tracks = laid(Route(points, np.full(len(points), np.nan), None), tmp_path / "a.csv", RADIUS, 3)
    place, course, curvature = (x.double().numpy() for x in tracks.rows[: tracks.samples + 1].split((2, 1, 1), dim=1))
    course, curvature = np.unwrap(course[:, 0]), curvature[:, 0]
    length = float(tracks.length_m[0])
    step = length / tracks.samples
    way = np.diff(place, axis=0)
    assert np.linalg.norm(way, axis=1) == pytest.approx(step, rel=step**2 / (24 * RADIUS**2) + 1e-4)
    middle = (course[1:] + course[:-1]) / 2
    assert np.abs(np.exp(1j * np.arctan2(way[:, 1], way[:, 0])) - np.exp(1j * middle)).max() < step / RADIUS / 2
    assert np.diff(course).sum() == pytest.approx(np.trapezoid(curvature, dx=step), abs=2 * len(points) * step / RADIUS)
    assert set(np.round(np.abs(curvature) * RADIUS, 4)) == {0.0, 1.0}
    leg = np.roll(points, -1, axis=0) - points
    toward = np.arctan2(leg[:, 1], leg[:, 0])
    turn = np.angle(np.exp(1j * np.diff(toward, prepend=toward[-1])))
    saved = (2 * RADIUS * np.tan(np.abs(turn) / 2) - RADIUS * np.abs(turn)).sum()
    assert length == pytest.approx(np.linalg.norm(leg, axis=1).sum() - saved, rel=1e-6)
    at = tracks.at(torch.zeros(len(points), dtype=torch.int64), tracks.checkpoint_s[0]).position.numpy()
    assert np.linalg.norm(at - points, axis=1) == pytest.approx(RADIUS * (1 / np.cos(turn / 2) - 1), abs=0.05)
    assert (tracks.table[0] == tracks.table[2]).all()


def plan(items: list[dict], home: tuple[float, float] = HOME, **fences: list[dict]) -> str:
    mission = {"items": items, "plannedHomePosition": [*home, 0.0]}
    return json.dumps({"fileType": "Plan", "geoFence": fences, "mission": mission})


def item(north: float, east: float, command: int = 16, frame: int = 3, height: float | None = 60.0) -> dict:
    """A waypoint near home, as QGroundControl writes it."""
    where = (HOME[0] + north / 111_420, HOME[1] + east / 55_970)
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": [0, 0, 0, None, *where, height]}


def survey(**changed: object) -> list[dict]:
    takeoff = item(0, 0, 22) | {"params": [15, 0, 0, None, 0, 0, 60]}
    lanes = {"type": "ComplexItem", "complexItemType": "survey",
             "TransectStyleComplexItem": {"Items": [item(*p, **changed) for p in SURVEY[2:]]}}  # fmt: skip
    camera = {"type": "SimpleItem", "command": 206, "frame": 2, "params": [0, 0, 0, 0, 0, 0, 0]}
    return [takeoff, item(*SURVEY[0]), camera, item(*SURVEY[1]), lanes, item(0, 0, 20, 2), item(5, 5)]


def waypoints() -> str:
    """The same as Mission Planner writes it."""
    lines = [f"0\t1\t0\t16\t0\t0\t0\t0\t{HOME[0]}\t{HOME[1]}\t12.0\t1"]
    for k, p in enumerate(SURVEY, 1):
        lat, lon = item(*p)["params"][4:6]
        lines.append(f"{k}\t0\t3\t16\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t60.0\t1")
    return "\n".join(["QGC WPL 110", *lines, ""])


def table() -> str:
    rows = [",".join(f"{x:.8f}" for x in item(*p)["params"][4:6]) for p in SURVEY]
    return "\n".join(["latitude [deg],longitude [deg]", *rows, ""])


FILES = {
    "a.plan": plan(survey()),
    "a.waypoints": waypoints(),
    "a.csv": table(),
    "m.csv": "\n".join(["north (m),east (m)", *(f"{n},{e}" for n, e in SURVEY), ""]),
}


@pytest.mark.parametrize("name", FILES)
def test_waypoints_are_read_from_the_files_of_other_programs(name, tmp_path):
    file = tmp_path / "a folder" / name
    file.parent.mkdir()
    file.write_text(FILES[name])
    route = read_route(file)
    wanted = SURVEY - (SURVEY.min(0) + SURVEY.max(0)) / 2
    assert route.place == pytest.approx(wanted, abs=0.5)
    assert (route.origin is None) == (name == "m.csv")
    assert np.isnan(route.height).all() == (name.endswith("csv"))


REFUSED = {
    "terrain": (plan(survey(frame=10)), "a.plan", "frame 10", "terrain"),
    "frames mixed": (plan(survey(frame=0)), "a.plan", "frame"),
    "jump": (plan([*survey()[:3], item(0, 0, 177)]), "a.plan", "177"),
    "loiter": (plan([item(0, 0, 17), *survey()]), "a.plan", "item 1", "command 17"),
    "another home": (plan(survey(), (47.4, 8.5)), "a.plan", "home", "km"),
    "no place": (plan([*survey()[:3], item(-59.9 * 111_420, -10.7 * 55_970)]), "a.plan", "0 0"),
    "no plan": ('{"fileType": "Plan"}', "a.plan", "cannot be read", "mission"),
    "two waypoints": ("north,east\n0,0\n100,0\n", "a.csv", "three waypoints"),
    "other columns": ("x,y\n0,0\n100,0\n", "a.csv", "latitude and longitude"),
    "short lines": ("QGC WPL 110\n0 1 0 16\n", "a.waypoints", "12 numbers"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_track_can_be_made_of_is_refused(case, tmp_path):
    text, name, *words = REFUSED[case]
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_route(file)
    assert all(word in str(error.value) for word in (str(file), *words))


def scenario(tmp_path, *changed: str) -> FormationScenario:
    file = tmp_path / "own.plan"
    file.write_text(FILES["a.plan"])
    few = ("track.worlds=2", "sea.realisations=2", "obstacles.count=4", "obstacles.moving_fraction=0")
    config = load_scenario("otter", overrides=[f"track.file={file}", "track.min_radius=12", *few, *changed])
    assert isinstance(config, FormationScenario)
    return config


def test_a_formation_follows_a_route(tmp_path):
    mission = Formation(scenario(tmp_path), 2, seed=0, teams=("usv",))
    assert mission.tracks.checkpoints.shape == (2, len(SURVEY), 2)
    mission.begin_each()
    off = mission.teams["usv"].target.position[:, :2]
    assert ((off[:, None] - mission.tracks.table[0, :, :2]).norm(dim=-1).amin(1) < 1.0).all()


@pytest.mark.parametrize(
    ("name", "height", "taken"), [("otter", 0.0, True), ("cruise", 0.0, False), ("cruise", None, True)]
)
def test_only_aircraft_that_act_mind_the_altitudes_of_a_route(name, height, taken, tmp_path):
    file = tmp_path / "own.plan"
    items = [item(*p, height=height if k else 100.0) for k, p in enumerate(3 * SURVEY)]  # one at the flight height
    file.write_text(plan(items))
    few = ("track.worlds=2", "obstacles.count=0", "track.min_radius=20", "area=2000", "track.flight_height=100")
    config = load_scenario(name, overrides=[f"track.file={file}", *few])
    assert isinstance(config, FormationScenario)
    if taken:
        generate_worlds(config, 0)
    else:
        with pytest.raises(ConfigError, match="altitudes are 0 to 100"):
            generate_worlds(config, 0)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (("track.min_radius=40",), ("own.plan", "track.min_radius = 40", "at most 30 m")),
        (("area=600",), ("area = 600",)),
    ],
)
def test_a_route_that_does_not_fit_is_refused(changed, words, tmp_path):
    with pytest.raises(ConfigError) as error:
        Formation(scenario(tmp_path, *changed), 2, seed=0, teams=("usv",))
    assert all(word in str(error.value) for word in words), str(error.value)


# -- geofences -----------------------------------------------------------------------------------------------------


def fence(corners, inclusion: bool = True) -> dict:
    return {"polygon": [item(*p)["params"][4:6] for p in corners], "inclusion": inclusion, "version": 1}


def circle(north: float, east: float, radius: float, inclusion: bool) -> dict:
    return {"circle": {"center": item(north, east)["params"][4:6], "radius": radius}, "inclusion": inclusion}


AROUND = [(-60, -140), (420, -140), (420, 180), (-60, 180)]  # of the survey, north, east, m


def test_the_clearance_of_a_fence_is_the_distance_to_its_nearest_side_or_corner():
    """Of an L, whose inner corner is at (2, 2)."""
    corners = torch.tensor([(0.0, 0.0), (6.0, 0.0), (6.0, 2.0), (2.0, 2.0), (2.0, 6.0), (0.0, 6.0)])
    place = torch.tensor([(1.0, 1.0), (5.5, 1.0), (3.0, 4.0), (1.0, 5.8), (-3.0, -4.0), (1.8, 1.8), (7.0, 1.0)])
    away = torch.tensor([1.0, 0.5, -1.0, 0.2, -5.0, 0.2 * 2**0.5, -1.0])
    for turned in (corners, corners.flip(0)):
        torch.testing.assert_close(Fence(turned, True).clearance(place), away)
        torch.testing.assert_close(Fence(turned, False).clearance(place), -away)


def test_geofences_of_a_plan_are_limits(tmp_path):
    """A boat that is put past a fence has left the area, one inside has not; so near an excluded circle."""
    text = plan(survey(), polygons=[fence(AROUND)], circles=[circle(150, 30, 20, False)])
    (tmp_path / "fenced.plan").write_text(text)
    config = scenario(tmp_path, f"track.file={tmp_path / 'fenced.plan'}", "usv.count=1", "usv.lost_distance=1000")
    mission = Formation(config, 4, seed=0, teams=("usv",))
    middle = (SURVEY.min(0) + SURVEY.max(0)) / 2
    place = torch.tensor([(-55.0, 0.0), (-65.0, 0.0), (150.0, 8.0), (150.0, 12.0)]) - torch.tensor(middle).float()
    mission.place("usv", torch.arange(4), place.unsqueeze(1), torch.zeros(4, 1))
    mission.measure_anew()
    assert mission.teams["usv"].endings()["left"].flatten().tolist() == [False, True, False, True]


@pytest.mark.parametrize(
    ("given", "which"),
    [({"polygon": fence([(p[0] / 2, p[1]) for p in AROUND])["polygon"]}, "geofence 1"),
     ({"polygons": [fence(AROUND), fence([(p[0] / 2, p[1]) for p in AROUND])]}, "geofence 2"),
     ({"polygons": [fence(AROUND)], "circles": [circle(300, 30, 15, False)]}, "geofence 2")],
)  # fmt: skip
def test_a_track_that_crosses_a_geofence_is_refused(given, which, tmp_path):
    (tmp_path / "fenced.plan").write_text(plan(survey(), **given))
    with pytest.raises(ConfigError, match=f"fenced.plan: the track.*crosses {which}"):
        Formation(scenario(tmp_path, f"track.file={tmp_path / 'fenced.plan'}"), 2, seed=0, teams=("usv",))
