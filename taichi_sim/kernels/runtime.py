"""Start of Taichi: architecture, precision, threads.

Taichi holds one program per process. `init` starts it. A second call with the same arguments does nothing. A call with
other arguments starts a new program, and every kernel is compiled again at its next launch. A launch is refused
(`ProgramError`) with tensors of another precision or device than the program's, in a forked process, which has none of
Taichi's threads, and after somebody else has ended our program (`ti.init`, `ti.reset`). A program that somebody else
started is not ended.

Settings of torch belong to the whole process, and a caller may have others than this package relies on. All work is
done within `own_settings`, which also lets one thread work at a time.
"""

# Kernels are another language inside Python syntax.
# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false

import atexit
import contextlib
import copy
import ctypes
import io
import os
import shutil
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, cast

import taichi as ti
import torch
from taichi.lang import impl
from taichi.lang.argpack import ArgPack, ArgPackType
from taichi.lang.kernel_impl import Kernel
from taichi.types.annotations import template

from taichi_sim.config.machine import own_cores
from taichi_sim.errors import UserError
from taichi_sim.kernels import kept

Precision = Literal["f32", "f64"]
array1, array2, array3, array4, array5 = cast(Any, [ti.types.ndarray(ndim=n) for n in range(1, 6)])
"""Types of kernels' arguments: tensors of one to five axes, of the run's precision."""
whole1 = cast(Any, ti.types.ndarray(dtype=ti.i32, ndim=1))
"""Type of kernels' arguments: int32, one axis."""


FORKED = (
    "this process was forked from one that had started Taichi, whose threads a fork does not have: start processes by "
    "'spawn' or 'forkserver' instead (multiprocessing.set_start_method; for an AsyncVectorEnv of Gymnasium "
    "vector_kwargs={'context': 'spawn'}), or fork before anything of taichi_sim is made"
)


ENDED = (
    "the Taichi program of this was ended by ti.init or ti.reset, which taichi_sim did not call: call ts.init to go on "
    "(after ti.reset() if a program of your own runs), and leave ti.init out: fields and kernels of your own that are "
    "made after ts.init work beside ours"
)
FOREIGN = (
    "a Taichi program runs that taichi_sim did not start (ti.init), and a process has one: starting ours would end it, "
    "with its fields. Call ts.init() in place of ti.init, and make fields and kernels of your own after it; or end "
    "that program by ti.reset() first"
)


class ProgramError(UserError, RuntimeError):
    """Objects are used in a Taichi program that is not theirs, or Taichi in a process in which it cannot run."""


@dataclass(frozen=True)
class Runtime:
    """Arguments with which Taichi was started."""

    arch: str
    precision: Precision
    threads: int

    @property
    def torch_dtype(self) -> torch.dtype:
        """Dtype of every state tensor."""
        return torch.float64 if self.precision == "f64" else torch.float32

    @property
    def device(self) -> torch.device:
        """Device of the state tensors, on which kernels work in place."""
        return torch.device("cuda" if self.arch == "cuda" else "cpu")

    def check(self, *tensors: torch.Tensor) -> None:
        """Refuse floating-point tensors of another precision, and any on another device."""
        for tensor in tensors:
            known = tensor.dtype == self.torch_dtype or not tensor.is_floating_point()
            if not known or tensor.device.type != self.device.type:
                theirs = "f64" if tensor.dtype == torch.float64 else "f32"
                arch = self.arch if tensor.device.type == self.device.type else tensor.device.type
                raise ProgramError(
                    f"this was made with arch {arch!r} and precision {theirs!r}, and Taichi has been started again "
                    f"since, with arch {self.arch!r} and precision {self.precision!r}: make it anew, go back by "
                    f"ts.init(arch={arch!r}, precision={theirs!r}), or use one precision in a process"
                )


PATCHED = not os.environ.get("TAICHI_SIM_NO_PATCHES")
"""Whether this process changes Taichi's own code (taichi_patches.py)."""
CACHE = "TI_OFFLINE_CACHE_FILE_PATH"  # environment variable: Taichi's folder of compiled kernels
KEPT_KERNELS = "ticache.tcb"  # Taichi's list of them, in that folder
MOST = 1024  # threads that kernels are compiled for; the running ones share the work, and any number finds the kernels
LONG = 3.0  # s; a kernel that is kept is read in less
_own_cache: str | None = None  # a temporary one, of a process that cannot write to that
_current: Runtime | None = None
_generation = 0  # number of the Taichi program; kernels compiled in an earlier one are gone
_void: str | None = None  # why nothing can be launched: the process was forked, or somebody else ended our program
_lock = threading.RLock()  # held by the thread that works
_packs: weakref.WeakValueDictionary[int, ArgPack] = weakref.WeakValueDictionary()  # packs that are alive, by identity


def init(arch: str = "cpu", precision: Precision = "f32", threads: int = 0) -> Runtime:
    """Start Taichi once.

    Args:
        arch: "cpu" or "cuda".
        precision: "f32" for simulation, "f64" for validation against reference tables.
        threads: CPU threads for kernels; 0 means one per available core.
    """
    global _current, _generation, _void
    if arch not in ("cpu", "cuda"):
        raise ValueError(f"arch = {arch!r}: allowed are 'cpu' and 'cuda'")
    if precision not in ("f32", "f64"):
        raise ValueError(f"precision = {precision!r}: allowed are 'f32' and 'f64'")
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 0:
        raise ValueError(f"threads = {threads!r}: a number of threads is expected, 0 for one per available core")
    wanted = Runtime(arch, precision, threads or len(own_cores()))
    if _current == wanted and _void is None:
        return wanted
    if _void is FORKED or (impl.get_runtime().prog is not None and (_void or _current is None)):
        raise ProgramError(FORKED if _void is FORKED else FOREIGN)
    with _lock:
        _check_cache()
        before = _threads()
        with contextlib.redirect_stdout(io.StringIO()):  # hides Taichi's greeting: stdout is for results
            ti.init(
                arch=getattr(ti, arch),
                default_fp=ti.f64 if precision == "f64" else ti.f32,
                cpu_max_num_threads=wanted.threads,
                fast_math=True,
                offline_cache=True,
                offline_cache_max_size_of_files=1 << 30,  # bytes; of 100 MiB, the default, the tests alone fill more
                make_cpu_multithreading_loop=False,  # which gives a loop of less than 1,024 turns to one thread
                default_cpu_block_dim=BLOCK,
                unrolling_limit=0,  # no warning of long unrolled loops: a hull of 500 panels takes 3 s to compile
                log_level=ti.ERROR,
                verbose=False,
            )
        impl.current_cfg().cpu_max_num_threads = MOST  # the threads have been started
        _bind_to_cores(sorted(_threads() - before)[-wanted.threads :])
        _clear_stale_lock(Path(impl.current_cfg().offline_cache_file_path))
        _current, _void = wanted, None
        _generation += 1
    return wanted


def _threads() -> set[int]:
    """Numbers of the threads of this process; none where the system does not list them (macOS, Windows)."""
    return {int(task.name) for task in Path("/proc/self/task").glob("*")}


def _bind_to_cores(pool: list[int]) -> None:
    """Bind each thread of Taichi's `pool`, which it starts last, to a core of its own, if there are as many cores.

    Linux otherwise often wakes two of them on one core, and moves one away only after a millisecond: a kernel of 1 ms
    on two cores then takes 0.77 ms in place of 0.53 ms.
    """
    cores = own_cores()
    if len(pool) == len(cores):
        for thread, core in zip(pool, cores, strict=True):
            with contextlib.suppress(OSError):
                os.sched_setaffinity(thread, {core})


def _check_cache() -> None:
    """Give Taichi a folder of this process for compiled kernels where it cannot write to its own, and say so.

    Taichi would end the process with an error, after all work.
    """
    global _own_cache
    place = os.environ.get(CACHE) or impl.default_cfg().offline_cache_file_path
    try:
        Path(place).mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=place).close()
    except OSError as error:
        print(
            f"warning: {place} cannot be written ({error.strerror}): compiled kernels are not kept, and every start "
            f"compiles them again; name another folder in the environment variable {CACHE}",
            file=sys.stderr,
        )
        _own_cache = os.environ[CACHE] = tempfile.mkdtemp(prefix="taichi-sim-")


def _clear_stale_lock(cache: Path) -> None:
    """Remove a lock from Taichi's `cache` that a killed process left behind, which would block all later writes."""
    lock = cache / "ticache.lock"
    with contextlib.suppress(OSError):
        if time.time() - lock.stat().st_mtime > 60.0:  # s; a write takes less than 1 s
            lock.unlink()


def current() -> Runtime:
    """Return the running Taichi program; start the default one if there was none."""
    if _void is not None:
        raise ProgramError(_void)
    return _current or init()


def is_f64() -> bool:
    """Whether kernels compiled now have double precision; read inside `ti.static`."""
    return current().precision == "f64"


def generation() -> int:
    """Number of the running Taichi program; packs and launches of an earlier one are void."""
    current()
    return _generation


def pack(kind: ArgPackType, **members: torch.Tensor) -> ArgPack:
    """Return an argument pack of type `kind` (`ti.types.argpack`): several tensors as one argument of a kernel."""
    made = kind(**members)
    _packs[id(made)] = made
    return made


class Packed:
    """Tensors that kernels take as one argument; valid in every Taichi program of their precision and device.

    Attributes:
        members: name -> tensor.
    """

    def __init__(self, kind: ArgPackType, **members: torch.Tensor):
        """Take tensors for a pack of type `kind` (`ti.types.argpack`)."""
        self.members, self._kind = members, kind
        self._made: ArgPack | None = None
        self._generation = -1

    def __call__(self) -> ArgPack:
        """Return the pack: the same object as long as the Taichi program runs."""
        if self._made is None or self._generation != generation():
            self._made, self._generation = pack(self._kind, **self.members), _generation
        return self._made


class _Forked:
    """Replaces the Taichi program of the parent in a forked process; any use of it is refused."""

    def __init__(self, program: object):
        """Keep the parent's `program`, whose end waits for threads that are not there."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(program))

    def __bool__(self) -> bool:
        """There is no program to end."""
        return False

    def __getattr__(self, name: str) -> Any:
        """Refuse."""
        raise ProgramError(FORKED)


def _after_fork() -> None:
    """In a forked process: void the packs and the program, if Taichi ran in the parent."""
    global _void, _lock
    if _current is None:
        return
    _forget_packs()
    _void, _lock = FORKED, threading.RLock()
    impl.get_runtime().prog = _Forked(impl.get_runtime().prog)


if hasattr(os, "register_at_fork"):  # Windows has no fork
    os.register_at_fork(after_in_child=_after_fork)


class _Void:
    """Replaces a pack whose Taichi program has ended."""


def _forget_packs() -> None:
    """Void all packs of a Taichi program that has freed them.

    Python must not free them a second time, or free a newer pack at the same address.
    """
    for old in list(_packs.values()):
        old.__class__ = _Void  # type: ignore[assignment]
    _packs.clear()


class _Watch:
    """A kernel, for Taichi: it resets all kernels when a program ends, whoever ends it."""

    compiled_kernels: ClassVar[dict[object, object]] = {}

    def reset(self) -> None:
        """Void what belongs to the program that has ended, until `init` has started another."""
        global _void
        _forget_packs()
        if _current is not None and _void is None:
            _void = ENDED


impl.get_runtime().kernels.append(_Watch())


@atexit.register
def _end() -> None:
    """End the Taichi program with the process, so that Taichi writes the compiled kernels to its cache.

    If that were left to Python, the program would outlive the interpreter and the cache would stay empty. The next
    process would compile everything again, which takes half a minute at a team's first step.
    """
    _forget_packs()
    try:
        impl.get_runtime().clear()
    except RuntimeError as error:  # a full disk
        print(f"warning: compiled kernels are not kept: {error}", file=sys.stderr)
    if _own_cache is not None:
        shutil.rmtree(_own_cache, ignore_errors=True)


BLOCK = 64  # turns of a loop that a thread takes at a time; vehicles' loops have fewer (packs.Build.block)
SMALL, MEDIUM, LARGE = 1024, 384, 35
"""Turns of a loop from which on other threads are woken for it, for a kernel of about 0.1, 0.4, or 4 us a turn."""


class loop:  # noqa: N801 (an attribute of it is read in kernels)
    """How a kernel that is being compiled runs its loop: `ti.loop_config(serialize=runtime.loop.serial)`."""

    serial = False
    for_many = False

    @classmethod
    @contextlib.contextmanager
    def run(cls, serial: bool) -> Iterator[None]:
        """Within this context, compile kernels for the calling thread, if `serial`."""
        cls.serial = serial
        try:
            yield
        finally:
            cls.serial = False

    @classmethod
    @contextlib.contextmanager
    def as_for_many(cls) -> Iterator[None]:
        """Within this context, large kernels run as for many environments: none is compiled for a few of them.

        An episode of `cruise` takes up to a sixth longer, and 17 s less where only a training has compiled its kernels.
        """
        before, cls.for_many = cls.for_many, True
        try:
            yield
        finally:
            cls.for_many = before


class own_settings(contextlib.ContextDecorator):  # noqa: N801 (a context, used like a function)
    """Within this context, torch has the settings that this package relies on, whatever the caller's are.

    New tensors are float32 and on the CPU unless told otherwise, products have the precision of their factors (no
    `torch.autocast`), and results can be written in place, also when `torch.inference_mode` has ended. Whether
    gradients are recorded stays as it is. Other threads wait: Taichi compiles in one thread at a time, and these
    settings are those of the process. Where all is as it should be, entering and leaving take a microsecond.
    """

    def _recreate_cm(self) -> "own_settings":
        return type(self)()  # one for each call of a decorated function

    def __enter__(self) -> None:
        """Wait for other threads, and change what differs."""
        if _void is not None:
            raise ProgramError(_void)
        _lock.acquire()
        dtype = torch.get_default_dtype()
        elsewhere = torch._C._len_torch_function_stack() > 0  # a default device is a mode on this stack
        self._changed: contextlib.ExitStack | None = None
        halves = [kind for kind in ("cpu", "cuda") if torch.is_autocast_enabled(kind)]
        if dtype is not torch.float32 or elsewhere or halves or torch.is_inference_mode_enabled():
            self._changed = changed = contextlib.ExitStack()
            recorded = torch.is_grad_enabled()
            changed.enter_context(torch.inference_mode(False))
            changed.enter_context(torch.set_grad_enabled(recorded))
            if dtype is not torch.float32:
                torch.set_default_dtype(torch.float32)
                changed.callback(torch.set_default_dtype, dtype)
            if elsewhere:
                changed.enter_context(torch.device("cpu"))
            for kind in halves:
                changed.enter_context(torch.autocast(kind, enabled=False))

    def __exit__(self, *_: object) -> None:
        """Change it back."""
        try:
            if self._changed is not None:
                self._changed.close()
        finally:
            _lock.release()


class torch_at_rest(own_settings):  # noqa: N801
    """Within this context, torch works on the calling thread alone, by our `own_settings`.

    Torch's own threads spin for milliseconds after a parallel operation. They then take cores from Taichi's kernels,
    which took up to twice the time. Matrix products on one thread also have the same bits whatever the machine's
    setting.
    """

    def __enter__(self) -> None:
        """Set one thread."""
        super().__enter__()
        self._threads = torch.get_num_threads()
        if self._threads != 1:
            torch.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        """Set the threads that there were."""
        if self._threads != 1:
            torch.set_num_threads(self._threads)
        super().__exit__()


@contextlib.contextmanager
def without_passes() -> Iterator[None]:
    """Within this context, compile kernels without Taichi's own passes: LLVM alone optimises them."""
    config = impl.current_cfg()
    level, config.opt_level = config.opt_level, 0
    try:
        yield
    finally:
        config.opt_level = level


_told = os.environ.get("RANK", "0") != "0"  # whether this process, or the first of several, has said that it compiles


def _tell_compiling(place: Path) -> None:
    """Say once in a process, for several of one job, that kernels are compiled and kept in `place`."""
    global _told
    if not _told:
        _told = True
        print(f"compiling kernels, a minute or so for each kind of vehicle; they are kept in {place}", file=sys.stderr)


@contextlib.contextmanager
def _telling() -> Iterator[None]:
    """Say that a kernel is compiled in this context: at once where none are kept yet, or after LONG."""
    place, begin = Path(impl.current_cfg().offline_cache_file_path), time.perf_counter()
    if not (place / KEPT_KERNELS).exists():
        _tell_compiling(place)
    yield
    if time.perf_counter() - begin > LONG:
        _tell_compiling(place)


class _Bound(NamedTuple):
    """Arguments of a launch, and the form in which Taichi takes them."""

    args: tuple[object, ...]
    compiled: object
    context: Any  # Taichi's launch context: the arguments of one launch
    serial: bool  # on the calling thread


class Launcher:
    """Repeats a kernel call with the same arguments at a fifth of the cost of a plain call.

    A plain call checks and converts every argument. That takes 0.4 ms for a dozen tensors: little with thousands of
    environments, most of the time with one. A vehicle's kernel gets the same tensors, written in place, in every step.
    The converted arguments of the last two sets are therefore kept and launched again. Arguments are the same if they
    are the same objects (tuples also if they are equal). Other tensors of the same types are bound anew without
    compiling, at a third of the cost of a plain call.

    A launch of few turns runs on the calling thread, because to wake the others takes longer (70 us on two cores). On a
    GPU none does: the tensors stay on the device. The number of threads is ignored on purpose: the two loops are
    compiled separately and may round differently, and the bits must be the same on any number of threads.

    This class uses internals of Taichi 1.7. pyproject.toml pins that version.
    """

    KEPT = 2

    def __init__(self, kernel: Callable[..., object], *, plain: bool = False, few: int = SMALL):
        """Take a kernel, or a kernel of an object: `model.step_kernel`.

        A turn of its loop is an environment's vehicle, by the first two axes of its first tensor; below `few` of them
        it runs on the calling thread.

        A `plain` kernel is compiled without Taichi's own passes: LLVM alone optimises it. A large kernel with many
        branches then compiles in a quarter to an eighth of the time; a vehicle's equations of motion lose up to 7 % of
        their speed.
        """
        self._kernel, self._primal = kernel, cast(Kernel, cast(Any, kernel)._primal)
        owner = getattr(kernel, "_kernel_owner", None)
        self._owner = () if owner is None else (owner,)
        self._wanted = self._primal.arguments[len(self._owner) :]
        self._typed = [getattr(wanted.annotation, "dtype", None) is not None for wanted in self._wanted]
        self._templates = [isinstance(wanted.annotation, template) for wanted in self._wanted]
        self._bound: list[_Bound] = []
        self._last: _Bound | None = None  # of `once`, with the types of tensors in their place
        self._compiled: dict[tuple[Hashable, ...], tuple[Any, object]] = {}  # by the arguments' types
        self._generation, self._plain, self._few, self._first = -1, plain, few, self._templates.index(False)
        self._pack: tuple[object, Sequence[int]] = None, ()  # the last first argument, and its first tensor's shape

    def __call__(self, *args: object, envs: int | None = None) -> None:
        """Launch the kernel, and keep the bound arguments for the next call; only `envs` environments have work."""
        self._renew()
        serial = self._serial(args, envs)
        bound = next((bound for bound in self._bound if bound.serial is serial and _same(args, bound.args)), None)
        if bound is None:
            bound = self._bind(args, serial)
            self._bound = [bound, *self._bound[: self.KEPT - 1]]
        impl.get_runtime().prog.launch_kernel(bound.compiled, bound.context)

    def once(self, *args: object, envs: int | None = None) -> None:
        """Launch the kernel with tensors that will not be used again; packs stay bound for the next call."""
        self._renew()
        last, serial = self._last, self._serial(args, envs)
        if last is None or last.serial is not serial or not _same(tuple(map(_brief, args)), last.args):
            last = self._bind(args, serial)
            self._last = last = last._replace(args=tuple(map(_brief, args)))
        else:
            given = (value for value, fixed in zip(args, self._templates, strict=True) if not fixed)
            for slot, value in enumerate(given):
                if isinstance(value, torch.Tensor):
                    _set_tensor(last.context, slot, value)
        impl.get_runtime().prog.launch_kernel(last.compiled, last.context)

    def _renew(self) -> None:
        run = current()
        if self._generation != _generation:
            self._generation, self._bound, self._last, self._compiled = _generation, [], None, {}
        if run.arch == "cuda":  # a launch context is spent: it then points to arguments in the GPU's memory
            self._bound, self._last = [], None

    def _serial(self, args: tuple[object, ...], envs: int | None) -> bool:
        """Whether the loop runs on the calling thread."""
        if current().arch != "cpu" or len(args) != len(self._wanted) or (loop.for_many and self._few < SMALL):
            return False
        first = args[self._first]
        if isinstance(first, ArgPack):
            if first is not self._pack[0]:
                self._pack = first, next(value for _, value in first.items).shape
            shape = self._pack[1]
        else:
            shape = cast(torch.Tensor, first).shape
        return (shape[0] if envs is None else envs) * (shape[1] if len(shape) > 1 else 1) < self._few

    def _bind(self, args: tuple[object, ...], serial: bool) -> _Bound:
        """Compile the kernel for `args` if needed, and bind them."""
        if len(args) != len(self._wanted):
            raise TypeError(f"{self._primal.func.__name__} takes {len(self._wanted)} arguments, not {len(args)}")
        for value, typed in zip(args, self._typed, strict=True):
            if isinstance(value, ArgPack):
                current().check(*(member for _, member in value.items))
            elif isinstance(value, torch.Tensor) and not typed:
                current().check(value)
        form = (serial, *map(_form, args, self._templates))
        if form not in self._compiled:
            primal = _on_one_thread(self._primal) if serial else self._primal
            with loop.run(serial), without_passes() if self._plain else contextlib.nullcontext(), _telling():
                self._compiled[form] = kept.compiled(primal, self._owner, args, (PATCHED, form))
        kernel, compiled = self._compiled[form]
        context = kernel.make_launch_context()
        given = [value for value, fixed in zip(args, self._templates, strict=True) if not fixed]
        slots, inside = len(given), []
        for slot, value in enumerate(given):
            if isinstance(value, ArgPack):
                context.set_arg_argpack((slot,), value._ArgPack__argpack)  # type: ignore[attr-defined]
                inside += [(member, _element(value, name)) for name, member in value.items]
            else:
                _set_tensor(context, slot, cast(torch.Tensor, value))
        for k, (value, element) in enumerate(inside):
            _set_tensor(context, slots + k, value, element)
        return _Bound(args, compiled, context, serial)


def _on_one_thread(kernel: Kernel) -> Kernel:
    """The same kernel, for Taichi another one: compiled with `loop.serial`."""
    if not hasattr(kernel, "on_one_thread"):
        kernel.on_one_thread = twin = copy.copy(kernel)
        twin.compiled_kernels, twin.kernel_counter = {}, Kernel.counter
        Kernel.counter += 1
        impl.get_runtime().kernels.append(twin)
    return kernel.on_one_thread


def _brief(value: object) -> object:
    """The type of a tensor, so that it is not kept alive; any other argument as it is."""
    return (value.dtype, value.ndim) if isinstance(value, torch.Tensor) else value


def _form(value: object, fixed: bool) -> Hashable:
    """What a kernel is compiled for: the value of a template, or the types of tensors."""
    if fixed:
        return value
    if isinstance(value, ArgPack):
        return tuple((m.dtype, m.ndim, m.shape[m.ndim - _element(value, name) :]) for name, m in value.items)
    if isinstance(value, torch.Tensor):
        return value.dtype, value.ndim
    raise TypeError(f"a launched kernel takes packs, tensors and templates, not {type(value).__name__}")


def _element(pack: ArgPack, name: str) -> int:
    """Number of axes of one element of a pack's tensor: 0 for numbers, 1 for vectors (lanes.py)."""
    return getattr(pack._ArgPack__annotations[name].dtype, "ndim", 0)  # type: ignore[attr-defined]


def _set_tensor(context: Any, slot: int, value: torch.Tensor, element: int = 0) -> None:
    if not value.is_contiguous():
        raise ValueError("a launched kernel takes contiguous tensors")
    size = value.element_size() * value.nelement()
    if element and value.data_ptr() % (value.element_size() * value.shape[-1]):
        raise ValueError("a tensor of vectors must begin at an address that is a multiple of the vector's size")
    shape = tuple(value.shape[: value.ndim - element])
    context.set_arg_external_array_with_shape((slot,), value.data_ptr(), size, shape, 0)


def _same(args: tuple[object, ...], before: tuple[object, ...]) -> bool:
    """Whether every argument is the same as before."""
    return len(args) == len(before) and all(
        a is b or (isinstance(a, tuple) and a == b) for a, b in zip(args, before, strict=True)
    )
