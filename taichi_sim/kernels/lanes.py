"""Loops over wave components, panels and filters in vectors, of which a processor takes all lanes at once.

LLVM vectorises a loop of numbers by what it knows of the processor. Taichi's knows none that is newer than itself, and
takes a quarter of their width. So the loops of hulls are written in vectors: an array [..., n] goes into a kernel as
[..., block] vectors of `width()` lanes (`laned`), which stay whole in kernels compiled under `vectors()`; others are
taken apart into numbers.

Of whole vectors Taichi makes no code for -v, abs(v), v -= w, nor for comparisons outside `ti.select`.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import taichi as ti
import torch
from taichi.lang import impl
from torch import Tensor

from taichi_sim.kernels import runtime

WIDTH = 16  # lanes in f32: a register of AVX-512, two of AVX2, four of SSE and NEON
laned1, laned2, laned3 = (ti.types.ndarray(element_dim=1, ndim=n) for n in (1, 2, 3))


def width() -> int:
    """Lanes of the running Taichi program: 1 where its vectors are not kept whole."""
    run = runtime.current()
    return WIDTH if run.arch == "cpu" and run.precision == "f32" else 1


def laned(values: Tensor, fill: float = 0.0) -> Tensor:
    """`values` [..., n] as [..., block, lane]: a view where n is a multiple of the width, else a copy that ends in
    `fill`.
    """
    missing = blocks(values.shape[-1]) * width() - values.shape[-1]
    if missing:
        values = torch.nn.functional.pad(values, (0, missing), value=fill)
    return values.unflatten(-1, (-1, width()))


def blocks(count: int) -> int:
    """Vectors of `count` numbers."""
    return -(-count // width())


def filled(count: int) -> int:
    """`count` numbers, filled up to whole vectors of any program."""
    return -(-count // WIDTH) * WIDTH


@contextmanager
def vectors() -> Iterator[None]:
    """Kernels that are compiled meanwhile keep their vectors whole; LLVM alone optimises them, in a quarter of the time
    that Taichi takes to do it first.
    """
    config = impl.current_cfg()
    level, config.opt_level, config.real_matrix_scalarize = config.opt_level, 0, width() == 1
    try:
        yield
    finally:
        config.opt_level, config.real_matrix_scalarize = level, True


def variables(count: int, value: Any) -> list[Any]:
    """In a kernel, inside `ti.static`: so many variables that begin at `value`."""
    return [impl.expr_init(value) for _ in range(count)]


@ti.func
def part(v: ti.template(), first: ti.template(), size: ti.template()):
    """`size` lanes of v from `first` on."""
    return ti.Vector([v[first + k] for k in ti.static(range(size))])


@ti.func
def quarter(v: ti.template()):
    """Four lanes (of one lane: one) with the same sum."""
    if ti.static(v.n == 1):
        return v
    else:
        half = part(v, 0, 8) + part(v, 8, 8)
        return part(half, 0, 4) + part(half, 4, 4)


@ti.func
def total(v: ti.template()):
    """Sum of a vector's lanes."""
    return quarter(v).sum()


@ti.func
def totals(several: ti.template()):
    """`total` of each of the `variables`, by fours: their lanes, turned into columns, are added as vectors."""
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
