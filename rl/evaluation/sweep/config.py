"""A sweep's file: axes of conditions, and the number of episodes for each."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from taichi_sim.config import ConfigError, Positive, Strict
from taichi_sim.config.base import Table
from taichi_sim.config.io import config_folder, read_toml, validate

FOLDER = "sweeps"  # of sweep files in configs/, and of results in a run's folder


class Axis(Strict):
    """One axis of a sweep: `[[axis]]`.

    Each of `values` is set for all `keys`, or is a list with one value for each key. `*` in a key stands for every
    trained team. Numbers are multiplied by `scale`, and by the scenario's value of the key `times`. Tables and plots
    show `labels` in place of values, if given.
    """

    name: Annotated[str, Field(min_length=1)]
    keys: tuple[Annotated[str, Field(min_length=1)], ...]
    values: tuple[object, ...]
    labels: tuple[str | int | float, ...] | None = None
    unit: str = ""  # of `values`, as printed
    scale: Positive = 1.0  # from `unit` to the unit of the keys
    times: str | None = None

    @model_validator(mode="after")
    def _fits(self):
        for what, given in (("keys", self.keys), ("values", self.values)):
            if not given:
                raise ValueError(
                    f"axis {self.name!r} has no {what}: an axis sets at least one key to at least one value"
                )
        for value in self.values:
            if isinstance(value, tuple) and len(value) != len(self.keys):
                raise ValueError(f"axis {self.name!r}: {list(value)} has {len(value)} values for {len(self.keys)} keys")
            scaled = self.scale != 1.0 or self.times is not None
            if scaled and not all(isinstance(v, int | float) for v in self.of_keys(value)):
                raise ValueError(f"axis {self.name!r}: {value!r} is not a number: scale and times need numbers")
        if self.labels is not None and len(self.labels) != len(self.values):
            raise ValueError(f"axis {self.name!r} has {len(self.labels)} labels for {len(self.values)} values")
        return self

    def label(self, value: object) -> object:
        """The label of one of `values`."""
        return value if self.labels is None else self.labels[self.values.index(value)]

    def of_keys(self, value: object) -> tuple[object, ...]:
        """One value for each key."""
        return value if isinstance(value, tuple) else (value,) * len(self.keys)


class Sweep(Strict):
    """A sweep: each axis alone around the run's own scenario, or with `grid` the product of all axes."""

    axis: tuple[Axis, ...]
    grid: bool = False
    episodes: Annotated[int, Field(ge=2, le=100_000)] = 256  # under each condition
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 5000  # of the episodes; not the evaluation's or training's

    @model_validator(mode="after")
    def _has_axes(self):
        names = [axis.name for axis in self.axis]
        if not names:
            raise ValueError("there is no [[axis]]: nothing is varied")
        if len(set(names)) < len(names):
            raise ValueError(f"two axes of one name: {', '.join(names)}")
        return self


def find_sweep(name: str | Path) -> Path:
    """The file `name`, or the shipped sweep of that name ("default", "configs/sweeps/default.toml").

    Raises:
        ConfigError: if there is neither.
    """
    path, folder = Path(name), config_folder() / FOLDER
    shipped = folder / path.with_suffix(".toml").name
    if path.is_file():
        return path
    if path.parent in (Path("."), Path("configs") / FOLDER) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in folder.glob("*.toml")))
    raise ConfigError(f"{path}: no such sweep file; shipped sweeps: {names}")


def load_sweep(file: Path, **changes: int | None) -> Sweep:
    """Read a sweep from its file; `changes` replace single keys, unless None.

    Raises:
        ConfigError: if a value is not allowed; the message names file, key, value and what is allowed.
    """
    given: Table = {key: value for key, value in changes.items() if value is not None}
    return validate(Sweep, {**read_toml(file), **given}, str(file))
