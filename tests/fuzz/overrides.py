"""Random overrides of a scenario and of a vehicle file: keys of strict models, and values that fit them or do not."""

import types
import typing
from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel

from rl.scenario import Scenario
from taichi_sim.config.vary import CONDITIONS

WRONG = (
    "0", "-1", "1", "1.5", "nan", "inf", "-inf", "1e400", "1e308", "-1e308", "1e30", "-1e30", "1e12", "1e-30", "1e-300",
    "9999999999999999999999", "1000000", "-9223372036854775809", "true", "false", '""', '"x"', "x",
    '"nan"', '"1.0"', "[]", "[1]",
    "[0, 1]", "[1, 0]", "[nan, 1]", "[-1e30, 1e30]", "[1, 2, 3]", "{}", "{x = 1}", "{range = [0, 1]}", "[[1]]", "[{}]",
    "2020-01-01", "07:32:00", "1979-05-27T07:32:00Z", "0x10", "1_000", "'''", "\\", "\u00e9", "=", "", "[", "{",
    '"/"', '"."', '"a:b"', '"module:"', '":"', '"os:path"', '"taichi_sim:World"', '"\\u0000"',
)  # fmt: skip
"""Values in TOML, or what is not TOML, which stand in place of any value."""
GARBAGE = (".", "..", "usv.", ".usv", "a.b.c.d", "seed.x", "usv.count.x", "stages", "stages.x", "stages.x.y", "sea.x.y",
           "obstacles.fixed.0.north", "vary", "vary.x", "usv.vary.mass", "usv.vary.x.factor", "usv", "name", "mission",
           '"sea.hs"', "sea\u0000", "\u00e9", "sea hs", "__class__", "model_config", "evaluation")  # fmt: skip
"""Keys that are none, or stand for a whole section."""


def scenario_keys(config: Scenario) -> list[tuple[str, object]]:
    """Every key of a scenario with its value, in its teams and stages too, and those of ranges."""
    found = list(_keys(config, ""))
    for name, team in config.teams.items():
        found += [(f'{name}.vary."rigid_body.mass"', [0.9, 1.1]), (f"{name}.vary.mass", [0.9, 1.1])]
        found += _keys(team, f"{name}.")
    for name, stage in config.stages.items():
        found += _keys(stage, f"stages.{name}.")
        found += [(f'stages.{name}.set."sea.hs"', 0.3), (f'stages.{name}.set."{next(iter(config.teams))}.count"', 2)]
    found += [(f'vary."{key}"', list(pair)) for key, pair in CONDITIONS.items()]
    return found


def keys_of(model: BaseModel) -> list[tuple[str, object]]:
    """Every key of a strict model with its value."""
    return list(_keys(model, ""))


def _keys(model: BaseModel, head: str) -> Iterator[tuple[str, object]]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _keys(value, f"{head}{name}.")
            continue
        inner = next((kind for kind in _models(field.annotation)), None)
        if value is None and inner is not None:
            for other, of in inner.model_fields.items():
                yield f"{head}{name}.{other}", None if of.is_required() else of.get_default(call_default_factory=True)
        yield f"{head}{name}", value


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        for part in typing.get_args(annotation):
            yield from _models(part)


def overrides(keys: list[tuple[str, object]], rng: np.random.Generator) -> list[str]:
    """One to three overrides `KEY=VALUE`; half of them have a value of the right type."""
    found = []
    for _ in range(int(rng.choice(3, p=(0.7, 0.2, 0.1))) + 1):
        key, value = keys[int(rng.integers(len(keys)))]
        text = _like(value, rng) if rng.random() < 0.6 else WRONG[int(rng.integers(len(WRONG)))]
        draw = rng.random()
        if draw < 0.05:
            key = GARBAGE[int(rng.integers(len(GARBAGE)))]
        elif draw < 0.12:
            key = _misspelt(key, rng)
        found.append(key if rng.random() < 0.01 else f"{key}={text}")
    return found


def _misspelt(key: str, rng: np.random.Generator) -> str:
    k = int(rng.integers(len(key)))
    return (key[:k] + key[k + 1 :], key[:k] + key[k] + key[k:], key[:k] + "x" + key[k + 1 :])[int(rng.integers(3))]


def _like(value: object, rng: np.random.Generator) -> str:
    """A value of the same type in TOML, of another size."""
    if isinstance(value, bool):
        return "true" if rng.random() < 0.5 else "false"
    if isinstance(value, int):
        return str(int((value or 1) * rng.choice((-1, 0, 1, 1, 2, 3, 10, 1000))))
    if isinstance(value, float) or value is None:
        return f"{(value or 1.0) * 10.0 ** rng.uniform(-6, 6) * rng.choice((1, 1, 1, -1)):.4g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_like(part, rng) for part in value)}]"
    if isinstance(value, str):
        return f'"{value}"'
    return "{}"
