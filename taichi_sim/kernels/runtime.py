"""Starts Taichi: architecture, precision, threads; the one place that does.

Taichi holds one program per process. `init` starts it; a second call with the same arguments does nothing,
with other arguments it starts afresh and every kernel is compiled again at its next launch.
"""

# Kernels are another language inside Python syntax.
# pyright: reportOptionalMemberAccess=false

import atexit
import contextlib
import io
import os
import time
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import taichi as ti
import torch
from taichi.lang import impl
from taichi.lang.argpack import ArgPack
from taichi.types.annotations import template

from taichi_sim.kernels.frontend import quicken

Precision = Literal["f32", "f64"]


@dataclass(frozen=True)
class Runtime:
    """The arguments with which Taichi was started."""

    arch: str
    precision: Precision
    threads: int

    @property
    def torch_dtype(self) -> torch.dtype:
        """The dtype of every state tensor."""
        return torch.float64 if self.precision == "f64" else torch.float32

    @property
    def device(self) -> torch.device:
        """Where state tensors live, so that kernels work on them in place."""
        return torch.device("cuda" if self.arch == "cuda" else "cpu")


_current: Runtime | None = None
_generation = 0  # of Taichi programs: what an older one compiled is gone
_packs: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()  # alive, by identity


def init(arch: str = "cpu", precision: Precision = "f32", threads: int = 0) -> Runtime:
    """Start Taichi, once.

    Args:
        arch: "cpu" or "cuda".
        precision: "f32" for simulation, "f64" for validation against reference tables.
        threads: CPU threads for kernels; 0 means one per available core.

    Raises:
        ValueError: for an unknown architecture or precision.
    """
    global _current, _generation
    if arch not in ("cpu", "cuda"):
        raise ValueError(f"arch = {arch!r}: allowed are 'cpu' and 'cuda'")
    if precision not in ("f32", "f64"):
        raise ValueError(f"precision = {precision!r}: allowed are 'f32' and 'f64'")
    wanted = Runtime(arch, precision, threads or len(os.sched_getaffinity(0)))
    if _current != wanted:
        quicken()
        with contextlib.redirect_stdout(io.StringIO()):  # its greeting; a command's stdout is its result
            ti.init(
                arch=getattr(ti, arch),
                default_fp=ti.f64 if precision == "f64" else ti.f32,
                cpu_max_num_threads=wanted.threads,
                fast_math=True,
                offline_cache=True,
                log_level=ti.ERROR,
                verbose=False,
            )
        _clear_stale_lock(Path(impl.current_cfg().offline_cache_file_path))
        _current = wanted
        _generation += 1
        _forget_packs()
    return wanted


def _clear_stale_lock(cache: Path) -> None:
    """Remove a lock that a process left in Taichi's `cache` when it was killed: no other would ever write there."""
    lock = cache / "ticache.lock"
    with contextlib.suppress(OSError):
        if time.time() - lock.stat().st_mtime > 60.0:  # s; writing takes less than one
            lock.unlink()


def current() -> Runtime:
    """The running Taichi program; starts the default one if there is none."""
    return _current or init()


def is_f64() -> bool:
    """Whether kernels compiled now work in double precision (read inside `ti.static`)."""
    return current().precision == "f64"


def generation() -> int:
    """Number of the Taichi program that runs: packs and launches of an earlier one are void."""
    current()
    return _generation


def pack(kind: Any, **members: torch.Tensor) -> Any:
    """An argument pack of `kind` (`ti.types.argpack`): several tensors as one argument of a kernel."""
    made = kind(**members)
    _packs[id(made)] = made
    return made


class Packed:
    """Tensors that kernels take as one argument, whatever Taichi program runs.

    Attributes:
        members: name -> tensor.
    """

    def __init__(self, kind: Any, **members: torch.Tensor):
        """Of `kind` (`ti.types.argpack`)."""
        self.members, self._kind = members, kind
        self._made: Any = None
        self._generation = -1

    def __call__(self) -> Any:
        """The pack, the same object for as long as the Taichi program runs."""
        if self._generation != generation():
            self._made, self._generation = pack(self._kind, **self.members), _generation
        return self._made


class _Void:
    """Stands for a pack whose Taichi program has ended."""


def _forget_packs() -> None:
    """Packs went with their Taichi program: Python must not free them a second time, or a newer one of that address."""
    for old in list(_packs.values()):
        old.__class__ = _Void
    _packs.clear()


@atexit.register
def _end() -> None:
    """End the Taichi program with the process: that is when Taichi writes the kernels compiled in it to its cache.

    Left to Python, the program outlives the interpreter, the cache stays empty, and the next process compiles
    everything again: half a minute of a team's first step.
    """
    _forget_packs()
    impl.get_runtime().clear()


WAKE_UP = 70e3  # ns that a launch takes to wake the threads and to wait for them


def few(items: int, each: float = 100.0) -> bool:
    """Whether a loop over `items` of `each` ns is faster on the calling thread (`ti.loop_config(serialize=...)`).

    On a GPU nothing is: what is written there stays there. The number of threads does not count: the two loops are
    compiled apart and may round apart, and bits are the same on any number of threads.
    """
    return current().arch == "cpu" and items * each < 2 * WAKE_UP


@contextlib.contextmanager
def torch_at_rest() -> Iterator[None]:
    """Torch works on the calling thread alone.

    Its own threads spin for milliseconds after a parallel operation, in case there is another one. Between Taichi's
    kernels, which then have to share their cores with them, that costs more than it gives: kernels took up to twice
    the time. On one thread matrix products are the same bits, too, whatever the machine's setting.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _Bound(NamedTuple):
    """Arguments of a launch, and the form in which Taichi takes them."""

    args: tuple[Any, ...]
    compiled: Any
    context: Any


class Launcher:
    """Repeats a kernel call with the same arguments at a fifth of the cost of a plain call.

    A call from Python checks and converts every argument: 0.4 ms for a dozen tensors, which is nothing at thousands of
    environments and nearly everything at one. A vehicle's kernel gets the same tensors, written in place, step after
    step; so what Taichi has made of them is kept and launched again, for the last two sets of arguments. Arguments
    count as the same if they are the same objects (values without identity, such as numbers and tuples, if they are
    equal). Other tensors of the same types are bound anew without compiling, for a third of a call's price.

    It reaches into Taichi 1.7 below its public interface. pyproject.toml keeps Taichi there.
    """

    KEPT = 2

    def __init__(self, kernel: Any):
        """`kernel` is a kernel, or a kernel of an object: `model.step_kernel`."""
        self._kernel, self._primal = kernel, kernel._primal
        self._owner = (kernel._kernel_owner,) if hasattr(kernel, "_kernel_owner") else ()
        self._wanted = self._primal.arguments[len(self._owner) :]
        self._templates = [isinstance(wanted.annotation, template) for wanted in self._wanted]
        self._bound: list[_Bound] = []
        self._compiled: dict[tuple[Any, ...], tuple[Any, Any]] = {}  # by types of arguments: as declared, and compiled
        self._generation = -1

    def __call__(self, *args: Any) -> None:
        """Launch the kernel, and keep the bound arguments for the next call."""
        self._renew()
        bound = next((bound for bound in self._bound if _same(args, bound.args)), None)
        if bound is None:
            bound = self._bind(args)
            self._bound = [bound, *self._bound[: self.KEPT - 1]]
        impl.get_runtime().prog.launch_kernel(bound.compiled, bound.context)

    def once(self, *args: Any) -> None:
        """Launch it with tensors that will not be used again."""
        self._renew()
        bound = self._bind(args)
        impl.get_runtime().prog.launch_kernel(bound.compiled, bound.context)

    def _renew(self) -> None:
        current()
        if self._generation != _generation:
            self._generation, self._bound, self._compiled = _generation, [], {}

    def _bind(self, args: tuple[Any, ...]) -> _Bound:
        """Compile for `args` if needed, and bind them."""
        if len(args) != len(self._wanted):
            raise TypeError(f"{self._primal.func.__name__} takes {len(self._wanted)} arguments, not {len(args)}")
        form = tuple(map(_form, args, self._templates))
        if form not in self._compiled:
            key = self._primal.ensure_compiled(*self._owner, *args)
            kernel, program = self._primal.compiled_kernels[key], impl.get_runtime().prog
            compiled = program.compile_kernel(program.config(), program.get_device_caps(), kernel)
            self._compiled[form] = kernel, compiled
        kernel, compiled = self._compiled[form]
        context = kernel.make_launch_context()
        given = [value for value, fixed in zip(args, self._templates, strict=True) if not fixed]
        slots, inside = len(given), []
        for slot, value in enumerate(given):
            if isinstance(value, ArgPack):
                context.set_arg_argpack((slot,), value._ArgPack__argpack)  # type: ignore[attr-defined]
                inside += [(member, _element(value, name)) for name, member in value.items]
            else:
                _set_tensor(context, slot, value)
        for k, (value, element) in enumerate(inside):
            _set_tensor(context, slots + k, value, element)
        return _Bound(args, compiled, context)


def _form(value: Any, fixed: bool) -> Any:
    """What a kernel is compiled for: a template's value, the types of tensors."""
    if fixed:
        return value
    if isinstance(value, ArgPack):
        return tuple((m.dtype, m.ndim, m.shape[m.ndim - _element(value, name) :]) for name, m in value.items)
    if isinstance(value, torch.Tensor):
        return value.dtype, value.ndim
    raise TypeError(f"a launched kernel takes packs, tensors and templates, not {type(value).__name__}")


def _element(pack: ArgPack, name: str) -> int:
    """Axes of an element of a pack's tensor: none of numbers, one of vectors (lanes.py)."""
    return getattr(pack._ArgPack__annotations[name].dtype, "ndim", 0)  # type: ignore[attr-defined]


def _set_tensor(context: Any, slot: int, value: torch.Tensor, element: int = 0) -> None:
    if not value.is_contiguous():
        raise ValueError("a launched kernel takes contiguous tensors")
    size = value.element_size() * value.nelement()
    if element and value.data_ptr() % (value.element_size() * value.shape[-1]):
        raise ValueError("vectors must begin where memory is aligned to their size")
    shape = tuple(value.shape[: value.ndim - element])
    context.set_arg_external_array_with_shape((slot,), value.data_ptr(), size, shape, 0)


def _same(args: tuple[Any, ...], before: tuple[Any, ...]) -> bool:
    """Whether every argument is the one it was."""
    return len(args) == len(before) and all(
        a is b or (isinstance(a, tuple) and a == b) for a, b in zip(args, before, strict=True)
    )
