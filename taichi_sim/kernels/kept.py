"""Kernels that an earlier process compiled, found without reading them again.

Taichi finds a compiled kernel in its cache by the instructions that it makes of the kernel's source, and to make them
takes a third of a start: those of `cruise` have 177,000 nodes of Python syntax. Here the key is a digest of all that
they are made from: the text of every file that the kernel reaches, the values in it, its templates, all settings and
versions. A kernel begins as its parameters and that digest, of which Taichi takes the key. The rest is made only where
nothing is kept under it.

What a kernel reaches is followed from its function on: globals, closures, members of modules and attributes of objects
by the names in the code, the functions and classes found there, and theirs. Values are those of this moment, so that a
number which somebody changed from outside changes the digest. Of plain methods only `FOLLOWED` ones are followed:
others belong to the host, and reach its state. There is no digest of a kernel that reaches code of others, such as a
user's vehicle, or a file that was changed while this process ran: Taichi reads it at each start.

To look into its cache, Taichi must be asked to compile. It is asked first for an architecture for which it cannot
(`NONE`): its error says whether a kernel was found, and the kernel has its key. If another program empties the cache
just then, Taichi compiles the key alone: the kernel is made again under another key, and nothing that the process
compiles is kept. This uses internals of Taichi 1.7, the version that pyproject.toml pins.
"""

# Taichi has no types for its internals.
# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false

import ast
import ctypes
import functools
import hashlib
import linecache
import os
import platform
import sys
import time
from collections.abc import Hashable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, suppress
from dataclasses import is_dataclass
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, cast

import numpy as np
import taichi as ti
import torch
from pydantic import VERSION, BaseModel
from taichi._lib import core
from taichi.lang import impl, kernel_impl
from taichi.lang.argpack import ArgPackType
from taichi.lang.ast.ast_transformer import build_stmt, build_stmts
from taichi.lang.kernel_impl import Func, Kernel
from taichi.lang.matrix import MatrixType
from taichi.lang.struct import StructType
from taichi.types.annotations import template
from taichi.types.ndarray_type import NdarrayType

BEGIN = time.time()  # s; files changed later are not those that this process imported
NONE = core.Arch.vulkan  # an architecture that the compiler of ours, LLVM, has no code for
FOUND = "loaded->arch() == arch"  # in Taichi's error, if it found a kernel, which is of another architecture
SETTINGS = [name for name in dir(core.CompileConfig) if not name.startswith("_")]
OURS = ("taichi_sim", "rl")
THEIRS = ("taichi", "torch", "numpy", "pydantic", "pydantic_core", "builtins", *sys.stdlib_module_names)
"""Packages that are known by their version."""
READ = "taichi_sim.kernels.runtime"  # a module of which kernels read what digests have anyway: precision, loop.serial
FOLLOWED = ("own", "inertia_change", "rate_limit", "column", "read", "__len__", "__iter__", "__getitem__", "__call__")
"""Plain methods that kernels call while they are made."""
UNNAMED = frozenset(name for name in FOLLOWED if name.startswith("__"))  # which no code names
FRONT_END = [str(Path(__file__).with_name(name)) for name in ("abreast.py", "kept.py", "lanes.py", "taichi_patches.py")]
_names: dict[object, frozenset[str]] = {}  # function of a kernel -> the names that its last digest followed
unkeyed: dict[str, str] = {}  # kernels without a digest in this process -> why


def compiled(kernel: Kernel, owner: Sequence[object], args: Sequence[object], form: Hashable) -> tuple[Any, object]:
    """Return a kernel for arguments of this form, and what Taichi compiled of it, now or before.

    Args:
        kernel: the kernel.
        owner: the object that it is a method of, if any.
        args: its other arguments.
        form: what it is compiled for: the values of templates, the types of tensors.
    """
    given, key = (*owner, *args), digest(kernel, owner, form)
    if key is not None:
        return _made(kernel, given, key)
    made, program = kernel.compiled_kernels[kernel.ensure_compiled(*given)], impl.get_runtime().prog
    return made, program.compile_kernel(program.config(), program.get_device_caps(), made)


def digest(kernel: Kernel, owner: Sequence[object], form: Hashable) -> str | None:
    """Return the digest of all that a kernel's instructions are made from (see `compiled`); None if there is none."""
    given = kernel.func, [argument.annotation for argument in kernel.arguments], list(owner), form
    names = _names.get(kernel.func, UNNAMED)
    walk = _Walk(names, given) if names is not UNNAMED else None
    if walk is None or walk.names | UNNAMED != names:  # of another object the same kernel may follow fewer
        names = UNNAMED
        while not (walk := _Walk(names, given)).names <= names:
            names = names | walk.names
    _names[kernel.func], key = names, walk.end()
    if walk.stopped:
        unkeyed[f"{kernel.func.__module__}.{kernel.func.__qualname__}"] = walk.stopped
    return None if walk.stopped else key


def _made(kernel: Kernel, args: Sequence[object], key: str) -> tuple[Any, object]:
    """The kernel, of its parameters and its key alone if one is kept under it, and what Taichi compiled."""
    kernel.runtime.materialize()
    of_program: dict[str, tuple[Any, object]] = vars(kernel.runtime).setdefault("kept", {})
    if key in of_program:
        return of_program[key]
    _, features = kernel.mapper.lookup(args)
    tree, context = kernel_impl._get_tree_and_ctx(
        kernel, args=args, excluded_parameters=kernel.template_slot_locations, arg_features=features
    )
    function = cast(ast.FunctionDef, tree.body[0])
    whole, words = function.body, [int(key[k : k + 7], 16) for k in range(0, len(key), 7)]
    function.body = ast.parse("\n".join(f"_{k} = {word}" for k, word in enumerate(words))).body

    @contextmanager
    def building(made: Any) -> Iterator[None]:
        run = kernel.runtime
        kernel.kernel_cpp = run.compiling_callable = made
        run.inside_kernel, run.current_kernel, context.ast_builder = True, kernel, made.ast_builder()
        try:
            yield
        finally:
            run.inside_kernel, run.current_kernel, run.compiling_callable = False, None, None

    def begin(made: Any) -> None:
        with building(made):
            build_stmt(context, function)

    program = impl.get_runtime().prog
    before = _files()
    with context.variable_scope_guard():
        made = program.create_kernel(begin, kernel.func.__name__, kernel.autodiff_mode)
        kept = _kept(made)
        if not kept:
            with building(made), context.variable_scope_guard():
                build_stmts(context, whole)
    data = program.compile_kernel(program.config(), program.get_device_caps(), made)
    if kept and not before <= _files():  # another program emptied the cache: Taichi may have compiled the key alone
        _end_without_keeping()
        made, data = _made(kernel, args, hashlib.sha256(key.encode()).hexdigest())
    of_program[key] = made, data
    return made, data


def _files() -> set[tuple[str, int]]:
    """Names and numbers of the files of kernels that Taichi keeps."""
    with suppress(FileNotFoundError), os.scandir(impl.current_cfg().offline_cache_file_path) as found:
        return {(file.name, file.inode()) for file in found if file.name.endswith(".tic")}
    return set()


def _end_without_keeping() -> None:
    """Let the program end without its own end, in which Taichi writes what it compiled to its cache."""
    run = impl.get_runtime()

    def clear() -> None:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(run.prog))
        run.prog, run.materialized = None, False

    run.clear = clear


def _kept(made: Any) -> bool:
    """Whether Taichi holds a kernel under the key of `made`, in its cache or in this process.

    Taichi keeps the key with `made`, as it is when it is first asked for.
    """
    program, config = impl.get_runtime().prog, core.CompileConfig()
    for name in SETTINGS:
        setattr(config, name, getattr(program.config(), name))
    config.arch = NONE
    try:
        with _silent():
            program.compile_kernel(config, program.get_device_caps(), made)
    except RuntimeError as error:
        return FOUND in str(error)
    return True


@contextmanager
def _silent() -> Iterator[None]:
    """Within this context, of a millisecond, nothing printed is seen: Taichi prints each of its errors."""
    kept: dict[int, int] = {}
    with open(os.devnull, "wb") as nowhere:
        try:
            for place in (1, 2):
                with suppress(OSError):  # closed
                    kept[place] = os.dup(place)
                    os.dup2(nowhere.fileno(), place)
            yield
        finally:
            for place, was in kept.items():
                os.dup2(was, place)
                os.close(was)


class _Walk:
    """Goes through all that is reached by known names, in an order that depends on nothing else, and sums it up."""

    def __init__(self, known: Set[str], value: object):
        """Take a value, by members of known names."""
        self.names: set[str] = set()
        self.stopped = ""  # at what no digest can be made of
        self._known = sorted(known)
        self._seen: dict[int, tuple[int, object]] = {}  # identity -> number, and the object, which so stays alive
        self._files = set(FRONT_END)
        self._sum = hashlib.sha256()
        self.take(value)

    def end(self) -> str:
        """Return the digest of what was taken, of the files, the settings, and the versions."""
        for file in sorted(self._files):
            if not os.path.isfile(file) or os.stat(file).st_mtime > BEGIN:
                self.stopped = f"{file} has changed"
            self._note(os.path.basename(file), "".join(linecache.getlines(file)))
        for name in SETTINGS:
            if not name.startswith("offline_cache"):
                self._note(name)
                self.take(getattr(impl.current_cfg(), name))
        self._note(platform.python_version(), np.__version__, torch.__version__, ti.__version__, VERSION)
        return self._sum.hexdigest()

    def take(self, value: object) -> None:
        """Take a value, and all that is reached from it."""
        if isinstance(value, str) and os.path.isabs(value) and os.path.isfile(value):  # a run has a copy of its own
            self._note("file", os.path.basename(value), hashlib.sha256(Path(value).read_bytes()).hexdigest())
        elif value is None or isinstance(value, bool | int | float | complex | str | bytes | range | slice):
            self._note(type(value).__name__, repr(value))
        elif isinstance(value, torch.dtype | torch.device | np.dtype) or hasattr(type(value), "__members__"):
            self._note(type(value).__name__, value)  # or an enumeration, of Python or of Taichi
        elif isinstance(value, core.DataType):
            self._note("type", value.to_string())
        elif id(value) in self._seen:
            self._note("seen", self._seen[id(value)][0])
        else:
            self._seen[id(value)] = len(self._seen), value
            self._note(type(value).__name__)
            self._take_new(value)

    def _take_new(self, value: Any) -> None:  # noqa: C901 (one case a kind)
        if isinstance(value, np.ndarray | np.generic | torch.Tensor):
            array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
            self._note(array.dtype, array.shape, hashlib.sha256(array.tobytes()).hexdigest())
        elif isinstance(value, tuple | list | set | frozenset):
            self._class(type(value))
            self._all(sorted(value, key=repr) if isinstance(value, set | frozenset) else value)
        elif isinstance(value, Mapping):
            self._all(item for pair in value.items() for item in pair)
        elif isinstance(value, StructType | ArgPackType):
            self._all((value.members, getattr(value, "methods", None)))
        elif isinstance(value, MatrixType | NdarrayType):
            self.take({name: item for name, item in vars(value).items() if name != "tensor_type"})
        elif isinstance(value, Func | Kernel | functools.cached_property):
            self.take(value.func)
        elif isinstance(value, ModuleType):
            self._note(value.__name__)
            if self._ours(value.__name__) and value.__name__ != READ:
                self._members(vars(value))
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(value, BuiltinFunctionType | np.ufunc):
            self._note(getattr(value, "__module__", None), value.__name__)
        elif isinstance(value, MethodType):
            self._all((value.__func__, value.__self__))
        elif isinstance(value, staticmethod | classmethod):
            self.take(value.__func__)
        elif isinstance(value, property):
            self.take(value.fget)
        elif isinstance(value, functools.partial):
            self._all((value.func, value.args, value.keywords))
        elif hasattr(value, "__wrapped__"):  # functools.cache
            self.take(value.__wrapped__)
        elif type(value).__module__ == "typing":
            self._note(value)
        elif not isinstance(value, template) and not hasattr(value, "__get__"):  # a slot, whose values are taken
            self._object(value)

    def _ours(self, module: str) -> bool:
        """Whether a module is one of ours; its code is then followed."""
        top = module.partition(".")[0]
        if top not in OURS and top not in THEIRS:
            self.stopped = f"{module} is code of others"
        return top in OURS

    def _all(self, values: Iterator[object] | Sequence[object]) -> None:
        for value in values:
            self.take(value)

    def _note(self, *facts: object) -> None:
        for fact in facts:
            text = str(fact).encode()
            self._sum.update(b"%d:" % len(text) + text)

    def _members(self, members: Mapping[str, object], known: Set[str] | None = None) -> None:
        """Take those that have a known name."""
        for name in self._known if known is None else sorted(known):
            if name in members:
                self._note(name)
                self.take(members[name])

    def _class(self, kind: type) -> None:
        self._note(kind.__module__, kind.__qualname__)
        if self._ours(kind.__module__) and kind.__module__ != READ:
            self._files.add(str(sys.modules[kind.__module__].__file__))
            for base in kind.__mro__:
                if base is not kind and not self._ours(base.__module__):
                    self._note(base.__module__, base.__qualname__)
                else:
                    self._members({name: item for name, item in vars(base).items() if _in_kernels(name, item)})

    def _object(self, value: object) -> None:
        """Take an object by its attributes of known names; records by all of them."""
        kind, record = type(value), is_dataclass(value) or isinstance(value, BaseModel)
        if not record and not self._ours(kind.__module__):
            self.stopped = f"a {kind.__module__}.{kind.__qualname__}"
        self._class(kind)
        own = dict(getattr(value, "__dict__", {}))
        for base in kind.__mro__:
            slots = vars(base).get("__slots__", ())
            own |= {name: getattr(value, name) for name in slots if not name.startswith("__") and hasattr(value, name)}
            for name, item in vars(base).items():
                if isinstance(item, functools.cached_property):  # the same whether it was asked for before or not
                    own.pop(name, None)
                    own |= {name: getattr(value, name)} if name in self._known else {}
        if record:
            self.take(own)
        else:
            self._members(own)

    def _function(self, function: Any) -> None:
        if hasattr(function, "_is_taichi_function") and hasattr(function, "func"):
            self.take(function.func)
            return
        self._note(function.__module__, function.__qualname__)
        if hasattr(function, "_primal") or not self._ours(function.__module__):  # no kernel calls a kernel
            return
        self._files.add(function.__code__.co_filename)
        if function.__module__ == READ:
            return
        codes = list(_codes(function.__code__))
        own = {name for code in codes for name in code.co_names}
        self.names |= own | {x for code in codes for x in code.co_consts if isinstance(x, str) and x.isidentifier()}
        self._all((function.__defaults__, function.__kwdefaults__, getattr(function, "__wrapped__", None)))
        self._members(function.__globals__, own)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._note(name)
            self.take(cell.cell_contents)


def _in_kernels(name: str, member: object) -> bool:
    """Whether kernels may use a class's member: of its plain methods, only `FOLLOWED` ones."""
    if isinstance(member, FunctionType):
        return name in FOLLOWED or hasattr(member, "_is_taichi_function")
    return not name.startswith("__") and not isinstance(member, classmethod)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A function's code, and that of the functions in it."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _codes(inner)
