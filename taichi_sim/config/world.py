"""What a world is made of: times, sea, air, and teams of vehicles. A mission's scenario adds its own keys to these."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from taichi_sim.config.air import AirConfig
from taichi_sim.config.base import Strict
from taichi_sim.config.sea import SeaConfig


class TeamConfig(Strict):
    """One team: a section of any name that has a `vehicle`."""

    vehicle: Annotated[str, Field(min_length=1)]  # a file of configs/vehicles, without .toml, or a path
    count: Annotated[int, Field(ge=1, le=64)] = 3  # vehicles; number 0 leads, where a mission has a leader
    medium: Literal["water", "air"] | None = None  # what the team is meant to move in: other vehicles are refused
    script: Annotated[str, Field(min_length=1)] | None = None  # module:Class that acts for it (script.py)


class WorldConfig(Strict):
    """Seed, times, sea, air, teams. Every section that is not a key of the model is a team.

    Class attributes, for overrides of a file:
        ways: section -> ways of saying what it says, each some keys: an override of one takes the file's others back.
        plain: section that a file may also give as a plain value -> the key that the value is of.
    """

    ways: ClassVar[Mapping[str, tuple[tuple[str, ...], ...]]] = {
        "sea": (("hs", "tp"), ("sea_state",), ("wind_speed", "fetch"), ("follows_wind",)),
        "air": (("speed",), ("beaufort",)),
    }
    plain: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, TeamConfig] = Field(init=False)

    name: Annotated[str, Field(min_length=1)] = "world"
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1
    dt: Annotated[float, Field(gt=0, le=0.1)] = 0.02  # physics step, s
    decision_interval: Annotated[float, Field(gt=0, le=5)] = 0.1  # actions are held this long, s
    sea: SeaConfig = SeaConfig()
    air: AirConfig = AirConfig()

    @property
    def teams(self) -> dict[str, TeamConfig]:
        """Sections of the teams, in the order of the file."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def scripted(self) -> tuple[str, ...]:
        """Teams that a script acts for."""
        return tuple(name for name, team in self.teams.items() if team.script is not None)

    @property
    def substeps(self) -> int:
        """Physics steps per decision."""
        return round(self.decision_interval / self.dt)

    @model_validator(mode="after")
    def _whole_steps(self):
        ratio = self.decision_interval / self.dt
        if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
            raise ValueError(f"decision_interval = {self.decision_interval} must be a whole multiple of dt = {self.dt}")
        return self

    def bare(self) -> "WorldConfig":
        """The world alone, without what a scenario adds."""
        world = {key: getattr(self, key) for key in WorldConfig.model_fields}
        teams = {
            name: TeamConfig(**{key: getattr(team, key) for key in TeamConfig.model_fields})
            for name, team in self.teams.items()
        }
        return WorldConfig.model_validate(world | teams)
