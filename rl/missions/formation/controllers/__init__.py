"""What may decide for the teams: a run's trained policies, or classical controllers.

A classical controller is a class named for its vehicle model: built from the model, it acts as a Policy.
"""

from pathlib import Path
from typing import Any

from torch import Tensor

from rl.learn.policy import Policy, load_policy
from rl.missions.formation.controllers.fixed_wing_6dof import FixedWing6DofController
from rl.missions.formation.controllers.hull_6dof import Hull6DofController
from rl.missions.formation.controllers.manoeuvring_3dof import Manoeuvring3dofController
from rl.missions.formation.controllers.unity_aircraft import UnityAircraftController
from rl.missions.formation.controllers.unity_boat import UnityBoatController
from rl.missions.formation.team import TeamTask
from rl.runs.folder import RunError
from taichi_sim.config import ScenarioConfig
from taichi_sim.conventions import TEAMS

CLASSICAL: dict[str, Any] = {
    "UnityBoat": UnityBoatController,
    "Hull6Dof": Hull6DofController,
    "Manoeuvring3dof": Manoeuvring3dofController,
    "UnityAircraft": UnityAircraftController,
    "FixedWing6DOF": FixedWing6DofController,
}


class ClassicalPolicy:
    """Acts with the classical controller of whatever vehicles the team has."""

    def __init__(self):
        """Wait for the first call to see the vehicles."""
        self.model: Any = None
        self.controller: Any = None

    def __call__(self, team: TeamTask) -> Tensor:
        """Actions [env, vehicle, action] in [-1, 1].

        Raises:
            RunError: if there is no classical controller for the team's vehicle model.
        """
        model = team.team.model
        if model is not self.model:
            kind = type(model).__name__
            if kind not in CLASSICAL:
                raise RunError(
                    f"{team.name}: there is no classical controller for the vehicle model {kind} (only for "
                    f"{', '.join(CLASSICAL)})"
                )
            self.model, self.controller = model, CLASSICAL[kind](model)
        return self.controller(team)


def controllers(kind: str, run: Path, config: ScenarioConfig) -> dict[str, Policy]:
    """A controller for each team, by name: "policy" (those trained in `run`) or "classical" (of both teams).

    Raises:
        RunError: if the run has no trained policy.
    """
    if kind == "classical":
        return {team: ClassicalPolicy() for team in TEAMS}
    trained = {stage.team for stage in config.stages.values()}
    teams = [team for team in TEAMS if team in trained and (run / team).is_dir()]
    if not teams:
        raise RunError(f"{run}: no trained policy in it")
    return {team: load_policy(run, config, team) for team in teams}
