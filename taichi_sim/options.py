"""Arguments of commands: argparse types, each of which judges an argument where it is parsed."""

import argparse
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
N = TypeVar("N", int, float)
PICTURES = (".png", ".pdf", ".svg", ".jpg")
TABLES = (".parquet", ".csv")
ROOM = 1 << 20  # bytes that a disk must take for an output to begin; assumed


def option(convert: Callable[[str], T], fits: Callable[[T], bool], wanted: str) -> Callable[[str], T]:
    """An argparse type: `convert` reads the text, and `wanted` says which values fit."""

    def read(text: str) -> T:
        with suppress(ValueError):
            if fits(value := convert(text)):
                return value
        raise argparse.ArgumentTypeError(f"{text}: {wanted}")

    return read


def ranged(kind: Callable[[str], N], low: N, high: N) -> Callable[[str], N]:
    """An argparse type: a number from `low` to `high`."""
    return option(kind, lambda value: low <= value <= high, f"allowed are {low:.10g} to {high:.10g}")


positive_int = option(int, lambda value: value >= 1, "must be a whole number of at least 1")
positive_float = option(float, lambda value: 0 < value <= sys.float_info.max, "must be a number above 0")
seed = ranged(int, 0, 2**31 - 1)
port = ranged(int, 1, 65535)
address = option(lambda text: str(ip_address(text)), bool, "not an IP address")


def parser_of(docstring: str | None, prog: str | None = None) -> argparse.ArgumentParser:
    """A parser that shows a module's docstring: its first paragraph above the arguments, the rest below."""
    summary, _, rest = (docstring or "").partition("\n\n")
    plain = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog=prog, description=summary, epilog=rest, formatter_class=plain)


def refuse_unwritable(place: Path) -> None:
    """Refuse now what could not be written after hours of work, as a file or a folder `place`, new or not.

    Raises:
        OSError: if its folder cannot be written, or the disk is full.
    """
    parents = place.absolute().parents
    folder = place if place.is_dir() else next(parent for parent in parents if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
    except OSError as error:
        raise OSError(error.errno, f"cannot be written: {error.strerror}", str(place)) from None


def output(text: str, is_folder: bool = False) -> Path:
    """An argparse type: a file to write, whose folder is made, or refused at once if it could not be written."""
    place, why = Path(text), "a folder of that name exists"
    if is_folder or not place.is_dir():
        try:
            refuse_unwritable(place)
            (place if is_folder else place.parent).mkdir(parents=True, exist_ok=True)
            return place
        except OSError as error:
            why = error.strerror
    raise argparse.ArgumentTypeError(f"{text}: {why}")


def output_folder(text: str) -> Path:
    """The same of a folder to write to, which is made."""
    return output(text, is_folder=True)


table = option(output, lambda file: file.suffix in TABLES, f"must end in {' or '.join(TABLES)}")
picture = option(output, lambda file: file.suffix.lower() in PICTURES, f"must end in one of {', '.join(PICTURES)}")
