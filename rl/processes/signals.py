"""Being asked to end: Ctrl-C (SIGINT), and SIGTERM, which Slurm, Docker and Kubernetes send before they kill.

Alone, a command ends at once, with a KeyboardInterrupt wherever it is. Processes that learn together must end after
the same iteration, or those that are left wait for each other: there the first signal is noted (`asked`), and all ask
each other after every iteration; the second ends at once.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM has come: to be treated as Ctrl-C, but for the exit status."""


_asked = 0  # the number of the signal that has been noted


def interruption(number: int, text: str = "") -> KeyboardInterrupt:
    """What a signal raises."""
    return (Terminated if number == signal.SIGTERM else KeyboardInterrupt)(*([text] if text else []))


def status(interrupt: KeyboardInterrupt) -> int:
    """The exit status of a command that was interrupted, as shells have it."""
    return 128 + (signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)


def _raise(number: int, frame: FrameType | None) -> None:
    raise interruption(number)


def _note(number: int, frame: FrameType | None) -> None:
    global _asked
    if _asked:
        raise interruption(number)
    _asked = number


def asked() -> int:
    """The number of the signal that has been noted; 0 if none has."""
    return _asked


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """SIGTERM interrupts as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _raise)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def ignore() -> None:
    """Ignore both from now on: the work is done, what is left is to exit."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def noted(note: bool = True) -> Iterator[None]:
    """The first signal is noted instead of raised, if `note` says so."""
    global _asked
    if not note or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, _note) for number in ENDING}
    try:
        yield
    finally:
        _asked = 0
        for number, handler in before.items():
            signal.signal(number, handler)
