"""Vehicles abreast: kernels that step a vehicle in each lane (lanes.py).

A vehicle without long loops, such as an aircraft, leaves lanes idle. Its kernel therefore takes `lanes.width()`
vehicles at a time, and each number in it is a vector of lanes:

    e, i = group(width, g * width, envs, count)     # environment and number of each vehicle of group g
    mass = taken(fleet.numbers, e, i, 0)            # a number of each
    put(fleet.aux, e, i, k, mass)

`ti.Vector` and `ti.Matrix` of such numbers are `Laned`, by changes of Taichi's front end (taichi_patches.py). The same
functions then serve one vehicle and a group, if they keep to docs/kernels.md.

Where the width is 1 (f64, GPUs, an unchanged Taichi) the numbers are scalars. Members beyond the last vehicle are
copies of it: they read and write the same.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportAttributeAccessIssue=false, reportIndexIssue=false

import operator
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import reduce
from typing import Any

import taichi as ti
from taichi.lang import impl, matrix, ops
from taichi.lang.common_ops import TaichiOperations
from taichi.lang.expr import Expr

from taichi_sim.kernels import lanes
from taichi_sim.kernels.lanes import in_kernels, is_laned, part

AUGMENTED: dict[str, Callable[[Any, Any], Any]] = {
    "Add": operator.add, "Sub": operator.sub, "Mult": operator.mul, "Div": operator.truediv
}  # fmt: skip


class Laned(TaichiOperations):
    """A vector, or a matrix by rows, of numbers of a group; a value, as Taichi's own vectors are."""

    def __init__(self, entries: Sequence[Any], columns: int = 0):
        """Make variables of `entries`; scalars among them are the same for all vehicles."""
        self.entries: list[Any] = [impl.expr_init(x if is_laned(x) else _alike(x)) for x in entries]
        self.columns = columns

    @property
    def n(self) -> int:
        """Number of entries of a vector."""
        return len(self.entries)

    def __getitem__(self, index: Any) -> Any:
        """Entry of a vector (k), or of a matrix (row, column)."""
        return self.entries[index[0] * self.columns + index[1] if isinstance(index, tuple) else index]

    @in_kernels
    def transpose(self) -> "Laned":
        """The transpose of a matrix."""
        rows = len(self.entries) // self.columns
        return Laned([self[r, c] for c in range(self.columns) for r in range(rows)], rows)

    @in_kernels
    def dot(self, other: Any) -> Any:
        """Scalar product of vectors."""
        return impl.expr_init(reduce(operator.add, [x * entry(other, k) for k, x in enumerate(self.entries)]))

    @in_kernels
    def norm(self) -> Any:
        """Length of a vector."""
        return ops.sqrt(self.dot(self))

    @in_kernels
    def sum(self) -> Any:
        """Sum of the entries of a vector."""
        return impl.expr_init(reduce(operator.add, self.entries))

    def times(self, other: Any) -> "Laned":
        """Product of a matrix and a vector or a matrix."""
        rows, inner = len(self.entries) // self.columns, range(self.columns)
        if getattr(other, "columns", 0) == 0:
            of = [[entry(other, k) for k in inner]]
        else:
            of = [[other[k, c] for k in inner] for c in range(other.columns)]
        products = [reduce(operator.add, [self[r, k] * x[k] for k in inner]) for r in range(rows) for x in of]
        return Laned(products, getattr(other, "columns", 0))

    def _assign(self, other: Any) -> None:
        for k, x in enumerate(self.entries):
            x._assign(entry(other, k))

    def _augassign(self, other: Any, by: str) -> None:
        self._assign(AUGMENTED[by](self, other))


def _alike(x: Any) -> Any:
    """Repeat a number for each vehicle of a group."""
    return matrix.make_matrix([impl.expr_init(float(x) if isinstance(x, int) else x)] * lanes.WIDTH)


def entry(x: Any, k: int) -> Any:
    """Entry k of a vector or matrix; a number itself."""
    if isinstance(x, Laned):
        return x.entries[k]
    if isinstance(x, Expr) and x.is_tensor() and not is_laned(x):
        return impl.subscript(None, x, k)
    return x


def vectors() -> AbstractContextManager[None]:
    """Return the context in which kernels for groups are compiled: `lanes.vectors`, unless their width is 1."""
    return nullcontext() if lanes.width() == 1 else lanes.vectors()


class Record:
    """Numbers by name, as a struct in a kernel."""

    _data_oriented = True

    def __init__(self, **numbers: Any):
        """Take the numbers."""
        self.__dict__.update(numbers)


@ti.func
def group(width: ti.template(), first, envs, count):
    """Environment, and index in it, of each of `width` consecutive vehicles from vehicle `first` on.

    Vehicles are counted through all `envs` environments, `count` in each. Members beyond the last are copies of it.
    """
    e, i = first // count, first % count
    if ti.static(width > 1):
        envs_of, numbers_of = ti.Vector([e] * width), ti.Vector([i] * width)
        for lane in range(width):
            vehicle = ti.min(first + lane, envs * count - 1)
            envs_of[lane], numbers_of[lane] = vehicle // count, vehicle % count
        return envs_of, numbers_of
    else:
        return e, i


@ti.func
def taken(array: ti.template(), e, i, first: ti.template(), size: ti.template()):
    """Vector of array[e, i, first + k] for k < size.

    A loop over lanes: a copy for each lane would take LLVM most of the time of compilation.
    """
    if ti.static(not is_laned(e)):
        return ti.Vector([array[e, i, first + k] for k in ti.static(range(size))])
    else:
        read = [ti.Vector([0.0] * lanes.WIDTH) for _ in ti.static(range(size))]
        for lane in range(lanes.WIDTH):
            for k in ti.static(range(size)):
                read[k][lane] = array[e[lane], i[lane], first + k]
        return ti.Vector([read[k] for k in ti.static(range(size))])


@ti.func
def taken2(array: ti.template(), e, size: ti.template()):
    """Vector of array[e, k] for k < size."""
    if ti.static(not is_laned(e)):
        return ti.Vector([array[e, k] for k in ti.static(range(size))])
    else:
        read = [ti.Vector([0.0] * lanes.WIDTH) for _ in ti.static(range(size))]
        for lane in range(lanes.WIDTH):
            for k in ti.static(range(size)):
                read[k][lane] = array[e[lane], k]
        return ti.Vector([read[k] for k in ti.static(range(size))])


@ti.func
def taken1(array: ti.template(), e, ahead: ti.template()):
    """array[e + ahead]."""
    if ti.static(not is_laned(e)):
        return array[e + ahead]
    else:
        read = ti.Vector([array[ahead]] * lanes.WIDTH)
        for lane in range(lanes.WIDTH):
            read[lane] = array[e[lane] + ahead]
        return read


@ti.func
def put(array: ti.template(), e, i, first: ti.template(), values: ti.template()):
    """array[e, i, first + k] = values[k] for every entry of a list of numbers."""
    if ti.static(not is_laned(e)):
        for k in ti.static(range(len(values))):
            array[e, i, first + k] = values[k]
    else:
        kept = [values[k] for k in ti.static(range(len(values)))]
        for lane in range(lanes.WIDTH):
            for k in ti.static(range(len(values))):
                array[e[lane], i[lane], first + k] = kept[k][lane]


@in_kernels
def cast(x: Any, kind: Any) -> Any:
    """ti.cast, also of a group's numbers."""
    if not is_laned(x):
        return ops.cast(x, kind)
    held = impl.expr_init(x)
    return matrix.make_matrix([ops.cast(impl.subscript(None, held, lane), kind) for lane in range(lanes.WIDTH)])


@in_kernels
def bit_cast(x: Any, kind: Any) -> Any:
    """Reinterpret the bits of a number, or of each number of a group; LLVM makes one instruction of it."""
    if not is_laned(x):
        return ops.bit_cast(x, kind)
    held = impl.expr_init(x)
    return matrix.make_matrix([ops.bit_cast(impl.subscript(None, held, lane), kind) for lane in range(lanes.WIDTH)])


@ti.func
def largest(v):
    """The largest of a group's numbers."""
    if ti.static(not is_laned(v)):
        return v
    else:
        half = ti.max(part(v, 0, 8), part(v, 8, 8))
        fourth = ti.max(part(half, 0, 4), part(half, 4, 4))
        return ti.max(ti.max(fourth[0], fourth[1]), ti.max(fourth[2], fourth[3]))


@in_kernels
def some(condition: Any) -> Any:
    """Whether a condition holds for a vehicle of the group."""
    return largest(ops.select(condition, 1.0, 0.0)) > 0.5 if is_laned(condition) else condition
