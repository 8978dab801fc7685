"""The parts of a world: times, sea, `[air]`, and teams of vehicles. A mission's scenario adds its own keys to these."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field

from taichi_sim.config.base import Direction, Finite, NonNegative, Positive, Strict, meant
from taichi_sim.config.sea import SeaConfig
from taichi_sim.config.vary import CONDITIONS, SIZE, Ranges

WindSpeed = Annotated[float, Field(ge=0, le=60)]  # m/s


class GustConfig(Strict):
    """`[air.gust]`: one discrete gust, met at a time or at a place, given in exactly one way.

    - `start_time` and `rise_time`: everywhere at once;
    - `start_north`, `start_east`, `direction_deg` and `length`: a standing wall of air, met by flying into it.
    """

    amplitude: tuple[Finite, Finite, Finite]  # air velocity at the peak, NED, m/s (where it blows to)
    shape: Literal["pulse", "ramp"] = "pulse"  # 14 CFR 25.341: rises and falls; MIL-F-8785C: rises and stays
    start_time: NonNegative | None = None  # s
    rise_time: Positive | None = None  # time from zero to the peak, s
    start_north: Finite | None = None  # m
    start_east: Finite | None = None  # m
    direction_deg: Direction | None = None  # direction in which the gust grows from its start, clockwise from north
    length: Positive | None = None  # from zero to the peak, m (gradient distance H of 25.341, d_m of MIL-F-8785C)

    def _mistakes(self) -> Iterator[str]:
        time = ("start_time", "rise_time")
        place = ("start_north", "start_east", "direction_deg", "length")
        given = {name for name in time + place if getattr(self, name) is not None}
        if given not in ({*time}, {*place}):
            yield f"give either {', '.join(time)}, or {', '.join(place)}; given: {sorted(given) or 'none'}"


class AirConfig(Strict):
    """`[air]`: the mean wind, given by `speed`, `beaufort` or `series` (none of them: calm), and its disturbances."""

    speed: WindSpeed | None = None  # mean wind 10 m above the sea, m/s
    beaufort: Annotated[int, Field(ge=0, le=12)] | None = None  # stands for the middle of that force's speeds
    direction_deg: Direction = 0.0  # the wind blows from here, clockwise from north
    series: Annotated[str, Field(min_length=1)] | None = None  # CSV of the mean wind over time (series.py), at 10 m
    profile: Literal["log", "power", "uniform"] = "log"  # mean wind over height
    roughness: Annotated[float, Field(ge=1e-6, le=1)] | None = None  # z0 of the log profile, m; omitted: Charnock's
    charnock: Annotated[float, Field(ge=0.005, le=0.05)] = 0.0144  # Garratt 1977; 0.011 (open sea) to 0.0185 (coast)
    exponent: Annotated[float, Field(ge=0, le=0.5)] = 1 / 7  # for the power profile; 0.11 over sea (Hsu et al. 1994)
    std: Annotated[float, Field(ge=0, le=20)] = 0.0  # deviation of each component's (north, east) slow variation, m/s
    time_constant: Annotated[float, Field(ge=0.1, le=1e5)] = 300.0  # time constant of that variation, s (assumed)
    turbulence: Literal["none", "dryden"] = "none"
    turbulence_w20: WindSpeed | None = None  # wind at 20 ft that sets the turbulence, m/s; omitted: the mean wind's
    gust: GustConfig | None = None

    def _mistakes(self) -> Iterator[str]:
        given = [key for key in ("speed", "beaufort", "series") if getattr(self, key) is not None]
        if len(given) > 1:
            named = [f"{key} = {getattr(self, key)}" for key in given]
            yield (f"the wind is given {'twice' if len(given) == 2 else '3 times'}, by "
                             f"{' and '.join(named)}: keep one")  # fmt: skip


# Physics steps in a decision. The random numbers of turbulence are counted by step, in 32 bits (around_vehicles.py):
# with so many they come again after 400,000 decisions. Shipped hulls are stable with steps of 0.1 s, 50 in the longest
# one.
MOST_SUBSTEPS = 10_000
WHOLE = 1e-6  # of a step: a rest below it is rounding


Step = Annotated[float, Field(gt=0, le=0.1)]  # s


class TeamConfig(Strict):
    """One team: a section of any name that has a `vehicle`."""

    vehicle: Annotated[str, Field(min_length=1)]  # a file of configs/vehicles, without .toml, or a path
    count: Annotated[int, Field(ge=1, le=64)] = 3  # vehicles; number 0 leads, where a mission has a leader
    dt: Step | None = None  # its physics step, s; omitted: that of the vehicle file, if the scenario gives none
    medium: Literal["water", "air"] | None = None  # what the team is meant to move in: other vehicles are refused
    script: Annotated[str, Field(min_length=1)] | None = None  # module:Class that acts for it (world.py)
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
    dt: Step | None = None  # physics step of all teams, s; omitted: each team's own
    decision_interval: Annotated[float, Field(ge=5e-4, le=5)] = 0.1  # actions are held this long, s
    sea: SeaConfig = SeaConfig()
    air: AirConfig = AirConfig()
    vary: Ranges = {}  # key of `CONDITIONS` -> range; drawn for each realisation of the sea (vary.py, conditions.py)
    variation: Annotated[float, Field(ge=0, le=10)] = 1.0  # width of all ranges over that given

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

    def substeps(self, team: str, own: float) -> int:
        """Physics steps of `team` in a decision: by `dt`, by the team's, or else the fewest steps of at most `own` (s),
        the step of its vehicle file.
        """
        given = self.dt or self.teams[team].dt
        return round(self.decision_interval / given) if given else math.ceil(self.decision_interval / own - WHOLE)

    def _mistakes(self) -> Iterator[str]:
        given = {"dt": self.dt, **{f"{name}.dt": team.dt for name, team in self.teams.items()}}
        for key, dt in given.items():
            if dt is None:
                continue
            ratio = self.decision_interval / dt
            if key != "dt" and self.dt is not None:
                yield f"{key} = {dt:g}: dt = {self.dt:g} is the step of all teams: leave out one of them"
            if ratio > MOST_SUBSTEPS * (1 + 1e-9):
                yield (
                    f"{key} = {dt:g}: {ratio:.3g} steps in a decision_interval of {self.decision_interval:g} s, "
                    f"allowed are {MOST_SUBSTEPS}: give a dt of {self.decision_interval / MOST_SUBSTEPS:g} s or more, "
                    "or decide more often"
                )
            if ratio < 0.999 or abs(ratio - round(ratio)) > WHOLE:
                yield f"decision_interval = {self.decision_interval} must be a whole multiple of {key} = {dt}"
        for key, given in self.vary.items():
            if key not in CONDITIONS:
                yield (
                    f"vary.{key} = {given}: unknown key{meant(key, CONDITIONS)}; allowed here: {', '.join(CONDITIONS)}"
                )
        if self.sea.measured and (key := next((key for key in (*SIZE, "sea.direction_deg") if key in self.vary), None)):
            yield (
                f"vary.{key} = {self.vary[key]}: sea.spectrum is a measured one, as large as it was and from where it "
                "came; sea.record = 'all' takes one record after the other"
            )
        flow = self.sea.current.series if self.sea.current else None
        for series, section in ((self.air.series, "air"), (flow, "sea.current")):
            keys = (f"{section}.speed", f"{section}.direction_deg")
            if series and (key := next((key for key in keys if key in self.vary), None)):
                yield f"vary.{key} = {self.vary[key]}: {section}.series gives it over time"
        size = [key for key in SIZE if key in self.vary]
        if "sea.sea_state" in size and len(size) > 1:
            yield f"vary: {' and '.join(size)}: a sea state is a height and a period: vary it, or these"
        if self.sea.follows_wind:
            size += [key for key in self.vary if key == "sea.direction_deg"]
            reason = "the sea follows the wind: vary air.speed and air.direction_deg"
        else:
            reason = "the size of the sea is given by sea.wind_speed: give hs and tp, or sea_state,"
        if size and (self.sea.follows_wind or self.sea.wind_speed is not None):
            yield f"vary.{size[0]} = {self.vary[size[0]]}: {reason} instead"

    def bare(self) -> "WorldConfig":
        """The world's own keys, without those that a scenario adds."""
        world = {key: getattr(self, key) for key in WorldConfig.model_fields}
        teams = {
            name: TeamConfig(**{key: getattr(team, key) for key in TeamConfig.model_fields})
            for name, team in self.teams.items()
        }
        return WorldConfig.model_validate(world | teams)
