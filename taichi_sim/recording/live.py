"""A live view: parts of an episode, streamed to a rerun viewer on this machine while it is simulated.

A server of rerun's own runs beside the simulation, on the loopback alone, and keeps what viewers that come later are to
see; it ends with this process. Where there is a display, a viewer is opened on it. Everything is sent from a thread of
its own: a viewer that is closed, or a server that has died or hangs, costs the simulation nothing.
"""

import contextlib
import errno
import os
import queue
import shlex
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from taichi_sim.recording.blueprint import CURVES, LiveLayout, blueprint
from taichi_sim.recording.draw import draw
from taichi_sim.recording.episode import Episode
from taichi_sim.recording.stream import Stream

PORT = 9876  # rerun's own
HOST = "127.0.0.1"
SERVER_MEMORY, VIEWER_MEMORY = "512MB", "2GB"  # then the oldest goes
WAITING = 100  # parts not sent yet, at most; more are dropped
STARTS_S, ENDS_S = 60.0, 2.0  # how long the server may take to start, and what is left to be sent
ROOTS = ("world", "map")  # where an episode's things are
QUIET = {"RERUN_APP_ONLY": "true"}  # rerun asks and tells nothing when it starts
# the server ends when the pipe to this process closes, however that happens
TIED = "{command} & child=$!; cat > /dev/null; kill -9 $child"


class Live:
    """A live view that shows parts of episodes, one after the other.

        with Live("calm") as live:
            print(live.told)
            while ...:
                live.show(recorder.part(like=live.like))

    Attributes:
        url: where viewers connect. told: what to tell the user. like: what parts are to be drawn like, None before the
            first; that one should be some seconds long, for scales and layout are taken from it.
    """

    def __init__(self, name: str, *, port: int = PORT, viewer: bool | None = None, everywhere: bool = False) -> None:
        """Start a server at `port`, and a `viewer` (default: if there is a display); if `everywhere`, the map shows
        the whole area, for there will be more than one episode.

        Raises:
            OSError: if the port is in use, or the server does not start.
        """
        refuse_used(port)
        self.url = f"rerun+http://{HOST}:{port}/proxy"
        self._server = _tied([program(), "--serve-grpc", "--bind", HOST, "--port", str(port),
                              "--server-memory-limit", SERVER_MEMORY])  # fmt: skip
        _await_server(self._server, port)
        viewer = has_display() if viewer is None else viewer
        if viewer:
            command = [program(), self.url, "--bind", HOST, "--port", "auto", "--memory-limit", VIEWER_MEMORY]
            self._viewer = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                start_new_session=True, env=os.environ | QUIET,
            )  # fmt: skip
        self.told = f"live: {'a viewer is opening; another: ' if viewer else ''}rerun {self.url}"
        # a viewer keeps one layout for each application
        self._rec = rr.RecordingStream(f"taichi_sim live {name} {uuid.uuid4().hex[:6]}")
        self._rec.connect_grpc(self.url)
        self._outbox = _Outbox(self._rec)
        self._stream: Stream | None = None
        self._first, self._everywhere = 0, everywhere
        self._curves: dict[str, tuple[str, ...]] = {}
        self.like: Episode | None = None

    def __enter__(self) -> "Live":
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def show(self, part: Episode, *, after_s: float = 0.0, at: float = 0.0) -> None:
        """Draw the next part of an episode, its clock counted from `after_s`; viewers get it at `at` (s, of
        time.monotonic), or when what was before it is through.
        """
        if self.like is None:
            self.like = part
            self._outbox.begin()
            layout = LiveLayout(tuple(self._curves), self._everywhere)
            self._outbox.call(self._rec.send_blueprint, blueprint(part, layout))
            self._outbox.log("events", rr.TextLog("live", level="INFO"), static=True)
            self._outbox.end(at)
        self._outbox.begin()
        if self._stream is None:
            self._clear(float(part.time_s[0]) + after_s)
            self._stream = Stream(self._outbox, first=self._first)
        self._stream.after_s = after_s
        draw(self._stream, part)
        self._first = self._stream.first + len(part.time_s)
        if not self._outbox.end(at):
            self._stream = None  # what is to come would go on from what never came

    def begin(self, *, anew: bool = False) -> None:
        """Announce that the next part belongs to another episode; `anew`: with other teams, so lay out again."""
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

    def _clear(self, time_s: float) -> None:
        """Clear all entities of the episode before."""
        clock = {"sim_time": np.timedelta64(round(time_s * 1e9) - 1, "ns")}
        for root in ROOTS:
            self._outbox.call(_log_at, self._rec, clock, root, rr.Clear(recursive=True))

    def close(self) -> None:
        """End the server; viewers keep their data."""
        if self._outbox.close():
            self._rec.disconnect()
        assert self._server.stdin is not None
        with contextlib.suppress(OSError):
            self._server.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._server.wait(ENDS_S)


class _Outbox:
    """Stands in for a recording stream: a thread sends what is logged later, a whole part or nothing."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._calls: list[tuple[Any, tuple, dict]] = []
        self._parts: queue.Queue[tuple[float, list] | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._send, name="live", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Begin a part."""
        self._calls = []

    def call(self, function: Any, *args: Any, **kwargs: Any) -> None:
        """Queue a call."""
        self._calls.append((function, args, kwargs))

    def log(self, *args: Any, **kwargs: Any) -> None:
        """See RecordingStream.log."""
        self.call(self._rec.log, *args, **kwargs)

    def send_columns(self, *args: Any, **kwargs: Any) -> None:
        """See RecordingStream.send_columns."""
        self.call(self._rec.send_columns, *args, **kwargs)

    def end(self, at: float) -> bool:
        """Schedule the part for `at`; False if too many wait already, so that it is dropped."""
        try:
            self._parts.put_nowait((at, self._calls))
        except queue.Full:
            return False
        return True

    def _send(self) -> None:
        while (part := self._parts.get()) is not None:
            at, calls = part
            time.sleep(max(0.0, at - time.monotonic()))
            for function, args, kwargs in calls:
                function(*args, **kwargs)

    def close(self) -> bool:
        """Send what waits, if that does not take long; return whether all was sent."""
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


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _log_at(rec: rr.RecordingStream, clock: Mapping[str, Any], path: str, thing: Any) -> None:
    for timeline, now in clock.items():
        rec.set_time(timeline, duration=now)
    rec.log(path, thing)
    rec.reset_time()


def refuse_used(port: int) -> None:
    """Refuse a port that is in use.

    Raises:
        OSError: naming the port.
    """
    if port > 65535:
        raise OSError(errno.EINVAL, f"port {port} is above 65535: give another with --port")
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
    found = os.environ.get("RERUN_CLI_PATH") or next((str(place) for place in places if place.exists()), None)
    if found is None:
        raise OSError(errno.ENOENT, f"rerun's viewer is not in {folder}: install rerun-sdk anew")
    return found


def _tied(command: Sequence[str]) -> subprocess.Popen:
    """Run a command that ends with this process and ignores its Ctrl-C."""
    return subprocess.Popen(
        ["sh", "-c", TIED.format(command=shlex.join(command))], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True, env=os.environ | QUIET,
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
