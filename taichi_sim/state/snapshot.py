"""Snapshots, restoring, copies and forks of everything that a world or a mission remembers
(taichi_sim/state/memory.py).

Tensors are written in place if the shape allows it, so that kernels stay bound to them. What classes have declared is
found from the world or mission on, each part once. A `StateError` names an
attribute that was declared and is gone, or that is remembered and whose class does not derive from `Remembers`. Other
state that nobody has declared stays as it is.
"""

import contextlib
import functools
import hashlib
import math
import random
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, Self

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor

from taichi_sim.config.arguments import Envs, environments, whole_number
from taichi_sim.errors import refuse
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import Keys, Noise
from taichi_sim.state.memory import Kind, Remembers, StateError, declared

VERSION = 5  # version of a snapshot's layout
GIB = 2**30
WORKING_SHARE = 4.0  # memory of an environment over that of its state: buffers of kernels and torch; assumed

NoiseOf = Literal["shared", "own"]
"""Whether copies draw the noise of their source (sensors, radio, gusts), or their own."""


@dataclass(frozen=True)
class Snapshot:
    """A copy of everything that a world or a mission remembers; `torch.save` can write it.

    Attributes:
        version: version of the layout.
        about: identity of the world or mission.
        num_envs: number of environments.
        values: path -> value.
        made: names of the parts that had been made at first use (`Stateful.made`).
    """

    version: int
    about: dict[str, object]
    num_envs: int
    values: dict[str, object]
    made: tuple[str, ...] = ()


@dataclass(frozen=True)
class Archive:
    """States of single environments, kept apart from the world or mission that they came from (`Stateful.keep`).

    Attributes:
        about, made: as of a `Snapshot`.
        rows: number of states.
        values: path -> [row, ...] of what differs between environments.
        whole: path -> what is declared as such and is no tensor [env, ...].
    """

    about: dict[str, object]
    made: tuple[str, ...]
    rows: int
    values: dict[str, Tensor]
    whole: dict[str, object]

    def __len__(self) -> int:
        """Number of states."""
        return self.rows

    def pick(self, rows: Tensor) -> "Archive":
        """States `rows` [n], int64."""
        values = {path: value.index_select(0, rows) for path, value in self.values.items()}
        return Archive(self.about, self.made, len(rows), values, self.whole)

    def joined(self, *others: "Archive") -> "Archive":
        """These states and then those of `others`, which came from the same world."""
        parts = self, *others
        values = {path: torch.cat([part.values[path] for part in parts]) for path in self.values}
        return Archive(self.about, self.made, sum(map(len, parts)), values, self.whole)


class Entry(NamedTuple):
    """One remembered value."""

    path: str
    owner: Any  # an object, or a container
    key: Any
    of_env: bool  # whether it differs between environments

    @property
    def value(self) -> Any:
        """The present value of the entry."""
        return getattr(self.owner, self.key) if isinstance(self.owner, Remembers) else self.owner[self.key]

    def put(self, value: object) -> None:
        """Replace the value of the entry."""
        if isinstance(self.owner, Remembers):
            setattr(self.owner, self.key, value)
        else:
            self.owner[self.key] = value


_FUNCTION = types.FunctionType | types.MethodType | types.BuiltinFunctionType | functools.partial
_KERNEL = runtime.Launcher | runtime.Runtime | torch.device | torch.dtype
_CONSTANT = _FUNCTION | _KERNEL | types.ModuleType | type | Path | bytes | BaseModel | frozenset | range
_PLAIN = bool | int | float | complex | np.generic | str


class _Walk:
    """Finds the entries of an object and of its parts, each once."""

    def __init__(self, num_envs: int):
        self.num_envs = num_envs
        self.entries: list[Entry] = []
        self.objects: list[Remembers] = []
        self._seen: set[int] = set()

    def find(self, value: object, path: str, owner: object = None, key: object = None) -> None:
        """Find the entries of a value that differs between environments, held by `owner` under `key`."""
        if value is None or isinstance(value, Tensor):
            self.entries.append(Entry(path, owner, key, True))
        elif isinstance(value, _PLAIN):
            if not isinstance(owner, tuple):
                self.entries.append(Entry(path, owner, key, False))
        elif isinstance(value, _CONSTANT) or id(value) in self._seen:
            return
        elif isinstance(value, Remembers):
            self._seen.add(id(value))
            self._attributes(value, path)
        elif isinstance(value, Mapping | list | tuple):
            self._seen.add(id(value))
            for k, item in value.items() if isinstance(value, Mapping) else enumerate(value):
                self.find(item, f"{path}[{k!r}]", value, k)
        else:
            kind = f"{type(value).__module__}.{type(value).__qualname__}"
            raise StateError(
                f"{path} is a {kind}, which does not say what it remembers: derive its class from "
                "taichi_sim.state.memory.Remembers, or share(...) an array or a generator (docs/extending.md)"
            )

    def _attributes(self, thing: Remembers, path: str) -> None:
        self.objects.append(thing)
        held = vars(thing)
        for name, kind in declared(thing).items():
            if name not in held:
                raise StateError(
                    f"{type(thing).__name__}.{name} was declared by self.{kind.value}(...) and is gone: a declared "
                    "attribute stays; set it to None"
                )
            elif kind is Kind.OF_ENV:
                self.find(held[name], f"{path}.{name}", thing, name)
            elif kind is Kind.SHARED:
                self.entries.append(Entry(f"{path}.{name}", thing, name, False))


def walk(root: Any) -> _Walk:
    """The entries of `root`, which has `num_envs`, and the objects that own them."""
    found = _Walk(root.num_envs)
    found.find(root, type(root).__name__)
    return found


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _kind(root: Any) -> tuple[object, ...]:
    """What two worlds or missions must have in common; quick to compare where objects are the same."""
    params = tuple(fleet.model.params for fleet in _fleets(root))
    return type(root), root.config, root.seed, tuple(root.teams), params


def _fleets(root: Any) -> list[Any]:
    return list(getattr(root, "world", root).teams.values())


def about(root: Any) -> dict[str, object]:
    """Identity of a world or mission, whatever its number of environments."""
    kind, config = type(root), root.config
    return {
        "class": f"{kind.__module__}.{kind.__qualname__}",
        "scenario": getattr(config, "name", ""),
        "configuration": _digest(config.model_dump_json()),
        "seed": root.seed,
        "teams": list(root.teams),
        "vehicles": [_digest(fleet.model.params.model_dump_json()) for fleet in _fleets(root)],
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

    def rows(self, entry: Entry, rows: Tensor, value: Tensor) -> None:
        """Write rows of a tensor."""
        now = entry.value
        before = self._written.get(place := (now.data_ptr(), now.numel()))
        if 0 in now.stride() or (before is not None and now.numel() and not torch.equal(before, value)):
            now = now.clone()
            entry.put(now)
        now[rows] = value
        self._written[place] = value


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
        thing.restored()


# -- saving, copying, forking ------------------------------------------------------------------------------------------


def transfer(source: object, target: object) -> None:
    """Copy the state of part `source` of one mission into `target`, a part of the same kind and size of another
    mission.
    """
    given, write = entries(source), _Writer()
    there = {entry.path: entry for entry in entries(target)}
    if missing := [entry.path for entry in given if entry.path not in there]:
        raise StateError(f"{type(target).__name__} has no {missing[0]}")
    for entry in given:
        write(there[entry.path], _taken(entry.value))


def entries(part: object) -> list[Entry]:
    """All values that a part of a world or a mission remembers."""
    found = _Walk(-1)
    found.find(part, type(part).__name__)
    return found.entries


def _envs(given: Envs, num_envs: int, name: str, *, twice: bool = False) -> Tensor:
    """Check environments and convert them to int64 [n]."""
    with _as_state_errors():
        return environments(given, num_envs, name, whole=True, twice=twice)


@contextlib.contextmanager
def _as_state_errors() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise StateError(str(error)) from None


def _same(saved: Snapshot | Archive, here: dict[str, object], kind: str) -> None:
    """Refuse what was taken of another world or mission."""
    if wrong := [key for key in here if saved.about.get(key) != here[key]]:
        differences = ", ".join(f"{key} {saved.about.get(key)!r} instead of {here[key]!r}" for key in wrong)
        raise StateError(f"the snapshot was taken of another {kind}: {differences}")


def _fits(entry: Entry, kept: Archive, num_envs: int) -> bool:
    """Whether a kept state has rows for an entry, or the same value where it has no rows."""
    now, rows = entry.value, kept.values.get(entry.path)
    if isinstance(now, Tensor) and len(now) == num_envs and rows is not None:
        return rows.shape[1:] == now.shape[1:] and rows.dtype == now.dtype
    whole = kept.whole.get(entry.path, kept)
    if isinstance(now, Tensor) and isinstance(whole, Tensor):
        return torch.equal(now, whole)
    return rows is None and now is whole is None


def _known_noise(noise: str) -> tuple[bool, str]:
    return noise not in ("shared", "own"), f"noise = {noise!r}: allowed are 'shared' and 'own'"


def _size(source: _Walk) -> float:
    """Bytes of state of each environment."""
    values = (entry.value for entry in source.entries if entry.of_env)
    return sum(value.nbytes for value in values if isinstance(value, Tensor)) / source.num_envs


def check_memory(each: float, total: int) -> None:
    """Refuse `total` environments with `each` bytes of state that do not fit into memory."""
    need, free = WORKING_SHARE * each * total, _free_memory()
    if need > free:
        raise StateError(
            f"{total} environments would take about {need / GIB:.1f} GiB of memory; {free / GIB:.1f} GiB are free"
        )


def _free_memory() -> float:
    """Bytes available without swapping, on the device of the state."""
    if runtime.current().arch == "cuda":
        return float(torch.cuda.mem_get_info()[0])
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    return math.inf  # not Linux: it is not known


class Stateful(Remembers):
    """A world or a mission whose environments can be saved, restored, copied and forked (module docstring)."""

    num_envs: int
    keys: Keys
    """Keys of copies that draw noise of their own; forks share those of their source."""

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Refuse to be copied by `copy` or written by `pickle`: kernels and packs are of this process alone."""
        kind = type(self).__name__
        raise TypeError(
            f"a {kind} cannot be copied by `copy` or `pickle`: fork(envs) makes a {kind} of copies of its environments "
            "(of an adapter: env.mission.fork, env.task.fork), snapshot() takes its state, which torch.save "
            "writes and restore(...) goes back to"
        )

    @runtime.torch_at_rest()
    def snapshot(self) -> Snapshot:
        """Copy everything that the environments remember; `restore` continues from there, to the bit."""
        values = {entry.path: _taken(entry.value) for entry in walk(self).entries}
        return Snapshot(VERSION, about(self), self.num_envs, values, self.made())

    @runtime.torch_at_rest()
    def restore(self, saved: Snapshot) -> None:
        """Restore a snapshot of this world, or of one of the same configuration and seed.

        Raises:
            StateError: for a snapshot of another world, number of environments, or version; nothing is written then.
        """
        if not isinstance(saved, Snapshot) or (saved.version, saved.num_envs) != (VERSION, self.num_envs):
            told = f"{saved.num_envs} environments, version {saved.version}" if isinstance(saved, Snapshot) else "none"
            raise StateError(f"the snapshot is {told}; wanted are {self.num_envs} environments, version {VERSION}")
        _same(saved, about(self), type(self).__name__)
        self.make(saved.made)
        found = walk(self)
        missing = {entry.path for entry in found.entries} - saved.values.keys()
        if missing:
            raise StateError(f"the snapshot lacks {', '.join(sorted(missing)[:3])}: it was taken of other parts")
        write = _Writer()
        for entry in found.entries:
            write(entry, saved.values[entry.path])
            if isinstance(entry.owner, Noise) and entry.of_env:
                self.keys.skip(entry.value)
        restored(found)

    @runtime.torch_at_rest()
    def keep(self, envs: Envs) -> Archive:
        """Copy what environments `envs` [n] remember, row by row, for `put`."""
        rows, values, whole = _envs(envs, self.num_envs, "envs", twice=True), {}, {}
        for entry in walk(self).entries:
            value = entry.value
            if entry.of_env and isinstance(value, Tensor) and len(value) == self.num_envs:
                values[entry.path] = value.index_select(0, rows)
            elif entry.of_env:
                whole[entry.path] = _taken(value)
        return Archive(about(self), self.made(), len(rows), values, whole)

    @runtime.torch_at_rest()
    def put(self, kept: Archive, envs: Envs, *, noise: NoiseOf = "own") -> None:
        """Make environments `envs` [n] what the states `kept` [n] were, of this world or of another of the same
        configuration and seed, with any number of environments. Clocks stay, so even with the keys of their source
        (`noise` "shared") they meet other noise than it did, unless both clocks agree.

        Raises:
            StateError: for a state of another world, another number of states, environments that do not exist or are
                named twice, or parts that only one of both has made yet; nothing is written then.
        """
        rows = _envs(envs, self.num_envs, "envs")
        refuse(
            StateError, _known_noise(noise), (len(rows) != len(kept), f"{len(kept)} kept states for {len(rows)} envs")
        )
        _same(kept, about(self), type(self).__name__)
        self.make(kept.made)
        found = walk(self)
        for entry in found.entries:
            if entry.of_env and not _fits(entry, kept, self.num_envs):
                raise StateError(
                    f"{entry.path} is not what it was where the state was kept: it is made at its first use; let both "
                    "worlds make a step before"
                )
        own = self.keys.take(len(rows)) if noise == "own" else None
        write = _Writer()
        for entry in found.entries:
            if (value := kept.values.get(entry.path)) is not None:
                if isinstance(entry.owner, Noise):
                    value = own.to(value) if own is not None else value
                    self.keys.skip(value)
                write.rows(entry, rows, value)
        restored(found)

    @runtime.torch_at_rest()
    def copy(self, source_envs: Envs, target_envs: Envs, *, noise: NoiseOf = "shared") -> None:
        """Make environments `target_envs` [n] equal to `source_envs` [n]; see `NoiseOf`."""
        source = _envs(source_envs, self.num_envs, "source_envs", twice=True)
        target = _envs(target_envs, self.num_envs, "target_envs")
        told = f"{len(source)} source_envs for {len(target)} target_envs"
        refuse(StateError, (len(source) != len(target), told), _known_noise(noise))
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
        rows = _envs(envs, self.num_envs, "envs", twice=True)
        with _as_state_errors():
            copies = whole_number(copies, "copies", 1)
        refuse(
            StateError,
            (not len(rows), "a fork of no environments: there is nothing in it"),
            _known_noise(noise),
            (not isinstance(into, Stateful | None), f"into = {into!r}: an earlier fork is expected"),
        )
        this: Any = self
        rows, source = rows.repeat_interleave(copies), walk(self)
        total = len(rows)
        if into is None:
            check_memory(_size(source), total)
            into = this._alike(total)
        elif (into.num_envs, _kind(into)) != (total, _kind(self)):
            raise StateError(
                f"`into` is a {type(into).__name__} of {into.num_envs} environments, scenario "
                f"{getattr(into.config, 'name', '')!r}, seed {into.seed}, teams {', '.join(into.teams)}: the fork has "
                f"{total} of {type(self).__name__}, {getattr(this.config, 'name', '')!r}, seed {this.seed}, teams "
                f"{', '.join(this.teams)}, with the same vehicles"
            )
        into.make(self.made())
        into.keys = getattr(into, "world", into).keys = self.keys
        own = self.keys.take(total) if noise == "own" else None
        target, write = {entry.path: entry for entry in walk(into).entries}, _Writer()
        for entry in source.entries:
            there, value = target.get(entry.path), entry.value
            if there is None:
                raise StateError(f"the fork has no {entry.path}: its parts are others than those of its source")
            if entry.of_env and isinstance(value, Tensor) and len(value) == self.num_envs:
                if isinstance(entry.owner, Noise) and own is not None:
                    there.value.copy_(own)
                    continue
                write(there, value.index_select(0, rows))
            else:
                write(there, _taken(value))
        restored(walk(into))
        return into

    def made(self) -> tuple[str, ...]:
        """Names of parts that are made at first use, and have been made. Default: there are none."""
        return ()

    def make(self, parts: Sequence[str]) -> None:
        """Make the parts that `made` has named, so that their state can be written."""

    def _alike(self, num_envs: int) -> Self:
        """Another world or mission of the same configuration, seed and teams."""
        raise NotImplementedError
