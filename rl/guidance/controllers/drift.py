"""Drift of a team: the velocity over ground that compensates current, wind and sway, added to the desired one.

It is the integral of the position error, z' = k_i e, in n, where a current is constant whatever way the hull turns. So
that it does not wind up, it waits while the hull cannot follow its command or is farther off than a drift explains, and
it is limited. Far from a slot that itself may be anywhere, the course over ground is held instead: the integral of the
velocity's error to the side of what is wanted, the integral action of line-of-sight guidance (Børhaug, Pavlov &
Pettersen 2008, IEEE CDC, eq. 7, in terms of velocities). An episode begins without a drift, whatever was before it.
"""

import torch
from torch import Tensor

COURSE_TIME = 8.0  # s of the integral of the course error; assumed
COURSE_ERROR = 0.5  # its sine: greater ones are turns; assumed
DRIFT_SHARE = 0.2  # of the top speed, the most that is believed; assumed


class Drift:
    """The integral of each vehicle of a team; made anew where the team's shape changes."""

    STATE = ("place", "moved", "value", "given")

    def __init__(self, k_i: float, top_speed: float, interval: float):
        """`k_i` 1/s^2, `top_speed` m/s, `interval` s."""
        self.interval, self.step, self.most = interval, k_i * interval, DRIFT_SHARE * top_speed
        self.place: Tensor | None = None  # as are the others, before the first decision
        self.moved: Tensor | None = None
        self.value: Tensor | None = None
        self.given: Tensor | None = None

    def at(self, position: Tensor, begins: Tensor) -> Tensor:
        """The drift [env, vehicle, 2] (m/s) of vehicles now at `position` [env, vehicle, 2] (m), in environments where
        no episode `begins` [env].
        """
        place, value, given = self.place, self.value, self.given
        if place is None or value is None or given is None or place.shape != position.shape:
            place, value = position, torch.zeros_like(position)
            given = value
        fresh = begins.view(-1, 1, 1)
        self.value = torch.where(fresh, 0.0, value)
        self.moved = ~fresh & (position != place).any(-1, keepdim=True)
        self.given = torch.where(self.moved | fresh, self.value, given)  # or asked again about the same moment
        self.place = position.clone()
        return self.given

    def learn(self, error: Tensor, able: Tensor) -> None:
        """Integrate `error` [env, vehicle, 2] (m) of those who are `able` [env, vehicle, 1] to follow."""
        self._add(self.step * error, able)

    def correct(self, wanted: Tensor, velocity: Tensor, able: Tensor) -> None:
        """Integrate what of `velocity` [env, vehicle, 2] (m/s) is to the side of what is `wanted` of those who are
        `able` [env, vehicle, 1] to make way.
        """
        speed = wanted.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        side = torch.stack((-wanted[..., 1], wanted[..., 0]), dim=-1) / speed
        off = (velocity * side).sum(-1, keepdim=True)
        steady = off.abs() < COURSE_ERROR * velocity.norm(dim=-1, keepdim=True)
        self._add(-self.interval / COURSE_TIME * off * side, able & steady)

    def _add(self, change: Tensor, able: Tensor) -> None:
        assert self.value is not None and self.moved is not None, "`at` comes first"
        value = self.value + change
        value = value * (self.most / value.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
        self.value = torch.where(able & self.moved & value.isfinite(), value, self.value)
