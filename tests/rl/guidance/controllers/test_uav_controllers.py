"""The classical controller of aircraft: arcs against closed forms, and how aircraft find and keep their slots."""

import math
from types import SimpleNamespace

import pytest
import torch
from folders import ROOT
from torch import Tensor

from rl.guidance.controllers.fixed_wing_6dof import FixedWing6DofController, FixedWing6DofGains, FlightCommand
from rl.learn.policy import ClassicalPolicy
from rl.mission import ControllerError
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import READINGS

VEHICLES = ROOT / "configs" / "vehicles"
STEADY = (
    "sea.follows_wind=false", "sea.sea_state=0", "air.std=0", 'air.turbulence="none"', "obstacles.count=0",
    "track.worlds=4", "sea.realisations=1", "variation=0", "sensors.errors=0", "radio={}",
)  # fmt: skip
CALM = (*STEADY, "air.speed=0")
BENDS = ("track.min_radius=150",)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    """Return the Aerosonde with other actions, by their name."""

    def of(actions: str) -> str:
        file = tmp_path_factory.mktemp("vehicles") / f"{actions}.toml"
        file.write_text((VEHICLES / "aerosonde.toml").read_text().replace('"guidance"', f'"{actions}"', 1))
        return f'uav.vehicle="{file}"'

    return of


def make(*overrides: str, envs: int = 4, seed: int = 3) -> Formation:
    """Return a task with environment i in world i."""
    task = Formation(load_scenario("aerosonde", overrides), envs, seed=seed, teams=("uav",))
    task.reset(worlds=torch.arange(envs), starts=torch.zeros(envs, dtype=torch.int64))
    return task


def fly(task: Formation, seconds: float) -> Tensor:
    """Distances [step, env, vehicle] from the slots; no aircraft's episode may end."""
    policy, team, distances = ClassicalPolicy(), task.teams["uav"], []
    for _ in range(round(seconds / task.config.decision_interval)):
        ended = task.step({"uav": policy}).endings["uav"]
        assert not ended.any.any(), ended
        distances.append(team.distance.clone())
    return torch.stack(distances)


def rms(x: Tensor) -> float:
    return float(x.square().mean().sqrt())


# -- closed forms -------------------------------------------------------------------------------------------------


def test_surfaces_are_refused():
    with pytest.raises(ControllerError, match='autopilot.actions = "guidance" or "altitude"'):
        FixedWing6DofController(SimpleNamespace(actions="surfaces"))


# -- flights ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("actions", ["guidance", "altitude"])
def test_aircraft_find_their_slots_in_calm_air_and_keep_them_in_bends(vehicle, actions):
    task = make(*CALM, *BENDS, vehicle(actions))
    distance = fly(task, 35.0)
    assert float(distance[0].max()) > 15.0  # starts are that far off
    late = distance[-50:]
    assert rms(late[..., 0]) < 0.3
    assert rms(late[..., 1:]) < 0.7


def test_aircraft_keep_their_slots_in_a_steady_wind_of_a_third_of_their_airspeed():
    task = make(*STEADY, *BENDS)
    distance = fly(task, 35.0)
    late, team = distance[-50:], task.teams["uav"]
    assert rms(late[..., 0]) < 0.5
    assert rms(late[..., 1:]) < 1.0
    Va, alpha, beta = team.fleet.aux[..., READINGS : READINGS + 3].unbind(-1)
    through_air = torch.stack((Va * beta.cos() * alpha.cos(), Va * beta.sin(), Va * beta.cos() * alpha.sin()), dim=-1)
    wind = team.fleet.velocity_n - (team.fleet.R_nb @ through_air.unsqueeze(-1)).squeeze(-1)
    met = team.fleet.aux[..., team.fleet.model.aux_names.index("wind_north") :][..., :3]
    assert float(met.norm(dim=-1).min()) > 7.0
    torch.testing.assert_close(wind, met, atol=1e-3, rtol=0)


def test_a_faster_course_loop_turns_sooner_and_settles():
    task = make(*CALM)
    team = task.teams["uav"]
    start, nothing = team.fleet.velocity_n.clone(), torch.zeros_like(team.distance)
    turn = math.radians(8.0)  # to starboard; the largest bank is not reached
    c, s = math.cos(turn), math.sin(turn)
    way = torch.stack((c * start[..., 0] - s * start[..., 1], s * start[..., 0] + c * start[..., 1], nothing), dim=-1)
    wanted = FlightCommand(way, torch.zeros_like(way[..., :2]), torch.ones_like(way[..., :1]))
    saved, left = task.snapshot(), {}
    for gain in (1.0, 1.56):
        task.restore(saved)
        gains = FixedWing6DofGains(course=gain)
        pilot = FixedWing6DofController(team.fleet.model, gains)
        courses = []
        for _ in range(10):
            task.drive({"uav": pilot.act(team, wanted)})
            v = team.fleet.velocity_n
            courses.append(torch.atan2(v[..., 0] * way[..., 1] - v[..., 1] * way[..., 0], (v * way)[..., :2].sum(-1)))
        left[gain] = torch.stack(courses) / turn
    assert float(left[1.0][3].min()) > 0.2  # after 0.8 s
    assert float(left[1.56][3].abs().max()) < 0.1
    assert float(left[1.56].min()) > -0.2  # it overshoots by a sixth at most
    assert float(left[1.56][-1].abs().max()) < 0.05
