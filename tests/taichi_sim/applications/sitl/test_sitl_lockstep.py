"""A world that autopilots step in lockstep: a boat and a copter on its deck, driven by peers of our own."""

import math
import socket

import numpy as np
import pytest
from sitl_peer import Copter, Mate, free_ports

from taichi_sim.applications.sitl.ardupilot import Session
from taichi_sim.applications.sitl.lockstep import Aboard, LockstepWorld, SilentError, Station
from taichi_sim.config import ConfigError, WorldConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.models.contact.deck_motion import PRESSED

pytestmark = pytest.mark.slow

BOAT, COPTER = ("usv", 0), ("uav", 0)
STILL = [1500, 0, 1500]


def _world(hs=0.0, rate=400.0):
    teams = {"usv": {"vehicle": "wamv", "count": 1}, "uav": {"vehicle": "t650", "count": 1}}
    sea = {"hs": hs, "tp": 4.0, "components": 8}
    config = WorldConfig.model_validate({"decision_interval": 0.05, "sea": sea, **teams})
    return LockstepWorld(config, direct=["uav"], rate=rate)


class Crew:
    """A boat and a copter on its deck, with an autopilot each."""

    def __init__(self, boat=lambda _: STILL, copter=lambda _: [1000] * 4, rates=(50, 400), **world):
        self.world = _world(**world)
        crafts = Aboard(self.world, *BOAT), Aboard(self.world, *COPTER, BOAT)
        self.boat, self.copter = (
            Mate(Session(craft), outputs, rate)
            for craft, outputs, rate in zip(crafts, (boat, copter), rates, strict=True)
        )
        self.world.crew, self.world.wait = list(crafts), lambda: (self.boat.poll(), self.copter.poll())
        self.actions = {name: fleet.action.clone() for name, fleet in self.world.teams.items()}

    def go_on(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.world.step(self.actions)
        return self


def _flight(rates):
    """In waves: the copter rises from the deck and lands on it again."""
    place = {}

    def fly(answer):
        if answer is None or answer["timestamp"] < 0.2:
            return [1000] * 4
        boat, pilot = crew.boat.heard[-1], place.setdefault("pilot", Copter(crew.world.crew[1].model.params))
        up = answer["timestamp"] < 1.6
        pilot.goal[:] = [*boat["position"][:2], boat["position"][2] - (2.3 if up else 0.0)]
        return [1000] * 4 if not up and crew.world.crew[1].fleet.touch.all_down.item() else pilot.outputs(answer)

    crew = Crew(lambda _: STILL, fly, rates, hs=0.2)
    heights, crew.blow = [], 0.0
    for _ in range(80):
        crew.go_on(0.05)
        crew.blow = max(crew.blow, crew.world.teams["uav"].touch.blow.item())
        heights.append(crew.boat.heard[-1]["position"][2] - crew.copter.heard[-1]["position"][2])
    return crew, heights


@pytest.fixture(scope="module")
def flown():
    return _flight((50, 400))


def test_two_rates_pass_in_lockstep_and_each_frame_is_answered_once(flown):
    crew, _ = flown
    for mate in (crew.boat, crew.copter):
        stamps = np.array([answer["timestamp"] for answer in mate.heard])
        assert stamps == pytest.approx(np.arange(1, len(stamps) + 1) / mate.rate, abs=1e-9)
        assert mate.session.counts.frames in (len(stamps), len(stamps) + 1)  # the last one may not be over
    assert crew.copter.heard[-1]["timestamp"] - crew.boat.heard[-1]["timestamp"] < 1 / crew.boat.rate


def test_a_copter_takes_off_from_a_deck_and_lands_on_it_by_what_it_is_told(flown):
    crew, heights = flown
    assert heights[2] == pytest.approx(heights[0], abs=0.2) and max(heights) > heights[0] + 0.4
    assert heights[-1] == pytest.approx(heights[0], abs=0.25)
    touch = crew.world.teams["uav"].touch
    assert touch.all_down.item() and touch.pressing[0, 0, PRESSED] == 1
    assert 0.1 < crew.blow < 1.5  # of any step of a decision


def test_the_same_outputs_give_the_same_bits(flown):
    crew, _ = flown
    again, _ = _flight((50, 400))
    assert again.copter.heard == crew.copter.heard and again.boat.heard == crew.boat.heard


def test_measurements_between_steps_agree_with_each_other(flown):
    """At 50 Hz every frame has 8 steps; at 1200 Hz a step has 3 frames. Specific force is the change of velocity."""
    fast = Crew(rates=(1200, 700), hs=0.3, boat=lambda _: [1600, 0, 1900]).go_on(0.3)
    for mate in (flown[0].boat, flown[0].copter, fast.boat, fast.copter):
        v = np.array([a["velocity"] for a in mate.heard])
        R = np.array([numpy_rotation_matrix(np.array(a["quaternion"])) for a in mate.heard])
        force = np.einsum("nij,nj->ni", R, np.array([a["imu"]["accel_body"] for a in mate.heard]))
        felt = (force + [0.0, 0.0, GRAVITY]) / mate.rate
        assert felt[1:] == pytest.approx(np.diff(v, axis=0), abs=1e-6)
        p, way = np.array([a["position"] for a in mate.heard]), 0.5 * (v[1:] + v[:-1]) / mate.rate
        assert np.diff(p, axis=0) == pytest.approx(way, abs=1e-4 if mate.rate > 50 else 3e-3)


def test_an_output_acts_at_once_where_frames_and_steps_begin_together():
    """And within a step elsewhere: full thrust, from frame 20 on, lifts in the frame that it is sent for."""
    for rate, late in ((400, 0), (1200, 2)):
        crew = Crew(rates=(400, rate))
        crew.copter.outputs = lambda answer, peer=crew.copter.peer: [1000 if peer.frame < 20 else 2000] * 4
        crew.go_on(0.1)
        up = np.array([-a["imu"]["accel_body"][2] for a in crew.copter.heard])
        first = int(np.argmax(up > 1.02 * up[10:20].max()))
        assert 20 <= first <= 20 + late


def test_boat_and_copter_feel_each_other_on_the_deck():
    """In a calm sea the boat rises when the copter leaves, by its weight over the stiffness of the waterplane."""
    crew = Crew(copter=lambda _: [crew.output] * 4)
    crew.output = 1000
    down = crew.go_on(4.0).boat.heard[-1]["position"][2]
    assert crew.copter.heard[-1]["imu"]["accel_body"][2] == pytest.approx(-GRAVITY, abs=0.1)
    crew.output = 1800
    rises = down - crew.go_on(4.0).boat.heard[-1]["position"][2]
    model = crew.world.teams["uav"].model
    wet = 2 * 4.9 * 2 * math.sqrt(0.213**2 - (0.213 - 0.0879) ** 2)  # m^2, waterplane of two cylinders
    assert rises == pytest.approx(model.params.physical.mass / (1000.0 * wet), rel=0.3)


def test_a_vehicle_whose_autopilot_restarts_is_back_at_its_beginning_and_the_others_go_on():
    crew = Crew(copter=lambda answer: [1900 if answer and answer["timestamp"] > 0.1 else 1000] * 4)
    crew.go_on(0.6)
    assert crew.copter.heard[-1]["position"][2] < -2.0
    crew.copter.restart()
    crew.go_on(0.1)
    assert crew.copter.heard[0]["timestamp"] == pytest.approx(1 / 400) and crew.copter.session.counts.restarts == 1
    assert crew.copter.heard[-1]["position"][2] == pytest.approx(-1.3 - 0.255, abs=0.05)
    assert crew.world.teams["uav"].touch.all_down.item()
    stamps = [answer["timestamp"] for answer in crew.boat.heard]
    assert np.diff(stamps) == pytest.approx(1 / 50)


def test_an_aircraft_without_a_deck_is_held_until_it_lifts_off():
    world = _world()
    world.teams["uav"].state[0, 0, 2] = -12.0
    mate = Mate(Session(Aboard(world, *COPTER)), lambda _: [output] * 4)
    world.crew, world.wait = [mate.session.craft], mate.poll
    for output in (1000, 1900):
        for _ in range(10):
            world.step({"usv": [[[0.0, 0.0]]], "uav": [[[0.0] * 4]]})
        assert (mate.heard[-1]["position"][2] == -12.0) == (output == 1000)
    assert mate.session.craft.news == ["lifts off"]


def test_who_holds_the_world_is_named():
    world, told, (mine, silent) = _world(), [], free_ports(2)
    station = Station(world, {BOAT: mine, COPTER: silent}, {COPTER: BOAT}, address="127.0.0.1", timeout=0.3,
                      tell=told.append)  # fmt: skip
    try:
        with pytest.raises(ConfigError, match=rf"usv\.0={mine}: .* in use"):
            Station(world, {BOAT: mine}, {}, address="127.0.0.1", timeout=0.0, tell=told.append)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            wire.sendto(Mate(station.sessions[0], lambda _: STILL).peer.packet(STILL), ("127.0.0.1", mine))
            wire.sendto(b"a stranger", ("127.0.0.1", silent))
            with pytest.raises(SilentError, match=rf"autopilot of uav\.0 on 127\.0\.0\.1:{silent} \(has not come\)$"):
                world.step({"usv": [[[0.0, 0.0]]], "uav": [[[0.0] * 4]]})
    finally:
        station.close()
    assert told == ["refused: magic 8289: allowed are 18458 (16 channels) and 29569 (32 channels)"]
