"""Pictures of landings: the last seconds in the deck's frame and in the world's, and of the training."""

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from rl.evaluation.training_figures import save_figures, training_figures
from rl.mission import Histories
from rl.missions.landing.config import LandingScenario
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.visualisation.plotting import INK, dress, new_figure, rgb
from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.east_north_up import Array
from taichi_sim.visualisation.recording.episode import TeamTrack

WIDE = 7.6  # inches
BEFORE, AFTER = 10.0, 2.0  # s about the first touch that are drawn
AROUND = 2.5  # m about the deck's middle, likewise


def write_landing_figures(
    out: Path, histories: Histories, episode: Episode | None, config: LandingScenario
) -> list[Path]:
    """Write every figure that there are data for into `out`; an old one stays until the new one is complete."""
    figures = {} if episode is None else {"landing": landing_figure(episode, config)}
    return save_figures(out, figures | training_figures(histories, episode))


def over_deck(boats: TeamTrack, aircraft: TeamTrack, vehicle: int) -> tuple[Array, Array]:
    """Position [T, 3] of an aircraft relative to the middle of its deck (m, b of the boat), and that middle [T, 3] (m,
    NED).
    """
    assert boats.deck is not None
    R = torch_rotation_matrix(torch.from_numpy(np.asarray(boats.quaternion_nb[:, vehicle], np.float64))).numpy()
    centre = boats.position_n[:, vehicle] + R @ np.array(boats.deck.centre_b)
    away = aircraft.position_n[:, vehicle] - centre
    return np.einsum("tji,tj->ti", R, away), centre


def landing_figure(episode: Episode, config: LandingScenario) -> Figure:
    """The last seconds of the first aircraft: over the deck from above, and heights in the world."""
    parts = config.landing
    boats, aircraft = episode.teams[parts.boats], episode.teams[parts.aircraft]
    offset, centre = over_deck(boats, aircraft, 0)
    assert boats.deck is not None
    below = float(aircraft.size_m[2])
    over = (-offset[:, 2] < below) & (np.abs(offset[:, :2]) < boats.deck.half_m).all(axis=1)
    low = np.argmax(over) if over.any() else len(offset) - 1
    time = episode.time_s - episode.time_s[low]
    shown = (time >= -BEFORE) & (time <= AFTER)
    figure = new_figure(WIDE, 0.5 * WIDE, "The last seconds before a touchdown")
    plan, high = figure.subplots(1, 2)
    (a, b), colour = boats.deck.half_m, rgb(episode.liveries[parts.aircraft].of(0))
    plan.add_patch(Rectangle((-b, -a), 2 * b, 2 * a, facecolor="#D8E2DC", edgecolor=INK))
    plan.plot(offset[shown, 1], offset[shown, 0], color=colour, linewidth=1.4)
    plan.plot(offset[low, 1], offset[low, 0], "o", color=colour, markersize=5)
    plan.set_xlim(-AROUND, AROUND)
    plan.set_ylim(-AROUND, AROUND)
    plan.set_aspect("equal")
    dress(plan, "in the deck's frame", "to starboard (m)", "ahead (m)")
    high.plot(time[shown], -aircraft.position_n[shown, 0, 2], color=colour, label="aircraft")
    high.plot(time[shown], -centre[shown, 2], color=INK, label="deck")
    high.plot(time[shown], boats.wave_height[shown, 0], color="#56B4E9", linewidth=0.9, label="sea")
    high.legend(frameon=False, fontsize=8)
    dress(high, "above the mean sea", "time from the first touch (s)", "height (m)")
    return figure
