"""Vectors for loops over wave components, panels and filters, so that all SIMD lanes of the processor are used.

LLVM vectorises a scalar loop for the processor that it knows. Taichi's LLVM knows no processor newer than itself, and
so uses a quarter of the lanes of newer ones. The loops of hulls are therefore written in vectors: an array [..., n]
enters a kernel as [..., block] vectors of `width()` lanes (`laned`). Kernels compiled under `vectors()` keep these
vectors whole; others take them apart into scalars.

For whole vectors, Taichi cannot compile -v, abs(v), or comparisons outside `ti.select`.

On Linux and x86-64, such kernels also call functions in LLVM's own language (lanes.ll, `linked`) for what Taichi's
lacks: a product of vectors and a sum become one operation, rounded once (Taichi does not allow LLVM to contract them);
`totals` need half as many shuffles; stack frames are aligned. Elsewhere kernels are compiled without these functions.

`teach` changes internals of Taichi 1.7, the version that pyproject.toml pins.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

import operator
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import taichi as ti
import torch
from taichi._lib import core
from taichi.lang import impl, ops
from taichi.lang.expr import Expr, make_expr_group
from torch import Tensor

from taichi_sim.kernels import runtime

WIDTH = 16  # lanes in f32: one register of AVX-512, two of AVX2, four of SSE or NEON
BITCODE = Path(__file__).with_name("lanes.bc")
FUSED = {
    (core.expr_add, 0): "plus", (core.expr_add, 1): "plus", (core.expr_sub, 0): "minus", (core.expr_sub, 1): "from"
}  # (sum, place of the product in it) -> function of lanes.ll  # fmt: skip
AUGMENTED: dict[str, Callable[[Any, Any], Any]] = {
    "Add": operator.add, "Sub": operator.sub, "Mult": operator.mul, "Div": operator.truediv
}  # fmt: skip
Variable = TypeVar("Variable")
laned1, laned2, laned3 = cast(Any, [ti.types.ndarray(element_dim=1, ndim=n) for n in (1, 2, 3)])


def width() -> int:
    """Number of lanes in the running Taichi program; 1 where vectors are not kept whole."""
    run = runtime.current()
    return WIDTH if run.arch == "cpu" and run.precision == "f32" else 1


def laned(values: Tensor, fill: float = 0.0) -> Tensor:
    """Return `values` [..., n] as [..., block, lane].

    The result is a view if n is a multiple of the width, else a copy padded with `fill`.
    """
    missing = blocks(values.shape[-1]) * width() - values.shape[-1]
    if missing:
        values = torch.nn.functional.pad(values, (0, missing), value=fill)
    return values.unflatten(-1, (-1, width()))


def blocks(count: int) -> int:
    """Number of vectors that hold `count` numbers."""
    return -(-count // width())


def filled(count: int) -> int:
    """`count` rounded up to whole vectors of the widest program."""
    return -(-count // WIDTH) * WIDTH


def whole() -> bool:
    """Whether the kernel that is being compiled keeps vectors whole."""
    return not impl.current_cfg().real_matrix_scalarize


@contextmanager
def vectors() -> Iterator[None]:
    """Within this context, compile kernels with whole vectors.

    LLVM alone optimises these kernels (`runtime.without_passes`): Taichi's passes gain nothing here.
    """
    teach()
    config = impl.current_cfg()
    with runtime.without_passes():
        config.real_matrix_scalarize = width() == 1
        try:
            yield
        finally:
            config.real_matrix_scalarize = True


def in_kernels(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a Python function that kernels call while they are compiled."""
    function._is_wrapped_kernel = True
    return function


@in_kernels
def linked() -> bool:
    """Whether the kernel that is being compiled can call the functions of lanes.ll."""
    return whole() and sys.platform == "linux" and platform.machine() == "x86_64"


def _call(function: str, *variables: Any) -> None:
    """Call a function of lanes.ll, which takes pointers to variables."""
    where = core.DebugInfo(impl.get_runtime().get_current_src_info())
    builder = cast(Any, impl.get_runtime().compiling_callable).ast_builder()
    builder.insert_external_func_call(
        0, "", str(BITCODE), f"lanes_{function}", make_expr_group(*variables), make_expr_group([]), where
    )


@in_kernels
def align_stack() -> None:
    """Align the stack frame of a kernel to vectors; to be called inside its loop over environments or vehicles."""
    if linked():
        _call("align_stack")


@in_kernels
def is_laned(x: object) -> bool:
    """Whether x is a whole vector."""
    return isinstance(x, Expr) and x.is_tensor() and x.get_shape() == (WIDTH,) and whole()


@in_kernels
def lane_of(x: Any, lane: Any) -> Any:
    """A number in one lane of x, or x itself if it is the same in all."""
    return impl.subscript(None, x, lane) if is_laned(x) else x


@cache
def teach() -> None:
    """Let Taichi's front end compile v += w and the like for whole vectors, and fuse their products and sums.

    The expression a * b remembers its factors. It is evaluated only if anything else than a sum uses it.
    """
    plain, assigned = ops._binary_operation, Expr._augassign

    def operation(function: Any, of_python: Any, a: Any, b: Any) -> Any:
        pair = (a, b)
        for k in (1, 0):
            factors, other = getattr(pair[k], "factors", None), pair[1 - k]
            if factors and (function, k) in FUSED and (is_laned(other) or _is_number(other)):
                x, y = sorted(factors, key=_is_number)
                out = impl.expr_init(x)
                _call(FUSED[function, k], out, out, _spread(y, out), _spread(other, out))
                return out
        found: Any = plain(function, of_python, a, b)
        if function is core.expr_mul and is_laned(found) and found.element_type() == ti.f32 and linked():
            found.factors = pair
        return found

    def augassign(self: Any, x: Any, op: str) -> None:
        if is_laned(self) and op in AUGMENTED:
            self._assign(AUGMENTED[op](self, x))
        else:
            assigned(self, x, op)

    ops._binary_operation, Expr._augassign = operation, augassign


def _is_number(x: Any) -> bool:
    return isinstance(x, float | int) or (isinstance(x, Expr) and not x.is_tensor())


def _spread(x: Any, like: Any) -> Any:
    """Variable like another, with the value of a vector, or with a number in every lane."""
    if not _is_number(x):
        return impl.expr_init(x)
    out = impl.expr_init(like)
    _call("spread", out, impl.expr_init(ops.cast(x, ti.f32) if isinstance(x, Expr) else float(x)))
    return out


def variables(count: int, value: Variable) -> list[Variable]:
    """Return `count` variables with the initial value `value`; to be called in a kernel inside `ti.static`."""
    return [cast(Variable, impl.expr_init(value)) for _ in range(count)]


@ti.func
def row_of(n, size: ti.template()):
    """n * size: index of row n of a flat array.

    The mask changes no index that fits into an i32. It tells LLVM that there is no overflow, so that all entries of a
    row are read from one address.
    """
    return (n & ti.static((1 << (31 - size.bit_length())) - 1)) * size


@ti.func
def part(v: ti.template(), first: ti.template(), size: ti.template()):
    """`size` lanes of v, from lane `first` on."""
    return ti.Vector([v[first + k] for k in ti.static(range(size))])


@ti.func
def taken_lanes(rows: ti.template(), e, i, columns: ti.template()):
    """Vector of the numbers at `columns` of row [e, i]; lanes behind them hold other numbers of the row.

    The columns are known when the kernel is compiled. LLVM makes one shuffle for each vector that holds some of them.
    """
    found = rows[e, i, ti.static(columns[0] // width())]
    for n in ti.static(blocks_of(columns)):
        source = rows[e, i, n]
        for lane in ti.static(range(len(columns))):
            if ti.static(columns[lane] // width() == n):
                found[lane] = source[ti.static(columns[lane] % width())]
    return found


@in_kernels
def blocks_of(columns: Sequence[int]) -> list[int]:
    """Indices of the vectors that hold `columns`."""
    return sorted({column // width() for column in columns})


@ti.func
def quarter(v: ti.template()):
    """Four lanes with the same sum as v (one lane if v has one)."""
    if ti.static(v.n == 1):
        return v
    else:
        half = part(v, 0, 8) + part(v, 8, 8)
        return part(half, 0, 4) + part(half, 4, 4)


@ti.func
def total(v: ti.template()):
    """Sum of the lanes of a vector."""
    return quarter(v).sum()


@ti.func
def totals(several: ti.template()):
    """`total` of each vector in `several`."""
    if ti.static(linked()):
        found = ti.static(laned_totals(several))
        return ti.Vector([found[k // WIDTH][k % WIDTH] for k in ti.static(range(len(several)))])
    else:
        return _totals(several)


@ti.func
def _totals(several: ti.template()):
    """`totals` without lanes.ll: four vectors at a time are transposed, and their columns added."""
    count = ti.static(len(several))
    sums = ti.Vector([several[0][0] * 0.0 for _ in ti.static(range(count))])
    for n in ti.static(range(0, count, 4)):
        a, b = quarter(several[n]), quarter(several[ti.static(min(n + 1, count - 1))])
        c, d = quarter(several[ti.static(min(n + 2, count - 1))]), quarter(several[ti.static(min(n + 3, count - 1))])
        column = ti.Vector([a[0], b[0], c[0], d[0]])
        for k in ti.static(range(1, a.n)):
            column += ti.Vector([a[k], b[k], c[k], d[k]])
        for k in ti.static(range(min(4, count - n))):
            sums[n + k] = column[k]
    return sums


@in_kernels
def laned_totals(several: list[Any]) -> list[Any]:
    """Vectors of `width()` lanes that hold `total` of each vector in `several`."""
    found, given = [], [impl.expr_init(x) for x in several]
    if linked():
        given += given[-1:] * (-len(given) % 4)
        for n in range(0, len(given), WIDTH):
            group = given[n : n + WIDTH]  # fills up with its own sums, which cost nothing again
            found.append(impl.expr_init(group[0]))
            _call("totals", found[-1], *[group[k % len(group)] for k in range(WIDTH)])
        return found
    sums, wide = _totals(several), several[0].n
    for n in range(0, len(several), wide):
        found.append(ti.Vector([impl.subscript(None, sums, min(n + k, len(several) - 1)) for k in range(wide)]))
    return found
