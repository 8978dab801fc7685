"""Docstrings as the reference shows them: one entry a line, and comments behind attributes as their descriptions."""

import io
import re
import tokenize
from typing import Any

import griffe

SECTION = re.compile(r"^( *)(Args|Attributes|Raises):\n((?:\1 +.*(?:\n|\Z)|\n(?=\1 ))+)", re.MULTILINE)
ENTRY = re.compile(r"(?:^ *|(?<=[.;]) +)(\w+(?:, \w+)*): ", re.MULTILINE)  # "width: m. depth: m" are two entries


def _comment(lines: list[str]) -> str:
    """The comment at the end of a definition."""
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO("\n".join(map(str.strip, lines))).readline))
    except (tokenize.TokenError, IndentationError):
        return ""
    return " ".join(t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT and "pyright" not in t.string)


def _entries(obj: griffe.Object, section: re.Match[str]) -> str:
    """A section with an entry a line, one for each name."""
    indent, title, text = section[1], section[2], section[3]
    known = {p.name for p in obj.parameters} if isinstance(obj, griffe.Function) else {*obj.members}

    def begins(found: re.Match[str]) -> bool:
        """Whether it is a name: the first of a line, or one that is there."""
        first = found[0].startswith(f"{indent}    ") and not found[0].startswith(f"{indent}     ")
        return first or all(name in known or name.endswith("Error") for name in found[1].split(", "))

    starts = [found for found in ENTRY.finditer(text) if begins(found)]
    if not starts:
        return section[0]
    ends = [found.start() for found in starts[1:]] + [len(text)]
    lines = []
    for found, end in zip(starts, ends, strict=True):
        for name in found[1].split(", "):
            # griffe gives an attribute whose type it does not know that of the one before; () says that there is none
            typed = title != "Attributes" or getattr(obj.members.get(name), "annotation", None)
            lines.append(f"{indent}    {name}{'' if typed else ' ()'}: {' '.join(text[found.end() : end].split())}")
    return f"{indent}{title}:\n" + "\n".join(lines) + "\n"


class Docstrings(griffe.Extension):
    """Changes docstrings of a package when it has been read."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Change those of everything in it."""
        self._change(pkg)

    def _change(self, obj: griffe.Object) -> None:
        if obj.docstring:
            obj.docstring.value = SECTION.sub(lambda found: _entries(obj, found), obj.docstring.value)
        elif isinstance(obj, griffe.Attribute) and ("class-attribute" in obj.labels or obj.value is None):
            # fields of a class; one without a comment is shown, too: its name, type and default say it all
            obj.docstring = griffe.Docstring(_comment(obj.lines) or "&nbsp;", parent=obj, lineno=obj.lineno)
        for member in list(obj.members.values()):
            if not member.is_alias and (member.name == "__init__" or not member.name.startswith("_")):
                self._change(member)
