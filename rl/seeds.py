"""Seeds of independent purposes, derived from one run seed."""

import hashlib


def derive_seed(seed: int, *purpose: str | int) -> int:
    """A 31-bit seed for `purpose`: the same words give the same seed, other words an unrelated one."""
    digest = hashlib.sha256(repr((int(seed), *purpose)).encode()).digest()
    return int.from_bytes(digest[:4], "little") >> 1
