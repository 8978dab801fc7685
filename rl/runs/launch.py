"""Starting a command as several processes, by torchrun's engine, and again after one of them was lost.

`--processes N` is what `torchrun --standalone --nproc-per-node=N` is, with two differences: a user's mistake ends the
command with its message instead of being tried again, and a process that was killed is always worth another try.

Every worker that fails leaves a file that says why, which the engine names in TORCHELASTIC_ERROR_FILE.
"""

import json
import logging
import os
import sys
import tempfile
import threading
import time
import traceback
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rl import processes
from rl.processes import signals
from rl.runs.folder import RunError

RESTARTS = 20  # after a process was lost
MOST = 8  # processes a core
ENOUGH = 128  # environments that a process should have at least: below, it mostly waits
LAUNCHED = "TAICHI_SIM_LAUNCHED"  # in the environment of workers: the launcher's process
MINE, LOST, UNEXPECTED = "mistake", "lost", "unexpected"


class Failure(NamedTuple):
    """Why a worker ended."""

    rank: int
    kind: str  # MINE: a user's mistake; LOST: the others were gone; UNEXPECTED: anything else
    text: str
    time: float


def launched() -> bool:
    """Whether this process is one of those that `run` has started."""
    return LAUNCHED in os.environ and processes.engine() is not None


def wanted(given: int | None, threads: int, share: int, arch: str = "cpu", enough: int = ENOUGH) -> int:
    """How many processes to start to do `share` environments, episodes or cells: `given`, or by default one a core.

    By default it is one if the number of `threads` is given, on a GPU, and where each would have fewer than `enough`;
    also in a process that the engine has started itself.

    Raises:
        RunError: for more than the machine bears, or than there is to share.
    """
    if processes.engine() is not None:
        return 1
    cores = len(os.sched_getaffinity(0))
    if given is None:
        return 1 if threads or arch != "cpu" else max(1, min(cores, share // enough))
    most = max(1, min(MOST * cores, share)) if enough > 1 else MOST * cores
    if given > most:
        why = f"this machine has {cores} cores" if most == MOST * cores else f"a stage has {share} environments"
        raise RunError(f"--processes {given}: allowed are 1 to {most}; {why}")
    given = min(given, share)
    if given > cores:
        print(f"warning: {given} processes share {cores} cores: they will wait for each other", file=sys.stderr)
    return given


def run(script: Path, arguments: list[str], number: int) -> None:
    """Run a script of rl/ as so many processes; return when all have succeeded.

    Raises:
        RunError: if one failed, with its message and rank. KeyboardInterrupt: if this process was asked to end; all
            have ended then.
    """
    for attempt in range(RESTARTS + 1):
        failures = _attempt(script, arguments, number)
        if failures is None:
            return
        first = _cause(failures)
        if first.kind != LOST or attempt == RESTARTS:
            raise RunError(first.text if first.kind == MINE else f"process {first.rank} of {number}: {first.text}")
        print(f"\nprocess {first.rank} of {number} {first.text}: all start again from the last checkpoint "
              f"({attempt + 1} of {RESTARTS})", file=sys.stderr)  # fmt: skip


def _attempt(script: Path, arguments: list[str], number: int) -> list[Failure] | None:
    """What went wrong, if anything did."""
    from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs, SignalException
    from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
    from torch.distributed.launcher.api import LaunchConfig, elastic_launch

    logging.getLogger("torch.distributed").setLevel(logging.CRITICAL)  # what it would say is said here
    os.environ[LAUNCHED] = str(os.getpid())
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, len(os.sched_getaffinity(0)) // number)))
    with tempfile.TemporaryDirectory(prefix="taichi-sim-") as logs:
        config = LaunchConfig(
            min_nodes=1, max_nodes=1, nproc_per_node=number, run_id=uuid.uuid4().hex[:8], max_restarts=0,
            rdzv_backend="c10d", rdzv_endpoint="127.0.0.1:0", local_addr="127.0.0.1", logs_specs=DefaultLogsSpecs(logs),
            signals_to_handle="SIGTERM,SIGINT",
        )  # fmt: skip
        try:
            elastic_launch(config, sys.executable)(str(script), *arguments)
        except SignalException as ended:
            raise signals.interruption(ended.sigval, _told(logs)) from None
        except ChildFailedError as error:
            killed = [
                Failure(rank, LOST, f"was killed ({of.signal_name()})", time.time())
                for rank, of in error.failures.items()
                if of.exitcode < 0
            ]
            silent = [Failure(rank, UNEXPECTED, "ended without a word", time.time()) for rank in error.failures]
            return _failures(logs) + killed or silent
        finally:
            del os.environ[LAUNCHED]
    return None


def _failures(logs: str) -> list[Failure]:
    """What workers have left."""
    found = []
    for file in sorted(Path(logs).rglob("error.json")):
        try:
            said = json.loads(file.read_text(encoding="utf-8"))["message"]
            found.append(Failure(said["rank"], said["kind"], said["message"], float(said["time"])))
        except (OSError, ValueError, KeyError, TypeError):
            continue  # of the engine itself, or cut short
    return found


def _told(logs: str) -> str:
    """What rank 0 said when it was interrupted."""
    return next((failure.text for failure in _failures(logs) if failure.rank == 0 and failure.kind == MINE), "")


def _cause(failures: list[Failure]) -> Failure:
    """Of several, that of which the others are consequences: the first that is not just the loss of another."""
    order = (MINE, UNEXPECTED, LOST)
    return min(failures, key=lambda of: (order.index(of.kind), not of.text.startswith("was killed"), of.time))


def run_worker(
    main: Callable[[list[str] | None], None], argv: list[str] | None, mistake: Callable[[Exception], str | None]
) -> int:
    """Run an entry point as a process that torchrun has started; leave word of how it ended, return its exit status.

    `mistake` gives what a user is told of an error that is the user's.
    """
    _end_with_launcher()
    silent = LAUNCHED in os.environ  # the launcher tells
    with signals.heeded():
        try:
            main(argv)
            return 0
        except KeyboardInterrupt as interrupt:
            text, kind, status = str(interrupt), MINE, signals.status(interrupt)
        except Exception as error:
            said, status = mistake(error), 1
            kind = MINE if said is not None else LOST if lost_another(error) else UNEXPECTED
            text = said or ("lost the others" if kind == LOST else f"{type(error).__name__}: {error}")
            if kind == UNEXPECTED:
                traceback.print_exc()
    _leave_word(text, kind)
    if not silent:
        print(f"process {processes.here().rank}: {text}", file=sys.stderr)
    return status


def _leave_word(text: str, kind: str) -> None:
    file = os.environ.get("TORCHELASTIC_ERROR_FILE")
    if not file:
        return
    now = time.time()
    said: dict[str, Any] = {"message": text, "kind": kind, "rank": processes.here().rank, "time": now}
    said["extraInfo"] = {"timestamp": str(int(now)), "py_callstack": ""}
    with open(file, "w", encoding="utf-8") as stream:
        json.dump({"message": said}, stream)


def lost_another(error: BaseException) -> bool:
    """Whether an error only says that another process is gone."""
    words = ("connection closed by peer", "connection reset", "broken pipe", "connection refused", "timed out waiting",
             "connection was likely closed", "failed to recv", "gloo")  # fmt: skip
    return isinstance(error, RuntimeError) and any(word in str(error).lower() for word in words)


def _end_with_launcher() -> None:
    """In a worker: end when the process that has started it is gone, however it ended."""
    parent = os.environ.get(LAUNCHED)
    if parent is None:
        return

    def watch() -> None:
        while os.getppid() == int(parent):
            time.sleep(1.0)
        os.kill(os.getpid(), signals.signal.SIGTERM)
        time.sleep(30.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
