"""Everything that is replaced in Taichi's own code, what it buys, and the switch that leaves all of it as it is.

`TAICHI_SIM_NO_PATCHES` in the environment of a process, set to anything, turns `PATCHES` off. Vectors then have one
lane (`lanes.width`). Figures are the same to rounding. Both kinds of kernels may lie in one cache: Taichi finds a
compiled kernel by its instructions and options, in which they differ.

The patches are for Taichi 1.7, the version that pyproject.toml pins. Figures are CPU time of one core of an Intel Xeon
at 2.5 GHz: of a process that makes an Otter, an Aerosonde and an x500 with compiled kernels from the cache (one to four
runs); of a substep of one of 1,024 vehicles (best of eight times a hundred, two runs).

| what | without | with |
|---|---|---|
| FRONT END: `get_pos_info`, to read the kernels of the three | 6.1 s | 2.9 s |
| `__call__`, `getsourcefile`, `textwrap`, to read the kernels of `cruise` (Zen 5) | 2.9 s | 2.1 s |
| `_inside_class`, to import all packages | 2.8 s | 1.7 s |
| `build_Assign`, to make a mission of `cruise` and step it, with an empty cache (three runs) | 39 s | 36 s |
| WHOLE VECTORS: a substep of `otter`, 32 wave components | 2,920 ns | 770 ns |
| GROUPS: of `aerosonde` | 490 ns | 125 ns |
| of `x500` | 740 ns | 280 ns |
| of `unity_boat` | 230 ns | 145 ns |
| of `unity_aircraft` | 88 ns | 52 ns |

FRONT END. Taichi inlines every use of a function, and each time finds its source and unwraps its lines; here they are
kept. For each node it composes an error message with the node's source lines and carets, which is hardly ever printed;
here carets are drawn for errors only, and an error that Taichi's compiler finds later names the statement. To learn
whether a decorated function is in a class, Taichi goes through all imported modules; here it reads the line. `x =
value` makes the variable x twice, and the compiler takes time by the square of the number of variables in a kernel;
here it is made once.

WHOLE VECTORS. Taichi can keep a vector whole (`real_matrix_scalarize`), for lanes.py. It then cannot compile v += w, -v
or abs(v).

GROUPS. A vector or matrix whose numbers are whole vectors is an `abreast.Laned`. Each of these patches is needed by all
groups.

Used as they are, but internal as well: what `runtime.Launcher` launches, packs and the program of a process
(runtime.py), variables and subscripts in functions of `lanes.in_kernels`.
"""

# Taichi has no types for its internals.
# pyright: reportOptionalMemberAccess=false

import ast
import linecache
import sys
import textwrap
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

from taichi._lib import core
from taichi.lang import impl, kernel_impl, matrix, matrix_ops, ops
from taichi.lang.ast.ast_transformer import ASTTransformer, build_stmt
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext, Builder
from taichi.lang.expr import Expr

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import AUGMENTED, Laned, entry
from taichi_sim.kernels.lanes import is_laned, is_whole

_with_carets, _assigned = ASTTransformerContext.get_pos_info, Expr._augassign
_build = Builder.__call__
_build_assign = ASTTransformer.build_Assign
_expr_init, _make_matrix, _matmul = impl.expr_init, matrix.make_matrix, matrix_ops.matmul


def install() -> None:
    """Replace what `PATCHES` lists, unless the switch is set."""
    if runtime.PATCHED:
        for patch in PATCHES:
            setattr(patch.owner, patch.name, patch.new)


def position(context: ASTTransformerContext, node: ast.expr | ast.stmt) -> str:
    """Return the position of a node; source lines and carets are added once an error was raised there."""
    if context.raised:
        return _with_carets(context, node)
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'


class _Raises:
    """A builder of which every method raises `error`."""

    def __init__(self, error: Exception):
        self.error = error

    def __getattr__(self, name: str) -> Callable[..., None]:
        """Any method."""

        def method(*_: object) -> None:
            raise self.error

        return method


def build(self: Builder, context: ASTTransformerContext, node: ast.AST) -> Any:
    """Build a node; the place of a statement is that of all its expressions, until an error is raised."""
    method = getattr(self, f"build_{type(node).__name__}", None)
    if method is None:
        return _build(self, context, node)
    try:
        if not isinstance(node, ast.stmt):
            return method(context, node)
        with impl.get_runtime().src_info_guard(context.get_pos_info(node)):
            return method(context, node)
    except Exception as error:
        return _build(cast(Builder, _Raises(error)), context, node)  # adds the place to the message


def unwrapped(line: str, **_: int) -> str:
    """A line of source as Taichi reads it."""
    return line.expandtabs(4).rstrip()


def assign(context: ASTTransformerContext, node: ast.Assign) -> None:
    """Build `x = value` and `a, b = values`: a variable that is new is made once."""
    target = node.targets[0]
    value: Any = node.value
    unpacked = isinstance(target, ast.Tuple)
    names = [getattr(x, "id", None) for x in (target.elts if unpacked else [target])]
    new = all(names) and len(set(names)) == len(names) and not any(map(context.is_var_declared, names))
    if len(node.targets) > 1 or not new:
        _build_assign(context, node)
        return
    build_stmt(context, value)
    values, static = value.ptr, isinstance(value, ast.Call) and getattr(value.func, "ptr", None) is impl.static
    if unpacked and not static and not isinstance(values, tuple | list):  # one vector: its entries are of a variable
        values = impl.expr_init(values)
    ASTTransformer.build_assign_unpack(context, target, values, static)


def inside_class(level_of_class_stackframe: int) -> bool:
    """Whether the statement of a frame, that many calls up, begins a class."""
    try:
        frame = sys._getframe(level_of_class_stackframe)
    except ValueError:  # a function of a script itself
        return False
    statement = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return any(pattern.match(statement) for pattern in kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)


def augassign(self: Any, x: Any, op: str) -> None:
    """v += w and the like, also for whole vectors."""
    if is_laned(self) and op in AUGMENTED:
        self._assign(AUGMENTED[op](self, x))
    else:
        _assigned(self, x, op)


def expr_init(x: Any) -> Any:
    """Variable with the value x, also of a group's vector or matrix."""
    return Laned(x.entries, x.columns) if isinstance(x, Laned) else _expr_init(x)


def make_matrix(rows: Any, dt: Any = None) -> Any:
    """Vector or matrix of numbers, or of a group's numbers."""
    entries = [x for row in rows for x in row] if len(rows) and isinstance(rows[0], list | tuple) else rows
    if any(is_laned(x) for x in entries):
        return Laned(entries, 0 if entries is rows else len(rows[0]))
    return _make_matrix(rows, dt)


def matmul(a: Any, b: Any) -> Any:
    """a @ b, also of a group's matrix and vector or matrix."""
    return a.times(b) if isinstance(a, Laned) else _matmul(a, b)


def by_entries(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Return the operation `plain`, also for a group's vectors and matrices, entry by entry."""

    def operation(function: Any, of_python: Any, *args: Any) -> Any:
        vector = next((x for x in args if isinstance(x, Laned)), None)
        if vector is not None:
            each = range(len(vector.entries))
            return Laned([operation(function, of_python, *(entry(x, k) for x in args)) for k in each], vector.columns)
        if function is core.expr_neg and is_whole(args[0]):
            return 0.0 - args[0]
        if function is core.expr_abs and is_whole(args[0]):
            return ops.select(args[0] < 0.0, 0.0 - args[0], args[0])
        return plain(function, of_python, *args)

    return operation


class Patch(NamedTuple):
    """A replaced attribute of Taichi."""

    owner: Any  # module or class
    name: str
    new: Any


PATCHES = (
    # FRONT END
    Patch(ASTTransformerContext, "get_pos_info", position),
    Patch(Builder, "__call__", build),
    Patch(kernel_impl, "getsourcelines", cache(kernel_impl.getsourcelines)),
    Patch(kernel_impl, "getsourcefile", cache(kernel_impl.getsourcefile)),
    Patch(kernel_impl, "textwrap", SimpleNamespace(fill=unwrapped, dedent=cache(textwrap.dedent))),
    Patch(kernel_impl, "_inside_class", inside_class),
    Patch(ASTTransformer, "build_Assign", staticmethod(assign)),
    # WHOLE VECTORS
    Patch(Expr, "_augassign", augassign),
    # GROUPS
    Patch(impl, "expr_init", expr_init),
    Patch(matrix, "make_matrix", make_matrix),
    Patch(matrix_ops, "matmul", matmul),
    Patch(ops, "_unary_operation", by_entries(ops._unary_operation)),
    Patch(ops, "_binary_operation", by_entries(ops._binary_operation)),
    Patch(ops, "_ternary_operation", by_entries(ops._ternary_operation)),
)
