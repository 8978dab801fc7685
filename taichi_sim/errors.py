"""The errors of users, and the one rule by which commands print them: a message without a traceback."""

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import wraps


class UserError(Exception):
    """A mistake of the user; the message says what to do.

    Each error that a user can cause derives from it, most of them also from a builtin one.
    """


class MissingExtraError(UserError, ImportError):
    """An optional package is not installed; the message says how to install it."""

    def __init__(self, package: str, extra: str):
        """Name the missing `package` and the extra that installs it."""
        super().__init__(f'{package} is not installed: pip install "taichi-sim[{extra}]"', name=package)


def refuse(error: type[Exception], *checks: tuple[object, str]) -> None:
    """Raise `error` for the first of the `checks` that holds: (what is wrong, the message for it)."""
    for wrong, told in checks:
        if wrong:
            raise error(told)


@contextmanager
def named(where: str, error: type[Exception], caught: type[Exception] | None = None) -> Generator[None]:
    """Raise what goes wrong inside it, as `caught` (default: as `error`), as `error` with `where` before its words."""
    try:
        yield
    except caught or error as fault:  # noqa: B030
        raise error(f"{where}{fault}") from None


@contextmanager
def reading(path: object, error: type[Exception]) -> Generator[None]:
    """Read a file inside it: what goes wrong is raised as `error`, and names the file.

    Readers of other packages raise what they like.
    """
    try:
        yield
    except Exception as fault:
        if isinstance(fault, MissingExtraError) or (isinstance(fault, UserError) and str(path) in str(fault)):
            raise
        why = getattr(fault, "strerror", None) or f"{type(fault).__name__}: {fault}"
        raise error(f"{path}: {fault if isinstance(fault, UserError) else f'cannot be read: {why}'}") from fault


@contextmanager
def needs(package: str, extra: str) -> Generator[None]:
    """Import optional packages inside it: `extra` installs `package`.

    Raises:
        MissingExtraError: if an import fails.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(package, extra) from error


def command(name: str) -> Callable[[Callable[[list[str] | None], None]], Callable[..., int]]:
    """Make a command of a function of arguments: it returns 0, or 2 after a mistake of the user, which is printed."""

    def decorate(work: Callable[[list[str] | None], None]) -> Callable[..., int]:
        @wraps(work)
        def main(argv: list[str] | None = None) -> int:
            try:
                work(argv)
                return 0
            except (UserError, OSError) as error:
                print(f"{name}: {message(error)}", file=sys.stderr)
                return 2

        return main

    return decorate


def message(error: Exception) -> str | None:
    """The message for an error of the user or of the machine; None for any other error."""
    if isinstance(error, OSError):
        return f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}"
    notes = "".join(f" ({note})" for note in getattr(error, "__notes__", ()))
    return f"{error}{notes}" if isinstance(error, UserError) else None
