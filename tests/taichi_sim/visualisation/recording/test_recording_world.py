"""A world without a mission, recorded and read back; views and plots of what there is, and only of that."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
import torch
from recorded import assert_nothing_is_empty, column, entities, make_episode, parts

from taichi_sim.kernels.rotation import torch_quaternion_from_euler
from taichi_sim.visualisation.recording import Recorder, TeamTrack
from taichi_sim.visualisation.recording.blueprint import blueprint
from taichi_sim.visualisation.recording.palette import FIRST, OTHERS, liveries
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.visualisation.recording.sea_patch import patch_of
from taichi_sim.world import World

SMALL = (
    "sea.realisations=2", "sea.components=4", "air.speed=5", "ferry.vehicle=unity_boat", "ferry.count=2",
    "scout.vehicle=unity_aircraft", "scout.count=2",
)  # fmt: skip
STEPS, ENV = 12, 1


def sail(teams: tuple[str, ...]) -> tuple[Recorder, dict[str, list[np.ndarray]]]:
    """A recorder of environment 1 of a world whose teams have names of their own, and the states it went through."""
    world = World.from_scenario("paper", 2, overrides=SMALL, teams=teams)
    for team in teams:
        state = world.teams[team].state.clone()
        state[..., 0] = 20.0 * torch.arange(2) + 100.0 * torch.arange(2)[:, None]
        state[..., 2] = 0.0 if team == "ferry" else -30.0
        state[..., 3:7] = torch_quaternion_from_euler(*torch.tensor([0.0, 0.0, 1.0]))
        state[..., 7] = 5.0 if team == "ferry" else 15.0
        world.place(team, torch.arange(2), state)
    world.time += 7.0
    recorder = Recorder(world, ENV)
    states: dict[str, list[np.ndarray]] = {name: [] for name in world.teams}
    for step in range(STEPS):
        shapes = {name: (2, 2, len(team.model.action_names)) for name, team in world.teams.items()}
        actions = {name: torch.full(shape, 0.02 * step) for name, shape in shapes.items()}
        recorder.add(world.step(actions))
        for name, team in world.teams.items():
            states[name].append(team.state[ENV].numpy().copy())
    return recorder, states


@pytest.mark.parametrize("teams", [("ferry", "scout"), ("ferry",)])
def test_a_bare_world_is_recorded_as_it_moved(teams: tuple[str, ...], tmp_path: Path) -> None:
    recorder, states = sail(teams)
    path = recorder.write(tmp_path / "world.rrd", name="bare")
    for name, frames in states.items():
        for vehicle in range(2):
            entity = f"/world/{name}/vehicle_{vehicle}"
            state = np.stack(frames)[:, vehicle]
            times, _, place = column(path, entity, "Transform3D:translation")
            np.testing.assert_array_equal(place, state[:, [1, 0, 2]] * np.float32([1, 1, -1]))
            np.testing.assert_array_equal(times, 100_000_000 * np.arange(1, STEPS + 1))
            rates = recorder.track(name).angular_velocity_b
            assert rates is not None
            np.testing.assert_array_equal(rates[:, vehicle], state[:, 10:13])
            _, _, turn = column(path, entity, "Transform3D:quaternion")
            w, x, y, z = state[:, 3:7].astype(np.float64).T  # half a turn about east and north together, then q
            expected = np.sqrt(0.5) * np.stack([w + z, w - z, y - x, -x - y], axis=1)
            np.testing.assert_array_equal(turn, expected.astype(np.float32))
    there = entities(path)
    mission = ("target", "slot", "error", "reward", "/track", "checkpoints", "obstacles", "/map/area", "/events")
    assert not [entity for entity in there for word in mission if word in entity]
    assert {entity for entity in there if entity.startswith("/plots/a")} == {
        f"/plots/{plot}/{name}/{whose}"
        for name in states
        for plot in ("action", "attitude", *(["altitude"] if name == "scout" else []))
        for whose in ("first", "others")
    }
    assert_nothing_is_empty(recorder.episode(), path)
    sea = {entity for entity in there if entity.endswith("/sea")}
    assert sea == {"/world/ferry/sea"}
    _, _, heave = column(path, "/plots/heave/ferry/first", "Scalars:scalars")
    sent = pickle.loads(pickle.dumps(recorder.episode()))  # as processes of a job do
    wave = [float(sent.elevation(*frame[:1, :2].T, 0.1 * (i + 1))[0]) for i, frame in enumerate(states["ferry"])]
    np.testing.assert_allclose(heave[:, 1], wave, atol=2e-5)


def test_a_recorder_refuses_what_is_not_one_motion() -> None:
    recorder, _ = sail(("ferry",))
    with pytest.raises(ValueError, match="begun anew"):
        recorder.add()  # the clock stands still
    recorder.world.time[ENV] += 0.1
    recorder.add()
    track = recorder.track("ferry")
    assert track.action is not None
    assert np.isnan(track.action[-1]).all()  # nobody said what was done
    with pytest.raises(ValueError, match="environment 2"):
        Recorder(recorder.world, 2)
    with pytest.raises(ValueError, match="no frame"):
        Recorder(recorder.world, 0).episode()


@pytest.mark.parametrize("teams", [("usv",), ("uav",), ("usv", "uav")])
@pytest.mark.parametrize("vehicles", [1, 3])
def test_no_view_of_a_mission_is_empty(teams: tuple[str, ...], vehicles: int, tmp_path: Path) -> None:
    episode = replace(make_episode(vehicles, teams, steps=5), events=())
    assert_nothing_is_empty(episode, write_recording(episode, tmp_path / "mission.rrd"))


def renamed(team: TeamTrack, name: str, north: float = 0.0) -> TeamTrack:
    """The same team under another name, elsewhere, without a mission."""
    return replace(
        team, name=name, position_n=team.position_n + (north, 0.0, 0.0), target_n=None, target_course=None, slot_n=None,
        error_m=None, reward=None,
    )  # fmt: skip


def test_many_teams_of_any_name_have_each_a_view_and_a_colour(tmp_path: Path) -> None:
    episode = make_episode(2, steps=5)
    usv, uav = episode.teams.values()
    crowd = {
        team.name: team
        for team in (
            renamed(usv, "ferry"),
            renamed(uav, "scout"),
            renamed(usv, "tug", 1000.0),
            renamed(usv, "pilot", 10.0),
        )
    }
    crowd = replace(episode, teams=crowd, events=(), scene=type(episode.scene)())
    assert_nothing_is_empty(crowd, write_recording(crowd, tmp_path / "crowd.rrd"))
    # the tug is out of sight and has a sea of its own; the pilot is on that of the ferry
    assert patch_of(crowd) == {"ferry": "ferry", "scout": "ferry", "tug": "tug", "pilot": "ferry"}
    views = [view for view in parts(blueprint(crowd).root_container) if isinstance(view, rrb.Spatial3DView)]
    assert [view.name for view in views] == ["FERRY team", "TUG team", "PILOT team", "SCOUT team", "SCOUT 0"]
    assert liveries({"ferry": "water", "scout": "air", "tug": "water", "pilot": "water"}) == {
        "ferry": FIRST["water"], "scout": FIRST["air"], "tug": OTHERS[0], "pilot": OTHERS[1]
    }  # fmt: skip


def test_a_view_holds_company_and_not_the_whole_ocean() -> None:
    team = renamed(make_episode(3, ("usv",), steps=5).teams["usv"], "traffic")
    position = team.position_n.copy()
    position[:, 1] = position[:, 0] + (12.0, 9.0, 0.0)
    position[:, 2] = position[:, 0] + (3000.0, 0.0, 0.0)
    team = replace(team, position_n=position)
    assert team.company.tolist() == [True, True, False]
    assert team.formation_radius_m == pytest.approx(15.0)
