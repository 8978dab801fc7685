"""A live view: who may connect, what viewers are sent, and that nothing of it is in the way of the simulation."""

import contextlib
import errno
import os
import signal
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import column
from rerun.chunk import RrdReader
from test_recording_parts import STEPS, busy, part

from taichi_sim.visualisation.recording import live as live_module
from taichi_sim.visualisation.recording.live import Live, program, serve_web
from taichi_sim.visualisation.recording.rrd import write_recording

WAITS_S = 30.0  # a call that waits for a server waits for ever; a busy machine takes some seconds


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def live() -> Iterator[Live]:
    with Live("test", port=free_port(), viewer=False) as view:
        yield view


def show(live: Live, begin: int, end: int, after_s: float = 0.0) -> None:
    """Steps of an episode, each part at once: nothing is waited for, whatever becomes of it."""
    began = time.monotonic()
    live.show(replace(part(busy(), begin, end), like=live.like), after_s=after_s)
    assert time.monotonic() - began < WAITS_S


def settle(file: Path) -> None:
    """Wait until a client has written what it is sent."""
    deadline, size = time.monotonic() + WAITS_S, -1
    while time.monotonic() < deadline and (not file.exists() or file.stat().st_size > size):
        size = file.stat().st_size if file.exists() else -1
        time.sleep(1.0)


def server_of(live: Live) -> int:
    """The process that listens, below the one that ties it to this process."""
    shell = live._server.pid
    children = Path(f"/proc/{shell}/task/{shell}/children").read_text().split()
    (found,) = [int(child) for child in children if "rerun" in Path(f"/proc/{child}/cmdline").read_text()]
    return found


def viewer_of(live: Live, file: Path) -> subprocess.Popen:
    """A client of rerun's own that writes what it is sent to `file`, until the server ends."""
    command = [program(), live.url, "--save", str(file), "--bind", "127.0.0.1", "--port", str(free_port())]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def test_viewers_that_come_and_go_see_what_is_shown(live: Live, tmp_path: Path) -> None:
    gone = viewer_of(live, tmp_path / "gone.rrd")
    show(live, 0, 20)
    gone.kill()
    gone.wait(WAITS_S)
    show(live, 20, 22)
    live.begin()  # another episode, later
    show(live, 0, 20, after_s=30.0)
    late = viewer_of(live, tmp_path / "late.rrd")
    live.plot("reward", {"usv": 1.5}, 50.0, ("decision", 7))
    settle(tmp_path / "late.rrd")
    live.close()
    late.wait(WAITS_S)
    times, steps, place = column(tmp_path / "late.rrd", "/world/usv/vehicle_0", "Transform3D:translation")
    np.testing.assert_array_equal(steps, np.arange(42))
    np.testing.assert_allclose(times * 1e-9, 0.1 * np.r_[:22, 300:320])
    north, east, down = busy().teams["usv"].position_n[np.r_[:22, :20], 0].T
    np.testing.assert_array_equal(place, np.stack([east, north, -down], 1).astype(np.float32))

    def batches(entity: str) -> list:
        chunks = RrdReader(tmp_path / "late.rrd").stream().filter(content=entity, is_static=False)
        return [chunk.to_record_batch() for chunk in chunks]

    (point,) = batches("/plots/curves/reward")
    assert point.column("Scalars:scalars").to_pylist() == [[1.5]]
    assert point.column("decision").to_pylist() == [7]
    assert any("Clear:is_recursive" in batch.schema.names for batch in batches("/world"))


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="it is asked of Linux who listens where")
def test_nobody_else_can_connect_and_nothing_is_left(live: Live) -> None:
    port = int(live.url.split(":")[-1].split("/")[0])

    def listening() -> set[str]:
        lines = [line for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
        places = [line.split()[1].split(":") for line in lines if line.split()[3] == "0A"]
        return {address for address, number in places if int(number, 16) == port}

    assert listening() == {"0100007F"}  # 127.0.0.1
    live.close()
    deadline = time.monotonic() + WAITS_S
    while listening() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not listening()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_server_that_dies_or_hangs_holds_nothing_up(live: Live, number: signal.Signals, monkeypatch) -> None:
    monkeypatch.setattr(live_module, "ENDS_S", 0.5)
    show(live, 0, 20)
    server = server_of(live)
    os.kill(server, number)
    for begin in range(20, STEPS - 2, 2):
        show(live, begin, begin + 2)
    began = time.monotonic()
    live.close()
    assert time.monotonic() - began < WAITS_S
    if number == signal.SIGSTOP:
        with contextlib.suppress(ProcessLookupError):  # `close` may have ended it
            os.kill(server, signal.SIGKILL)


def test_a_port_in_use_is_refused_by_name(live: Live) -> None:
    port = int(live.url.split(":")[-1].split("/")[0])
    with pytest.raises(OSError, match=f"port {port}.*--port") as refused:
        Live("other", port=port, viewer=False)
    assert refused.value.errno == errno.EADDRINUSE


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="it is asked of Linux who listens where")
def test_a_recording_is_served_to_browsers_on_this_machine_alone(tmp_path: Path) -> None:
    port, web = free_port(), free_port()
    server, url = serve_web(write_recording(busy(), tmp_path / "busy.rrd"), port, web)
    with urllib.request.urlopen(url, timeout=WAITS_S) as page:
        assert b"rerun" in page.read().lower()
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    places = [line[1].split(":") for line in lines if line[3] == "0A"]
    assert {at for at, number in places if int(number, 16) in (port, web)} == {"0100007F"}
    with pytest.raises(OSError, match=f"port {web} cannot be had"):
        serve_web(tmp_path / "busy.rrd", free_port(), web)
    assert server.stdin is not None
    server.stdin.close()
    server.wait(WAITS_S)


def test_a_ghost_sails_in_the_same_scene(tmp_path: Path) -> None:
    other = part(busy(), 0, 20)  # it ended early
    file = write_recording(replace(busy(), ghost=other), tmp_path / "ghost.rrd")
    _, steps, place = column(file, "/world/usv/ghost_0", "Transform3D:translation")
    np.testing.assert_array_equal(steps, np.arange(20))
    north, east, down = other.teams["usv"].position_n[:, 0].T
    np.testing.assert_array_equal(place, np.stack([east, north, -down], 1).astype(np.float32))
    assert len(column(file, "/world/usv/vehicle_0", "Transform3D:translation")[1]) == STEPS
