"""Worker processes of one thread each, which end with the command."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

CONTEXT = get_context("spawn")
WATCHED_S = 1.0  # s between checks that the command still runs
# Workers have one thread each, because they share the cores and the matrices are small. (Threads of a BLAS that wait
# for each other take ten times as long.) glibc keeps the memory of a frequency's matrices for the next frequency,
# because to allocate it anew page by page takes up to half the time.
ENVIRONMENT = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")} | {
    f"MALLOC_{name}_": str(2**33) for name in ("MMAP_THRESHOLD", "TRIM_THRESHOLD")
}


@contextmanager
def workers(count: int, begin: Callable[..., None] | None = None, *given: object) -> Iterator[ProcessPoolExecutor]:
    """Pool of `count` processes, each of which first calls `begin(*given)`."""
    with _environment(), ProcessPoolExecutor(count, CONTEXT, _begin, (os.getpid(), begin, given)) as pool:
        yield pool


def _begin(parent: int, begin: Callable[..., None] | None, given: tuple[object, ...]) -> None:
    """Start a worker that ends when its parent ends, for whatever reason."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCHED_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    if begin is not None:
        begin(*given)


@contextmanager
def _environment() -> Iterator[None]:
    """Set ENVIRONMENT for processes started inside."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
