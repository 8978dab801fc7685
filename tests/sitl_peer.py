"""Plays ArduPilot's side of the JSON interface: lockstep over a wire that loses, repeats and delays packets.

ArduPilot's documented behaviour (SIM_JSON.cpp, SIM_Aircraft.cpp): it sends a frame, and waits. It takes one answer, the
oldest one, for each frame. Without an answer it sends the frame again after a second.
"""

import json
import random
import socket
import struct
from collections.abc import Callable

import numpy as np

from taichi_sim.kernels.conventions import GRAVITY

Wire = Callable[[bytes], bytes | None]  # what comes back for a packet; None: nothing
RESEND = 1.0  # s


class Clock:
    """Time that passes when it is told to, s."""

    def __init__(self):
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Peer:
    """Sends servo outputs frame by frame, until each is answered.

    Attributes:
        frame: the one to be sent next. heard: answers, parsed, by frame. waiting: answers that it has not taken.
        clock: its time, which passes while it waits for an answer; that of the session, too, if times matter.
    """

    def __init__(
        self, wire: Wire, rate: int = 400, channels: int = 16, *, loss: float = 0.0, seed: int = 0,
        clock: Clock | None = None,
    ):  # fmt: skip
        """`loss`: probability that a packet is lost, on either way; as many are repeated, or come again late."""
        self.wire, self.rate, self.channels, self.loss = wire, rate, channels, loss
        self.random, self.frame, self.heard, self.old = random.Random(seed), 0, {}, []
        self.clock, self.waiting = clock or Clock(), []
        self._stopped_until, self._arrived = 0.0, []

    def packet(self, pwm) -> bytes:
        """Binary, as SITL writes it."""
        full = [*pwm, *[0] * (self.channels - len(pwm))]
        magic = 18458 if self.channels == 16 else 29569
        return struct.pack(f"<HHI{self.channels}H", magic, self.rate, self.frame, *full)

    def stop_them(self, seconds: float) -> None:
        """The physics stop for `seconds`; packets wait until they go on."""
        self._stopped_until = self.clock.now + seconds

    def send(self, data: bytes) -> None:
        """Send a packet; answers to it, and to what has waited before it, join those that wait."""
        self._arrived.append(data)
        if self.clock.now < self._stopped_until:
            return
        for packet in self._arrived:
            answer = self.wire(packet)
            if answer is not None and self.random.random() >= self.loss:  # and back
                self.waiting.append(answer)
        self._arrived.clear()

    def step(self, pwm) -> dict:
        """One frame: sent again and again until there is an answer."""
        data = self.packet(pwm)
        for _ in range(1000):
            if self.random.random() >= self.loss:  # there
                self.send(data)
                if self.random.random() < self.loss:  # twice
                    self.send(data)
                if self.old and self.random.random() < self.loss:  # an old one, late
                    self.send(self.random.choice(self.old))
            if self.waiting:
                break
            self.clock.now += RESEND
        else:
            raise TimeoutError("no answer")
        answer = self.waiting.pop(0)
        assert answer.startswith(b"\n") and answer.endswith(b"\n")
        self.old = [*self.old[-5:], data] if self.frame else []
        self.heard[self.frame] = json.loads(answer)
        self.frame += 1
        return self.heard[self.frame - 1]

    def restart(self) -> None:
        """SITL begins anew at frame 0."""
        self.frame, self.heard, self.old = 0, {}, []


class PacedPeer(Peer):
    """A peer that changes its frame rate as ArduPilot does (SIM_JSON.cpp, SIM_Aircraft.cpp), in single precision.

    Its rate follows the time stamps of the answers, and from there moves toward `target` (SIM_RATE_HZ) by 1 Hz a frame.
    Packets hold its whole part.

    Attributes:
        sent: rates of the packets, Hz. stamps: of the answers, s.
    """

    LEAST, MOST = 1e-9, 0.1  # s between time stamps that it takes for a frame

    def __init__(self, wire: Wire, rate: int, target: int, **more):
        """Begin at `rate`, Hz."""
        super().__init__(wire, rate, **more)
        self.exact, self.target = np.float32(rate), np.float32(target)
        self.sent, self.stamps = [], [0.0]

    def step(self, pwm) -> dict:
        """One frame."""
        self.rate = int(self.exact)
        self.sent.append(self.rate)
        answer = super().step(pwm)
        self.stamps.append(answer["timestamp"])
        length = self.stamps[-1] - self.stamps[-2]
        if self.LEAST < length < self.MOST:
            self.exact = np.float32(1.0 / length)
        self.exact = min(max(self.target, self.exact - np.float32(1.0)), self.exact + np.float32(1.0))
        return answer


class Mate:
    """An autopilot of a world: it has sent a frame whenever the world waits for it.

    Attributes:
        frame: the one to be sent next. heard: answers, parsed, since the last restart.
    """

    def __init__(self, session, outputs: Callable[[dict | None], list[int]], rate: int = 400):
        """`outputs` gives pulse widths for the last answer, None at first."""
        self.session, self.outputs, self.rate = session, outputs, rate
        self.peer, self.heard = Peer(lambda data: None, rate), []

    def restart(self) -> None:
        """It begins anew at frame 0; the answer to the old one is lost."""
        self.peer.frame, self.heard = 0, []
        self._send()

    def poll(self) -> None:
        """Take an answer that is due, and send frames until one is not answered at once."""
        if self.session.answer is None and self.session.craft.ready:
            self.heard.append(json.loads(self.session.complete()))
        while self.session.craft.ready:
            self._send()

    def _send(self) -> None:
        data = self.peer.packet(self.outputs(self.heard[-1] if self.heard else None))
        self.peer.frame += 1
        answer = self.session.receive(data, ("127.0.0.1", 5501))
        if answer is not None:
            self.heard.append(json.loads(answer))


class Copter:
    """The outputs of a copter's autopilot: a position is held by tilt, attitude by rates, rotors by their allocation.

    Attributes:
        goal: north, east, down, m.
    """

    POSITION, VELOCITY, ATTITUDE, RATE = 2.25, 3.0, 64.0, 16.0  # 1/s^2, 1/s, 1/s^2, 1/s
    YAW = 4.0, 4.0  # 1/s^2, 1/s
    MOST = 4.0, 0.7  # m/s^2 to the side; m/s of climb or descent
    IDLE = 1000  # us

    def __init__(self, craft):
        """Take the numbers of a multirotor file."""
        rotors, body, rotor = craft.rotors, craft.physical, craft.rotor
        self.mass, self.inertia, self.rotor, self.goal = body.mass, np.diag(body.inertia), rotor, np.zeros(3)
        arms = np.array([np.subtract(r.position, body.cg) for r in rotors])
        turn = np.array([1.0 if r.spin == "ccw" else -1.0 for r in rotors]) * rotor.k_m / rotor.k_f
        self.shares = np.linalg.inv(np.array([np.ones(len(rotors)), -arms[:, 1], arms[:, 0], turn]))

    def outputs(self, answer: dict) -> list[int]:
        """Pulse widths for the state in an answer."""
        p, v, (roll, pitch, yaw) = (np.array(answer[key]) for key in ("position", "velocity", "attitude"))
        away = self.goal - p
        away[2] = np.clip(away[2], -1.0, 1.0) * self.MOST[1] * self.VELOCITY / self.POSITION
        a = self.POSITION * away - self.VELOCITY * v
        a[:2] = np.clip(a[:2], -self.MOST[0], self.MOST[0])
        ahead, right = np.cos(yaw) * a[0] + np.sin(yaw) * a[1], -np.sin(yaw) * a[0] + np.cos(yaw) * a[1]
        lift = GRAVITY - a[2]
        errors = np.arctan2(right, lift) - roll, np.arctan2(-ahead, lift) - pitch, -yaw
        gains = ((self.ATTITUDE, self.RATE),) * 2 + (self.YAW,)
        moments = [j * (k * e - d * w) for j, (k, d), e, w in zip(
            self.inertia, gains, errors, answer["imu"]["gyro"], strict=True)]  # fmt: skip
        thrusts = self.shares @ [self.mass * lift / (np.cos(roll) * np.cos(pitch)), *moments]
        speeds = np.sqrt(np.clip(thrusts, 0.0, None) / self.rotor.k_f)
        shares = (speeds - self.rotor.omega_min) / (self.rotor.omega_max - self.rotor.omega_min)
        return [round(1000 + 1000 * float(x)) for x in np.clip(shares, 0.0, 1.0)]


def free_ports(n):
    """Numbers of UDP ports that nobody uses."""
    wires = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(n)]
    for wire in wires:
        wire.bind(("127.0.0.1", 0))
    ports = [wire.getsockname()[1] for wire in wires]
    for wire in wires:
        wire.close()
    return ports
