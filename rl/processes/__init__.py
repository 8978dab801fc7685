"""Processes that work as one: which of them this is, and what they tell each other.

torchrun starts them, on one machine or on many (rl/runs/launch.py does so for who does not), and says in the
environment which is which: rank 0 alone writes and shows progress. A command that was started alone is rank 0 of 1, and
every function here then does nothing but what it is asked to.

What is told travels by pickle: all ranks are the same user's processes of one run.
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from datetime import timedelta
from typing import Any, NamedTuple, TypeVar

import torch
import torch.distributed as dist

from rl.processes import wires

T = TypeVar("T")
_wires: dict[int, Any] = {}  # to other ranks of this machine (wires.py)
PATIENCE = timedelta(hours=2)  # that ranks wait for each other: rank 0 evaluates and draws alone


class Place(NamedTuple):
    """Which process this is."""

    rank: int  # among all
    count: int  # of all
    local_rank: int  # on this machine
    local_count: int

    @property
    def first(self) -> bool:
        """Whether it is the one that writes."""
        return self.rank == 0


def here() -> Place:
    """Which process this is, as torchrun has said."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        return Place(0, 1, 0, 1)
    names = ("RANK", "WORLD_SIZE", "LOCAL_RANK", "LOCAL_WORLD_SIZE")
    return Place(*(int(os.environ.get(name, "1" if name == "LOCAL_WORLD_SIZE" else "0")) for name in names))


def engine() -> str | None:
    """The name of the run of the engine (torchrun) that has started this process; None: nobody has."""
    return os.environ.get("TORCHELASTIC_RUN_ID")


def of_each(total: int) -> int:
    """How many of `total` environments each process has: as many as any other, and together not fewer."""
    return -(-total // here().count)


def cores() -> int:
    """Cores that this process may use: those of the machine, shared out over its processes."""
    return max(1, len(os.sched_getaffinity(0)) // here().local_count)


@contextlib.contextmanager
def joined(arch: str = "cpu") -> Iterator[Place]:
    """Be connected with the others: gloo between CPUs, nccl between GPUs."""
    place = here()
    if place.count == 1:
        yield place
        return
    dist.init_process_group("cpu:gloo,cuda:nccl" if arch == "cuda" else "gloo", timeout=PATIENCE)
    try:
        with wires.connected(place.rank, place.count) as near:
            _wires.update(near)
            yield place
    finally:
        _wires.clear()
        dist.destroy_process_group()


class _Failed(NamedTuple):
    """What a rank tells in the place of a result."""

    error: Exception


def _tried(make: Callable[[], Any]) -> Any:
    try:
        return make()
    except Exception as error:
        return _Failed(error)


def told(make: Callable[[], T]) -> T:
    """What `make` returns on rank 0, where alone it is called; what it raises is raised by all."""
    if here().count == 1:
        return make()
    box = [_tried(make) if here().first else None]
    dist.broadcast_object_list(box, src=0)
    if isinstance(box[0], _Failed):
        raise box[0].error
    return box[0]  # pyright: ignore[reportReturnType]


def of_all(make: Callable[[], T]) -> list[T]:
    """What `make` returns on each rank, in their order, on rank 0; nothing on the others. What one raises all do.

    Raises:
        what the first rank that failed has raised, with a note that names it.
    """
    if here().count == 1:
        return [make()]
    found: list[Any] | None = [None] * here().count if here().first else None
    dist.gather_object(_tried(make), found, dst=0)
    told(lambda: _refuse_failures(found or []))
    return found or []


def _refuse_failures(found: list[Any]) -> None:
    for rank, of_it in enumerate(found):
        if isinstance(of_it, _Failed):
            of_it.error.add_note(f"on rank {rank} of {len(found)}")
            raise of_it.error


def mean(values: Mapping[str, float]) -> dict[str, float]:
    """The mean over ranks of numbers that all have, by name."""
    if here().count == 1 or not values:
        return dict(values)
    numbers = torch.tensor(list(values.values()), dtype=torch.float64)
    average_(numbers)
    return dict(zip(values, numbers.tolist(), strict=True))


def average_(numbers: torch.Tensor) -> None:
    """Put the mean over ranks in the place of numbers [n] that all have, the same bits on each."""
    if here().count > 1:
        _reduce_(numbers, torch.add, dist.ReduceOp.SUM)
        numbers /= here().count


def _reduce_(numbers: torch.Tensor, combine: Callable[..., Any], operation: Any) -> None:
    """Put in the place of `numbers` what `combine` makes of those of all ranks: 2^n exchange with one other at a time
    (recursive doubling), over wires where there are.
    """
    place = here()
    if place.count & (place.count - 1) or numbers.is_cuda:
        dist.all_reduce(numbers, op=operation)
        return
    theirs = torch.empty_like(numbers)
    for other in wires.partners(place.rank, place.count):
        if other in _wires:
            wires.swap(_wires[other], numbers, theirs, place.rank < other)
        else:
            for work in (dist.isend(numbers, other), dist.irecv(theirs, other)):
                if work is not None:
                    work.wait()
        combine(numbers, theirs, out=numbers)


def greatest(value: int) -> int:
    """The greatest of the numbers that the ranks give."""
    if here().count == 1:
        return value
    number = torch.tensor([value])
    _reduce_(number, torch.maximum, dist.ReduceOp.MAX)
    return int(number)
