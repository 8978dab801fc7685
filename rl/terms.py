"""Reward terms and observations of a team, those of its class and those that a scenario adds.

A term is a pure function of the team, `team`, and of the endings of the step, `ended`, as far as it names them as
parameters; every other parameter is a number of the term, a key in its section. It returns [env, vehicle]. The first
sentence of its docstring says what it is.

    [usv.terms]
    fine = { scale = 0.3 }                                            # a number of a shipped term
    coarse = { weight = 0.0 }                                         # taken out
    calm = { function = "mine:calm", weight = 0.2, scale = 0.5 }      # def calm(team, scale): ...

    [usv.observe]
    wind = "mine:wind"              # def wind(team): ... -> [env, vehicle, n], of order one
    without = ["drift"]
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import create_model
from torch import Tensor

from rl.scenario import TeamSection
from taichi_sim.config import ConfigError, Finite, Strict
from taichi_sim.config.base import Table, meant
from taichi_sim.config.explain_errors import source_of
from taichi_sim.config.io import validate
from taichi_sim.config.plugins import load_class

READ = ("team", "ended")  # parameters that are no numbers
NO_SOURCES: Mapping[str, str] = {}


class Term(NamedTuple):
    """A reward term of a team's class: its function, its weight, and numbers other than the function's defaults."""

    function: Callable[..., Tensor]
    weight: float = 1.0
    numbers: Mapping[str, float] = {}


class Paid(NamedTuple):
    """A reward term as a team is paid by it."""

    term: Term
    reads: tuple[str, ...]
    added: bool  # by the scenario

    def of(self, team: object, ended: object) -> Tensor:
        """The term now, [env, vehicle], without its weight."""
        given = {"team": team, "ended": ended}
        return self.term.function(**{name: given[name] for name in self.reads}, **self.term.numbers)

    def __str__(self) -> str:
        """Weight, numbers, and what it is."""
        numbers = "".join(f", {key} {value:g}" for key, value in self.term.numbers.items())
        return f"weight {self.term.weight:g}{numbers}: {meaning(self.term.function)}"


class Door(NamedTuple):
    """Where a team's section is read, for errors: file, the overrides of its keys, folders of modules, team."""

    file: str
    beside: Sequence[Path]
    team: str
    sources: Mapping[str, str] = NO_SOURCES

    def refuse(self, key: str, why: str) -> ConfigError:
        """An error of a key of the section."""
        key = f"{self.team}.{key}"
        return ConfigError(f"{source_of(key, self.file, self.sources)}: {key}{why}")

    def function(self, key: str, name: object) -> Callable[..., Any]:
        """The function `module:function` that a key names."""
        try:
            found = load_class(str(name), None, self.beside)
        except ConfigError as error:
            raise self.refuse(key, f" = {error}") from None
        if not inspect.isroutine(found):
            raise self.refuse(key, f" = {name!r}: not a function")
        return found


def meaning(function: Callable[..., object]) -> str:
    """The first sentence of a docstring."""
    return " ".join((inspect.getdoc(function) or "of order one").split("\n\n")[0].split()).removesuffix(".")


def paid_terms(declared: Mapping[str, Term], section: TeamSection, door: Door) -> dict[str, Paid]:
    """The terms `declared` by a team's class with the changes of its section, and those that it adds."""
    terms, given = dict(declared), {name: dict(keys) for name, keys in section.terms.items()}
    for name, keys in given.items():
        if "function" not in keys:
            continue
        if name in declared:
            raise door.refuse(f"terms.{name}.function", ": the team has a term of this name: choose another")
        terms[name] = Term(door.function(f"terms.{name}.function", keys.pop("function")))
    kinds: dict[str, Any] = {name: (_keys(name, term), {}) for name, term in terms.items()}
    section_of = create_model("Terms", __base__=Strict, **kinds)
    team_of = create_model("Team", __base__=Strict, terms=(section_of, ...))
    whole: Any = create_model("Whole", __base__=Strict, **{door.team: (team_of, ...)})  # pyright: ignore
    data: Table = {door.team: {"terms": {name: {} for name in terms} | given}}
    read = getattr(validate(whole, data, door.file, door.sources), door.team).terms
    found = {}
    for name, term in terms.items():
        numbers = getattr(read, name).model_dump()
        new = Term(term.function, numbers.pop("weight"), numbers)
        reads = tuple(key for key in inspect.signature(term.function).parameters if key in READ)
        found[name] = Paid(new, reads, name not in declared)
    return found


def _keys(name: str, term: Term) -> type[Strict]:
    """The keys of a term: its weight, and the numbers of its function."""
    keys: dict[str, Any] = {"weight": (Finite, term.weight)}
    for key, of in inspect.signature(term.function).parameters.items():
        if key not in READ:
            kind = Finite if of.annotation in (inspect.Parameter.empty, float) else of.annotation
            default = term.numbers.get(key, ... if of.default is inspect.Parameter.empty else of.default)
            keys[key] = (kind, default)
    return create_model(name, __base__=Strict, **keys)


def added_observations(section: TeamSection, door: Door) -> dict[str, Callable[..., Tensor]]:
    """Functions of the observations that a section adds, by name."""
    given = {} if section.observe is None else section.observe.added
    return {name: door.function(f"observe.{name}", function) for name, function in given.items()}


def check_names(shipped: Sequence[str], section: TeamSection, door: Door) -> None:
    """Refuse observations to be left out that the class has not, and added ones of a name that it has."""
    if section.observe is None:
        return
    without = section.observe.without
    for name in without:
        if name not in shipped:
            raise door.refuse("observe.without", f": there is no {name!r}{meant(name, shipped)}; there are "
                              f"{', '.join(shipped)}")  # fmt: skip
        if without.count(name) > 1:
            raise door.refuse("observe.without", f": {name!r} is named twice")
    for name in section.observe.added:
        if name in shipped and name not in without:
            raise door.refuse(f"observe.{name}", ": there is an observation of this name: choose another, or take that "
                              f"one out, by without = [{name!r}]")  # fmt: skip
