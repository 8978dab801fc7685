"""Aircraft in a recording: their shape, their velocities through the air, the view that follows, how a flight ends."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from recorded import column, elevation, make_episode, rows

from rl.evaluation.episode_log import EVENTS
from rl.evaluation.episode_recording import _stalls, record_episode
from rl.missions import load_scenario
from rl.missions.formation.mission import TeamTask
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.uav.aircraft import Aircraft
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.visualisation.recording import Airframe, Episode
from taichi_sim.visualisation.recording.arrows import metres_per_second_per_metre
from taichi_sim.visualisation.recording.bodies import aircraft
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.visualisation.recording.sea_patch import SeaGrid
from taichi_sim.visualisation.recording.team_view import smooth_course

SIZE, CHORD = (1.7, 2.9, 0.6), 0.19
STEPS = 40
GREY = (128, 128, 128)


@pytest.mark.parametrize("tail", [True, False])
def test_an_aircraft_has_the_proportions_it_is_given(tail: bool) -> None:
    x, y, z = aircraft(SIZE, Airframe(CHORD, tail), GREY).vertices_b.T
    assert np.ptp(y) == pytest.approx(SIZE[1], rel=0.02)  # winglets have a thickness
    assert y.max() == pytest.approx(-y.min())
    assert -z.min() > 0.8 * (SIZE[2] - 0.1 * SIZE[0])  # fin or winglet, upward
    assert np.ptp(x) == pytest.approx(SIZE[0], rel=1e-6 if tail else 0.1)  # a wing has a propeller behind
    panel = np.abs(np.abs(y) - 0.35 * SIZE[1]) < 1e-6  # where the panels meet the tips
    assert np.ptp(x[panel]) == pytest.approx(CHORD, rel=0.1)


def test_only_an_airplane_has_anything_behind_its_wing() -> None:
    def tail_span(tail: bool) -> float:
        x, y, _ = aircraft((3.0 * CHORD, SIZE[1], SIZE[2]), Airframe(CHORD, tail), GREY).vertices_b.T
        return float(np.ptp(y[x < x.min() + 0.05 * CHORD]))

    assert tail_span(True) < 0.4 * SIZE[1]  # a tailplane
    assert tail_span(False) > 0.9 * SIZE[1]  # the swept tips themselves


@pytest.fixture(scope="module")
def taichi() -> None:
    runtime.init(threads=1)


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(("name", "tail"), [("aerosonde", True), ("zagi", False)])
def test_fixed_wings_say_what_they_look_like(name: str, tail: bool) -> None:
    model = load_vehicle(name)
    assert model.airframe == (model.params.physical.c, tail)


def aloft() -> Episode:
    """Two aircraft on a circle, in wind that changes."""
    episode = make_episode(2, ("uav",), steps=STEPS)
    air = np.stack([3.0 + 0.1 * np.arange(STEPS), -2.0 * np.ones(STEPS), 0.5 * np.ones(STEPS)], axis=-1)
    team = replace(episode.teams["uav"], air_n=np.repeat(air[:, None], 2, axis=1))
    return replace(episode, teams={"uav": team}, wind_n=air)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Episode, Path]:
    episode = aloft()
    return episode, write_recording(episode, tmp_path_factory.mktemp("aloft") / "aloft.rrd")


def test_the_wind_closes_the_triangle_of_velocities(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    team = episode.teams["uav"]
    scale = metres_per_second_per_metre(team)
    root = f"/world/uav/velocity_1m_is_{scale:g}m_s"
    tip = {}
    for name in ("airspeed", "wind", "ground_speed"):
        vector = column(path, f"{root}/{name}", "Arrows3D:vectors")[2][:, 3:]  # of the second
        tip[name] = column(path, f"{root}/{name}", "Arrows3D:origins")[2][:, 3:] + vector
    np.testing.assert_allclose(tip["wind"], tip["ground_speed"], atol=1e-5)
    north, east, down = (team.position_n + team.velocity_n / scale)[:, 1].T
    np.testing.assert_allclose(tip["ground_speed"], np.stack([east, north, -down], axis=1), atol=1e-4)
    foot = column(path, f"{root}/wind", "Arrows3D:origins")[2][:, 3:]
    np.testing.assert_allclose(foot, tip["airspeed"], atol=1e-5)
    blows = (tip["wind"] - foot) * scale
    assert team.air_n is not None
    np.testing.assert_allclose(blows[:, 0], team.air_n[:, 1, 1], atol=1e-3)  # east


def test_wind_on_the_map_points_where_it_blows_to(recorded: tuple[Episode, Path]) -> None:
    _, path = recorded
    _, _, arrow = column(path, "/map/wind", "Arrows2D:vectors")
    assert np.all(arrow[:, 0] < 0)  # west: the air moves to negative east
    assert np.all(arrow[:, 1] < 0)  # up the map: to the north
    np.testing.assert_allclose(arrow[0, 0] / arrow[0, 1], 2.0 / 3.0, rtol=1e-5)


def test_plumb_lines_reach_from_the_aircraft_to_the_sea(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    _, _, strips = rows(path, "/world/uav/plumb_lines", "LineStrips3D:strips")
    top, foot = np.array(strips[17][1])
    north, east, down = episode.teams["uav"].position_n[17, 1]
    np.testing.assert_allclose(top, [east, north, -down], rtol=1e-6)
    np.testing.assert_allclose(foot, [east, north, elevation(north, east, episode.time_s[17])], atol=1e-5)


def test_the_view_turns_with_the_course_and_not_with_its_noise() -> None:
    time = 0.2 * np.arange(60)
    noise = np.random.default_rng(1).normal(0.0, 2.0, time.shape)

    def chased(course: NDArray) -> NDArray:
        velocity = 25.0 * np.stack([np.cos(course), np.sin(course), 0.0 * course], axis=-1)
        velocity[:, 0] += noise
        velocity[:, 1] += noise[::-1]
        return smooth_course(time, velocity)

    turning = 3.0 + 0.3 * time  # through south
    error = np.angle(np.exp(1j * (chased(turning) - turning)))[5:-5]
    assert np.abs(error).max() < 0.1
    assert np.std(chased(0.0 * time)) < 0.5 * np.std(noise) / 25.0


def test_the_formation_is_no_larger_while_the_leader_is_far_from_its_target() -> None:
    team = make_episode(3, ("uav",)).teams["uav"]
    behind = team.position_n + (200.0, 0.0, 0.0)
    slots = np.concatenate([team.slot_n[:, :1], behind[:, :1] + (0.0, 25.0, 0.0), behind[:, :1] - (0.0, 25.0, 0.0)], 1)
    assert replace(team, position_n=behind, slot_n=slots).formation_radius_m == pytest.approx(25.0)
    assert make_episode(1, ("uav",)).teams["uav"].formation_radius_m == 0.0


def test_the_sea_under_aircraft_alone_is_as_wide_as_they_are_high() -> None:
    grid = SeaGrid.of(aloft().afloat)
    assert grid.half_m > 40.0
    assert grid.parts == 1


def test_every_way_a_flight_ends_has_words() -> None:
    assert {*Aircraft.ending_names, *Vessel.ending_names} <= set(EVENTS)


def test_a_stall_is_told_when_it_begins() -> None:
    model = SimpleNamespace(aux_names=("airspeed", "stall_time"))
    aux = np.zeros((6, 2, 2))
    aux[[0, 1, 4], 1, 1] = (0.2, 0.4, 0.2)
    aux[2:, 0, 1] = 0.2 * np.arange(1, 5)
    events = _stalls(model, "uav", aux, 0.2 * np.arange(1, 7))
    assert {(event.vehicle, round(event.time_s, 3)) for event in events} == {(1, 0.2), (0, 0.6), (1, 1.0)}
    assert _stalls(SimpleNamespace(aux_names=()), "usv", aux, np.arange(6.0)) == []


@pytest.fixture(scope="module")
def dive(taichi: None) -> Episode:
    """Aerosondes that turn right, and then into the sea."""
    config = load_scenario("aerosonde", ["track.flight_height=60", "sea.components=4", "variation=0"])

    def turn_and_dive(team: TeamTask) -> torch.Tensor:
        action = torch.zeros_like(team.action)
        action[..., 0] = -1.0 if float(team.fleet.aux[0, 0, 12]) > 5.0 else 0.0
        action[..., 1] = 0.7
        return action

    return record_episode(config, {"uav": turn_and_dive}, seed=3)


@pytest.mark.slow
def test_the_drawn_airspeed_meets_the_drawn_body_at_the_plotted_angles(dive: Episode) -> None:
    """Attitude, velocity and air are three records; airspeed, alpha and beta are the model's own."""
    team = dive.teams["uav"]
    assert team.air_n is not None
    rotation = torch_rotation_matrix(torch.from_numpy(team.quaternion_nb).double()).numpy()
    u, v, w = np.einsum("tvji,tvj->itv", rotation, team.velocity_n - team.air_n)
    alpha, beta = np.moveaxis(team.signals["air angles"].values, -1, 0)
    np.testing.assert_allclose(np.sqrt(u * u + v * v + w * w), team.signals["airspeed"].values[..., 0], rtol=1e-4)
    np.testing.assert_allclose(np.arctan2(w, u), alpha, atol=1e-4)
    np.testing.assert_allclose(np.arctan2(v, np.hypot(u, w)), beta, atol=1e-4)
    assert team.signals["air angles"].unit == "rad"


@pytest.mark.slow
def test_a_recording_ends_when_the_last_aircraft_is_in_the_water(dive: Episode) -> None:
    crashed = [event for event in dive.events if event.kind == "crashed"]
    assert sorted(event.vehicle for event in crashed) == [0, 1, 2]
    assert dive.time_s[-1] == pytest.approx(max(event.time_s for event in crashed))
    assert dive.time_s[-1] < 30.0
