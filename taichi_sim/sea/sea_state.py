"""Sea states by number: WMO Code Table 3700 (Manual on Codes, WMO-No. 306).

A number is a range of significant wave height. A limit belongs to the lower number: exactly 4 m is code 5.
"""

import math

UPPER_HS = (0.0, 0.1, 0.5, 1.25, 2.5, 4.0, 6.0, 9.0, 14.0, math.inf)  # m, upper limits of codes 0 to 9


def sea_state_range(code: int) -> tuple[float, float]:
    """Smallest and largest significant wave height (m) of sea state `code`, 0 to 9; code 9 has no upper limit.

    Raises:
        ValueError: for a code outside 0..9.
    """
    if code not in range(len(UPPER_HS)):
        raise ValueError(f"sea state {code!r}: allowed are 0 to {len(UPPER_HS) - 1}")
    return (UPPER_HS[code - 1] if code > 0 else 0.0), UPPER_HS[code]


def sea_state(hs: float) -> int:
    """Sea state number of a significant wave height (m).

    Raises:
        ValueError: for a negative height or one that is not a number.
    """
    if not hs >= 0:
        raise ValueError(f"hs = {hs!r}: must be 0 m or more")
    return next(code for code, upper in enumerate(UPPER_HS) if hs <= upper)
