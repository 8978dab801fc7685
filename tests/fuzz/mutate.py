"""Wrong files from a right one: cut, bytes flipped, lines repeated or lost, numbers and words replaced."""

import re
from collections.abc import Callable, Iterator

import numpy as np

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
WRONG = (b"nan", b"inf", b"-inf", b"1e30", b"-1e30", b"1e400", b"0", b"-1", b"999", b"-9999", b"", b"1,5", b"x", b"1_0")
"""What stands where a number stood."""


def mutations(right: bytes, count: int, seed: int, *, text: bool) -> Iterator[tuple[str, bytes]]:
    """Yield `count` wrong files made from `right`, each with what was done to it.

    Args:
        right: the bytes of a file that is read without complaint.
        count: number of files.
        seed: of the draws; the same seed gives the same files.
        text: whether the file has lines and numbers, which are then mutated, too.
    """
    rng = np.random.default_rng(seed)
    ways: list[Callable[[bytes, np.random.Generator], tuple[str, bytes]]] = [_cut, _flipped, _noise, _lost, _twice]
    if text:
        ways += [_number, _number, _number, _line_lost, _line_twice, _lines_swapped, _word]
    for k in range(count):
        yield ways[k % len(ways)](right, rng)


def _span(size: int, rng: np.random.Generator) -> tuple[int, int]:
    first = int(rng.integers(size))
    return first, min(size, first + int(rng.integers(1, 64)))


def _cut(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    end = int(rng.integers(len(right)))
    return f"cut after {end} bytes", right[:end]


def _flipped(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    made, at = bytearray(right), int(rng.integers(len(right)))
    made[at] ^= 1 << int(rng.integers(8))
    return f"a bit of byte {at} flipped", bytes(made)


def _noise(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    first, end = _span(len(right), rng)
    return f"bytes {first} to {end} random", right[:first] + rng.bytes(end - first) + right[end:]


def _lost(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    first, end = _span(len(right), rng)
    return f"bytes {first} to {end} lost", right[:first] + right[end:]


def _twice(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    first, end = _span(len(right), rng)
    return f"bytes {first} to {end} twice", right[:end] + right[first:end] + right[end:]


def _number(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    found = list(NUMBER.finditer(right))
    if not found:
        return _flipped(right, rng)
    at, wrong = found[int(rng.integers(len(found)))], WRONG[int(rng.integers(len(WRONG)))]
    return f"{at.group()!r} at {at.start()} becomes {wrong!r}", right[: at.start()] + wrong + right[at.end() :]


def _word(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    found = list(re.finditer(rb"[A-Za-z_]\w+", right))
    if not found:
        return _flipped(right, rng)
    at = found[int(rng.integers(len(found)))]
    return f"the word {at.group()!r} at {at.start()} lost", right[: at.start()] + right[at.end() :]


def _line_lost(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    lines = right.splitlines(keepends=True)
    k = int(rng.integers(len(lines)))
    return f"line {k + 1} lost", b"".join(lines[:k] + lines[k + 1 :])


def _line_twice(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    lines = right.splitlines(keepends=True)
    k = int(rng.integers(len(lines)))
    return f"line {k + 1} twice", b"".join(lines[: k + 1] + lines[k:])


def _lines_swapped(right: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    lines = right.splitlines(keepends=True)
    k, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    lines[k], lines[j] = lines[j], lines[k]
    return f"lines {k + 1} and {j + 1} swapped", b"".join(lines)
