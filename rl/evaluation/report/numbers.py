"""Numbers of a report as text, with no more digits than their intervals carry."""

import math

from rl.evaluation.intervals import Interval

NOTHING = "-"


def short(value: float, digits: int = 3) -> str:
    """A number with so many significant digits at most, without an exponent."""
    if not math.isfinite(value):
        return NOTHING
    decimals = digits if value == 0 else max(0, digits - 1 - math.floor(math.log10(abs(value))))
    found = f"{value:.{decimals}f}"
    return found.rstrip("0").rstrip(".") if "." in found else found


def number(of: Interval, against_zero: bool = False) -> str:
    """A figure with its interval as HTML, to the first digit in which the interval is uncertain."""
    if of.value is None:
        return NOTHING
    sign = "+" if against_zero else ""
    if of.low is None or of.high is None:
        return f"{of.value:{sign}.3g}"
    width = of.high - of.low
    form = f".{max(0, -math.floor(math.log10(width / 2)))}f" if width > 0 else ".3g"
    value, low, high = f"{of.value:{sign}{form}}", f"{of.low:{form}}", f"{of.high:{form}}"
    clear = against_zero and (of.low > 0 or of.high < 0)
    return f"{f'<b>{value}</b>' if clear else value} <i>({low} to {high})</i>"
