"""Base of every configuration section: number types, the strict model, the errors."""

from typing import Annotated, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Table: TypeAlias = dict[str, object]
"""A table of TOML: values, arrays and tables by key."""


class ConfigError(ValueError):
    """A mistake in a configuration: the message names file, key, value and what is allowed."""


class Strict(BaseModel):
    """Base of every section. Unknown keys and values of another type are errors; a section cannot be changed after
    reading.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class MissingExtraError(ImportError):
    """An optional package is not installed; the message says how to install it."""

    def __init__(self, package: str, extra: str):
        """Name the missing `package` and the extra that installs it."""
        super().__init__(f'{package} is not installed: pip install "taichi-sim[{extra}]"', name=package)
