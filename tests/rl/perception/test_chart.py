"""Looks, messages and charts: cameras and lookouts against geometry, the filter against least squares."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from phases import due

from rl.perception.chart import AGE, ASSUMED, P_PP, P_VV, V_NORTH, Chart, TrackNoise, width_of
from rl.perception.instruments import InstrumentsConfig
from rl.perception.radio import NEVER, Message, Radio, RadioConfig
from rl.perception.sightings import UNSEEN, Camera, CameraConfig, Lookout, LookoutConfig, Sighting
from taichi_sim.kernels.conventions import STATE_SIZE
from taichi_sim.kernels.random import Noise
from taichi_sim.kernels.rotation import DERIVED_SIZE, HEADING_COS, HEADING_SIN, ROTATION, torch_quaternion_from_euler

EXACT = InstrumentsConfig()
DT = 0.2


def views(place, euler=(0.0, 0.0, 0.0), envs: int = 1):
    """Vehicles at `place` [vehicle, 3] with one attitude (rad), in every environment."""
    place = torch.tensor(place, dtype=torch.float32).reshape(-1, 3)
    state = torch.zeros((envs, len(place), STATE_SIZE))
    state[..., :3] = place
    roll, pitch, heading = (torch.tensor(float(x)) for x in euler)
    q = torch_quaternion_from_euler(roll, pitch, heading)
    state[..., 3:7] = q
    w, x, y, z = q.tolist()
    R = torch.tensor(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    derived = torch.zeros((envs, len(place), DERIVED_SIZE))
    derived[..., ROTATION] = R.flatten()
    derived[..., HEADING_COS], derived[..., HEADING_SIN] = heading.cos(), heading.sin()
    R_nb = derived[..., ROTATION].unflatten(-1, (3, 3))
    return SimpleNamespace(state=state, derived=derived, position_n=state[..., :3], R_nb=R_nb)


def things_at(places, envs: int = 1, radius: float = 1.0):
    things = torch.zeros((envs, len(places), 6))
    things[..., :2], things[..., 5] = torch.tensor(places, dtype=torch.float32), radius
    return things


def noise_of(envs: int, clock: int, keys=None):
    noise = Noise(envs, 7, clock)
    if keys is not None:
        noise.keys.copy_(torch.tensor(keys))
    return noise


def look(aircraft, things, hs: float = 0.0, own=None, clock: int = 1, keys=None, **camera):
    """The looks of one team, and the camera."""
    envs, count = things.shape[0], aircraft.state.shape[1]
    looks = torch.full((envs, count, things.shape[1], 3), UNSEEN)
    config = CameraConfig(**{"noise_deg": 0.0, "reach": 1e5} | camera)
    made = Camera(config, EXACT, looks, things, torch.full((envs,), hs), aircraft, own or aircraft, first=0)
    made.aim(torch.zeros((envs, count, 2)))
    made.see(due(envs, noise=noise_of(envs, clock, keys)))
    return looks, made


@pytest.mark.parametrize("euler", [(0.0, 0.0, 0.0), (0.4, 0.1, 2.0), (-0.5, -0.2, -1.0)])
def test_what_a_camera_finds_is_where_it_is(euler):
    """Through the attitude and back, whatever that is; only within the field of view about where the gimbal looks."""
    places = [(0.0, 0.0), (40.0, 10.0), (-60.0, 30.0), (900.0, 900.0)]
    aircraft = views([(150.0, 20.0, -100.0)], euler)
    looks, _ = look(aircraft, things_at(places), field_of_view_deg=60.0)
    seen = looks[0, 0, :, Sighting.VARIANCE] > 0
    axis = torch.tensor([-150.0, -20.0, 100.0])
    for k, (north, east) in enumerate(places):
        line = torch.tensor([north - 150.0, east - 20.0, 100.0])
        inside = float((line @ axis) / (line.norm() * axis.norm())) > math.cos(math.radians(30.0))
        assert bool(seen[k]) == inside
    assert seen[0] and not seen[3]
    torch.testing.assert_close(looks[0, 0, seen, :2], torch.tensor(places)[seen], atol=0.02, rtol=0)


def test_a_fixed_camera_turns_with_the_aircraft():
    """To starboard and 30 degrees down: of a level aircraft that flies north, what is east; banked, what is below."""
    east, below = (0.0, 100.0 / math.tan(math.radians(30.0))), (0.0, 100.0 / math.tan(math.radians(70.0)))
    things = things_at([east, below])
    for roll, wanted in ((0.0, [True, False]), (math.radians(40.0), [False, True])):
        looks, _ = look(views([(0, 0, -100)], (roll, 0, 0)), things, mount="fixed", field_of_view_deg=40.0)
        assert (looks[0, 0, :, Sighting.VARIANCE] > 0).tolist() == wanted


@pytest.mark.parametrize(("hs", "reach"), [(0.0, 300.0), (2.0, 600.0), (1.0, 250.0)])
def test_detection_falls_by_the_inverse_cube_of_the_range(hs, reach):
    envs, slant = 4000, math.hypot(200.0, 100.0)
    things = things_at([(0.0, 0.0)], envs)
    looks, _ = look(views([(200.0, 0.0, -100.0)], envs=envs), things, hs, reach=reach, rough=2.0)
    found = float((looks[..., Sighting.VARIANCE] > 0).float().mean())
    expected = 1 - 2 ** -((reach / (1 + hs / 2.0) / slant) ** 3)
    assert found == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / envs))


def test_the_variance_of_a_look_is_what_pixels_make_of_it():
    envs = 3000
    things = things_at([(0.0, 0.0)], envs)
    looks, _ = look(views([(200.0, 0.0, -100.0)], envs=envs), things, noise_deg=0.3)
    error = looks[:, 0, 0, :2]
    told = float(looks[:, 0, 0, Sighting.VARIANCE].mean())
    assert float(error.square().sum(-1).mean() / 2) == pytest.approx(told, rel=0.08)


def test_a_heading_that_is_off_turns_what_is_found():
    true = views([(200.0, 0.0, -100.0)])
    own = views([(200.0, 0.0, -100.0)], (0.0, 0.0, 0.05))
    looks, _ = look(true, things_at([(20.0, 0.0)]), own=own, field_of_view_deg=90.0)
    to = torch.tensor([-180.0, 0.0])
    turned = torch.tensor([math.cos(0.05) * to[0], math.sin(0.05) * to[0]])
    torch.testing.assert_close(looks[0, 0, 0, :2], turned + torch.tensor([200.0, 0.0]), atol=0.05, rtol=0)


def see(boats, things, elevation=None, keys=None, **lookout):
    envs = things.shape[0]
    looks = torch.full((envs, boats.state.shape[1], things.shape[1], 3), UNSEEN)
    config = LookoutConfig(**{"range_noise": 0.0, "bearing_noise_deg": 0.0, "dropout": 0.0} | lookout)
    flat = elevation or (lambda points: torch.zeros(points.shape[:-1]))
    made = Lookout(config, EXACT, looks, things, boats, boats, flat)
    made.see(due(envs, noise=noise_of(envs, 1, keys)))
    return looks, made


def test_a_lookout_sees_the_vessel_and_obstacles_within_its_ranges():
    things = things_at([(59.0, 0.0), (0.0, 25.9), (0.0, -26.1), (10.0, 5.0)])
    looks, _ = see(views([(0, 0, 0), (2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]), things)
    assert (looks[0, :, 0, Sighting.VARIANCE] > 0).tolist() == [True, True, False]
    assert (looks[0, 0, :, Sighting.VARIANCE] > 0).tolist() == [True, True, False, True]
    torch.testing.assert_close(looks[0, 0, 3, :2], torch.tensor([10.0, 5.0]))


@pytest.mark.parametrize("who", ["camera", "lookout"])
def test_looks_err_alike_where_environments_have_the_same_key(who):
    things, keys = things_at([(40.0, 5.0)], 3), (4, 9, 4)
    if who == "camera":
        looks, _ = look(views([(0, 0, -100)], envs=3), things, noise_deg=0.3, keys=keys)
    else:
        looks, _ = see(views([(0, 0, 0)], envs=3), things, range_noise=2.0, bearing_noise_deg=1.0, keys=keys)
    assert bool((looks[..., Sighting.VARIANCE] > 0).all())
    first, other, same = looks[:, 0, 0, :2]
    assert first.equal(same) and float((first - other).abs().min()) > 1e-3


def test_crests_hide_the_vessel():
    """A ridge half way between, above and below the line of sight."""
    boats, things = views([(0, 0, 0)]), things_at([(40.0, 0.0), (10.0, 0.0)])
    for height, seen in ((0.9, True), (1.1, False)):

        def ridge(points, height=height):
            return torch.where((points[..., 0] - 20.0).abs() < 4.0, height, 0.0)

        looks, made = see(boats, things, ridge, crests=True, eye_height=1.0, vessel_height=1.0)
        assert (looks[0, 0, :, Sighting.VARIANCE] > 0).tolist() == [seen, True]  # obstacles are not hidden
        assert bool(made.behind_crests()[0, 0]) is not seen


class Net:
    """Lookers, their radio and their charts; what they see is written by hand."""

    def __init__(self, lookers: int, things: int = 1, envs: int = 1, numbers: TrackNoise = ASSUMED, **radio):
        place = torch.zeros((envs, lookers, 3))
        self.looks = torch.full((envs, lookers, things, 3), UNSEEN)
        shift = radio.pop("shift", 0)
        self.radio = Radio(
            RadioConfig(**radio),
            place,
            DT,
            width=width_of(things),
            kept=Message.SIZE,
            known=False,
            shift=shift,
        )
        self.chart = Chart(self.looks, self.radio, DT, numbers)
        self.place, self.step, self.envs = place, 0, envs
        self.chart.begin(torch.arange(envs))
        self.noise = Noise(envs, 3)

    def go(self, seen=None, which: int = 1):
        """One decision, with looks {(looker, thing): (north, east, variance)}, or a tensor for looker 0."""
        self.step += which == 1
        self.noise.tick()
        self.looks[..., Sighting.VARIANCE] = UNSEEN
        for (looker, thing), values in (seen or {}).items():
            self.looks[:, looker, thing] = torch.as_tensor(values, dtype=torch.float32)
        now = due(self.envs, which, step=self.step, noise=self.noise)
        self.chart.say(now)
        self.radio.talk(now)
        self.chart.keep(now)
        return self.chart.tracks


STILL = TrackNoise(first=0.0, others=0.0, first_speed=100.0, others_speed=100.0)


def test_a_track_is_the_line_of_least_squares():
    """Without process noise and with a wide prior, the filter is the weighted fit of a straight line."""
    net, rng = Net(1, numbers=STILL), np.random.default_rng(4)
    net.go(which=2)
    t, z, r = DT * np.arange(1, 31), [], []
    for when in t:
        variance = rng.uniform(0.5, 4.0)
        z.append(3.0 + 1.2 * when + rng.normal(0.0, variance**0.5))
        r.append(variance)
        tracks = net.go({(0, 0): (z[-1], 0.0, variance)})
    A, W = np.stack((np.ones_like(t), t - t[-1]), axis=1), np.diag(1 / np.array(r))
    covariance = np.linalg.inv(A.T @ W @ A)
    place, speed = covariance @ A.T @ W @ np.array(z)
    track = tracks[0, 0, 0]
    assert float(track[0]) == pytest.approx(place, abs=2e-3)
    assert float(track[V_NORTH]) == pytest.approx(speed, abs=2e-3)
    assert float(track[P_PP]) == pytest.approx(covariance[0, 0], rel=1e-2)
    assert float(track[P_VV]) == pytest.approx(covariance[1, 1], rel=1e-2)
    assert float(track[AGE]) == 0.0


def test_a_late_look_counts_as_much_as_one_in_time():
    """Who hears of everything 0.6 s late has, without process noise, what the other had, carried on."""
    net, rng = Net(2, numbers=STILL, delay=0.6), np.random.default_rng(5)
    net.go(which=2)
    for k in range(40):
        z = 5.0 - 0.7 * DT * k + rng.normal(0.0, 1.0)
        tracks = net.go({(0, 0): (z, 2.0, 1.0)} if k < 37 else None).clone()
    torch.testing.assert_close(tracks[0, 1, 0, :7], tracks[0, 0, 0, :7], atol=5e-3, rtol=1e-2)
    torch.testing.assert_close(tracks[0, :, 0, AGE], torch.tensor([0.6, 0.6]))


def test_no_look_is_taken_twice():
    """A message that repeats the last look adds nothing but age."""
    net = Net(2, numbers=STILL)
    net.go(which=2)
    for k in range(5):
        net.go({(0, 0): (1.0 * k, 0.0, 1.0)})
    before = net.chart.tracks[0, 1, 0].clone()
    for _ in range(10):
        net.go()
    after = net.chart.tracks[0, 1, 0]
    assert float(after[P_VV]) == pytest.approx(float(before[P_VV]))
    assert float(after[AGE]) == pytest.approx(2.0)
    assert float(after[0]) == pytest.approx(float(before[0] + 2.0 * before[V_NORTH]), rel=1e-4)


@pytest.mark.parametrize("radio", [{"loss": 1.0}, {"range": 50.0}])
def test_without_messages_nobody_knows(radio):
    net = Net(2, **radio)
    net.place[:, 1, 0] = 80.0
    net.go(which=2)
    for _ in range(5):
        net.go({(0, 0): (1.0, 0.0, 1.0)})
    assert float(net.chart.tracks[0, 0, 0, AGE]) == 0.0
    assert float(net.chart.tracks[0, 1, 0, AGE]) >= NEVER


def test_messages_of_another_environment():
    net = Net(2, envs=3, shift=1)
    net.go(which=2)
    for _ in range(3):
        net.looks[..., Sighting.VARIANCE] = UNSEEN
        net.go({(0, 0): torch.tensor([[10.0, 0, 1], [20.0, 0, 1], [30.0, 0, 1]])})
    assert net.chart.tracks[:, 0, 0, 0].tolist() == pytest.approx([10, 20, 30], abs=0.1)
    assert net.chart.tracks[:, 1, 0, 0].tolist() == pytest.approx([20, 30, 10], abs=0.1)
