"""Direct connections between the processes of one machine, for small and frequent messages: gradients.

gloo hands messages to its own threads. Where every core runs a computing process, such a thread waits for a core, 1 to
3 ms a message. A process that reads a socket itself is woken in 0.1 ms.
"""

import contextlib
import os
import socket
import tempfile
from collections.abc import Iterator
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import NamedTuple

import torch.distributed as dist
from torch import Tensor


class WireError(RuntimeError):
    """The process at the other end is gone."""


class _Address(NamedTuple):
    """Where a process listens."""

    machine: str
    path: str
    key: bytes


def partners(rank: int, count: int) -> list[int]:
    """The ranks with which a process exchanges in turn (recursive doubling); `count` is a power of two."""
    return [rank ^ (1 << n) for n in range(count.bit_length() - 1)]


@contextlib.contextmanager
def connected(rank: int, count: int) -> Iterator[dict[int, Connection]]:
    """Connections to the partners on this machine. All ranks call this together, after torch has joined them."""
    if count & (count - 1):
        yield {}
        return
    with tempfile.TemporaryDirectory(prefix="taichi-sim-") as folder, contextlib.ExitStack() as stack:
        own = _Address(socket.gethostname(), str(Path(folder) / "wire"), os.urandom(16))
        listener = stack.enter_context(Listener(own.path, "AF_UNIX", authkey=own.key))
        there: list[_Address] = [own] * count
        dist.all_gather_object(there, own)
        seen: list[set[int]] = [set()] * count
        near = {k for k in partners(rank, count) if there[k].machine == own.machine and Path(there[k].path).exists()}
        dist.all_gather_object(seen, near)
        wires: dict[int, Connection] = {}
        for other in partners(rank, count):  # this order is free of deadlock
            if other not in near or rank not in seen[other]:
                continue
            if rank < other:
                wire = stack.enter_context(listener.accept())
                other = int.from_bytes(wire.recv_bytes(4))  # a later partner may have connected first
            else:
                wire = stack.enter_context(Client(there[other].path, "AF_UNIX", there[other].key))
                wire.send_bytes(rank.to_bytes(4))
            wires[other] = wire
        yield wires


def exchange(wire: Connection, mine: Tensor, theirs: Tensor, first: bool) -> None:
    """Send `mine` and receive `theirs`, of the same size. `first` is true at one end only, or both would wait.

    Raises:
        WireError: if the process at the other end is gone.
    """
    try:
        for sends in (first, not first):
            if sends:
                wire.send_bytes(mine.numpy().data.cast("B"))
            else:
                wire.recv_bytes_into(theirs.numpy().data.cast("B"))
    except (EOFError, OSError) as error:
        raise WireError(f"connection closed by peer: {error}") from None
