"""Runs a command as several processes with torchrun's engine, and restarts them after one was lost.

`--processes N` means `torchrun --standalone --nproc-per-node=N`, with two differences: an error of the user ends the
command with its message instead of a restart, and a killed process always leads to a restart.

Each worker that fails writes the reason to a file, whose path the engine puts into TORCHELASTIC_ERROR_FILE.
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
from typing import NamedTuple

from rl.runs import ranks, signals
from rl.runs.folder import RunError
from taichi_sim.config.machine import own_cores
from taichi_sim.errors import message

RESTARTS = 20  # most restarts after lost processes
MAX_PER_CORE = 8  # processes
ENOUGH = 128  # least environments of a process: with fewer it mostly waits
LAUNCHED = "TAICHI_SIM_LAUNCHED"  # environment variable of workers: process id of the launcher
MINE, LOST, UNEXPECTED = "mistake", "lost", "unexpected"


class Failure(NamedTuple):
    """Why a worker ended."""

    rank: int
    kind: str  # MINE: error of the user; LOST: another process is gone; UNEXPECTED: any other error
    text: str
    time: float


def launched() -> bool:
    """Whether `run` started this process."""
    return LAUNCHED in os.environ and ranks.engine() is not None


def process_count(given: int | None, threads: int, share: int, arch: str = "cpu", enough: int = ENOUGH) -> int:
    """Number of processes for `share` environments, episodes or cells: `given`, or by default one for each core.

    The default is one process if `threads` is set, on a GPU, or where each process would have fewer than `enough`. It
    is also one in a process that the engine started.
    """
    if ranks.engine() is not None:
        return 1
    cores = len(own_cores())
    if given is None:
        return 1 if threads or arch != "cpu" else max(1, min(cores, share // enough))
    most = max(1, min(MAX_PER_CORE * cores, share)) if enough > 1 else MAX_PER_CORE * cores
    if given > most:
        why = f"this machine has {cores} cores" if most == MAX_PER_CORE * cores else f"a stage has {share} environments"
        raise RunError(f"--processes {given}: allowed are 1 to {most}; {why}")
    given = min(given, share)
    if given > cores:
        print(f"warning: {given} processes share {cores} cores: they will wait for each other", file=sys.stderr)
    return given


def run(script: Path, arguments: list[str], number: int) -> None:
    """Run a script of rl/ as `number` processes; return when all have succeeded.

    Raises:
        KeyboardInterrupt: if this process was interrupted, after all others have ended.
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
    """Run the processes once; return their failures, None if all succeeded."""
    from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs, SignalException
    from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
    from torch.distributed.launcher.api import LaunchConfig, elastic_launch

    logging.getLogger("torch.distributed").setLevel(logging.CRITICAL)  # `run` prints the failures
    os.environ[LAUNCHED] = str(os.getpid())
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, len(own_cores()) // number)))
    with tempfile.TemporaryDirectory(prefix="taichi-sim-") as logs:
        config = LaunchConfig(
            min_nodes=1, max_nodes=1, nproc_per_node=number, run_id=uuid.uuid4().hex[:8], max_restarts=0,
            rdzv_backend="c10d", rdzv_endpoint="127.0.0.1:0", local_addr="127.0.0.1", logs_specs=DefaultLogsSpecs(logs),
            signals_to_handle="SIGTERM,SIGINT",
        )  # fmt: skip
        try:
            elastic_launch(config, sys.executable)(str(script), *arguments)
        except SignalException as ended:
            told = (failure.text for failure in _failures(logs) if failure.rank == 0 and failure.kind == MINE)
            raise signals.interruption(ended.sigval, next(told, "")) from None
        except ChildFailedError as error:
            killed = [
                Failure(rank, LOST, f"was killed ({of.signal_name()})", time.time())
                for rank, of in error.failures.items()
                if of.exitcode < 0
            ]
            silent = [Failure(rank, UNEXPECTED, "ended without a message", time.time()) for rank in error.failures]
            return _failures(logs) + killed or silent
        finally:
            del os.environ[LAUNCHED]
    return None


def _failures(logs: str) -> list[Failure]:
    """The failures that workers wrote into the folder `logs`."""
    found = []
    for file in sorted(Path(logs).rglob("error.json")):
        try:
            error = json.loads(file.read_text(encoding="utf-8"))["message"]
            found.append(Failure(error["rank"], error["kind"], error["message"], float(error["time"])))
        except (OSError, ValueError, KeyError, TypeError):
            continue  # written by the engine itself, or cut short
    return found


def _cause(failures: list[Failure]) -> Failure:
    """The failure that caused the others: the first that is not merely the loss of another process."""
    order = (MINE, UNEXPECTED, LOST)
    return min(failures, key=lambda of: (order.index(of.kind), not of.text.startswith("was killed"), of.time))


def run_worker(main: Callable[[list[str] | None], None], argv: list[str] | None) -> int:
    """Run an entry point as a process of torchrun; write the reason if it fails, return its exit status.

    Args:
        main: the entry point.
        argv: its arguments.
    """
    _end_with_launcher()
    silent = LAUNCHED in os.environ  # the launcher prints the message
    with signals.sigterm_as_interrupt():
        try:
            main(argv)
            return 0
        except KeyboardInterrupt as interrupt:
            text, kind, status = str(interrupt), MINE, signals.status(interrupt)
        except Exception as error:
            told, status = message(error), 1
            kind = MINE if told is not None else LOST if lost_another(error) else UNEXPECTED
            text = told or ("lost the others" if kind == LOST else f"{type(error).__name__}: {error}")
            if kind == UNEXPECTED:
                traceback.print_exc()
    _write_error(text, kind)
    if not silent:
        print(f"process {ranks.here().rank}: {text}", file=sys.stderr)
    return status


def _write_error(text: str, kind: str) -> None:
    file = os.environ.get("TORCHELASTIC_ERROR_FILE")
    if not file:
        return
    now = time.time()
    extra = {"timestamp": str(int(now)), "py_callstack": ""}
    error = {"message": text, "kind": kind, "rank": ranks.here().rank, "time": now, "extraInfo": extra}
    with open(file, "w", encoding="utf-8") as stream:
        json.dump({"message": error}, stream)


def lost_another(error: BaseException) -> bool:
    """Whether an error only says that another process is gone."""
    words = ("connection closed by peer", "connection reset", "broken pipe", "connection refused", "timed out waiting",
             "connection was likely closed", "failed to recv", "gloo")  # fmt: skip
    return isinstance(error, RuntimeError) and any(word in str(error).lower() for word in words)


def _end_with_launcher() -> None:
    """End this worker when the process that started it is gone, however that ended."""
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
