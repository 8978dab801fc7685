"""Several processes that work as one: ranks, and exchange of values between them.

torchrun starts the processes, on one machine or several (rl/runs/torchrun.py does it for `--processes`), and sets their
ranks in environment variables. Rank 0 alone writes and shows progress. A command started alone is rank 0 of 1; every
function here then only calls its argument.

Values travel by pickle: all ranks are processes of one user and one run.

Small and frequent messages, gradients, go over direct connections between the processes of one machine, wires. gloo
hands messages to its own threads. Where every core runs a computing process, such a thread waits for a core, 1 to 3 ms
a message. A process that reads a socket itself is woken in 0.1 ms.
"""

import contextlib
import os
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import timedelta
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch
import torch.distributed as dist

from taichi_sim.config.machine import own_cores

T = TypeVar("T")
_wires: dict[int, Connection] = {}  # rank -> connection on this machine
_alone = False  # whether this process works for itself
PATIENCE = timedelta(hours=2)  # longest wait for another rank: rank 0 evaluates and draws alone


class Rank(NamedTuple):
    """Rank of this process."""

    rank: int  # among all
    count: int  # of all
    local_rank: int  # on this machine
    local_count: int

    @property
    def first(self) -> bool:
        """Whether this is rank 0, which writes."""
        return self.rank == 0


def here() -> Rank:
    """Rank of this process, from torchrun's environment variables; 0 of 1 within `alone`."""
    count = 1 if _alone else int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        return Rank(0, 1, 0, 1)
    names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
    return Rank(*(int(os.environ.get(name, "1" if name == "LOCAL_WORLD_SIZE" else "0")) for name in names))


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Within this context, the process exchanges nothing with others: each may do other work."""
    global _alone
    before, _alone = _alone, True
    try:
        yield
    finally:
        _alone = before


def engine() -> str | None:
    """The run id of the torchrun engine that started this process; None if none did."""
    return os.environ.get("TORCHELASTIC_RUN_ID")


def envs_each(total: int) -> int:
    """Environments of each process: the same for all, and together at least `total`."""
    return -(-total // here().count)


def cores() -> int:
    """Cores of this process: those of the machine shared among its processes."""
    return max(1, len(own_cores()) // here().local_count)


@contextlib.contextmanager
def joined(arch: str = "cpu") -> Iterator[Rank]:
    """Join the processes: gloo between CPUs, nccl between GPUs."""
    place = here()
    if place.count == 1:
        yield place
        return
    dist.init_process_group("cpu:gloo,cuda:nccl" if arch == "cuda" else "gloo", timeout=PATIENCE)
    try:
        with _connected(place.rank, place.count) as near:
            _wires.update(near)
            yield place
    finally:
        _wires.clear()
        dist.destroy_process_group()


class _Failed(NamedTuple):
    """Stands for the result of a rank that failed."""

    error: Exception


def _tried(make: Callable[[], T]) -> T | _Failed:
    try:
        return make()
    except Exception as error:
        return _Failed(error)


def broadcast(make: Callable[[], T]) -> T:
    """The result of `make` on rank 0, which alone calls it; if it raises, all ranks raise."""
    if here().count == 1:
        return make()
    box = [_tried(make) if here().first else None]
    dist.broadcast_object_list(box, src=0)
    if isinstance(box[0], _Failed):
        raise box[0].error
    return box[0]  # pyright: ignore[reportReturnType]


def gather(make: Callable[[], T]) -> list[T]:
    """On rank 0 the results of `make` on each rank, in order; on other ranks an empty list.

    Raises:
        Exception: the error of the first rank that failed, on all ranks, with a note that names it.
    """
    if here().count == 1:
        return [make()]
    found: list | None = [None] * here().count if here().first else None
    dist.gather_object(_tried(make), found, dst=0)
    broadcast(lambda: _refuse_failures(found or []))
    return found or []


def _refuse_failures(found: Sequence[object]) -> None:
    for rank, result in enumerate(found):
        if isinstance(result, _Failed):
            result.error.add_note(f"on rank {rank} of {len(found)}")
            raise result.error


def mean(values: Mapping[str, float]) -> dict[str, float]:
    """The mean over ranks of named numbers."""
    if here().count == 1 or not values:
        return dict(values)
    numbers = torch.tensor(list(values.values()), dtype=torch.float64)
    average_(numbers)
    return dict(zip(values, numbers.tolist(), strict=True))


def average_(numbers: torch.Tensor) -> None:
    """Replace numbers [n] by their mean over ranks, with the same bits on each rank."""
    if here().count > 1:
        _reduce_(numbers, torch.add, dist.ReduceOp.SUM)
        numbers /= here().count


def _reduce_(numbers: torch.Tensor, combine: Callable[..., torch.Tensor], operation: dist.ReduceOp.RedOpType) -> None:
    """Combine `numbers` of all ranks in place by recursive doubling: each round exchanges with one other rank.

    Ranks of one machine exchange over wires.
    """
    place = here()
    if place.count & (place.count - 1) or numbers.is_cuda:
        dist.all_reduce(numbers, op=operation)
        return
    theirs = torch.empty_like(numbers)
    for other in _partners(place.rank, place.count):
        if other in _wires:
            _exchange(_wires[other], numbers, theirs, place.rank < other)
        else:
            for work in (dist.isend(numbers, other), dist.irecv(theirs, other)):
                if work is not None:
                    work.wait()
        combine(numbers, theirs, out=numbers)


def greatest(value: int) -> int:
    """The greatest of the ranks' values."""
    if here().count == 1:
        return value
    number = torch.tensor([value])
    _reduce_(number, torch.maximum, dist.ReduceOp.MAX)
    return int(number)


# -- wires -------------------------------------------------------------------------------------------------------------


class _Address(NamedTuple):
    """Where a process listens."""

    machine: str
    path: str
    key: bytes


def _partners(rank: int, count: int) -> list[int]:
    """The ranks with which a process exchanges in turn (recursive doubling); `count` is a power of two."""
    return [rank ^ (1 << n) for n in range(count.bit_length() - 1)]


@contextlib.contextmanager
def _connected(rank: int, count: int) -> Iterator[dict[int, Connection]]:
    """Connect this rank to its `partners` on this machine; yield the connections by rank. All ranks must call this
    together, after torch has connected them.
    """
    if count & (count - 1):
        yield {}
        return
    with tempfile.TemporaryDirectory(prefix="taichi-sim-") as folder, contextlib.ExitStack() as stack:
        own = _Address(socket.gethostname(), str(Path(folder) / "wire"), os.urandom(16))
        listener = stack.enter_context(Listener(own.path, "AF_UNIX", authkey=own.key))
        there: list[_Address] = [own] * count
        dist.all_gather_object(there, own)
        seen: list[set[int]] = [set()] * count
        near = {k for k in _partners(rank, count) if there[k].machine == own.machine and Path(there[k].path).exists()}
        dist.all_gather_object(seen, near)
        wires: dict[int, Connection] = {}
        for other in _partners(rank, count):  # this order is free of deadlock
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


def _exchange(wire: Connection, mine: torch.Tensor, theirs: torch.Tensor, first: bool) -> None:
    """Send `mine` and receive `theirs`, of the same size. `first` is true at one end only, or both would wait."""
    try:
        for sends in (first, not first):
            if sends:
                wire.send_bytes(mine.numpy().data.cast("B"))
            else:
                wire.recv_bytes_into(theirs.numpy().data.cast("B"))
    except (EOFError, OSError) as error:
        raise RuntimeError(f"connection closed by peer: {error}") from None
