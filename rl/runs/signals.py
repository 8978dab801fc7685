"""Interruption by Ctrl-C (SIGINT) and by SIGTERM, which Slurm, Docker and Kubernetes send before they kill.

A command that runs alone ends at once, with a KeyboardInterrupt. Processes that learn together must all end after the
same iteration, or the remaining ones wait forever. There the first signal stays pending (`pending`), and the ranks
compare after every iteration; a second signal ends at once.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM: handled like Ctrl-C except for the exit status."""


_pending = 0  # number of the pending signal


def interruption(number: int, text: str = "") -> KeyboardInterrupt:
    """The exception that a signal raises."""
    return (Terminated if number == signal.SIGTERM else KeyboardInterrupt)(*([text] if text else []))


def status(interrupt: KeyboardInterrupt) -> int:
    """The exit status of an interrupted command, by the shell's convention."""
    return 128 + (signal.SIGTERM if isinstance(interrupt, Terminated) else signal.SIGINT)


def _raise(number: int, frame: FrameType | None) -> None:
    raise interruption(number)


def _defer(number: int, frame: FrameType | None) -> None:
    global _pending
    if _pending:
        raise interruption(number)
    _pending = number


def pending() -> int:
    """Number of the pending signal; 0 if there is none."""
    return _pending


@contextlib.contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM interrupt like Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _raise)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def ignore() -> None:
    """Ignore both signals from now on, when only the exit is left."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def deferred(defer: bool = True) -> Iterator[None]:
    """Let the first signal stay pending instead of raising, if `defer` is true."""
    global _pending
    if not defer or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, _defer) for number in ENDING}
    try:
        yield
    finally:
        _pending = 0
        for number, handler in before.items():
            signal.signal(number, handler)
