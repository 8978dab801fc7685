"""Draws an `Episode`, or a part of one, into a rerun stream; writes one as an `.rrd` file.

A file is written under a temporary name, then renamed over the old one.
"""

import json
import os
import uuid
from collections.abc import Mapping
from pathlib import Path

import rerun as rr

from taichi_sim.config.io import replacing
from taichi_sim.visualisation.recording.arrows import arrow_text, send_air, send_flow, send_forces
from taichi_sim.visualisation.recording.blueprint import blueprint
from taichi_sim.visualisation.recording.draw_overlays import send_overlays
from taichi_sim.visualisation.recording.episode import Episode
from taichi_sim.visualisation.recording.plots import send_plots
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.static_scene import send_events, send_scene, send_sea
from taichi_sim.visualisation.recording.table import CONDITIONS
from taichi_sim.visualisation.recording.team_view import send_ghost, send_team

APPLICATION = "taichi_sim"


def draw(stream: Stream, episode: Episode) -> None:
    """Draw the whole episode, or the part that follows what the stream already holds."""
    stream.part(episode.time_s)
    if stream.begins:
        stream.static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        about = f"{arrow_text(episode)}{episode.config_text or f'# {episode.name}'}"
        stream.static("config", rr.TextDocument(about, media_type="text/markdown"))
        if episode.conditions:
            text = json.dumps(dict(episode.conditions))
            stream.static(CONDITIONS, rr.TextDocument(text, media_type="application/json"))
        send_scene(stream, episode)
    send_sea(stream, episode)
    for team in episode.teams.values():
        send_team(stream, episode, team)
        send_forces(stream, episode, team)
        send_air(stream, episode, team)
        send_plots(stream, episode, team)
    if episode.ghost is not None:
        send_ghost(stream, episode.ghost)
    send_flow(stream, episode)
    send_overlays(stream, episode)
    send_events(stream, episode)


def write_recording(episode: Episode | Mapping[str, Episode], path: Path) -> Path:
    """Write `episode` to `path`; an old file stays until the new one is complete.

    Several episodes, by caption, are shown side by side; the paths of each begin with its caption. Plots of errors show
    all of them, the other plots the last one.

    Raises:
        OSError: if the disk or the folder cannot take it, with the operating system's reason.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with replacing(path) as part:
            _write({"": episode} if isinstance(episode, Episode) else episode, part)
    finally:
        rr.set_strict_mode(strict)
    return path


def _write(episodes: Mapping[str, Episode], part: Path) -> None:
    """Write the temporary file `part` from memory, because rerun itself would wait forever on a full disk."""
    recording, (*_, main) = uuid.uuid4(), episodes
    # a viewer stores one layout per application name: with a common name, an episode would open in another's layout
    application = f"{APPLICATION} {episodes[main].name} {recording.hex[:6]}"
    with rr.RecordingStream(application, recording_id=str(recording)) as rec:
        memory = rec.memory_recording()
        rec.send_blueprint(blueprint(episodes), make_active=False, make_default=True)
        for caption, episode in episodes.items():
            draw(Stream(rec, caption=caption, faint=caption != main), episode)
    try:
        with part.open("wb") as file:
            file.write(memory.drain_as_bytes())
            file.flush()
            os.fsync(file.fileno())
    except OSError as fault:
        raise OSError(fault.errno, f"recording not written: {fault.strerror}", str(part)) from fault
