"""Derives independent seeds from one seed."""

import hashlib


def derive_seed(seed: int, *purpose: str | int) -> int:
    """A 31-bit seed for `purpose`: equal words give equal seeds, other words give unrelated ones."""
    digest = hashlib.sha256(repr((int(seed), *purpose)).encode()).digest()
    return int.from_bytes(digest[:4], "little") >> 1
