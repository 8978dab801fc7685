"""Pictures of encounters: a chart of an episode, and of the training."""

from pathlib import Path

from rl.evaluation.training_figures import save_figures, training_figures
from rl.mission import Histories
from rl.missions.encounter.config import EncounterScenario
from taichi_sim.visualisation.recording import Episode


def write_encounter_figures(
    out: Path, histories: Histories, episode: Episode | None, config: EncounterScenario
) -> list[Path]:
    """Write every figure that there are data for into `out`."""
    return save_figures(out, training_figures(histories, episode))
