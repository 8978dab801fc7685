"""Writes an `Episode` as one `.rrd` file: beside the old one, then in its place."""

import os
import uuid
from pathlib import Path

import rerun as rr

from taichi_sim.recording.blueprint import blueprint
from taichi_sim.recording.draw import draw
from taichi_sim.recording.episode import Episode
from taichi_sim.recording.stream import Stream

APPLICATION = "taichi_sim"


def write_recording(episode: Episode, path: Path) -> Path:
    """Write `episode` to `path`; an old file stays until the new one is complete.

    Raises OSError, with the operating system's reason, where the disk or the folder cannot take it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        _write(episode, part)
        os.replace(part, path)
    finally:
        rr.set_strict_mode(strict)
        part.unlink(missing_ok=True)
    return path


def _write(episode: Episode, part: Path) -> None:
    """Fill the temporary file `part` from memory: rerun itself would wait forever on a disk that fills up."""
    recording = uuid.uuid4()
    # a viewer keeps one layout for each application: under one name, an episode would open in that of another
    application = f"{APPLICATION} {episode.name} {recording.hex[:6]}"
    with rr.RecordingStream(application, recording_id=str(recording)) as rec:
        memory = rec.memory_recording()
        rec.send_blueprint(blueprint(episode), make_active=False, make_default=True)
        draw(Stream(rec), episode)
    try:
        with part.open("wb") as file:
            file.write(memory.drain_as_bytes())
            file.flush()
            os.fsync(file.fileno())
    except OSError as fault:
        raise OSError(fault.errno, f"recording not written: {fault.strerror}", str(part)) from fault
