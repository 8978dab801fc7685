"""The section `[air]` of a scenario."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from taichi_sim.config.base import Finite, NonNegative, Positive, Strict

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
    direction_deg: Finite | None = None  # direction in which the gust grows from its start, clockwise from north
    length: Positive | None = None  # from zero to the peak, m (gradient distance H of 25.341, d_m of MIL-F-8785C)

    @model_validator(mode="after")
    def _time_or_place(self):
        time = ("start_time", "rise_time")
        place = ("start_north", "start_east", "direction_deg", "length")
        given = {name for name in time + place if getattr(self, name) is not None}
        if given not in ({*time}, {*place}):
            raise ValueError(f"give either {', '.join(time)}, or {', '.join(place)}; given: {sorted(given) or 'none'}")
        return self


class AirConfig(Strict):
    """`[air]`: the mean wind, given by `speed`, `beaufort` or `series` (none of them: calm), and its disturbances."""

    speed: WindSpeed | None = None  # mean wind 10 m above the sea, m/s
    beaufort: Annotated[int, Field(ge=0, le=12)] | None = None  # stands for the middle of that force's speeds
    direction_deg: Finite = 0.0  # the wind blows from here, clockwise from north
    series: Annotated[str, Field(min_length=1)] | None = None  # CSV of the mean wind over time (series.py), at 10 m
    profile: Literal["log", "power", "uniform"] = "log"  # mean wind over height
    roughness: Annotated[float, Field(gt=0, le=1)] | None = None  # z0 of the log profile, m; omitted: Charnock's
    charnock: Annotated[float, Field(ge=0.005, le=0.05)] = 0.0144  # Garratt 1977; 0.011 (open sea) to 0.0185 (coast)
    exponent: Annotated[float, Field(ge=0, le=0.5)] = 1 / 7  # for the power profile; 0.11 over sea (Hsu et al. 1994)
    std: Annotated[float, Field(ge=0, le=20)] = (
        0.0  # deviation of the slow variation of each component (north, east), m/s
    )
    time_constant: Positive = 300.0  # time constant of that variation, s (assumed)
    turbulence: Literal["none", "dryden"] = "none"
    turbulence_w20: WindSpeed | None = None  # wind at 20 ft that sets the turbulence, m/s; omitted: the mean wind's
    gust: GustConfig | None = None

    @model_validator(mode="after")
    def _one_speed(self):
        given = [key for key in ("speed", "beaufort", "series") if getattr(self, key) is not None]
        if len(given) > 1:
            named = [f"{key} = {getattr(self, key)}" for key in given]
            raise ValueError(f"the wind is given {'twice' if len(given) == 2 else '3 times'}, by "
                             f"{' and '.join(named)}: keep one")  # fmt: skip
        return self
