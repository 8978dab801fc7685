"""tools/transfer.py: our own model in disguise has our figures, and another simulator gets what it is told it gets."""

import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import torch

from rl.evaluation.episodes import one_episode_each
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario
from taichi_sim.bench import Bench
from taichi_sim.config import ConfigError
from taichi_sim.config.io import find_config
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import STATE_SIZE
from taichi_sim.models.catalogue import load_vehicle
from tools import simulators, transfer

SMALL = (
    "sea.sea_state=0", "air.speed=0", "usv.vary={}", "sea.realisations=4", "track.worlds=4", "episode_duration=20",
    "evaluation.settle=2",
)  # fmt: skip


class Disguise(simulators.Simulator):
    """Our model, in a fleet of its own."""

    sway = 1.0

    def advance(self, fleet, around):
        twin = Fleet("twin", self.model, fleet.num_envs, fleet.count)
        for name in ("state", "remainder", "aux", "action"):
            getattr(twin, name).copy_(getattr(fleet, name))
        type(self.model).step(self.model, twin, around)
        fleet.aux.copy_(twin.aux)
        twin.velocity_b[..., 1] *= self.sway
        return simulators.exact_states(twin).numpy()


class Slippery(Disguise):
    """It keeps half of its sway from step to step."""

    sway = 0.5


def episodes(kind):
    config = load_scenario("otter", SMALL)
    return transfer.judged(config, find_config("otter"), "usv", ClassicalPolicy(), 2, 5, kind, None)


@pytest.mark.slow
def test_our_model_in_disguise_has_our_figures_to_the_bit_and_another_has_others():
    ours, same, other = episodes(None), episodes(Disguise), episodes(Slippery)
    assert any(np.isfinite(values).all() and values.any() for values in ours.values())
    for key, values in ours.items():
        assert np.array_equal(values, same[key], equal_nan=True), key
    assert any(not np.array_equal(values, other[key], equal_nan=True) for key, values in ours.items())


def afloat():
    return one_episode_each(load_scenario("otter", SMALL), ("usv",), 2, 5, find_config("otter"))


@pytest.mark.slow
def test_a_simulator_that_gives_too_little_is_told():
    mission = afloat()

    class Short(simulators.Simulator):
        def advance(self, fleet, around):
            return np.zeros((3, STATE_SIZE))

    with (
        pytest.raises(ConfigError, match=r"Short.advance gave \[3, 13\], expected \[6, 13\]"),
        transfer.in_place(mission, "usv", Short, None),
    ):
        mission.step({"usv": torch.zeros(2, 3, 2)})
    mission.step({"usv": torch.zeros(2, 3, 2)})  # ours again


@pytest.fixture
def checkout(tmp_path):
    """A folder that looks like PythonVehicleSimulator: a boat on rails, as fast as its left propeller over 100."""
    package = tmp_path / "src" / "python_vehicle_simulator"
    for part in ("vehicles", "lib"):
        (package / part).mkdir(parents=True)
    (package / "lib" / "gnc.py").write_text(
        textwrap.dedent("""
        def attitudeEuler(eta, nu, h):
            eta[0] += h * nu[0]
            return eta
    """)
    )
    (package / "vehicles" / "otter.py").write_text(
        textwrap.dedent("""
        class otter:
            told = []
            def dynamics(self, eta, nu, u_actual, u_control, h):
                self.told.append((self.V_c, self.beta_c, *u_control, h))
                return nu * 0 + [u_control[0] / 100, 0, 0, 0, 0, 0], u_control.copy()
    """)
    )
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] == "python_vehicle_simulator"]:
        del sys.modules[name]


@pytest.mark.slow
def test_the_published_otter_gets_shaft_speeds_and_current(checkout):
    mission = afloat()
    fleet, n_max = mission.teams["usv"].fleet, mission.teams["usv"].fleet.model.thrusters.thrusters[0].n_max
    mission.world.around.current[:] = torch.tensor([0.3, -0.4])
    before = fleet.state.clone()
    with transfer.in_place(mission, "usv", simulators.PythonVehicleSimulator, checkout):
        fleet.action[:] = torch.tensor([1.0, 0.0])
        fleet.model.step(fleet, mission.world.around)
        told = np.array(sys.modules["python_vehicle_simulator.vehicles.otter"].otter.told)
    assert told.shape == (6 * 10, 5)  # 0.2 s in steps of 0.02 s
    assert told == pytest.approx(np.tile([0.5, np.arctan2(-0.4, 0.3), n_max, n_max, 0.02], (60, 1)), rel=1e-5)
    moved = fleet.state - before
    assert moved[..., 0].numpy() == pytest.approx(np.full((2, 3), 0.2 * n_max / 100), abs=1e-3)
    assert fleet.quaternion_nb.numpy() == pytest.approx(before[..., 3:7].numpy(), abs=1e-6)
    assert fleet.reading("shaft_left").numpy() == pytest.approx(n_max, rel=1e-6)


@pytest.mark.parametrize(("words", "told"), [
    (("--simulator", "gazebo"), "python_vehicle_simulator, rotorpy, jsbsim, crazyflow, or module:Class"),
    (("--simulator", "rotorpy"), "multirotors of four rotors alone"),
    (("--simulator", "jsbsim"), "fixed wings alone"),
    (("--simulator", "crazyflow"), "the x500 alone"),
    (("--simulator", "nothing:There"), "no module 'nothing'"),
    (("--team", "fish"), "allowed are usv, uav"),
    (("--episodes", "1000"), "at most 256"),
])  # fmt: skip
def test_bad_input_is_told(here, run, words, told):
    here("tools.transfer", run, *words).fails(told)


def test_a_boat_that_the_other_has_not_is_told(here, run, checkout):
    here("tools.transfer", run, "--path", checkout, "--episodes", 2).fails("it has the Otter alone")


def test_what_is_not_there_is_told(here, tmp_path, monkeypatch):
    here("tools.transfer", tmp_path).fails("not a run folder")
    here("tools.transfer", "otter", "--controller", "policy").fails("needs a run folder, and otter is none")
    for package in ("jsbsim", "crazyflow"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match="pip install jsbsim"):
        simulators.JSBSim(load_vehicle("aerosonde"), None)
    with pytest.raises(ConfigError, match="pip install crazyflow"):
        simulators.Crazyflow(load_vehicle("x500"), None)
    with pytest.raises(ConfigError, match="there is no python_vehicle_simulator: name a checkout"):
        simulators.published_otter(tmp_path)


@pytest.mark.parametrize("action", [(0.4, -0.3, 0.2, 0.0), (0.0, 0.0, -0.5, 0.8)])
def test_a_multirotor_in_rotorpy_flies_as_ours(action):
    """It has our equations: with equal time constants, and without gyroscopic moment and ground effect, it ends where
    ours does.
    """
    pytest.importorskip("rotorpy.vehicles.multirotor")
    equal = {"rotor": {"J_r": 0.0, "tau_up": 0.02, "tau_down": 0.02}, "ground_effect": False}
    model, ends = load_vehicle("x500", 0.01, 2, **equal), []
    for there in (False, True):
        team = Bench(model, envs=2, count=1).put((0.0, 0.0, -30.0), (0.0, 0.0, 0.4), (1.0, 0.0, 0.0), settle=True)
        team.fleet.action[:] = torch.tensor(action).to(team.fleet.action)
        simulator = simulators.RotorPy(model, None)
        for _ in range(50):
            if there:
                team.fleet.state.copy_(
                    torch.from_numpy(simulator.advance(team.fleet, team.around)).view(team.state.shape)
                )
            else:
                model.step(team.fleet, team.around)
        ends.append(team.fleet.state[:, 0].double().numpy().copy())
    assert ends[1] == pytest.approx(ends[0], abs=2e-3)
    assert np.abs(ends[0][:, 7:10] - (1.0, 0.0, 0.0)).max() > 0.5


@pytest.mark.slow
def test_an_x500_that_was_fitted_to_flights_follows_our_controller():
    """Needs crazyflow, and SCIPY_ARRAY_API=1 before anything imports scipy. Velocities settle where they do here."""
    try:
        simulators.Crazyflow(load_vehicle("x500"), None)
    except ConfigError as error:
        pytest.skip(str(error))
    model, ways = load_vehicle("x500", 0.02, 5), []
    for there in (False, True):
        team = Bench(model, envs=2, count=1).put((1.0, 2.0, -30.0), (0.0, 0.0, 0.4), (0.0, 0.0, 0.0), settle=True)
        team.fleet.action[:, 0] = torch.tensor([[0.0, 0.0, 0.0, 0.0], [0.5, 0.2, -0.3, 0.0]]).to(team.state)
        simulator, way = simulators.Crazyflow(model, None), []
        for _ in range(60):  # 6 s
            if there:
                moved = simulator.advance(team.fleet, team.around)
                team.fleet.state.copy_(torch.from_numpy(moved).view(team.state.shape))
                team.fleet.update()
            else:
                model.step(team.fleet, team.around)
            way.append(torch.cat((team.fleet.position_n, team.fleet.velocity_n), -1)[:, 0].double().numpy())
        ways.append(np.array(way))
    here, other = ways
    assert other[-1, 0] == pytest.approx(here[-1, 0], abs=0.1)  # it hovers
    assert np.linalg.norm(here[-1, 1, 3:5]) > 5.0
    assert other[-1, 1, 3:] == pytest.approx(here[-1, 1, 3:], abs=0.3)
    assert other[-1, 1, :3] == pytest.approx(here[-1, 1, :3], abs=2.0)
    assert np.abs(other - here).max() > 0.1  # another aircraft


@pytest.mark.slow
def test_a_cessna_at_our_scale_turns_climbs_and_flies_as_it_is_asked():
    """A steady turn has the rate g tan(bank) / V at any scale (Froude). What is placed anew begins there."""
    pytest.importorskip("jsbsim")
    model = load_vehicle("aerosonde", 0.02, 10)
    low, cruise, high = model.autopilot_limits.speeds
    team = Bench(model, envs=3, count=1).put((5.0, -3.0, -100.0), (0.0, 0.0, -2.0), (25.0, 0.0, 0.0), settle=True)
    begun, simulator, ways = team.fleet.state.clone(), simulators.JSBSim(model, None), []
    team.fleet.action[:, 0] = torch.tensor([[0.0, 0.5, 0.0], [0.1, 0.0, -0.4], [0.0, -0.2, 0.5]]).to(team.state)
    for _ in range(150):  # 30 s
        moved = simulator.advance(team.fleet, team.around)
        team.fleet.state.copy_(torch.from_numpy(moved).view(team.state.shape))
        team.fleet.update()
        ways.append(torch.cat((team.fleet.position_n, team.fleet.velocity_n), -1)[:, 0].double().numpy())
    way = np.array(ways)  # [step, env, 6]
    assert way[1:, :, :3] - way[:-1, :, :3] == pytest.approx(0.1 * (way[1:, :, 3:] + way[:-1, :, 3:]), abs=0.06)
    speed = np.linalg.norm(way[-1, :, 3:], axis=1)
    assert speed == pytest.approx([cruise, cruise - 0.4 * (cruise - low), cruise + 0.5 * (high - cruise)], rel=0.01)
    assert team.fleet.reading("airspeed")[:, 0].numpy() == pytest.approx(speed, rel=1e-3)
    course = np.unwrap(np.arctan2(way[-25:, :, 4], way[-25:, :, 3]), axis=0)
    rate = (course[-1] - course[0]) / (24 * 0.2)
    tangent = np.tan(np.radians(45.0)) * np.array([0.5, 0.0, -0.2])
    assert rate == pytest.approx(9.81 * tangent / speed, rel=0.05, abs=0.002)
    assert -way[-1, :, 5] / speed == pytest.approx([0.0, 0.1 * np.sin(np.radians(20.0)), 0.0], abs=0.004)
    team.fleet.state[0] = begun[0]
    again = simulator.advance(team.fleet, team.around)
    assert np.linalg.norm(again[0, :3] - begun[0, 0, :3].double().numpy()) == pytest.approx(5.0, abs=0.1)
    assert again[1:, :2] == pytest.approx(way[-1, 1:, :2] + 0.2 * way[-1, 1:, 3:5], abs=0.2)


@pytest.mark.slow
def test_aircraft_in_formation_are_held_by_cessnas_too():
    """Needs jsbsim. Another aircraft, whose pilot is slower: followers err more, and nobody is lost."""
    pytest.importorskip("jsbsim")
    calm = ("sea.sea_state=0", "air.speed=0", "air.std=0", 'air.turbulence="none"', "uav.vary={}", "sea.realisations=4",
            "track.worlds=16", "episode_duration=60", "evaluation.settle=20")  # fmt: skip
    config = load_scenario("aerosonde", calm)
    there, here = (
        transfer.judged(config, Path(find_config("aerosonde")), "uav", ClassicalPolicy(), 4, 1000, kind, None)
        for kind in (simulators.JSBSim, None)
    )
    assert not there["failed"].any() and not there["collided"].any()
    for key, most in (("leader_error_rms_m", 1.3), ("follower_error_rms_m", 2.5)):
        one, other = (np.sqrt(np.mean(of[key] ** 2)) for of in (there, here))
        assert 0.7 * other < one < most * other, key


@pytest.mark.slow
def test_followers_do_as_well_in_the_published_simulator():
    """Needs python_vehicle_simulator."""
    pytest.importorskip("python_vehicle_simulator.vehicles.otter")
    config = load_scenario("otter", (*SMALL, "episode_duration=60", "evaluation.settle=20", "obstacles.count=0"))
    there, here = (
        transfer.judged(config, Path(find_config("otter")), "usv", ClassicalPolicy(), 8, 5, kind, None)
        for kind in (simulators.PythonVehicleSimulator, None)
    )
    from rl.missions.formation.judge import FormationJudge

    one, other = (FormationJudge.pooled(of)["follower_error_rms_m"] for of in (there, here))
    assert float(one) == pytest.approx(float(other), rel=0.2)
