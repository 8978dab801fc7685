"""What vehicles know: instruments, contacts and radio against what is there."""

import math

import pytest
import torch
from small_missions import begin, make, wander

from rl.missions import load_scenario
from rl.perception.instruments import Readings
from rl.perception.tracked_objects import TrackedObjects
from taichi_sim.config import ConfigError

STEADY = ("sea.hs=0", "obstacles.count=0")
INSTRUMENTS = (
    "sensors.gnss={noise=0.5,bias=2.0,shared=0.75}", "sensors.compass={noise_deg=1.0,bias_deg=2.0}",
    "sensors.log={noise=0.1,bias=0.3}", "sensors.imu={rate_noise_deg=2.0,attitude_noise_deg=1.0}",
    "sensors.altimeter={noise=0.5,bias=1.0}",
)  # fmt: skip


def test_without_sensors_and_radio_the_truth_is_known():
    task = make()
    for team in task.teams.values():
        assert team.known is team
        assert team.privileged is None


def test_instruments_err_as_configured():
    """Standard deviations over 600 environments at the beginning, of bias and noise together; the shared part."""
    task = make(*STEADY, *INSTRUMENTS, envs=600, teams=("uav",))
    team = task.teams["uav"]
    own = team.known.fleet
    assert isinstance(own, Readings)
    error = own.state - team.fleet.state
    expected = {0: (0.5**2 + 2.0**2) ** 0.5, 1: (0.5**2 + 2.0**2) ** 0.5, 2: (0.5**2 + 1.0**2) ** 0.5}
    for column, std in expected.items():
        assert float(error[..., column].std()) == pytest.approx(std, rel=0.06)
    over_ground = own.velocity_n - team.fleet.velocity_n  # of aircraft measured in n
    assert over_ground.std(dim=(0, 1)).tolist() == pytest.approx([(0.1**2 + 0.3**2) ** 0.5] * 3, rel=0.06)
    for column in (10, 11, 12):
        assert float(error[..., column].std()) == pytest.approx(math.radians(2.0), rel=0.06)
    heading = own.euler - team.fleet.euler
    wrapped = torch.rad2deg(torch.remainder(heading + torch.pi, 2 * torch.pi) - torch.pi)
    assert float(wrapped[..., 2].std()) == pytest.approx(5**0.5, rel=0.06)
    assert float(wrapped[..., 0].std()) == pytest.approx(1.0, rel=0.08)
    between = error[:, 0, :2] - error[:, 1, :2]  # the shared part is gone
    assert float(between.std()) == pytest.approx((2 * (0.5**2 + 0.25 * 2.0**2)) ** 0.5, rel=0.06)
    assert float(own.quaternion_nb.norm(dim=-1).sub(1).abs().max()) < 1e-5
    before = own.memory.clone()
    wander(task, 1)
    kept = 0.1 / 60  # of a decision over the time constant
    walk = (own.memory - before)[..., :4]
    assert float(walk[..., :2].std()) == pytest.approx(1.0 * (2 * kept) ** 0.5, rel=0.1)
    assert torch.equal(own.memory[..., 4:], before[..., 4:])  # those of an episode


def test_a_seed_repeats_what_was_measured_and_no_two_decisions_do():
    task = make(*INSTRUMENTS, "radio={loss=0.5}", teams=("usv",))

    def measured(seed: int) -> torch.Tensor:
        begin(task, seed)
        wander(task, 3)
        return task.teams["usv"].observations()

    first = measured(3)
    assert torch.equal(measured(3), first)
    own = task.teams["usv"].known.fleet
    error = own.state - own.fleet.state
    wander(task, 1)
    assert ((own.state - own.fleet.state)[..., :2] != error[..., :2]).all()


def test_messages_arrive_late_and_age():
    """After `delay` decisions everybody knows where everybody was; followers go on from there."""
    task = make(*STEADY, "radio={delay=0.3}", teams=("usv",))
    begin(task)
    team, past = task.teams["usv"], []
    for _ in range(6):
        wander(task, 1, size=0.3)
        past.append(team.fleet.state[:, None, :, :3].expand(-1, 3, -1, -1).clone())
    heard = team.known.radio.heard
    torch.testing.assert_close(heard[..., :3], past[-4])
    torch.testing.assert_close(heard[..., 6], torch.full_like(heard[..., 6], 0.3))
    off = (team.known.now.slot - team.now.slot)[:, 1:, :2].norm(dim=-1)
    assert float(off.max()) < 0.5 * 20 * 0.3**2 + 0.1  # 20 m/s^2 at full thrust
    assert float(off.max()) > 0


@pytest.mark.parametrize("radio", ["radio={loss=1.0}", "radio={range=1.0}"])
def test_what_does_not_arrive_is_remembered_with_its_age(radio):
    task = make(*STEADY, radio, teams=("usv",))
    begin(task)
    heard = task.teams["usv"].known.radio.heard
    first = heard[..., :6].clone()
    wander(task, 5, size=0.3)
    others = ~torch.eye(3, dtype=torch.bool)
    assert torch.equal(heard[..., :6][:, others], first[:, others])
    torch.testing.assert_close(heard[..., 6][:, others], torch.full_like(heard[..., 6][:, others], 0.5))
    names = list(task.teams["usv"].observation_names)
    torch.testing.assert_close(task.teams["usv"].observations()[:, 1:, names.index("age")], torch.full((4, 2), 1 / 3))


def test_messages_are_lost_and_rare_as_configured():
    task = make(*STEADY, "radio={loss=0.4,rate=5}", envs=300, teams=("usv",))
    begin(task)
    radio = task.teams["usv"].known.radio
    arrived = []
    for _ in range(20):
        wander(task, 1, size=0.0)
        arrived.append(radio.heard[..., 6] == 0)
    assert float(torch.stack(arrived).float().mean()) == pytest.approx(0.5 * 0.6, abs=0.01)


def test_late_measurements_of_steady_bodies_are_exact_in_time():
    """Without noise a filter of constant velocity has what moves steadily where it is, however late it is measured."""
    busy = ("obstacles.clearance_min=-15", "obstacles.moving_fraction=0.5", "sensing.detection_range=150")
    task = make("sea.hs=0", *busy, "sensors.contacts={late=3}", teams=("usv",))
    begin(task)
    team = task.teams["usv"]
    contacts = team.known.sensor
    assert isinstance(contacts, TrackedObjects)
    settled = []
    for _ in range(60):
        wander(task, 1, size=0.2)
        same = (contacts.obstacles[..., 8] == team.sensor.obstacles[..., 8]) & (contacts.obstacles[..., 8] >= 0)
        settled.append((contacts.obstacles - team.sensor.obstacles)[same])
    late = torch.cat(settled[30:])
    assert len(late) > 100
    assert float(late[:, 0].abs().median()) < 0.02
    assert float(late[:, 4:6].abs().median()) < 0.05


def test_contacts_smooth_the_noise_and_bridge_what_drops_out():
    busy = ("obstacles.clearance_min=-15", "obstacles.count=40", "sensing.detection_range=100")
    noisy = "sensors.contacts={range_noise=2.0,bearing_noise_deg=2.0,dropout=0.3}"
    task = make("sea.hs=0", *busy, noisy, envs=64, teams=("usv",))
    begin(task)
    team, errors, gaps = task.teams["usv"], [], []
    for n in range(60):
        wander(task, 1, size=0.2)
        contacts = team.known.sensor
        there = team.sensor.obstacles[..., 8] >= 0
        same = there & (contacts.obstacles[..., 8] == team.sensor.obstacles[..., 8])
        if n > 20:
            errors.append((contacts.obstacles - team.sensor.obstacles)[same][:, 0])
            gaps.append(float(same.sum() / there.sum()))
    assert sum(gaps) / len(gaps) > 0.95
    assert float(torch.cat(errors).abs().median()) < 1.0  # of 2 m of noise in every single one


def test_critics_are_told_the_truth_and_actors_are_not():
    task = make(*INSTRUMENTS, teams=("usv",))
    begin(task)
    told, truth = task.teams["usv"].observations(), task.teams["usv"].privileged
    assert truth is not None
    assert truth.shape == told.shape
    assert not torch.equal(truth, told)
    exact = make(teams=("usv",))
    begin(exact)
    torch.testing.assert_close(exact.teams["usv"].observations(), truth)


@pytest.mark.parametrize(
    ("override", "match"),
    [
        ("sensors.gnss.noise=-1", "sensors.gnss.noise"),
        ("sensors.gns.noise=1", "did you mean 'gnss'"),
        ("radio.loss=1.1", "radio.loss"),
        ("radio.range=0", "radio.range"),
        ("sensors.contacts.dropout=1", "sensors.contacts.dropout"),
        ("usv.control.horizon=-1", "usv.control"),
    ],
)
def test_refused(override, match):
    with pytest.raises(ConfigError, match=match):
        task = make(override, teams=("usv",))
        task.teams["usv"].make_controller()
    assert load_scenario("paper").radio is None
