"""Base of every configuration section: number types, the strict model, the errors."""

import difflib
from collections.abc import Iterable, Iterator
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from torch import Tensor

from taichi_sim.errors import UserError

SMALLEST, LARGEST = 1e-30, 1e15
"""Limits of positive numbers, and of all numbers either way: kernels' single precision holds their squares, times 1e8.
The inertia of the largest ships is 1e13 kg m^2, the moment of a small rotor 1e-9 N m s^2."""


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise ValueError(f"allowed are {SMALLEST:g} to {LARGEST:g}")
    return value


Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False), AfterValidator(_not_tiny)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
NonPositive = Annotated[float, Field(ge=-LARGEST, le=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Direction = Annotated[float, Field(ge=-720, le=720, allow_inf_nan=False)]  # deg, clockwise from north
Table: TypeAlias = dict[str, object]
"""A table of TOML: values, arrays and tables by key."""


def _ordered(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError("the first must not be above the second")
    return span


Ordered = AfterValidator(_ordered)
"""Annotation of two numbers, of which the first must not be above the second."""
Span = Annotated[tuple[NonNegative, NonNegative], Ordered]
"""The least and the greatest value of a draw."""


class ConfigError(UserError, ValueError):
    """A mistake in a configuration: the message names file, key, value and what is allowed."""


class Strict(BaseModel):
    """Base of every section: unknown keys and values of another type are errors; a section is frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    def _mistakes(self) -> Iterator[str]:
        """Mistakes among values that are each allowed, of which the first is told: "KEY = VALUE: what is allowed"."""
        yield from ()

    @model_validator(mode="after")
    def _without_mistakes(self):
        if told := next(self._mistakes(), None):
            raise ValueError(told)
        return self


def span(values: ArrayLike | Tensor, unit: str) -> str:
    """Range of `values` to four digits: "0.5 m", or "0.5 to 1.25 m". `values` is an array or a tensor of any shape."""
    flat = np.asarray(values.detach().cpu() if isinstance(values, Tensor) else values, dtype=np.float64).ravel()
    if not flat.size:
        return "none"
    low, high = f"{flat.min():.4g}", f"{flat.max():.4g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def meant(name: object, known: Iterable[str]) -> str:
    """Hint to append to "unknown key" if `name` resembles one of the `known`; empty otherwise."""
    close = difflib.get_close_matches(str(name), list(known), n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def number(count: int, thing: str) -> str:
    """A count with its noun: "1 environment", "3 environments"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
