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
from taichi_sim.conventions import STATE_SIZE
from taichi_sim.fleet import Fleet
from taichi_sim.vehicles import load_vehicle
from tools import transfer

SMALL = (
    "sea.sea_state=0", "air.speed=0", "usv.vary={}", "sea.realisations=4", "track.worlds=4", "episode_duration=20",
    "evaluation.settle=2",
)  # fmt: skip


class Disguise(transfer.Simulator):
    """Our model, in a fleet of its own."""

    sway = 1.0

    def advance(self, fleet, around):
        twin = Fleet("twin", self.model, fleet.num_envs, fleet.count)
        for name in ("state", "aux", "action"):
            getattr(twin, name).copy_(getattr(fleet, name))
        type(self.model).step(self.model, twin, around)
        fleet.aux.copy_(twin.aux)
        twin.velocity_b[..., 1] *= self.sway
        return twin.state.double().view(-1, STATE_SIZE).numpy()


class Slippery(Disguise):
    """It keeps half of its sway from step to step."""

    sway = 0.5


def episodes(kind):
    config = load_scenario("otter", SMALL)
    return transfer.judged(config, find_config("otter"), "usv", ClassicalPolicy(), 2, 5, kind, None)


def test_our_model_in_disguise_has_our_figures_to_the_bit_and_another_has_others():
    ours, same, other = episodes(None), episodes(Disguise), episodes(Slippery)
    assert any(np.isfinite(values).all() and values.any() for values in ours.values())
    for key, values in ours.items():
        assert np.array_equal(values, same[key], equal_nan=True), key
    assert any(not np.array_equal(values, other[key], equal_nan=True) for key, values in ours.items())


def afloat():
    return one_episode_each(load_scenario("otter", SMALL), ("usv",), 2, 5, find_config("otter"))


def test_a_simulator_that_gives_too_little_is_told():
    mission = afloat()

    class Short(transfer.Simulator):
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


def test_the_published_otter_gets_shaft_speeds_and_current(checkout):
    mission = afloat()
    fleet, n_max = mission.teams["usv"].fleet, mission.teams["usv"].fleet.model.thrusters.thrusters[0].n_max
    mission.world.around.current[:] = torch.tensor([0.3, -0.4])
    before = fleet.state.clone()
    with transfer.in_place(mission, "usv", transfer.PythonVehicleSimulator, checkout):
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
    (("--simulator", "gazebo"), "python_vehicle_simulator, rotorpy, or module:Class"),
    (("--simulator", "rotorpy"), "multirotors of four rotors alone"),
    (("--simulator", "nothing:There"), "no module 'nothing'"),
    (("--team", "fish"), "allowed are usv, uav"),
    (("--episodes", "1000"), "at most 256"),
])  # fmt: skip
def test_bad_input_is_told(here, run, words, told):
    here("tools.transfer", run, *words).fails(told)


def test_a_boat_that_the_other_has_not_is_told(here, run, checkout):
    here("tools.transfer", run, "--path", checkout, "--episodes", 2).fails("it has the Otter alone")


def test_what_is_not_there_is_told(here, tmp_path):
    here("tools.transfer", tmp_path).fails("not a run folder")
    with pytest.raises(ConfigError, match="there is no python_vehicle_simulator: name a checkout"):
        transfer.published_otter(tmp_path)


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
        simulator = transfer.RotorPy(model, None)
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
def test_followers_do_as_well_in_the_published_simulator():
    """Needs python_vehicle_simulator."""
    pytest.importorskip("python_vehicle_simulator.vehicles.otter")
    config = load_scenario("otter", (*SMALL, "episode_duration=60", "evaluation.settle=20", "obstacles.count=0"))
    there, here = (
        transfer.judged(config, Path(find_config("otter")), "usv", ClassicalPolicy(), 8, 5, kind, None)
        for kind in (transfer.PythonVehicleSimulator, None)
    )
    from rl.missions.formation.judge import FormationJudge

    one, other = (FormationJudge.pooled(of)["follower_error_rms_m"] for of in (there, here))
    assert float(one) == pytest.approx(float(other), rel=0.2)
