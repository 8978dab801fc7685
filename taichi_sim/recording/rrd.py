"""Writes an `Episode` as one `.rrd` file: beside the old one, then in its place."""

import errno
import os
import uuid
from pathlib import Path

import rerun as rr

from taichi_sim.recording.blueprint import blueprint
from taichi_sim.recording.draw import draw
from taichi_sim.recording.episode import Episode
from taichi_sim.recording.stream import Stream

APPLICATION = "taichi_sim"
FOOTER = b"RRF2FOOT"  # in the last bytes of a whole file
RESERVE = 1 << 20  # bytes that must fit first: on a disk already full, rerun's `save` never returns


def write_recording(episode: Episode, path: Path) -> Path:
    """Write `episode` to `path`; an old file there stays until the new one is whole.

    Raises OSError, with the operating system's reason, where the disk or the folder cannot take it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        _reserve(part)
        _write(episode, part)
        os.replace(part, path)
    finally:
        rr.set_strict_mode(strict)
        part.unlink(missing_ok=True)
    return path


def _write(episode: Episode, part: Path) -> None:
    """Fill `part`. rerun writes from its own thread and reports a failure there late, as a RuntimeError."""
    logged, recording = False, uuid.uuid4()
    # a viewer keeps one layout for each application: under one name, an episode would open in that of another
    application = f"{APPLICATION} {episode.name} {recording.hex[:6]}"
    try:
        with rr.RecordingStream(application, recording_id=str(recording)) as rec:
            rec.save(part, default_blueprint=blueprint(episode))
            draw(Stream(rec), episode)
            logged = True
    except RuntimeError as fault:
        if logged:
            raise _disk_fault(part, str(fault)) from fault
        raise
    with part.open("rb") as file:
        file.seek(-min(64, part.stat().st_size), os.SEEK_END)
        if FOOTER not in file.read():
            raise _disk_fault(part, "the file has no footer")
        os.fsync(file.fileno())


def _reserve(part: Path) -> None:
    """Grow `part` by a little, or raise the operating system's own reason why it cannot grow."""
    try:
        with part.open("ab") as file:
            file.write(bytes(RESERVE))
            file.flush()
            os.fsync(file.fileno())
    except OSError as fault:
        raise OSError(fault.errno, f"recording not written: {fault.strerror}", str(part)) from fault


def _disk_fault(part: Path, reason: str) -> OSError:
    """Why `part` is not whole: the operating system's reason where it gives one, else rerun's."""
    try:
        _reserve(part)
    except OSError as fault:
        return fault
    return OSError(errno.EIO, f"recording not written: {reason}", str(part))
