"""One autopilot's side of the conversation: which frames are new, repeated, lost, or the first after a restart.

Lockstep: ArduPilot sends frame k and waits. It gets an answer once the vehicle has moved on by one frame. Where the
answer was lost it sends the same frame again, and gets the same answer. A jump ahead means that frames were lost on the
way: the vehicle moves on by as many, the lost ones under the last outputs known. Frame 0 after others is a restart. A
frame that is older otherwise was late, and gets no answer.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from ipaddress import ip_address

from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import PacketError, Sensors, Servos, parse, told

LONGEST_GAP = 2.0  # s; after more than that a conversation goes on with the frame that came
MOST_REASONS = 16  # that are counted apart
Address = tuple[str, int]


@dataclass
class Counts:
    """What came."""

    frames: int = 0  # answered anew
    repeated: int = 0
    lost: int = 0  # frames that never came
    late: int = 0
    restarts: int = 0
    refused: dict[str, int] = field(default_factory=dict)  # why -> how many


class Session:
    """A craft and the one peer that drives it.

    Attributes:
        craft. peer: who sends, from the first good packet on. counts. seen: all are called after each new frame.
    """

    def __init__(self, craft: Craft):
        """Nobody drives it yet."""
        self.craft, self.counts = craft, Counts()
        self.seen: list[Callable[[Servos, Sensors], None]] = []
        self.peer: Address | None = None
        self.last: Servos | None = None
        self.answer = b""

    def receive(self, data: bytes, sender: Address) -> bytes | None:
        """The answer to a packet; None where there is none to give."""
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
        self.answer = told(sensors)
        for seen in self.seen:
            seen(servos, sensors)
        return self.answer

    def _check_sender(self, sender: Address, servos: Servos) -> None:
        """Another port of the same machine may take over with frame 0, as a restarted SITL does; nobody else may.

        Raises:
            PacketError: for anybody else.
        """
        if self.peer is None or sender == self.peer:
            return
        if ip_address(sender[0]) != ip_address(self.peer[0]) or servos.frame != 0:
            raise PacketError(
                f"{sender[0]}:{sender[1]} does not drive this vehicle, {self.peer[0]}:{self.peer[1]} does"
            )
