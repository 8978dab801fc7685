"""Draws an episode, or a part of one, into a rerun stream."""

import rerun as rr

from taichi_sim.recording.arrows import arrow_text, send_air, send_flow, send_forces
from taichi_sim.recording.draw_overlays import send_overlays
from taichi_sim.recording.episode import Episode
from taichi_sim.recording.plots import send_plots
from taichi_sim.recording.space import send_events, send_scene, send_sea
from taichi_sim.recording.stream import Stream
from taichi_sim.recording.vehicles import send_team


def draw(stream: Stream, episode: Episode) -> None:
    """Draw the whole episode, or the part that follows what the stream already holds."""
    stream.part(episode.time_s)
    if stream.begins:
        stream.static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        about = f"{arrow_text(episode)}{episode.config_text or f'# {episode.name}'}"
        stream.static("config", rr.TextDocument(about, media_type="text/markdown"))
        send_scene(stream, episode)
    send_sea(stream, episode)
    for team in episode.teams.values():
        send_team(stream, episode, team)
        send_forces(stream, episode, team)
        send_air(stream, episode, team)
        send_plots(stream, episode, team)
    send_flow(stream, episode)
    send_overlays(stream, episode)
    send_events(stream, episode)
