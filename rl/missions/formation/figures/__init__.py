"""The seed paper's figures 2 to 6 as PNG files: from a recorded episode, and from the training's history.

Positions are drawn as on a map, east to the right and north up, heights up from mean sea level, in m.
"""

from pathlib import Path

from matplotlib.figure import Figure

from rl.figures import save_figures, training_figures
from rl.mission import Histories
from rl.missions.formation.figures.formation import formation_figure
from rl.missions.formation.figures.scene import scene_figure
from rl.missions.formation.figures.tracking import tracking_error_figure
from taichi_sim.recording import Episode

__all__ = ["formation_figure", "scene_figure", "tracking_error_figure", "write_figures"]


def write_figures(out: Path, histories: Histories, episode: Episode | None, settle: float = 0.0) -> list[Path]:
    """Every figure there is something to draw for, into `out`; an old one stays until the new is whole.

    `settle` (s) at the start of an episode counts for no error.
    """
    figures: dict[str, Figure] = {}
    if episode is not None:
        figures["scene"] = scene_figure(episode)
        figures["tracking_error"] = tracking_error_figure(episode, settle)
        figures["formation"] = formation_figure(episode)
    return save_figures(out, figures | training_figures(histories, episode))
