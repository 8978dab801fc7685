"""When a digital controller reads its instruments: at a rate of its own, whatever the physics step.

Between readings its command is held. A physics step that is longer than the controller's interval has one command: the
one for the reading in the middle of those that fall into it, whose state is predicted with the last step's rates. So a
controller faster than the physics step is second order in the step, and a slower one is the same for any step.
"""

from typing import NamedTuple

WHOLE = 1e-6  # of a step: a rest below it is rounding


class Sampling(NamedTuple):
    """Readings of a controller."""

    every: int  # physics steps from one to the next
    interval: float  # time between two, s
    ahead: float  # time from the beginning of a physics step to the reading that counts for it, s


def sampling(rate_hz: float, dt: float, substeps: int) -> Sampling:
    """Readings at `rate_hz` (Hz) in control steps of `substeps` physics steps of dt (s).

    A control step begins with one, because its action is new. If the interval is no whole number of physics steps, or
    the control step no whole number of intervals, readings are as much more often as they must. A rate of 0 reads once
    in a control step.
    """
    interval = 1.0 / rate_hz if rate_hz > 0.0 else dt * substeps
    most = max(1, min(substeps, int(interval / dt + WHOLE)))
    every = next(k for k in range(most, 0, -1) if substeps % k == 0)
    return Sampling(every, every * dt, 0.5 * max(dt - interval, 0.0))
