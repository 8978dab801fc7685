"""How a policy corrects a classical controller, `[TEAM.residual]`."""

from typing import Annotated

from pydantic import Field

from taichi_sim.config import NonNegative, Positive, Strict


class ResidualConfig(Strict):
    """A policy that corrects the classical controller instead of acting alone.

    It corrects the velocity that the controller wants, ahead and to starboard along the target's course, after evasion,
    or its actions, or both. With a `shield`, corrections are taken back as far as they lead where the risks of what is
    that near in time are greater than they are worth (avoidance.py): none leads into an obstacle that is seen. Where a
    team mate is nearer than `room` they fade out, to none at half of it: two that both correct, each counting on the
    other to go straight on, met more often than two that do not. With a `gate`, corrections fade in where the gap to an
    obstacle falls from `gate` to half of it, and are zero, exactly, where none is that near.
    """

    velocity: NonNegative = 0.0  # m/s, the most of each component
    shield: NonNegative = 0.0  # s; 0: the policy is trusted
    caution: Positive = 1.0  # how much the shield makes of risks, over what the controller does
    room: NonNegative = 0.0  # m from a team mate's origin: nearer than half of it nothing is corrected
    share: Annotated[float, Field(ge=0, le=2)] = 0.0  # of the range of actions
    gate: Positive | None = None  # m
