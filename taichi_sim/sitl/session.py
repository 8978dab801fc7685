"""The conversation with one autopilot: which frames are new, repeated, lost, or the first after a restart.

Lockstep: ArduPilot sends frame k and waits. It receives an answer once the vehicle has advanced by one frame. If the
answer is lost, ArduPilot sends the same frame again and receives the same answer. A jump ahead means that frames were
lost: the vehicle advances by as many frames, the lost ones under the last known outputs. Frame 0 after other frames is
a restart. Any other older frame came late, and gets no answer.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from ipaddress import ip_address

from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import PacketError, Sensors, Servos, encode, parse

LONGEST_GAP = 2.0  # s; after a longer gap the lost frames are skipped
MOST_REASONS = 16  # largest number of reasons that are counted separately
Address = tuple[str, int]


@dataclass
class Counts:
    """Numbers of packets received, by kind."""

    frames: int = 0  # new frames
    repeated: int = 0
    lost: int = 0  # frames that never arrived
    late: int = 0
    restarts: int = 0
    refused: dict[str, int] = field(default_factory=dict)  # reason -> number


class Session:
    """A craft and the one peer that drives it.

    Attributes:
        craft: the vehicle.
        peer: address of the sender, from the first valid packet on.
        counts: numbers of packets.
        seen: functions that are called after each new frame.
    """

    def __init__(self, craft: Craft):
        """Start without a peer."""
        self.craft, self.counts = craft, Counts()
        self.seen: list[Callable[[Servos, Sensors], None]] = []
        self.peer: Address | None = None
        self.last: Servos | None = None
        self.answer = b""

    def receive(self, data: bytes, sender: Address) -> bytes | None:
        """The answer to a packet, or None if there is none."""
        try:
            servos = parse(data)
            self._check_sender(sender, servos)
        except PacketError as error:
            why = str(error)
            if why in self.counts.refused or len(self.counts.refused) < MOST_REASONS:
                self.counts.refused[why] = self.counts.refused.get(why, 0) + 1
            return None
        last = self.last
        if last is None or (servos.frame == 0 and (last.frame != 0 or sender != self.peer)):
            if last is not None:
                self.counts.restarts += 1
            self.craft.begin(servos.rate)
            gap = 1
        elif servos.frame == last.frame:
            self.counts.repeated += 1
            return self.answer
        elif servos.frame < last.frame:
            self.counts.late += 1
            return None
        else:
            if servos.rate != last.rate:
                self.craft.change_rate(servos.rate)
            gap = servos.frame - last.frame
            if gap > LONGEST_GAP * servos.rate:
                gap = 1
            for _ in range(gap - 1):
                self.craft.advance(last.pwm)
            self.counts.lost += gap - 1
        self.craft.advance(servos.pwm)
        self.last, self.peer = servos, sender
        self.counts.frames += 1
        sensors = self.craft.sensors()
        self.answer = encode(sensors)
        for seen in self.seen:
            seen(servos, sensors)
        return self.answer

    def _check_sender(self, sender: Address, servos: Servos) -> None:
        """Refuse other senders than the peer. Another port of the same machine may take over with frame 0, as a
        restarted SITL does.

        Raises:
            PacketError: for any other sender.
        """
        if self.peer is None or sender == self.peer:
            return
        if ip_address(sender[0]) != ip_address(self.peer[0]) or servos.frame != 0:
            raise PacketError(
                f"{sender[0]}:{sender[1]} does not drive this vehicle, {self.peer[0]}:{self.peer[1]} does"
            )
