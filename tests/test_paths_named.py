"""Files that docstrings, comments, messages and pages name are there."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

from folders import ROOT

SOURCES = ("taichi_sim", "rl", "tools", "tests")
OURS = (*SOURCES, "docs", "configs")
EXISTING = {path.relative_to(ROOT).as_posix() for folder in OURS for path in (ROOT / folder).rglob("*.*")}
END = r"(?![\w*{/])"
FROM_ROOT = re.compile(rf"(?<![\w/.\-])(?:{'|'.join(OURS)})/[\w./\-]*\w\.(?:py|md|toml|json|ipynb|png){END}")
ANY = re.compile(rf"\.py\b|\b(?:{'|'.join(OURS)})/")
MODULE = re.compile(rf"(?<![\w/.\-*}}])(?:\.\./)*(?:[\w\-]+/)*[\w\-]+\.py{END}")
LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")
EXAMPLES = {"my_boat.py", "mine.py"}  # of a reader's own
FROZEN = {"tests/physics/test_otter_numbers.py"}  # in otter.toml, whose bytes are in tasks' digests
WHOEVER = re.compile(r"(?:^|/|_)[A-Z]+(?:[./]|$)")  # NAME.py stands for any


def _named(pattern: re.Pattern[str], text: str) -> Iterator[str]:
    """Paths in a text that are not placeholders."""
    return (found for found in pattern.findall(text) if not WHOEVER.search(found))


def _strings(tree: ast.AST) -> Iterator[str]:
    """All strings of a module, docstrings too."""
    return (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))


def _docstrings(tree: ast.AST) -> Iterator[str]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return (ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, kinds))


def _comments(source: str) -> Iterator[str]:
    """Comments of a source, if a line with a # names a file at all: to part a file into tokens takes long."""
    tails = "\n".join(line.partition("#")[2] for line in source.splitlines())
    if not (MODULE.search(tails) or FROM_ROOT.search(tails)):
        return iter(())
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return (token.string for token in tokens if token.type == tokenize.COMMENT)


@cache
def _is_there(name: str) -> bool:
    """Whether some file's path ends so; what lies beside is named from there on."""
    end = name.replace("../", "")
    return name in EXAMPLES or any(path == end or path.endswith(f"/{end}") for path in EXISTING)


def missing_of_source(path: Path) -> set[str]:
    """Modules named in docstrings and comments, and paths from the root in any string (of the tests: in docstrings)."""
    source = path.read_text(encoding="utf-8")
    if not ANY.search(source):
        return set()
    tree = ast.parse(source)
    told = [*_docstrings(tree), *_comments(source)]
    texts = told if path.is_relative_to(ROOT / "tests") else [*told, *_strings(tree)]
    modules = {name for text in told for name in _named(MODULE, text) if not _is_there(name)}
    return modules | {name for text in texts for name in _named(FROM_ROOT, text) if name not in EXISTING}


def missing_of_page(path: Path) -> set[str]:
    """Paths from the root, and links."""
    text = path.read_text(encoding="utf-8")
    links = {link for link in LINK.findall(text) if path.suffix == ".md" and not (path.parent / link).exists()}
    return links | {name for name in _named(FROM_ROOT, text) if name not in EXISTING}


def test_bare_names_in_the_tables_of_the_architecture_are_there():
    """A name without a folder, in backticks or with an underscore, is a file or a folder of the row's."""
    rows = re.findall(r"^\| \**`.*", (ROOT / "docs/architecture.md").read_text(encoding="utf-8"), re.MULTILINE)
    found = re.findall(r"`([a-z]\w+)`|\b([a-z]+_\w+)\b", "\n".join(rows))
    named = {name for names in found for name in names if name}
    known = {part.removesuffix(".py") for path in EXISTING if path.endswith(".py") for part in path.split("/")}
    assert named - known == set()


def test_named_files_are_there():
    sources = chain.from_iterable((ROOT / folder).rglob("*.py") for folder in SOURCES)
    pages = [ROOT / name for name in ("README.md", "CONTRIBUTING.md")]
    pages += [*(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").glob("*.ipynb")]
    pages += (ROOT / "configs").rglob("*.toml")
    found = {path: missing_of_source(path) for path in sources} | {path: missing_of_page(path) for path in pages}
    assert {str(path.relative_to(ROOT)): names for path, names in found.items() if names - FROZEN} == {}
