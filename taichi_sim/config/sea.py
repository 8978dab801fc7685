"""The sections `[sea]` and `[sea.current]` of a scenario."""

from collections.abc import Iterator
from datetime import UTC, date, datetime
from pathlib import PurePath
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from taichi_sim.config.base import Direction, Finite, NonNegative, Positive, Strict, meant

# Speeds of tidal constituents, degrees an hour (Schureman 1958, Manual of Harmonic Analysis, table 2).
CONSTITUENTS = {
    "M2": 28.9841042, "S2": 30.0, "N2": 28.4397295, "K2": 30.0821373,
    "K1": 15.0410686, "O1": 13.9430356, "P1": 14.9589314, "Q1": 13.3986609,
    "M4": 57.9682084, "MS4": 58.9841042, "M6": 86.9523127,
}  # fmt: skip


def _as_text(given: object) -> object:
    """A date or a time of TOML as text, UTC."""
    if isinstance(given, datetime):
        given = given if given.tzinfo is None else given.astimezone(UTC).replace(tzinfo=None)
        return given.isoformat(" ", "minutes")
    return given.isoformat() if isinstance(given, date) else given


Moment = Annotated[str, BeforeValidator(_as_text)]
File = Annotated[str, Field(min_length=1)]


class ConstituentConfig(Strict):
    """One harmonic constituent of the tide, A cos(omega t - phase)."""

    amplitude: NonNegative  # amplitude of the current, m/s
    phase_deg: Finite = 0.0  # omega t at the strongest flood; t counts from the beginning of the world's time


class TideConfig(Strict):
    """`[sea.current.tide]`: an oscillating current along one direction, added to the mean current.

    `constituents = { M2 = { amplitude = 0.6, phase_deg = 40.0 }, ... }`, with their usual names.
    """

    direction_deg: Direction = 0.0  # direction the flood flows to, clockwise from north
    constituents: Annotated[dict[str, ConstituentConfig], Field(min_length=1)]

    def _mistakes(self) -> Iterator[str]:
        if unknown := next((name for name in self.constituents if name not in CONSTITUENTS), None):
            yield f"constituents.{unknown}: unknown; allowed are {', '.join(CONSTITUENTS)}"


class CurrentConfig(Strict):
    """`[sea.current]`: the velocity of the water, one for each environment.

    The mean is steady (`speed`, `direction_deg`) or read from a file over time (`series`); a `tide` is added to either.
    """

    speed: Annotated[float, Field(ge=0, le=10)] = 0.0  # mean at the surface, m/s
    direction_deg: Direction = 0.0  # direction the mean current flows to, clockwise from north
    series: File | None = None  # CSV of the mean over time (series.py), instead of these two
    tide: TideConfig | None = None
    profile: Literal["uniform", "power"] = "uniform"  # over depth; power: (1 - d / depth)^(1/7), needs sea.depth
    std: Annotated[float, Field(ge=0, le=5)] = 0.0  # deviation of the fluctuation of each component (north, east), m/s
    time_constant: Annotated[float, Field(ge=0.1, le=1e5)] = 300.0  # time constant of that fluctuation, s (assumed)

    def _mistakes(self) -> Iterator[str]:
        if self.series is not None and self.speed:
            yield f"the current is given twice, by speed = {self.speed} and series: keep one"


MAX_COMPONENTS = 64  # largest number of components per realisation, wind sea and swell together
MEASURED_COMPONENTS = 32  # default for a measured sea, whose wave systems share them
SPECTRA = ("jonswap", "bretschneider", "pierson_moskowitz")  # known by name


def is_measured(spectrum: object) -> bool:
    """Whether `sea.spectrum` is the file of a measured spectrum."""
    return isinstance(spectrum, str) and spectrum not in SPECTRA


def path_like(value: str) -> bool:
    """Whether a text can be the path of a file, rather than a name."""
    return bool(PurePath(value).suffix) or "/" in value or "\\" in value


def _spectrum(value: str) -> str:
    if is_measured(value) and not path_like(value):
        names = ", ".join(map(repr, SPECTRA))
        raise ValueError(f"allowed are {names}, or the file of a measured spectrum{meant(value, SPECTRA)}")
    return value


Spectrum = Annotated[str, AfterValidator(_spectrum)]  # one of SPECTRA, or a file

Height = Annotated[float, Field(ge=0, le=15)]  # significant wave height, m; 0 is a calm sea
SHORTEST, LONGEST = 0.1, 30.0  # s: shorter waves are capillary, longer ones are not raised by wind
Period = Annotated[float, Field(ge=SHORTEST, le=LONGEST)]  # peak period, s
Peakedness = Annotated[float, Field(ge=1, le=10)]  # gamma of JONSWAP
SpreadingExponent = Annotated[float, Field(gt=0, le=200)]  # s of cos^2s; larger is narrower
ComponentCount = Annotated[int, Field(ge=1, le=MAX_COMPONENTS)]


class SwellConfig(Strict):
    """`[sea.swell]`: a second wave system from a distant storm, added to the wind sea, with a JONSWAP spectrum.

    Swell is narrow in frequency and direction: gamma_js 5 and s 50 (17 degrees circular deviation) are assumed.
    """

    hs: Height
    tp: Period | None = None  # omitted: that of a swell of the height `hs` (wind_sea.py)
    gamma_js: Peakedness = 5.0
    direction_deg: Direction = 0.0  # mean direction the swell travels to, clockwise from north
    spreading_s: SpreadingExponent = 50.0
    components: ComponentCount = 8  # in addition to those of the wind sea; together at most 64


class SeaConfig(Strict):
    """`[sea]`: a directional sea of Gerstner components. Its size is given in exactly one way:

    - `hs` and `tp`, or `hs` alone: a developed sea of that height;
    - `sea_state`, WMO code 0 to 8: middle of the code's heights, period of the fully developed sea;
    - `wind_speed` and `fetch`: growing JONSWAP sea (`spectrum = "jonswap"`);
    - `wind_speed` alone: fully developed sea (`spectrum = "pierson_moskowitz"`, which is then the default);
    - `follows_wind`: the scenario's wind (`[air]`) gives wind_speed and direction_deg;
    - `spectrum = "FILE"`: a measured sea (sea/measured), with its measured size and directions.

    The default is hs 0.5 m, tp 4 s. `taichi_sim.surroundings.sea.sea_size(config)` returns hs and tp for each of these.
    Bretschneider and Pierson-Moskowitz (DNV-RP-C205, sec. 3.5.5) have the same shape, JONSWAP's with gamma 1;
    `gamma_js` applies to JONSWAP only.
    """

    spectrum: Spectrum = "jonswap"  # a name of SPECTRA, or a file of measured spectra
    record: Moment | None = None  # record of that file: a time, "2020-06-08 03:50" (UTC), or "all"; omitted: the latest
    site: Annotated[int, Field(ge=0)] | None = None  # number of the site in a file with several sites, from 0
    hs: Height | None = None  # m
    tp: Period | None = None  # s
    sea_state: Annotated[int, Field(ge=0, le=8)] | None = None  # code of WMO table 3700; 9 has no upper end
    wind_speed: Annotated[float, Field(ge=0.001, le=60)] | None = None  # 10 m above the sea, m/s
    fetch: Annotated[float, Field(ge=0.1, le=1e7)] | None = None  # distance over which that wind blows, m
    follows_wind: bool = False  # the sea is raised by the wind of [air] and travels with it
    gamma_js: Peakedness = 3.3  # peakedness of a JONSWAP spectrum (Hasselmann et al. 1973: 3.3)
    direction_deg: Direction = 45.0  # mean direction the waves travel to, clockwise from north
    spreading_s: SpreadingExponent = 10.0  # this and direction_deg also apply to a measured spectrum without directions
    components: ComponentCount = 16  # components of the wind sea per realisation; default for a measured sea: 32
    amplitudes: Literal["exact", "random"] = "exact"  # random: Rayleigh's, for each component (Tucker et al. 1984)
    realisations: Annotated[int, Field(ge=1, le=4096)] = 64  # number of different seas in one run
    depth: Positive | None = None  # depth of the water, m; omitted: deep water
    swell: SwellConfig | None = None
    current: CurrentConfig | None = None

    @property
    def measured(self) -> bool:
        """Whether the spectrum comes from a file of measurements."""
        return is_measured(self.spectrum)

    @model_validator(mode="before")
    @classmethod
    def _defaults(cls, data):
        """Set the default size if none is given; a wind alone gives a fully developed sea."""
        if not isinstance(data, dict):
            return data
        if is_measured(data.get("spectrum")):
            return {"components": MEASURED_COMPONENTS} | data
        given = {key for key, value in data.items() if value is not None and value is not False}
        if not given & {"hs", "tp", "sea_state", "wind_speed", "fetch", "follows_wind"}:
            data = data | {"hs": 0.5, "tp": 4.0}
        elif given & {"wind_speed", "follows_wind"} and not given & {"fetch", "spectrum"}:
            data = data | {"spectrum": "pierson_moskowitz"}
        return data

    def _mistakes(self) -> Iterator[str]:
        ways = {
            "hs" if self.tp is None else "hs and tp": (self.hs, self.tp),
            "sea_state": (self.sea_state,),
            "wind_speed (with fetch for a growing sea)": (self.wind_speed, None if self.follows_wind else self.fetch),
            "follows_wind": (self.follows_wind or None,),
        }
        named = [way for way, values in ways.items() if any(v is not None for v in values)]
        if self.measured and named:
            yield f"spectrum is a measured one, which has a size of its own: remove {' and '.join(named)}"
        if self.measured:
            return
        if other := next((key for key in ("record", "site") if getattr(self, key) is not None), None):
            yield f"{other} is of a file of measured spectra: give spectrum = FILE, or remove it"
        if len(named) > 1:
            yield (
                f"the size of the sea is given {len(named)} times, by {', by '.join(named)}: "
                "keep one and remove the others"
            )
        if self.hs is None and self.tp is not None:
            yield "tp is given without hs: give both"
        windy = self.wind_speed is not None or self.follows_wind
        if self.fetch is not None and not windy:
            yield "fetch is given without wind_speed: give both"
        if self.fetch is not None and self.spectrum != "jonswap":
            yield f"fetch makes a growing sea: spectrum must be 'jonswap', not {self.spectrum!r}"
        if windy and self.fetch is None and self.spectrum == "jonswap":
            yield (
                "spectrum = 'jonswap' needs a fetch beside wind_speed; for a fully developed sea "
                "set spectrum = 'pierson_moskowitz'"
            )
        total = self.components + (self.swell.components if self.swell else 0)
        if total > MAX_COMPONENTS:
            yield f"components + swell.components = {total}: together they must be at most {MAX_COMPONENTS}"
        if self.current and self.current.profile == "power" and self.depth is None:
            yield "current.profile = 'power' needs the depth of the water: set depth, in m"
