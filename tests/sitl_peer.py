"""Plays ArduPilot's side of the JSON interface: lockstep over a wire that loses, repeats and delays packets.

ArduPilot's documented behaviour (SIM_JSON.cpp, SIM_Aircraft.cpp): it sends a frame, and waits. It takes one answer, the
oldest one, for each frame. Without an answer it sends the frame again after a second.
"""

import json
import random
import struct
from collections.abc import Callable

import numpy as np

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
