"""What every scenario says: a world, the mission in it, training stages, evaluation.

A mission's scenario class derives from `Scenario` and adds the keys of its own (rl/mission.py); rl/missions reads it.
"""

import difflib
import itertools
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from taichi_sim.config import ConfigError, NonNegative, Positive, Strict, WorldConfig
from taichi_sim.config.io import set_values, validate
from taichi_sim.config.vary import flattened

WHOLE = ("name", "seed", "mission", "stages", "evaluation")  # sections that are the same in all stages


class StageConfig(Strict):
    """One training stage: which team learns (others act from frozen weights), on what, and PPO's numbers.

    A team may be trained by several stages: a later one goes on from where the one before it ended.
    """

    team: Annotated[str, Field(min_length=1)]  # that learns
    start_from: Annotated[str, Field(min_length=1)] | None = None  # a run's folder, or a checkpoint: its weights
    set: Annotated[dict[str, Any], BeforeValidator(flattened)] = {}  # what differs in it from the scenario, by key
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
        """The stage that trains a team last, if there is one."""
        return next((stage for stage in reversed(self.stages.values()) if stage.team == team), None)

    def iterations_before(self, name: str) -> int:
        """Iterations that the team of stage `name` has behind it when that begins."""
        earlier = itertools.takewhile(lambda item: item[0] != name, self.stages.items())
        return sum(stage.iterations for _, stage in earlier if stage.team == self.stages[name].team)

    @model_validator(mode="after")
    def _has_teams(self):
        if not self.teams:
            raise ValueError("there is no team: a team is a section of any name that has a vehicle")
        return self

    @model_validator(mode="after")
    def _stages_fit(self):
        first: dict[str, tuple[str, StageConfig]] = {}
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
            earlier, begun = first.setdefault(stage.team, (name, stage))
            for key in ("hidden_dims", "activation", "critic"):
                before, now = getattr(begun, key), getattr(stage, key)
                if before != now:
                    raise ValueError(
                        f"stages.{name}.{key} = {now!r}: it goes on with the networks of stages.{earlier}, where that "
                        f"is {before!r}"
                    )
            if stage.start_from is not None and begun is not stage:
                raise ValueError(
                    f"stages.{name}.start_from = {stage.start_from!r}: it goes on from stages.{earlier}, the same "
                    "team's; only the first of a team may start from elsewhere"
                )
        return self


def at_stage(config: Any, name: str) -> Any:
    """The scenario as it is while the stage `name` trains: with what `stages.NAME.set` says.

    Raises:
        ConfigError: naming the stage's key, value and what is allowed.
    """
    changes = config.stages[name].set
    if not changes:
        return config
    sources = {key: f"stages.{name}.set" for key in changes}
    if fixed := next((key for key in changes if key.split(".")[0] in WHOLE), None):
        whole = ", ".join(WHOLE)
        raise ConfigError(f"stages.{name}.set: {fixed} cannot differ in a stage: {whole} are of the whole run")
    data = config.model_dump(mode="json", exclude_none=True)
    set_values(data, changes, type(config), sources)
    return validate(type(config), data, config.name, sources)
