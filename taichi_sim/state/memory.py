"""What an object remembers between two steps, declared once, where it is made.

A class whose objects hold state derives from `Remembers`. Its assignments say what becomes of a value:

    self.table = self.remember(zeros)    differs between environments: a tensor [env, ...], None, a part that remembers,
                                         a dictionary, list or tuple of such
    self.clock = self.share(0)           the same for all environments: numbers, generators, tensors of any shape
    self.slot = self.scratch(zeros)      no state: computed anew before anybody reads it

Later assignments and writes in place need no further word. What is not declared is constant, or a view of what is
remembered. A part is remembered by the object that owns it; others may hold it. taichi_sim/state/snapshot.py saves,
restores and copies what is declared. A test shows what was forgotten: after a restore the same steps lead elsewhere.
"""

from enum import Enum
from typing import Any, NamedTuple, TypeVar, cast

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


class Remembers:
    """An object that says what it remembers; see the module."""

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
        elif isinstance(value, Tensor) and name in mine and name not in kinds:
            raise StateError(
                f"{type(self).__name__}.{name} is assigned again, and is not declared: make it by self.{name} = "
                "self.remember(...) if it is state of each environment, self.share(...) if it is state that all share, "
                "self.scratch(...) if it is computed anew before anybody reads it (docs/extending.md)"
            )
        object.__setattr__(self, name, value)


def declared(thing: Remembers) -> dict[str, Kind]:
    """What becomes of the attributes of an object, by name."""
    return vars(thing).setdefault("_kinds", {})
