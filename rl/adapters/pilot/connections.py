"""Connections, as --connect names them: a UDP port that an autopilot sends to, or a TCP port that it serves.

    udp:127.0.0.1:14550     listens there, answers whoever sends first (a router, or the autopilot)
    tcp:127.0.0.1:5760      connects there
    udp:127.0.0.1:14550#2   system 2 of those that are heard there; several vehicles may share a connection so

Nothing is sent before something has arrived by UDP. Other senders to the port are ignored, until the first one has been
silent for `SILENT` seconds.
"""

import re
import socket
import time
from collections.abc import Sequence
from contextlib import suppress
from ipaddress import ip_address
from typing import NamedTuple

from taichi_sim.config import ConfigError

LARGEST = 65536  # bytes of a datagram
SILENT = 10.0  # s: a companion that acts has ended by then
TIMEOUT = 5.0  # s, to connect


class Address(NamedTuple):
    """A connection, as it was named."""

    kind: str  # udp, tcp
    host: str
    port: int
    system: int = 0  # of the vehicle; 0: the first that is heard

    def __str__(self) -> str:
        """As it was named."""
        return f"{self.kind}:{self.host}:{self.port}" + (f"#{self.system}" if self.system else "")

    @property
    def local(self) -> bool:
        """Whether it stays on this machine."""
        return ip_address(self.host).is_loopback


def read_address(text: str) -> Address:
    """An address from `udp:ADDRESS:PORT` or `tcp:ADDRESS:PORT`, with `#SYSTEM` or without."""
    match = re.fullmatch(r"(udp|tcp):([0-9.]+):(\d{1,5})(?:#(\d{1,3}))?", text)
    with suppress(ValueError):
        if match and 1 <= int(match[3]) <= 65535 and 1 <= int(match[4] or 1) <= 255 and ip_address(match[2]):
            return Address(match[1], match[2], int(match[3]), int(match[4] or 0))
    raise ConfigError(
        f"connection {text}: expected udp:ADDRESS:PORT, which listens, or tcp:ADDRESS:PORT, which connects; with "
        "#SYSTEM where several vehicles share one (udp:127.0.0.1:14550#2); MAVProxy or mavlink-router serve a "
        "serial line so"
    )


def check_different(addresses: Sequence[Address]) -> None:
    """Refuse addresses (ConfigError) two of which may mean one vehicle."""
    for k, one in enumerate(addresses):
        for other in addresses[:k]:
            if one[:3] == other[:3] and (one.system == other.system or not one.system or not other.system):
                raise ConfigError(f"connections {other} and {one}: both may be one vehicle: tell them apart by #SYSTEM")


class Wire:
    """An open connection."""

    def __init__(self, address: Address):
        """Open it."""
        self.address, self._peer, self._heard = address, None, 0.0
        udp = address.kind == "udp"
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if udp else socket.SOCK_STREAM)
        try:
            if udp:
                self.socket.bind((address.host, address.port))
            else:
                self.socket.settimeout(TIMEOUT)
                self.socket.connect((address.host, address.port))
                self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self.socket.close()
            raise ConfigError(f"connection {address}: {error.strerror or error}") from None
        self.socket.setblocking(False)
        self.open = True

    def receive(self) -> bytes:
        """What has arrived, perhaps nothing."""
        arrived = []
        with suppress(BlockingIOError):
            while self.open:
                data, sender = self.socket.recvfrom(LARGEST)
                now = time.monotonic()
                if self.address.kind == "tcp":
                    self.open = bool(data)  # nothing: the other side has closed it
                elif sender != self._peer:
                    if self._peer is not None and now - self._heard < SILENT:
                        continue
                    self._peer = sender
                self._heard = now
                arrived.append(data)
        return b"".join(arrived)

    def send(self, data: bytes) -> None:
        """Send it, if there is somebody; what cannot be sent is lost, like what a radio loses."""
        with suppress(OSError):
            if self.address.kind == "tcp":
                self.socket.send(data)
            elif self._peer is not None:
                self.socket.sendto(data, self._peer)

    def close(self) -> None:
        """Close it."""
        self.socket.close()
