"""What a sweep's file says: axes of conditions, and how many episodes there are under each."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from taichi_sim.config import ConfigError, Positive, Strict
from taichi_sim.config.io import config_folder, read_toml, validate

FOLDER = "sweeps"  # of the shipped ones in configs/, and of those made in a run's folder


class Axis(Strict):
    """One thing that is varied: `[[axis]]`.

    Each of `values` goes to all `keys`, or is a list with one value for each of them. `*` in a key stands for every
    trained team. A number is multiplied by `scale`, and by what the run's scenario has for the key `times`. Tables and
    plots name a value by its one of `labels`, if there are such.
    """

    name: Annotated[str, Field(min_length=1)]
    keys: tuple[Annotated[str, Field(min_length=1)], ...]
    values: tuple[Any, ...]
    labels: tuple[str | int | float, ...] | None = None
    unit: str = ""  # of `values`, as it is printed
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
                raise ValueError(f"axis {self.name!r}: {value!r} is no number, which scale and times need")
        if self.labels is not None and len(self.labels) != len(self.values):
            raise ValueError(f"axis {self.name!r} has {len(self.labels)} labels for {len(self.values)} values")
        return self

    def label(self, value: Any) -> Any:
        """What one of `values` is called."""
        return value if self.labels is None else self.labels[self.values.index(value)]

    def of_keys(self, value: Any) -> tuple[Any, ...]:
        """One value for each key."""
        return value if isinstance(value, tuple) else (value,) * len(self.keys)


class Sweep(Strict):
    """A sweep: every axis alone, about the run's own scenario, or with `grid` all of them against each other."""

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
    """`name` if it is a file; else the shipped sweep of that name ("default", "configs/sweeps/default.toml").

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


def load_sweep(file: Path, **changes: Any) -> Sweep:
    """A sweep from its file; `changes` are of single keys, unless None.

    Raises:
        ConfigError: naming file, key, value and what is allowed.
    """
    data = read_toml(file) | {key: value for key, value in changes.items() if value is not None}
    return validate(Sweep, data, str(file))
