"""What may decide for the teams: a run's trained policies, or classical controllers."""

from pathlib import Path

from rl.policy import Policy
from rl.run_folder import RunError
from rl.stages import load_policy
from taichi_sim.config import ScenarioConfig
from taichi_sim.conventions import TEAMS


def controllers(kind: str, run: Path, config: ScenarioConfig) -> dict[str, Policy]:
    """A controller for each team, by name: "policy" (those trained in `run`) or "classical".

    Raises:
        RunError: if the run has no trained policy.
    """
    if kind == "classical":
        raise RunError("--controller classical: there is no classical controller yet")
    trained = {stage.team for stage in config.stages.values()}
    teams = [team for team in TEAMS if team in trained and (run / team).is_dir()]
    if not teams:
        raise RunError(f"{run}: no trained policy in it")
    return {team: load_policy(run, config, team) for team in teams}
