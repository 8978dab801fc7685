"""The section `[sea.current]` of a scenario."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from taichi_sim.config.base import Finite, NonNegative, Positive, Strict

# Speeds of tidal constituents, degrees an hour (Schureman 1958, Manual of Harmonic Analysis, table 2).
CONSTITUENTS = {
    "M2": 28.9841042, "S2": 30.0, "N2": 28.4397295, "K2": 30.0821373,
    "K1": 15.0410686, "O1": 13.9430356, "P1": 14.9589314, "Q1": 13.3986609,
    "M4": 57.9682084, "MS4": 58.9841042, "M6": 86.9523127,
}  # fmt: skip

File = Annotated[str, Field(min_length=1)]


class ConstituentConfig(Strict):
    """One harmonic constituent of the tide, A cos(omega t - phase)."""

    amplitude: NonNegative  # amplitude of the current, m/s
    phase_deg: Finite = 0.0  # omega t at the strongest flood; t counts from the beginning of the world's time


class TideConfig(Strict):
    """`[sea.current.tide]`: an oscillating current along one direction, added to the mean current.

    `constituents = { M2 = { amplitude = 0.6, phase_deg = 40.0 }, ... }`, with their usual names.
    """

    direction_deg: Finite = 0.0  # direction the flood flows to, clockwise from north
    constituents: Annotated[dict[str, ConstituentConfig], Field(min_length=1)]

    @model_validator(mode="after")
    def _are_known(self):
        if unknown := next((name for name in self.constituents if name not in CONSTITUENTS), None):
            raise ValueError(f"constituents.{unknown}: unknown; allowed are {', '.join(CONSTITUENTS)}")
        return self


class CurrentConfig(Strict):
    """`[sea.current]`: the velocity of the water, one for each environment.

    The mean is steady (`speed`, `direction_deg`) or read from a file over time (`series`); a `tide` is added to either.
    """

    speed: Annotated[float, Field(ge=0, le=10)] = 0.0  # mean at the surface, m/s
    direction_deg: Finite = 0.0  # direction the mean current flows to, clockwise from north
    series: File | None = None  # CSV of the mean over time (series.py), instead of these two
    tide: TideConfig | None = None
    profile: Literal["uniform", "power"] = "uniform"  # over depth; power: (1 - d / depth)^(1/7), needs sea.depth
    std: Annotated[float, Field(ge=0, le=5)] = 0.0  # deviation of the fluctuation of each component (north, east), m/s
    time_constant: Positive = 300.0  # time constant of that fluctuation, s (assumed)

    @model_validator(mode="after")
    def _one_mean(self):
        if self.series is not None and self.speed:
            raise ValueError(f"the current is given twice, by speed = {self.speed} and series: keep one")
        return self
