"""`taichi-sim sitl SCENARIO --autopilot ...`: autopilots over UDP, and who drives the others."""

import contextlib
import csv
import socket
import threading
import time

import numpy as np
import pytest
from sitl_peer import Peer, free_ports

from rl.commands import sitl
from rl.missions import load_scenario
from rl.runs.autopilots import decks_for, read_autopilots, shared_mission
from taichi_sim.config import ConfigError
from taichi_sim.config.io import find_config

SMALL = ("sea.components=8", "usv.count=3")


class Afar(threading.Thread):
    """An autopilot over UDP: it sends a frame again after a while, and ends when nobody listens any more."""

    def __init__(self, port, rate, pwm):
        super().__init__(daemon=True)
        self.port, self.pwm, self.peer = port, pwm, Peer(self._wire, rate)

    def _wire(self, data):
        while True:
            try:
                self.wire.send(data)
                return self.wire.recv(65536)
            except TimeoutError:
                pass
            except ConnectionRefusedError:
                if self.peer.heard:
                    raise EOFError from None
                time.sleep(0.2)  # nobody listens yet

    def run(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as self.wire:
            self.wire.settimeout(0.5)
            self.wire.connect(("127.0.0.1", self.port))
            with contextlib.suppress(EOFError):
                while True:
                    self.peer.step(self.pwm)


@pytest.mark.slow
def test_two_autopilots_and_a_classical_controller_drive_three_boats(tmp_path, capsys):
    """At rest, ahead and to starboard; the third sails. The files hold what the autopilots were told."""
    ports = free_ports(2)
    crew = [Afar(ports[0], 50, [1500, 0, 1500]), Afar(ports[1], 400, [1900, 0, 2000])]
    for one in crew:
        one.start()
    sitl.main(["otter", "--autopilot", f"usv.0={ports[0]}", f"usv.2={ports[1]}", "--duration", "3", "--quiet",
               "--timeout", "300", "--log", str(tmp_path / "log.csv"), "--record", str(tmp_path / "run.rrd"),
               *(word for text in SMALL for word in ("--set", text))])  # fmt: skip
    for one in crew:
        one.join(60.0)
    told = capsys.readouterr().out
    assert f"usv.0 on 127.0.0.1:{ports[0]}, channels" in told and (tmp_path / "run.rrd").is_file()
    for one, name in zip(crew, ("usv.0", "usv.2"), strict=True):
        with (tmp_path / f"log-{name}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert abs(len(rows) - 3 * one.peer.rate) <= 1 and len(one.peer.heard) in (len(rows), len(rows) - 1)
        assert float(rows[100]["north"]) == pytest.approx(one.peer.heard[100]["position"][0])
    start, turned = (np.array(crew[1].peer.heard[k]["attitude"]) for k in (0, 1100))
    assert turned[2] - start[2] > 0.05


@pytest.mark.parametrize(("texts", "told"), [
    (["usv.0"], "expected TEAM.NUMBER=PORT"),
    (["usv.3=9002"], "there are usv.0 to usv.2"),
    (["boats.0=9002"], "no such vehicle"),
    (["usv.0=80"], "ports are 1024 to 65535"),
    (["usv.0=9002", "usv.1=9002"], "a port of its own"),
    (["usv.0=9002", "usv.0=9012"], "a vehicle has one autopilot"),
])  # fmt: skip
def test_autopilots_that_cannot_be_are_refused(texts, told):
    with pytest.raises(ConfigError, match=told):
        read_autopilots(texts, load_scenario("otter", SMALL))


def test_a_team_of_aircraft_has_autopilots_as_a_whole_and_decks_are_enough():
    two = ("usv.count=2", "uav.count=2", "sea.components=8")
    config = load_scenario("landing", two)
    with pytest.raises(ConfigError, match="uav: autopilots of aircraft command actuators"):
        shared_mission(config, [("uav", 0)], seed=1, rate=10.0, source=find_config("landing"))
    both = [("uav", 0), ("uav", 1)]
    mission = shared_mission(config, both, seed=1, rate=10.0, source=find_config("landing"))
    assert mission.world.teams["uav"].model.action_names[0].startswith("rotor")
    assert decks_for(mission, both[1:]) == {("uav", 1): ("usv", 0)}
    with pytest.raises(ConfigError, match="3 aircraft with legs have an autopilot, and there are 2 decks"):
        decks_for(mission, [*both, *both[1:]])
