"""A limit of time for what may hang."""

import signal
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def within(seconds: int, done: Callable[[], T]) -> T:
    """What `done` returns; TimeoutError if it takes longer."""

    def ends(*_: object) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, ends)
    signal.alarm(seconds)
    try:
        return done()
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
