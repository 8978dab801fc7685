"""Taichi's front end without its repetitions: kernels are read in about half the time.

Every use of a function is inlined: its source is looked up, wrapped line by line and parsed anew, and for each node of
it the lines that it stands in are set with carets below, for a message that is hardly ever wanted. Here sources and
lines are kept, and carets are drawn for errors alone.

It reaches into Taichi 1.7 below its public interface. pyproject.toml keeps Taichi there.
"""

import textwrap
from functools import cache
from types import SimpleNamespace
from typing import Any

from taichi.lang import kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

_context: Any = ASTTransformerContext
_with_carets = _context.get_pos_info


def quicken() -> None:
    """Install the faster front end in this process; a second call does nothing."""
    if _context.get_pos_info is _position:
        return
    _context.get_pos_info = _position
    kernel_impl.getsourcelines = cache(kernel_impl.getsourcelines)
    kernel_impl.getsourcefile = cache(kernel_impl.getsourcefile)
    kernel_impl.textwrap = SimpleNamespace(fill=cache(textwrap.fill), dedent=cache(textwrap.dedent))


def _position(context: Any, node: Any) -> str:
    """Where a node stands; with its lines and carets once an error has been raised there."""
    if context.raised:
        return _with_carets(context, node)
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'
