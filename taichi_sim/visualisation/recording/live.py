"""A live view: parts of an episode, streamed to a rerun viewer on this machine while it is simulated.

A rerun server runs beside the simulation, on the loopback interface only, and ends with this process. It keeps the data
for viewers that connect later. If there is a display, a viewer is opened on it. A thread sends all data, so a viewer
that is closed, or a server that has died or hangs, does not slow the simulation.
"""

import contextlib
import errno
import functools
import os
import queue
import shlex
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import ParamSpec
from urllib.parse import quote

import numpy as np
import rerun as rr

from taichi_sim.visualisation.recording.blueprint import CURVES, LiveLayout, blueprint
from taichi_sim.visualisation.recording.episode import Episode
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.rrd import draw

PORT, WEB_PORT = 9876, 9090  # rerun's defaults
HOST = "127.0.0.1"
SERVER_MEMORY, VIEWER_MEMORY = "512MB", "2GB"  # beyond it the oldest data are dropped
WAITING = 100  # largest number of parts that wait to be sent; further ones are dropped
STARTS_S, ENDS_S = 60.0, 2.0  # time limits: for the server to start, for the last parts to be sent
ROOTS = ("world", "map")  # roots of an episode's entities
QUIET = {"RERUN_APP_ONLY": "true"}  # rerun shows no questions or notices when it starts
# the server ends when the pipe to this process closes, however that happens
TIED = "{command} & child=$!; cat > /dev/null; kill -9 $child"


P = ParamSpec("P")


class Live:
    """A live view that shows parts of episodes, one after the other.

        with Live("calm") as live:
            print(live.told)
            while ...:
                live.show(recorder.part(like=live.like))

    Attributes:
        url: address to which viewers connect.
        told: line of text for the user, with the address.
        like: episode that sets scales and layout of all parts; None before the first part, which becomes it and should
            therefore be some seconds long.
    """

    def __init__(self, name: str, *, port: int = PORT, viewer: bool | None = None, everywhere: bool = False) -> None:
        """Start a server at `port`, and a viewer if `viewer` (default: if there is a display).

        With `everywhere` the map shows the whole area, because several episodes will follow.

        Raises:
            OSError: if the port is in use, or the server does not start.
        """
        refuse_used(port)
        self.url = f"rerun+http://{HOST}:{port}/proxy"
        limit = ["--server-memory-limit", SERVER_MEMORY]
        command = [program(), "--serve-grpc", "--bind", HOST, "--port", str(port), *limit]
        self._server = _started(["sh", "-c", TIED.format(command=shlex.join(command))], subprocess.PIPE)
        _await_server(self._server, port)
        if viewer is None:
            display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
            viewer = sys.platform in ("darwin", "win32") or bool(display)
        if viewer:
            command = [program(), self.url, "--bind", HOST, "--port", "auto", "--memory-limit", VIEWER_MEMORY]
            self._viewer = _started(command, subprocess.DEVNULL)
        self.told = f"live: {'a viewer is opening; another: ' if viewer else ''}rerun {self.url}"
        # a viewer stores one layout per application name
        self._rec = rr.RecordingStream(f"taichi_sim live {name} {uuid.uuid4().hex[:6]}")
        self._rec.connect_grpc(self.url)
        self._outbox = _Outbox(self._rec)
        self._stream: Stream | None = None
        self._first, self._everywhere = 0, everywhere
        self._curves: dict[str, tuple[str, ...]] = {}
        self.like: Episode | None = None

    def __enter__(self) -> "Live":
        """Return the view itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the view."""
        self.close()

    def show(self, part: Episode, *, after_s: float = 0.0, at: float = 0.0) -> None:
        """Draw the next part of an episode; its clock counts from `after_s` (s).

        Viewers receive it at `at` (s, of time.monotonic), or once earlier parts have been sent.
        """
        if self.like is None:
            self.like = part
            self._outbox.begin()
            layout = LiveLayout(tuple(self._curves), self._everywhere)
            self._outbox.call(self._rec.send_blueprint, blueprint(part, layout))
            self._outbox.log("events", rr.TextLog("live", level="INFO"), static=True)
            self._outbox.end(at)
        self._outbox.begin()
        if self._stream is None:  # nothing of the previous episode stays
            clock = np.timedelta64(round((float(part.time_s[0]) + after_s) * 1e9) - 1, "ns")
            for root in ROOTS:
                self._outbox.call(_log_at, self._rec, clock, root, rr.Clear(recursive=True))
            self._stream = Stream(self._outbox, first=self._first)
        self._stream.after_s = after_s
        draw(self._stream, part)
        self._first = self._stream.first + len(part.time_s)
        if not self._outbox.end(at):
            self._stream = None  # the next part must not continue one that was dropped

    def begin(self, *, anew: bool = False) -> None:
        """Announce that the next part belongs to another episode; `anew`: its teams, and so its layout, are others."""
        self._stream = None
        if anew:
            self.like, self._curves = None, {}

    def plot(self, name: str, values: Mapping[str, float], time_s: float, step: tuple[str, int]) -> None:
        """Add a point to each line of the plot `name`, at `time_s` and at a count such as ("iteration", 3)."""
        lines = self._curves.setdefault(name, tuple(values))
        path = f"plots/{CURVES}/{name}"
        clock = [rr.TimeColumn("sim_time", duration=[time_s]), rr.TimeColumn(step[0], sequence=[step[1]])]
        points = rr.Scalars.columns(scalars=[values.get(line, np.nan) for line in lines]).partition([len(lines)])
        self._outbox.begin()
        self._outbox.log(path, rr.SeriesLines(names=list(lines)), static=True)
        self._outbox.send_columns(path, clock, points)
        self._outbox.end(0.0)

    def close(self) -> None:
        """End the server; viewers keep their data."""
        if self._outbox.close():
            self._rec.disconnect()
        assert self._server.stdin is not None
        with contextlib.suppress(OSError):
            self._server.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._server.wait(ENDS_S)


def serve_web(file: Path, port: int = PORT, web_port: int = WEB_PORT) -> tuple[subprocess.Popen, str]:
    """Serve a recording to browsers on this machine, until the process that is returned, or this one, ends.

    Also returns the address to open.
    """
    refuse_used(port)
    refuse_used(web_port)
    ports = ["--port", str(port), "--web-viewer-port", str(web_port)]
    command = [program(), str(file), "--serve-web", "--bind", HOST, *ports, "--server-memory-limit", SERVER_MEMORY]
    server = _started(["sh", "-c", TIED.format(command=shlex.join(command))], subprocess.PIPE)
    _await_server(server, web_port)
    return server, f"http://{HOST}:{web_port}?url=" + quote(f"rerun+http://{HOST}:{port}/proxy", safe="")


class _Outbox:
    """Replaces a recording stream: queues all calls, which a thread sends part by part."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._calls: list[Callable[[], object]] = []
        self._parts: queue.Queue[tuple[float, list[Callable[[], object]]] | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._send, name="live", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Queue the calls that follow as a new part."""
        self._calls = []

    def call(self, function: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Queue a call."""
        self._calls.append(functools.partial(function, *args, **kwargs))

    def log(self, path: str, thing: rr.AsComponents, *, static: bool = False) -> None:
        """Queue RecordingStream.log."""
        self.call(self._rec.log, path, thing, static=static)

    def send_columns(self, path: str, clock: Iterable[rr.TimeColumn], columns: Iterable) -> None:
        """Queue RecordingStream.send_columns."""
        self.call(self._rec.send_columns, path, clock, columns)

    def end(self, at: float) -> bool:
        """Schedule the part for `at`; return False if too many parts wait already, so that this one is dropped."""
        try:
            self._parts.put_nowait((at, self._calls))
        except queue.Full:
            return False
        return True

    def _send(self) -> None:
        while (part := self._parts.get()) is not None:
            at, calls = part
            time.sleep(max(0.0, at - time.monotonic()))
            for call in calls:
                call()

    def close(self) -> bool:
        """Send the waiting parts within ENDS_S; return whether all were sent."""
        with contextlib.suppress(queue.Full):
            self._parts.put_nowait(None)
        self._thread.join(ENDS_S)
        if self._thread.is_alive():
            return False
        try:
            self._rec.flush(timeout_sec=ENDS_S)
        except (RuntimeError, ValueError):
            return False
        return True


def _log_at(rec: rr.RecordingStream, now: np.timedelta64, path: str, thing: rr.AsComponents) -> None:
    rec.set_time("sim_time", duration=now)
    rec.log(path, thing)
    rec.reset_time()


def refuse_used(port: int) -> None:
    """Refuse a port that is in use."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise OSError(
                error.errno, f"port {port} cannot be had ({(error.strerror or '').lower()}): give another with --port"
            ) from None


def program() -> str:
    """Path of rerun's program, which comes with its package."""
    import rerun_cli

    folder = Path(str(rerun_cli.__file__)).parent
    places = [folder / "rerun", folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"]
    if found := os.environ.get("RERUN_CLI_PATH") or next((str(place) for place in places if place.exists()), None):
        return found
    raise OSError(errno.ENOENT, f"rerun's viewer is not in {folder}: install rerun-sdk anew")


def _started(command: Sequence[str], stdin: int) -> subprocess.Popen:
    """Run a silent command that ignores this process's Ctrl-C."""
    return subprocess.Popen(
        command, stdin=stdin, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        env=os.environ | QUIET,
    )  # fmt: skip


def _await_server(server: subprocess.Popen, port: int) -> None:
    end = time.monotonic() + STARTS_S
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection((HOST, port), 0.2):
            return
        time.sleep(0.05)
    assert server.stdin is not None
    server.stdin.close()
    raise OSError(errno.ETIMEDOUT, f"rerun's server did not start at port {port}: give another with --port")
