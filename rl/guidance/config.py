"""Configuration of residual policies, `[TEAM.residual]`."""

from pydantic import model_validator

from taichi_sim.config import NonNegative, Positive, Strict


class ResidualConfig(Strict):
    """A residual policy corrects the classical controller instead of acting alone.

    It corrects the controller's desired velocity, ahead and to starboard along the target's course, after evasion. The
    `shield` reduces a correction where the risk of bodies within that time is greater than the
    correction is worth (avoidance.py): no correction then leads into an obstacle that is sensed. Corrections fade out
    where a team mate is nearer than `room`, to zero at half of it: two vehicles that both corrected, each expecting the
    other to go straight on, collided more often than two that did not. With a `gate`, corrections fade in as the gap to
    an obstacle falls from `gate` to half of it, and are exactly zero where no obstacle is within `gate`.
    """

    velocity: NonNegative = 0.0  # m/s, the most of each component; 0: the policy acts alone
    shield: NonNegative = 0.0  # s; 0: no shield
    caution: Positive = 1.0  # weight of the risks in the shield, relative to the controller's
    room: NonNegative = 0.0  # m from a team mate's origin: no correction below half of it
    gate: Positive | None = None  # m

    @model_validator(mode="before")
    @classmethod
    def _without_share(cls, data: object) -> object:
        """Accept files of earlier versions, whose `share` of 0 corrected no actions."""
        if not isinstance(data, dict) or "share" not in data:
            return data
        if data["share"]:
            raise ValueError("share: actions are not corrected any more; `velocity` corrects the controller's velocity")
        return {key: value for key, value in data.items() if key != "share"}
