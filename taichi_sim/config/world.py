"""The parts of a world: times, sea, air, and teams of vehicles. A mission's scenario adds its own keys to these."""

import difflib
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from taichi_sim.config.air import AirConfig
from taichi_sim.config.base import NonNegative, Strict
from taichi_sim.config.sea import SeaConfig
from taichi_sim.config.vary import CONDITIONS, SIZE, Ranges

# Physics steps in a decision. The random numbers of turbulence are counted by step, in 32 bits (surroundings.py): with
# so many they come again after 400,000 decisions. Shipped hulls are stable with steps of 0.1 s, 50 in the longest one.
MOST_SUBSTEPS = 10_000


class TeamConfig(Strict):
    """One team: a section of any name that has a `vehicle`."""

    vehicle: Annotated[str, Field(min_length=1)]  # a file of configs/vehicles, without .toml, or a path
    count: Annotated[int, Field(ge=1, le=64)] = 3  # vehicles; number 0 leads, where a mission has a leader
    medium: Literal["water", "air"] | None = None  # what the team is meant to move in: other vehicles are refused
    script: Annotated[str, Field(min_length=1)] | None = None  # module:Class that acts for it (script.py)
    vary: Ranges = {}  # key of the vehicle's `varying` -> range; drawn for each vehicle and episode (vary.py)


class WorldConfig(Strict):
    """Seed, times, sea, air, teams. Every section that is not a key of the model is a team."""

    ways: ClassVar[Mapping[str, tuple[tuple[str, ...], ...]]] = {
        "sea": (("hs", "tp"), ("sea_state",), ("wind_speed", "fetch"), ("follows_wind",), ("record", "site")),
        "air": (("speed",), ("beaufort",), ("series",)),
        "current": (("speed", "direction_deg"), ("series",)),
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
    vary: Ranges = {}  # key of `CONDITIONS` -> range; drawn for each realisation of the sea (vary.py, conditions.py)
    variation: NonNegative = 1.0  # width of all ranges, the teams' too, over that given; 0: nothing varies

    @property
    def teams(self) -> dict[str, TeamConfig]:
        """Sections of the teams, in the order of the file."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def varies(self) -> bool:
        """Whether environments differ in anything but the waves drawn."""
        return self.variation > 0 and bool(self.vary or any(team.vary for team in self.teams.values()))

    @property
    def scripted(self) -> tuple[str, ...]:
        """Teams that a script commands."""
        return tuple(name for name, team in self.teams.items() if team.script is not None)

    @property
    def substeps(self) -> int:
        """Physics steps per decision."""
        return round(self.decision_interval / self.dt)

    @model_validator(mode="after")
    def _whole_steps(self):
        ratio = self.decision_interval / self.dt
        if ratio > MOST_SUBSTEPS * (1 + 1e-9):
            raise ValueError(
                f"dt = {self.dt:g}: {ratio:.3g} steps in a decision_interval of {self.decision_interval:g} s, allowed "
                f"are {MOST_SUBSTEPS}: give a dt of {self.decision_interval / MOST_SUBSTEPS:g} s or more, or decide "
                "more often"
            )
        if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
            raise ValueError(f"decision_interval = {self.decision_interval} must be a whole multiple of dt = {self.dt}")
        return self

    @model_validator(mode="after")
    def _can_vary(self):
        for key, given in self.vary.items():
            if key not in CONDITIONS:
                close = difflib.get_close_matches(key, CONDITIONS, n=1)
                hint = f", did you mean {close[0]!r}?" if close else ""
                raise ValueError(f"vary.{key} = {given}: unknown key{hint}; allowed here: {', '.join(CONDITIONS)}")
        if self.sea.measured and (key := next((key for key in (*SIZE, "sea.direction_deg") if key in self.vary), None)):
            raise ValueError(
                f"vary.{key} = {self.vary[key]}: sea.spectrum is a measured one, as large as it was and from where it "
                "came; sea.record = 'all' takes one record after the other"
            )
        flow = self.sea.current.series if self.sea.current else None
        for series, section in ((self.air.series, "air"), (flow, "sea.current")):
            keys = (f"{section}.speed", f"{section}.direction_deg")
            if series and (key := next((key for key in keys if key in self.vary), None)):
                raise ValueError(f"vary.{key} = {self.vary[key]}: {section}.series gives it over time")
        size = [key for key in SIZE if key in self.vary]
        if "sea.sea_state" in size and len(size) > 1:
            raise ValueError(f"vary: {' and '.join(size)}: a sea state is a height and a period: vary it, or these")
        if self.sea.follows_wind:
            size += [key for key in self.vary if key == "sea.direction_deg"]
            reason = "the sea follows the wind: vary air.speed and air.direction_deg"
        else:
            reason = "the size of the sea is given by sea.wind_speed: give hs and tp, or sea_state,"
        if size and (self.sea.follows_wind or self.sea.wind_speed is not None):
            raise ValueError(f"vary.{size[0]} = {self.vary[size[0]]}: {reason} instead")
        return self

    def bare(self) -> "WorldConfig":
        """The world's own keys, without those that a scenario adds."""
        world = {key: getattr(self, key) for key in WorldConfig.model_fields}
        teams = {
            name: TeamConfig(**{key: getattr(team, key) for key in TeamConfig.model_fields})
            for name, team in self.teams.items()
        }
        return WorldConfig.model_validate(world | teams)
