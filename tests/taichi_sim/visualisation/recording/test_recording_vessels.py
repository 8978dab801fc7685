"""Boats drawn from their hulls, their loads, instruments and the water they float in."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
import torch
from numpy.typing import NDArray
from recorded import column, elevation, make_episode, rows

from rl.evaluation.episode_recording import events_of
from rl.mission import Endings
from taichi_sim.models.usv.hull.mesh import BoxHull, TwinPontoons, mesh
from taichi_sim.vehicle import Vehicle
from taichi_sim.visualisation.recording import Body, Episode, Force, Signal
from taichi_sim.visualisation.recording.arrows import newtons_per_metre, round_scale
from taichi_sim.visualisation.recording.bodies import above, below, body_mesh, lid, shell
from taichi_sim.visualisation.recording.palette import ALARM, GOOD
from taichi_sim.visualisation.recording.recorder import forces_of, signals_of
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.visualisation.recording.sea_patch import ROUND_M, Cadence, SeaGrid, SeaPatch
from taichi_sim.visualisation.recording.team_view import ABOVE_WATER, NEWEST, WAKE_OFF

BOX = BoxHull(length=4.0, beam=2.0, draft=0.5, freeboard=0.25, panels_along=4)
PONTOONS = TwinPontoons(y=0.4, freeboard=0.1, stations=((-1.0, 0.2, 0.1), (0.5, 0.3, 0.3), (1.0, 0.0, 0.2)))


def surface(hull: BoxHull | TwinPontoons) -> Body:
    """Two triangles per panel, outward."""
    p = mesh(hull)
    corners = np.stack([p.centre + s * p.along + t * p.up + s * t * p.twist for s, t in SIGNS], axis=1)
    inward = np.sum(np.cross(p.along, p.up) * p.area, axis=1) < 0
    corners[inward] = corners[inward, ::-1]
    first = 4 * np.arange(len(p))[:, None, None]
    return Body(corners.reshape(-1, 3), (first + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3))


SIGNS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def volume(faces: NDArray) -> float:
    """Of a closed surface [F, 3, 3], by Gauss's theorem."""
    return float(np.sum(np.cross(faces[:, 0], faces[:, 1]) * faces[:, 2]) / 6.0)


def area(faces: NDArray) -> float:
    return float(0.5 * np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1).sum())


def pontoons_volume() -> float:
    """Wedges: beam (keel + freeboard) / 2, both linear between stations, so Simpson's rule is exact."""
    x, beam, keel = np.array(PONTOONS.stations).T
    section = beam * (keel + PONTOONS.freeboard) / 2
    middle = 0.5 * (beam[:-1] + beam[1:]) * (0.5 * (keel[:-1] + keel[1:]) + PONTOONS.freeboard) / 2
    return 2.0 * float(np.sum(np.diff(x) / 6.0 * (section[:-1] + 4.0 * middle + section[1:])))


@pytest.mark.parametrize(("hull", "decks", "expected"), [(BOX, 1, 6.0), (PONTOONS, 2, pontoons_volume())])
def test_a_hull_with_its_decks_drawn_anew_is_closed(hull: BoxHull | TwinPontoons, decks: int, expected: float) -> None:
    sides, rims = shell(surface(hull))
    assert len(rims) == decks
    faces = np.concatenate([sides, *(lid(rim) for rim in rims)])
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-12)
    assert volume(faces) == pytest.approx(expected, rel=1e-9)
    assert volume(faces + [10.0, 5.0, 3.0]) == pytest.approx(expected, rel=1e-9)  # so all faces look outward


def test_paint_parts_a_hull_at_a_level() -> None:
    sides, _ = shell(surface(PONTOONS))
    over, under = above(sides, 0.03), below(sides, 0.03)
    assert over[..., 2].max() == pytest.approx(0.03)
    assert under[..., 2].min() == pytest.approx(0.03)
    assert area(over) + area(under) == pytest.approx(area(sides))


class Described:
    """A model that says everything of itself."""

    aux_names = ("lift", "rpm", "alpha")
    forces = {"lift": ((0.5, 0.0, 0.0), (None, None, "lift"))}
    signals = {"angles": ("rad", ("alpha",)), "engine": ("", ("rpm", "lift"))}

    def body(self) -> tuple[NDArray, NDArray]:
        return surface(BOX)


def test_a_model_is_read_as_it_describes_itself() -> None:
    model, aux = Described(), np.arange(24.0).reshape(4, 2, 3)
    lift = forces_of(model, aux)["lift"]
    assert lift.origin_b == (0.5, 0.0, 0.0)
    np.testing.assert_array_equal(lift.vector_b[3, 1], [0.0, 0.0, 21.0])
    signals = signals_of(model, aux)
    assert signals["angles"].unit == "rad"
    np.testing.assert_array_equal(signals["engine"].values[2, 1], [16.0, 15.0])


def test_a_model_need_not_describe_itself() -> None:
    model, aux = Vehicle(None, 0.02, 1), np.zeros((4, 2, 0))
    assert (forces_of(model, aux), signals_of(model, aux)) == ({}, {})


def test_a_column_that_is_not_there_is_named() -> None:
    model = SimpleNamespace(aux_names=("lift",), signals={"plot": ("N", ("drag",))})
    with pytest.raises(ValueError, match="'drag'"):
        signals_of(model, np.zeros((4, 2, 1)))


def boats() -> Episode:
    """Two boats of the test's pontoons, pushed, with one instrument, in current and wind."""
    episode = make_episode(2, ("usv",), steps=60)
    team = episode.teams["usv"]
    push = np.zeros((60, 2, 3))
    push[..., 0] = 30.0 + np.arange(60)[:, None]
    team = replace(
        team,
        body=surface(PONTOONS),
        forces={"thrust": Force((-0.8, 0.0, 0.1), push), "none": Force((0.0, 0.0, 0.0), 0.0 * push)},
        signals={"rudder angle": Signal(("rudder",), "rad", 0.01 * push[..., :1])},
    )
    flow = np.ones((60, 3)) * [1.0, -2.0, 0.0]
    return replace(episode, teams={"usv": team}, current_n=0.0 * flow[:, :2], wind_n=flow)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Episode, Path]:
    episode = boats()
    return episode, write_recording(episode, tmp_path_factory.mktemp("boats") / "boats.rrd")


def test_load_arrows_are_forces_at_the_scale_in_their_name(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    team = episode.teams["usv"]
    scale = newtons_per_metre(team)
    assert scale == 50.0  # 89 N at most over 1.5 lengths of 2 m is 29 N/m
    _, _, arrow = column(path, f"/world/usv/vehicle_1/forces_1m_is_{scale:g}N/thrust", "Arrows3D:vectors")
    np.testing.assert_allclose(arrow, team.forces["thrust"].vector_b[:, 1] / scale, rtol=1e-6)
    with pytest.raises(ValueError):  # nothing there: a force that never acts has no arrow
        column(path, f"/world/usv/vehicle_1/forces_1m_is_{scale:g}N/none", "Arrows3D:vectors")[2].max()


def test_wind_has_an_arrow_and_still_water_none(recorded: tuple[Episode, Path]) -> None:
    _, path = recorded
    # sqrt 5 m/s over 1.5 lengths of 2 m is 0.75 m/s per metre: 1
    _, _, arrow = column(path, "/world/usv/follow/wind_1m_is_1m_s", "Arrows3D:vectors")
    np.testing.assert_allclose(arrow, np.ones((60, 1)) * [-2.0, 1.0, 0.0])  # east, north, up
    _, _, flows = column(path, "/world/usv/follow/**", "Arrows3D:vectors")
    assert len(flows) == 60


def test_plots_show_instruments_in_degrees_and_the_boat_beside_its_wave(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    team = episode.teams["usv"]
    _, _, rudder = column(path, "/plots/signal/usv/rudder_angle/others", "Scalars:scalars")
    np.testing.assert_allclose(rudder, np.degrees(team.signals["rudder angle"].values[:, 1]))
    _, _, heave = column(path, "/plots/heave/usv/others", "Scalars:scalars")
    np.testing.assert_array_equal(heave, np.stack([-team.position_n[:, 1, 2], team.wave_height[:, 1]], axis=1))


def test_trails_and_rings_lie_on_the_water_of_the_moment(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    for name in ("trail", "water", "slot"):
        entity = "/world/usv/trails" if name == "trail" else f"/world/usv/{name}_1"
        _, _, strips = rows(path, entity, "LineStrips3D:strips")
        place = np.zeros((60, 3)) if name == "trail" else column(path, entity, "Transform3D:translation")[2]
        strips = [step[1:] for step in strips] if name == "trail" else strips
        for step in (0, 30, 59):
            points = np.array(strips[step]).reshape(-1, 3) + place[step]
            if step == 59 and name == "trail":
                points = points[-NEWEST:]  # the others move every 0.2 s
            above_wave = points[:, 2] - elevation(points[:, 1], points[:, 0], episode.time_s[step])
            rounding = 0.5 * ROUND_M + 1e-4
            if name == "trail":  # far behind, where it cannot be seen, higher, but never under the water
                assert above_wave.min() > ABOVE_WATER * 2.0 - rounding
                assert above_wave.max() < ABOVE_WATER * 2.0 + 2.0 * WAKE_OFF + rounding
                above_wave = above_wave[-NEWEST:]
            np.testing.assert_allclose(above_wave, ABOVE_WATER * 2.0, atol=rounding)


def test_a_trail_ends_at_the_boat_and_begins_where_it_was_put(recorded: tuple[Episode, Path], tmp_path: Path) -> None:
    episode, path = recorded
    team = episode.teams["usv"]
    _, _, strips = rows(path, "/world/usv/trails", "LineStrips3D:strips")
    trail = np.array(strips[59][1])
    np.testing.assert_allclose(trail[[0, -1], :2], team.position_n[[0, 59], 1][:, [1, 0]], rtol=1e-6)
    position = team.position_n + np.where(np.arange(60) < 32, 0.0, 50.0)[:, None, None]
    put = replace(episode, teams={"usv": replace(team, position_n=position)})
    _, _, strips = rows(write_recording(put, tmp_path / "put.rrd"), "/world/usv/trails", "LineStrips3D:strips")
    trail = np.array(strips[59][1])
    assert np.linalg.norm(np.diff(trail[:, :2], axis=0), axis=1).max() < 2.0
    np.testing.assert_allclose(trail[-1, :2], position[59, 1, [1, 0]], rtol=1e-6)


def test_the_body_is_the_hull_in_the_vehicles_own_frame() -> None:
    team = boats().teams["usv"]
    body = body_mesh(team, (213, 94, 0))
    x, y, z = body.vertices_b.T
    assert x.max() == pytest.approx(1.0)
    assert z.max() == pytest.approx(0.3)  # the keel: down is positive
    assert y.min() == pytest.approx(-y.max())
    assert z.min() < -0.1 - 0.2 * 2.0  # a mast


@pytest.mark.parametrize("length", [0.5, 2.0, 20.0])
def test_the_sea_has_neither_holes_nor_overlaps(length: float) -> None:
    episode = make_episode(2, ("usv",), steps=5)
    team = replace(episode.teams["usv"], size_m=(length, 0.5 * length, 0.3 * length))
    episode = replace(episode, teams={"usv": team})
    grid = SeaGrid.of(team)
    stream = Stream(rr.RecordingStream("none"))
    stream.part(episode.time_s)
    (frames,) = SeaPatch(episode, team).frames(stream, episode, team)
    corners = frames.vertices[-1][grid.triangles()].astype(np.float64)
    east, north = corners[..., 0], corners[..., 1]
    signed = 0.5 * ((east[:, 1] - east[:, 0]) * (north[:, 2] - north[:, 0]))
    signed -= 0.5 * ((east[:, 2] - east[:, 0]) * (north[:, 1] - north[:, 0]))
    assert signed.min() > 0.0
    side = np.ptp(frames.vertices[-1][:, 0].astype(np.float64))
    assert signed.sum() == pytest.approx(side**2, rel=1e-5)
    assert np.array_equal(np.unique(grid.triangles()), np.arange(len(frames.vertices[-1])))  # no point is idle
    # no crack: each edge is that of two triangles, which run along it in opposite directions, but for the outer border
    edges = np.concatenate([grid.triangles()[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]).astype(int)
    once = {tuple(edge) for edge in edges.tolist()}
    assert len(once) == len(edges)
    assert sum((b, a) not in once for a, b in once) == 4 * grid.cells


def test_the_sea_keeps_up_with_the_boats() -> None:
    for step, stride, whole in ((0.1, 1, 2), (0.2, 1, 2), (0.02, 5, 2), (0.5, 1, 1)):
        assert Cadence.of(step * np.arange(50)) == (stride, whole)
    assert Cadence.of(0.1 * np.arange(36_000), most=1200) == (30, 1)


@pytest.mark.parametrize("value", [0.013, 1.0, 1.9, 5.0, 5.1, 740.0])
def test_scales_are_round_and_hold_the_arrow(value: float) -> None:
    scale = round_scale(value)
    assert value * (1 - 1e-9) <= scale <= 2.5 * value
    assert f"{scale:.6e}"[0] in "125"
    assert float(f"{scale:.0e}") == pytest.approx(scale)


def test_events_are_whatever_reasons_the_endings_have_and_goals_what_the_judge_says() -> None:
    ended = Endings({"swamped": torch.tensor([[False, True]]), "moored": torch.tensor([[True, False]])})
    seen: set[tuple[str, int, str]] = set()
    step = SimpleNamespace(endings={"usv": ended})
    events = events_of(step, 0.1, seen, ("moored",), 0)  # pyright: ignore
    assert [(event.kind, event.vehicle, event.time_s) for event in events] == [("swamped", 1, 0.1), ("moored", 0, 0.1)]
    assert [event.goal for event in events] == [False, True]
    assert [event.colour for event in events] == [ALARM, GOOD]
    assert not events_of(step, 0.2, seen, (), 0)  # pyright: ignore


def test_loads_of_the_wrong_shape_are_refused() -> None:
    team = boats().teams["usv"]
    with pytest.raises(ValueError, match="force thrust"):
        replace(team, forces={"thrust": Force((0.0, 0.0, 0.0), np.zeros((60, 3, 3)))})
    with pytest.raises(ValueError, match="signal rudder"):
        replace(team, signals={"rudder": Signal(("a", "b"), "rad", np.zeros((60, 2, 1)))})
