"""Text helpers for `repr`."""

import numpy as np
from numpy.typing import ArrayLike
from torch import Tensor


def span(values: ArrayLike | Tensor, unit: str) -> str:
    """Range of `values` to four digits: "0.5 m", or "0.5 to 1.25 m". `values` is an array or a tensor of any shape."""
    flat = np.asarray(values.detach().cpu() if isinstance(values, Tensor) else values, dtype=np.float64).ravel()
    if not flat.size:
        return "none"
    low, high = f"{flat.min():.4g}", f"{flat.max():.4g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def number(count: int, thing: str) -> str:
    """A count with its noun: "1 environment", "3 environments"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
