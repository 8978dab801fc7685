"""What every scenario says: a world, the mission in it, training stages, evaluation.

A mission's scenario class derives from `Scenario` and adds the keys of its own (rl/mission.py); rl/missions reads it.
"""

import difflib
from typing import Annotated, Literal

from pydantic import Field, model_validator

from taichi_sim.config import NonNegative, Positive, Strict, WorldConfig


class StageConfig(Strict):
    """One training stage: which team learns (others act from frozen weights), and PPO's numbers."""

    team: Annotated[str, Field(min_length=1)]  # that learns
    iterations: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    num_envs: Annotated[int, Field(ge=1, le=1_000_000)] = 512
    steps_per_iteration: Annotated[int, Field(ge=2, le=1000)] = 24
    hidden_dims: Annotated[tuple[Annotated[int, Field(ge=1, le=4096)], ...], Field(min_length=1)] = (64, 64)
    activation: Literal["elu", "relu", "tanh"] = "elu"
    learning_rate: Positive = 1e-3
    learning_epochs: Annotated[int, Field(ge=1, le=100)] = 2
    mini_batches: Annotated[int, Field(ge=1, le=1000)] = 8
    discount: Annotated[float, Field(gt=0, lt=1)] = 0.97
    gae_lambda: Annotated[float, Field(ge=0, le=1)] = 0.95
    clip: Positive = 0.2
    entropy: NonNegative = 0.0
    desired_kl: Positive = 0.01
    initial_std: Positive = 0.6
    critic: Literal["truth", "policy"] = "truth"  # what the critic is told: also the truth that vehicles do not know
    checkpoint_interval: Annotated[int, Field(ge=1)] = 25  # iterations


class Evaluation(Strict):
    """Episodes never trained on."""

    episodes: Annotated[int, Field(ge=1, le=100_000)] = 256
    seed: Annotated[int, Field(ge=0)] = 1000
    settle: NonNegative = 20.0  # s at the start of an episode that are not measured


class Scenario(WorldConfig):
    """A whole scenario: physics, mission, training, evaluation."""

    name: Annotated[str, Field(min_length=1)]  # pyright: ignore[reportGeneralTypeIssues] (no default here)
    mission: Annotated[str, Field(min_length=1)] = "formation"  # a name in rl/missions, or module:Class
    episode_duration: Annotated[float, Field(gt=0, le=100_000)] = 60.0  # s
    stages: dict[str, StageConfig] = {}
    evaluation: Evaluation = Evaluation()

    @property
    def episode_steps(self) -> int:
        """Decisions per episode."""
        return max(1, round(self.episode_duration / self.decision_interval))

    @property
    def trained(self) -> tuple[str, ...]:
        """Teams that some stage trains, in the order of the file."""
        learning = {stage.team for stage in self.stages.values()}
        return tuple(name for name in self.teams if name in learning)

    def stage_of(self, team: str) -> StageConfig | None:
        """The stage that trains a team, if there is one."""
        return next((stage for stage in self.stages.values() if stage.team == team), None)

    @model_validator(mode="after")
    def _has_teams(self):
        if not self.teams:
            raise ValueError("there is no team: a team is a section of any name that has a vehicle")
        return self

    @model_validator(mode="after")
    def _stages_fit(self):
        teams = [s.team for s in self.stages.values()]
        for name, stage in self.stages.items():
            if stage.team not in self.teams:
                close = difflib.get_close_matches(stage.team, self.teams, n=1)
                hint = f", did you mean {close[0]!r}?" if close else ""
                raise ValueError(
                    f"stages.{name}.team = {stage.team!r}: there is no such team{hint}; allowed are "
                    f"{', '.join(map(repr, self.teams)) or 'none'}"
                )
            if stage.team in self.scripted:
                raise ValueError(f"stages.{name}.team = {stage.team!r}: a script acts for it, nothing is to be learnt")
        if len(set(teams)) != len(teams):
            raise ValueError(f"stages train {teams}: each team may be trained by one stage only")
        return self
