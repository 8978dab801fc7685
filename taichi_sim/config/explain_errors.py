"""Explains errors of a configuration: source, key, value, what is allowed, and the probable intention."""

import difflib
import re
import reprlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeGuard

from pydantic import BaseModel, ValidationError

from taichi_sim.config.base import meant as meant
from taichi_sim.config.world import TeamConfig, WorldConfig

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

SHORT = reprlib.Repr()  # shows a value of a file
SHORT.maxlist, SHORT.maxstring, SHORT.maxother, SHORT.maxlevel = 12, 400, 400, 3
SLIP = 0.75  # similarity (difflib) from which an unknown key counts as a misspelling of a known one


def nearly(name: str, known: Iterable[str]) -> str | None:
    """The name in `known` that equals `name` or resembles it; None without one."""
    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=SLIP)), None)


def source_of(key: str, file: str, sources: Mapping[str, str]) -> str:
    """Source of a key of `file` for error messages; `sources` maps keys that overrides have set to those overrides.

    For a section it is the file together with the overrides inside it.
    """
    parts = key.split(".")
    for depth in range(len(parts), 0, -1):  # the key itself, or a section around it that was set as a whole
        if ".".join(parts[:depth]) in sources:
            return sources[".".join(parts[:depth])]
    inside = [name for other, name in sources.items() if key and other.startswith(f"{key}.")]
    return f"{file} with {', '.join(inside)}" if inside else file


def explain(error: ValidationError, model: type[BaseModel], file: str, sources: Mapping[str, str]) -> str:
    """One line for each mistake in the data of a `model`."""
    lines = []
    for item in _telling(error.errors(), model):
        parts = item["loc"][:1] if _is_no_team(item, model) else item["loc"]
        key = ".".join(map(str, parts))
        lines.append(f"{source_of(key, file, sources)}: {_in_words(item, key, model)}")
    return "\n".join(lines)


def _telling(errors: Iterable["ErrorDetails"], model: type[BaseModel]) -> list["ErrorDetails"]:
    """Select the errors that tell a user what to change.

    For a section that is not a team, that is the misspelling of `vehicle` inside it, or otherwise its unknown name.
    """
    inside: dict[tuple[int | str, ...], list[ErrorDetails]] = {}
    for item in errors:
        inside.setdefault(item["loc"][:1], []).append(item)
    selected = []
    for items in inside.values():
        none = [item for item in items if _is_no_team(item, model)]
        slips = [x for x in items if x["type"] == "extra_forbidden" and nearly("vehicle", map(str, x["loc"][1:]))]
        selected += (slips or none) if none else items
    return selected


def _in_words(item: "ErrorDetails", key: str, model: type[BaseModel]) -> str:
    if _is_no_team(item, model):
        fields = keys_at(model, ())
        value = "" if item["type"] == "missing" else f" = {item['input']!r}"
        hint = meant(key, fields) or " (a team has a vehicle)"
        return f"{key}{value}: unknown key{hint}; allowed here: {', '.join(fields)}, and teams"
    if item["type"] == "extra_forbidden":
        fields = keys_at(model, item["loc"][:-1])
        hint = meant(item["loc"][-1], fields)
        return f"{key} = {item['input']!r}: unknown key{hint}; allowed here: {', '.join(fields)}"
    if item["type"] == "missing":
        return f"{key}: missing, and it has no default"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "literal_error":
        message += meant(item["input"], re.findall("'(.*?)'", item.get("ctx", {})["expected"]))
    if not key or isinstance(item["input"], dict | BaseModel):
        return f"{key}: {message}" if key else message
    given = list(item["input"]) if isinstance(item["input"], tuple) else item["input"]
    return f"{key} = {SHORT.repr(given)}: {message[0].lower()}{message[1:]}"


def _is_no_team(item: "ErrorDetails", model: type[BaseModel]) -> bool:
    """Whether the error concerns an unknown key that was parsed as a team."""
    loc = item["loc"]
    if not issubclass(model, WorldConfig) or not loc or loc[0] in model.model_fields:
        return False
    return (item["type"], loc[1:]) in (("model_type", ()), ("missing", ("vehicle",)))


def keys_at(model: object, loc: tuple[int | str, ...]) -> list[str]:
    """Field names at `loc`, as far as the path can be followed."""
    for part in loc:
        field = model.model_fields.get(str(part)) if _is_model(model) else None
        if field is None and _is_model(model) and issubclass(model, WorldConfig):
            model = _team_model(model)
            continue
        annotation = field.annotation if field else model
        inner = [kind for kind in getattr(annotation, "__args__", ()) if _is_model(kind)]
        model = annotation if _is_model(annotation) or not inner else inner[0]
    return sorted(model.model_fields) if _is_model(model) else []


def _is_model(kind: object) -> TypeGuard[type[BaseModel]]:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _team_model(model: type[WorldConfig]) -> type[TeamConfig]:
    """Model that validates team sections."""
    for kind in model.__mro__:
        annotation = kind.__dict__.get("__annotations__", {}).get("__pydantic_extra__")
        if annotation is not None:
            return annotation.__args__[1]
    raise TypeError(f"{model.__name__} has no teams")
