"""Snapshots, restoring, copies and forks of everything that a world or a mission remembers.

Every class that keeps state between two steps names it in two class attributes:

    STATE    state that differs between environments: tensors [env, ...], and parts with state of their own (objects
             with these attributes, or dictionaries, lists and tuples of such)
    SHARED   state that all environments share: counters, seeds, generators, numbers, tensors of any shape

Names that an object does not have (yet) are skipped; a value may be None. A subclass adds to the names of its bases. A
method `restored()`, if there is one, is called after any state has been written, to drop caches or to bind kernels
again.

A user's class that names nothing has a default, which covers every attribute that no class with names assigns. Tensors
whose first dimension is the number of environments, and parts, count as STATE. Numbers, texts, generators, arrays and
other tensors count as SHARED. Tuples, functions, configurations and kernels are constants. Any other value is refused
by name.

Tensors are written in place if the shape allows it, so that kernels stay bound to them.
"""

import dis
import functools
import hashlib
import os
import random
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, Self

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor

from taichi_sim.arguments import Envs, environments
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import FIRST_FORKED, Noise

VERSION = 4  # version of a snapshot's layout
GIB = 2**30
WORKING_SHARE = 4.0  # memory of an environment over that of its state: buffers of kernels and torch; assumed

NoiseOf = Literal["shared", "own"]
"""Whether copies draw the noise of their source (sensors, radio, gusts), or their own."""


class StateError(ValueError):
    """A state cannot be taken, written or copied."""


@dataclass(frozen=True)
class Snapshot:
    """A copy of everything that a world or a mission remembers; `torch.save` can write it.

    Attributes:
        version: version of the layout.
        about: identity of the world or mission.
        num_envs: number of environments.
        values: path -> value.
    """

    version: int
    about: dict[str, object]
    num_envs: int
    values: dict[str, object]


class Entry(NamedTuple):
    """One remembered value."""

    path: str
    owner: Any  # an object, a dictionary or a list
    key: Any
    of_env: bool  # whether it differs between environments

    @property
    def value(self) -> Any:
        """The present value of the entry."""
        if isinstance(self.owner, dict | list):
            return self.owner[self.key]
        return getattr(self.owner, self.key)

    def put(self, value: object) -> None:
        """Replace the value of the entry."""
        if isinstance(self.owner, dict | list):
            self.owner[self.key] = value
        else:
            setattr(self.owner, self.key, value)


_FUNCTION = types.FunctionType | types.MethodType | types.BuiltinFunctionType | functools.partial
_KERNEL = runtime.Launcher | runtime.Runtime | torch.device | torch.dtype
_CONSTANT = _FUNCTION | _KERNEL | types.ModuleType | type | Path | bytes | BaseModel | frozenset | range
_NUMBERS = bool | int | float | complex | np.generic
_PLAIN = _NUMBERS | str | types.NoneType
_GENERATORS = torch.Generator | np.random.Generator | random.Random


class _Walk:
    """Finds the entries of an object and of its parts, each once."""

    def __init__(self, num_envs: int):
        self.num_envs = num_envs
        self.entries: list[Entry] = []
        self.objects: list[object] = []
        self._seen: set[int] = set()

    def part(self, value: object, path: str) -> None:
        """Walk a part: an object, or a container of parts."""
        if isinstance(value, _PLAIN | _CONSTANT) or id(value) in self._seen:
            return
        self._seen.add(id(value))
        if isinstance(value, Mapping):
            for key, item in value.items():
                self._state(value, key, item, f"{path}[{key!r}]")
        elif isinstance(value, list | tuple):
            for k, item in enumerate(value):
                self._state(value, k, item, f"{path}[{k}]")
        else:
            self._object(value, path)

    def _state(self, owner: object, key: object, value: object, path: str) -> None:
        """Add a value under STATE; a property that is None has no state at present."""
        if value is None and isinstance(getattr(type(owner), str(key), None), property):
            return
        if value is None or isinstance(value, Tensor):
            self.entries.append(Entry(path, owner, key, True))
        else:
            self.part(value, path)

    def _object(self, value: object, path: str) -> None:
        self.objects.append(value)
        names = _names(type(value))
        for name in names.state:
            if (item := getattr(value, name, self)) is not self:
                self._state(value, name, item, f"{path}.{name}")
        for name in names.shared:
            if hasattr(value, name):
                self.entries.append(Entry(f"{path}.{name}", value, name, False))
        if not names.complete:
            for name, item in vars(value).items():
                if name not in names.assigned:
                    self._default(value, name, item, f"{path}.{name}")

    def _default(self, owner: object, key: object, value: object, path: str) -> None:
        """Add an attribute of a class that names nothing."""
        if isinstance(value, Tensor):
            self.entries.append(Entry(path, owner, key, value.dim() > 0 and value.shape[0] == self.num_envs))
        elif value is None or isinstance(value, _NUMBERS | _GENERATORS | np.ndarray | str):
            self.entries.append(Entry(path, owner, key, False))
        elif isinstance(value, _CONSTANT) or id(value) in self._seen or type(value).__module__.startswith("taichi."):
            return
        elif isinstance(value, dict | list):
            self._seen.add(id(value))
            items = value.items() if isinstance(value, dict) else enumerate(value)
            if all(isinstance(item, _PLAIN) for _, item in items):
                self.entries.append(Entry(path, owner, key, False))
            else:
                for k, item in value.items() if isinstance(value, dict) else enumerate(value):
                    self._default(value, k, item, f"{path}[{k!r}]")
        elif isinstance(value, tuple):
            for k, item in enumerate(value):
                if not isinstance(item, Tensor | _PLAIN):
                    self._default(value, k, item, f"{path}[{k}]")
        elif hasattr(value, "__dict__"):
            self.part(value, path)
        else:
            kind = type(value)
            raise StateError(
                f"{path} is a {kind.__module__}.{kind.__qualname__}, which a snapshot cannot look into: name what "
                f"{type(owner).__name__} remembers in its class attributes STATE and SHARED (docs/extending.md)"
            )


class _Names(NamedTuple):
    """Names of the state of a class."""

    state: tuple[str, ...]
    shared: tuple[str, ...]
    complete: bool  # whether the class itself names its state
    assigned: frozenset[str]  # attributes that classes with names assign


@functools.cache
def _names(kind: type) -> _Names:
    """STATE and SHARED of a class with those of its bases, and the attributes that it assigns."""
    named = [base for base in kind.__mro__ if "STATE" in vars(base) or "SHARED" in vars(base)]

    def of(attribute: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for base in reversed(named) for name in vars(base).get(attribute, ())))

    state, shared = of("STATE"), of("SHARED")
    known = [base for base in kind.__mro__ if named and issubclass(named[0], base)]
    assigned = frozenset(state + shared).union(*(_assigned(base) for base in known))
    return _Names(state, shared, bool(named) and named[0] is kind, assigned)


def _assigned(kind: type) -> frozenset[str]:
    """Names of the attributes that the methods of a class assign."""
    methods = [getattr(value, "fget", None) or getattr(value, "__wrapped__", value) for value in vars(kind).values()]
    return frozenset(
        instruction.argval
        for method in methods
        if isinstance(method, types.FunctionType)
        for instruction in dis.get_instructions(method)
        if instruction.opname == "STORE_ATTR"
    )


def walk(root: Any) -> _Walk:
    """The entries of `root`, which has `num_envs`, and the objects that own them."""
    found = _Walk(root.num_envs)
    found.part(root, type(root).__name__)
    return found


def about(root: Any) -> dict[str, object]:
    """Identity of a world or mission, whatever its number of environments."""
    kind, config = type(root), root.config
    digest = hashlib.sha256(config.model_dump_json().encode()).hexdigest()[:16]
    return {
        "class": f"{kind.__module__}.{kind.__qualname__}",
        "scenario": getattr(config, "name", ""),
        "configuration": digest,
        "seed": root.seed,
        "teams": list(root.teams),
        "precision": runtime.current().precision,
    }


# -- writing -----------------------------------------------------------------------------------------------------------


def _taken(value: object) -> object:
    """A copy that later steps do not change."""
    if isinstance(value, Tensor):
        return value.clone()
    if isinstance(value, np.ndarray | list | dict):
        return value.copy()
    if isinstance(value, torch.Generator):
        return value.get_state()
    if isinstance(value, np.random.Generator):
        return value.bit_generator.state
    if isinstance(value, random.Random):
        return value.getstate()
    return value  # numbers, texts and tuples are immutable


class _Writer:
    """Writes values, in place if possible.

    Two entries may hold the same tensor. If their new values are equal they keep sharing it; otherwise each gets its
    own.
    """

    def __init__(self):
        self._written: dict[tuple[int, int], Tensor] = {}

    def __call__(self, entry: Entry, value: object) -> None:
        now = entry.value
        if not isinstance(value, Tensor) or isinstance(now, torch.Generator):
            if isinstance(now, np.ndarray) and isinstance(value, np.ndarray) and now.shape == value.shape:
                now[...] = value
            else:
                _put_generator(entry, now, value)
        elif not isinstance(now, Tensor) or now.shape != value.shape or now.dtype != value.dtype or 0 in now.stride():
            entry.put(value.clone())
        elif (before := self._written.get(place := (now.data_ptr(), now.numel()))) is None or not now.numel():
            now.copy_(value)
            self._written[place] = value
        elif not torch.equal(before.flatten(), value.flatten()):
            entry.put(value.clone())


def _put_generator(entry: Entry, now: Any, value: Any) -> None:
    """Give a generator the state `value`, or replace whatever else is remembered."""
    if isinstance(now, torch.Generator):
        now.set_state(value)
    elif isinstance(now, np.random.Generator):
        now.bit_generator.state = value
    elif isinstance(now, random.Random):
        now.setstate(value)
    else:
        entry.put(_taken(value))


def restored(found: _Walk) -> None:
    """Tell all objects that their state was written."""
    for thing in found.objects:
        if (then := getattr(thing, "restored", None)) is not None:
            then()


# -- saving, copying, forking ------------------------------------------------------------------------------------------


def transfer(source: object, target: object) -> None:
    """Copy the state of part `source` of one mission into `target`, a part of the same kind and size of another
    mission.

    Raises:
        StateError: if their entries differ.
    """
    entries, write = _entries_of(source), _Writer()
    there = {entry.path: entry for entry in _entries_of(target)}
    if missing := [entry.path for entry in entries if entry.path not in there]:
        raise StateError(f"{type(target).__name__} has no {missing[0]}")
    for entry in entries:
        write(there[entry.path], _taken(entry.value))


def _entries_of(part: object) -> list[Entry]:
    found = _Walk(-1)
    found.part(part, type(part).__name__)
    return found.entries


def _envs(given: Envs, num_envs: int, name: str, *, twice: bool = False) -> Tensor:
    """Check environments and convert them to int64 [n]."""
    try:
        return environments(given, num_envs, name, whole=True, twice=twice)
    except ValueError as error:
        raise StateError(str(error)) from None


def _check_noise(noise: str) -> None:
    if noise not in ("shared", "own"):
        raise StateError(f"noise = {noise!r}: allowed are 'shared' and 'own'")


def _size(source: _Walk) -> float:
    """Bytes of state of each environment."""
    values = (entry.value for entry in source.entries if entry.of_env)
    return sum(value.nbytes for value in values if isinstance(value, Tensor)) / source.num_envs


def check_memory(each: float, total: int) -> None:
    """Refuse `total` environments with `each` bytes of state that do not fit into memory.

    Raises:
        StateError: saying how much memory they would take.
    """
    need, free = WORKING_SHARE * each * total, _free_memory()
    if need > free:
        raise StateError(
            f"{total} environments would take about {need / GIB:.1f} GiB of memory; {free / GIB:.1f} GiB are free"
        )


def _free_memory() -> float:
    """Bytes available without swapping, on the device of the state."""
    if runtime.current().arch == "cuda":
        return float(torch.cuda.mem_get_info()[0])
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    except (OSError, ValueError):  # not Linux
        pass
    return float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")


class Stateful:
    """A world or a mission whose environments can be saved, restored, copied and forked (module docstring)."""

    num_envs: int
    program: runtime.Runtime

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Refuse to be copied by `copy` or written by `pickle`: kernels and packs are of this process alone.

        Raises:
            TypeError: naming what copies and saves.
        """
        kind = type(self).__name__
        raise TypeError(
            f"a {kind} cannot be copied by `copy` or `pickle`: fork(envs) makes a {kind} of copies of its environments "
            "(of an adapter: env.mission.fork, env.task.fork), snapshot() takes its state, which torch.save "
            "writes and restore(...) goes back to"
        )

    @runtime.torch_at_rest()
    def snapshot(self) -> Snapshot:
        """Copy everything that the environments remember; `restore` continues from there, to the bit."""
        self.program.check()
        values = {entry.path: _taken(entry.value) for entry in walk(self).entries}
        return Snapshot(VERSION, about(self), self.num_envs, values)

    @runtime.torch_at_rest()
    def restore(self, saved: Snapshot) -> None:
        """Restore a snapshot of this world, or of one of the same configuration and seed.

        Raises:
            StateError: for a snapshot of another world, number of environments, or version; nothing is written then.
        """
        if not isinstance(saved, Snapshot):
            raise StateError(f"a {type(saved).__name__} is no snapshot")
        if saved.version != VERSION:
            raise StateError(f"the snapshot has version {saved.version}; this program reads version {VERSION}")
        here = about(self)
        if wrong := [key for key in here if saved.about.get(key) != here[key]]:
            differences = ", ".join(f"{key} {saved.about.get(key)!r} instead of {here[key]!r}" for key in wrong)
            raise StateError(f"the snapshot was taken of another {type(self).__name__}: {differences}")
        if saved.num_envs != self.num_envs:
            raise StateError(f"the snapshot has {saved.num_envs} environments, not {self.num_envs}")
        found = walk(self)
        missing = {entry.path for entry in found.entries} - saved.values.keys()
        if missing:
            raise StateError(f"the snapshot lacks {', '.join(sorted(missing)[:3])}: it was taken of other parts")
        write = _Writer()
        for entry in found.entries:
            write(entry, saved.values[entry.path])
        restored(found)

    @runtime.torch_at_rest()
    def copy(self, source_envs: Envs, target_envs: Envs, *, noise: NoiseOf = "shared") -> None:
        """Make environments `target_envs` [n] equal to `source_envs` [n]; see `NoiseOf`.

        Raises:
            StateError: for environments that do not exist, a target that is named twice, or another number of targets.
        """
        self.program.check()
        source = _envs(source_envs, self.num_envs, "source_envs", twice=True)
        target = _envs(target_envs, self.num_envs, "target_envs")
        if len(source) != len(target):
            raise StateError(f"{len(source)} source_envs for {len(target)} target_envs")
        _check_noise(noise)
        found = walk(self)
        for entry in found.entries:
            value = entry.value
            if entry.of_env and value is not None and not (noise == "own" and isinstance(entry.owner, Noise)):
                if len(value) == self.num_envs:
                    value[target] = value[source]
        restored(found)

    @runtime.torch_at_rest()
    def fork(self, envs: Envs, copies: int = 1, *, noise: NoiseOf = "shared", into: Any = None) -> Self:
        """Environments `envs` [n], `copies` times each, in a world of their own: copy c of envs[i] is i copies + c.

        With the same actions a copy that shares the noise does what its source does, until a new episode begins. `into`
        is an earlier fork of the same size, which is overwritten in milliseconds; without one a world is built, which
        takes as long as this one did.

        Raises:
            StateError: for environments that do not exist, `into` of another kind or size, or too little memory; the
                message says how much.
        """
        self.program.check()
        rows = _envs(envs, self.num_envs, "envs", twice=True)
        if copies < 1 or not len(rows):
            raise StateError(f"a fork of {len(rows)} environments, {copies} copies each: there is nothing in it")
        _check_noise(noise)
        this: Any = self
        rows, source = rows.repeat_interleave(copies), walk(self)
        total = len(rows)
        if into is None:
            check_memory(_size(source), total)
            into = this._alike(total)
        elif (into.num_envs, type(into), into.config, into.seed) != (total, type(self), this.config, this.seed):
            raise StateError(
                f"`into` is a {type(into).__name__} of {into.num_envs} environments, scenario "
                f"{getattr(into.config, 'name', '')!r}, seed {into.seed}: the fork has {total} of "
                f"{type(self).__name__}, {getattr(this.config, 'name', '')!r}, seed {this.seed}"
            )
        target, write = {entry.path: entry for entry in walk(into).entries}, _Writer()
        for entry in source.entries:
            there, value = target.get(entry.path), entry.value
            if there is None:
                raise StateError(f"the fork has no {entry.path}: its parts are others than those of its source")
            if entry.of_env and isinstance(value, Tensor) and len(value) == self.num_envs:
                if isinstance(entry.owner, Noise) and noise == "own":
                    there.value.copy_(FIRST_FORKED + torch.arange(total))
                    continue
                write(there, value.index_select(0, rows))
            else:
                write(there, _taken(value))
        restored(walk(into))
        return into

    def _alike(self, num_envs: int) -> Self:
        """Another world or mission of the same configuration, seed and teams."""
        raise NotImplementedError
