"""95 % intervals of figures, by the bootstrap over episodes.

Episodes are independent of each other, the moments within one are not: so whole episodes are drawn again, with
replacement, and the figures computed of each draw. An interval is from the 2.5th to the 97.5th percentile of those (the
percentile method, Efron & Tibshirani 1993, ch. 13). Of two controllers on the same episodes the same draws are taken of
both, so that what makes an episode hard for both cancels in the difference.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.judge import Episodes, Judge, finite

RESAMPLES = 2000
LEVEL = 0.95
AT_ONCE = 1_000_000  # numbers drawn at once


class Interval(NamedTuple):
    """A figure of all episodes, and its interval; None where it was not measured."""

    value: float | None
    low: float | None
    high: float | None


def intervals(kind: type[Judge], episodes: Episodes) -> dict[str, Interval]:
    """Of each figure that `kind.pooled` gives of one team's episodes, as Judge.episodes gives them."""
    return _of(kind.pooled(episodes), [kind.pooled(drawn) for (drawn,) in _draws(episodes)])


def differences(kind: type[Judge], one: Episodes, other: Episodes, times: int = 1) -> dict[str, Interval]:
    """Of the differences, one less the other, on the same episodes.

    Each may hold the same episodes several `times`, one after the other (by several policies): such are drawn together.
    """
    return paired(np.subtract, kind, one, other, times=times)


def ratios(kind: type[Judge], one: Episodes, other: Episodes, times: int = 1) -> dict[str, Interval]:
    """Of the ratios, one over the other, likewise."""
    with np.errstate(divide="ignore", invalid="ignore"):  # what is not finite is not known
        return paired(np.divide, kind, one, other, times=times)


def paired(
    how: Callable[..., NDArray[np.float64]], kind: type[Judge], *of: Episodes, times: int = 1
) -> dict[str, Interval]:
    """Of what `how` makes of the same figure of several controllers, on the same episodes, `times` as above.

    Raises:
        ValueError: if they have not as many episodes.
    """
    counts = [_count(episodes) for episodes in of]
    if len(set(counts)) > 1:
        raise ValueError(f"{' and '.join(map(str, counts))} episodes: pairs are of the same episodes")

    def together(parts: Sequence[Episodes]) -> dict[str, NDArray[np.float64]]:
        pooled = [kind.pooled(part) for part in parts]
        return {key: np.asarray(how(*(figures[key] for figures in pooled))) for key in pooled[0]}

    return _of(together(of), [together(drawn) for drawn in _draws(*of, times=times)])


def _count(episodes: Episodes) -> int:
    return len(next(iter(episodes.values())))


def _draws(*of: Episodes, times: int = 1) -> Iterator[list[dict[str, NDArray[np.float64]]]]:
    """The same episodes of each, drawn again and again: [draw, episode]; they are there `times`."""
    count, generator = _count(of[0]) // times, np.random.default_rng(0)
    rows = max(1, min(RESAMPLES, AT_ONCE // count))
    for begin in range(0, RESAMPLES, rows):
        drawn = generator.integers(count, size=(min(rows, RESAMPLES - begin), count))
        picks = np.concatenate([drawn + k * count for k in range(times)], axis=1)
        yield [{name: values[picks] for name, values in episodes.items()} for episodes in of]


def _of(value: Mapping[str, NDArray], draws: list[dict[str, NDArray[np.float64]]]) -> dict[str, Interval]:
    found = {}
    for key in value:
        drawn = np.concatenate([np.atleast_1d(draw[key]) for draw in draws])
        drawn = drawn[np.isfinite(drawn)]
        edge = 50 * (1 - LEVEL)
        low, high = np.percentile(drawn, [edge, 100 - edge]) if len(drawn) else (np.nan, np.nan)
        found[key] = Interval(finite(value[key]), finite(low), finite(high))
    return found
