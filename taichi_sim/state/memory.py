"""What an object remembers between two steps, declared once, where it is made.

A class whose objects hold state derives from `Remembers`. Its assignments say what becomes of a value:

    self.table = self.remember(zeros)    differs between environments: a tensor [env, ...], None, a part that remembers,
                                         a dictionary, list or tuple of such
    self.clock = self.share(0)           the same for all environments: numbers, generators, tensors of any shape
    self.slot = self.scratch(zeros)      no state: computed anew before anybody reads it

Later assignments and writes in place need no further word. What is not declared is constant, or a view of what is
remembered. A part is remembered by the object that owns it; others may hold it. taichi_sim/state/snapshot.py saves,
restores and copies what is declared, and refuses what was forgotten.
"""

from enum import Enum
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from torch import Tensor

from taichi_sim.errors import UserError

T = TypeVar("T")


class StateError(UserError, ValueError):
    """A state cannot be taken, written or copied, or is not declared."""


class Kind(Enum):
    """What becomes of an attribute."""

    OF_ENV = "remember"
    SHARED = "share"
    SCRATCH = "scratch"


class _Declared(NamedTuple):
    """A value on its way to the attribute that holds it."""

    kind: Kind
    value: Any


NUMBERS = (bool, int, float, complex, np.generic)
AGAIN = -1  # version of a number that is assigned again
_WATCHED = (Tensor, *NUMBERS)


class Remembers:
    """An object that says what it remembers; see the module."""

    def __init_subclass__(cls) -> None:
        """Refuse the lists of names by which classes once said what they remember.

        Raises:
            StateError: for a class with `STATE` or `SHARED`, which nobody reads.
        """
        super().__init_subclass__()
        for name, method in (("STATE", Kind.OF_ENV), ("SHARED", Kind.SHARED)):
            if name in vars(cls):
                raise StateError(
                    f"{cls.__name__}.{name} is read no more: declare each of its names where it is made, by "
                    f"self.NAME = self.{method.value}(...) (docs/extending.md)"
                )

    def remember(self, value: T) -> T:
        """Declare a value that differs between environments, to be assigned to an attribute."""
        return cast(T, _Declared(Kind.OF_ENV, value))

    def share(self, value: T) -> T:
        """Declare a value that changes and is the same for all environments, to be assigned to an attribute."""
        return cast(T, _Declared(Kind.SHARED, value))

    def scratch(self, value: T) -> T:
        """Declare a value that changes and is no state, to be assigned to an attribute."""
        return cast(T, _Declared(Kind.SCRATCH, value))

    def restored(self) -> None:
        """Called after state has been written: drop caches, bind kernels again. Default: nothing."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Register what is declared.

        Raises:
            StateError: for a name that is declared twice, or a tensor that is assigned again undeclared.
        """
        mine, kinds = vars(self), declared(self)
        if type(value) is _Declared:
            if name in kinds:
                raise StateError(
                    f"{type(self).__name__}.{name} is declared twice, first by self.{kinds[name].value}(...): assign "
                    "it plainly the second time, or give one of the two another name"
                )
            kinds[name], value = value
            versions(self).pop(name, None)
        elif name not in kinds and isinstance(value, _WATCHED):
            if isinstance(value, Tensor):
                if name in mine:
                    raise undeclared(self, name, "is assigned again")
                versions(self)[name] = version(value)
            elif name in mine:
                versions(self)[name] = AGAIN
        object.__setattr__(self, name, value)


def declared(thing: Remembers) -> dict[str, Kind]:
    """What becomes of the attributes of an object, by name."""
    return vars(thing).setdefault("_kinds", {})


def versions(thing: Remembers) -> dict[str, int]:
    """By name, `version` of each undeclared tensor when it was assigned, and `AGAIN` for numbers."""
    return vars(thing).setdefault("_versions", {})


def version(tensor: Tensor) -> int:
    """How often torch has written a tensor in place."""
    return 0 if tensor.is_inference() else tensor._version


def undeclared(thing: object, name: str, why: str) -> StateError:
    """An error that says how to declare attribute `name`, which `why`."""
    return StateError(
        f"{type(thing).__name__}.{name} {why}, and is not declared: make it by self.{name} = self.remember(...) if "
        "it is state of each environment, self.share(...) if it is state that all share, self.scratch(...) if it is "
        "computed anew before anybody reads it (docs/extending.md)"
    )
