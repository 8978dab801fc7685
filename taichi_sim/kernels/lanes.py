"""Vectors for loops over wave components, panels and filters, so that all SIMD lanes of the processor are used.

LLVM vectorises a scalar loop for the processor that it knows. Taichi's LLVM knows no processor newer than itself, and
so uses a quarter of the lanes of newer ones. The loops of hulls are therefore written in vectors: an array [..., n]
enters a kernel as [..., block] vectors of `width()` lanes (`laned`). Kernels compiled under `vectors()` keep these
vectors whole; others take them apart into scalars.

What such kernels may not write stands in docs/kernels.md.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import taichi as ti
import torch
from taichi.lang import impl
from taichi.lang.expr import Expr
from torch import Tensor

from taichi_sim.kernels import runtime

WIDTH = 16  # lanes in f32: one register of AVX-512, two of AVX2, four of SSE or NEON
Variable = TypeVar("Variable")
laned1, laned2, laned3 = cast(Any, [ti.types.ndarray(element_dim=1, ndim=n) for n in (1, 2, 3)])


def width() -> int:
    """Number of lanes in the running Taichi program; 1 where vectors are not kept whole."""
    run = runtime.current()
    return WIDTH if runtime.PATCHED and run.arch == "cpu" and run.precision == "f32" else 1


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
def is_whole(x: object) -> bool:
    """Whether x is a vector of any size that is kept whole."""
    return isinstance(x, Expr) and x.is_tensor() and whole()


@in_kernels
def is_laned(x: object) -> bool:
    """Whether x is a whole vector of lanes."""
    return isinstance(x, Expr) and is_whole(x) and x.get_shape() == (WIDTH,)


@in_kernels
def lane_of(x: Any, lane: Any) -> Any:
    """A number in one lane of x, or x itself if it is the same in all."""
    return impl.subscript(None, x, lane) if is_laned(x) else x


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
    """`total` of each vector in `several`: four vectors at a time are transposed, and their columns added."""
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
    sums, wide = totals(several), several[0].n
    return [
        ti.Vector([impl.subscript(None, sums, min(n + k, len(several) - 1)) for k in range(wide)])
        for n in range(0, len(several), wide)
    ]
