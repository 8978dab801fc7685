"""Residual policies: a policy corrects the velocity command of its team's classical controller (`ResidualConfig`)."""

from collections.abc import Mapping
from typing import Annotated, Any, cast

import torch
from torch import Tensor

from rl.guidance.avoidance import Shield, SlotController, Wanted
from rl.guidance.knowledge import Knowledge
from rl.perception.sensors import Obstacle
from rl.step import Due
from rl.team import Controller, Team
from taichi_sim.config import ConfigError, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible


class ResidualConfig(Strict):
    """A residual policy corrects the classical controller instead of acting alone.

    It corrects the controller's desired velocity, ahead and to starboard along the target's course, after evasion.
    The `shield` reduces a correction where the risk that it adds within that time is greater than its size
    (avoidance.py): no correction then leads into an obstacle that is sensed. With a `gate`, corrections fade in as the
    gap to an obstacle falls from `gate` to half of it, and are exactly zero where no obstacle is within `gate`.
    """

    # the largest correction of each component; 0: the policy acts alone
    velocity: Annotated[NonNegative, Plausible(0.02, 50.0, "m/s")] = 0.0
    shield: Annotated[NonNegative, Plausible(0.1, 600.0, "s")] = 0.0  # s; 0: no shield
    gate: Annotated[Positive, Plausible(0.5, 5000.0, "m")] | None = None


CORRECTIONS = ("velocity ahead (correction)", "velocity to starboard (correction)")


class ResidualTeam(Team):
    """Adds a residual policy's corrections to the commands of the classical controller.

    A mission derives its team from this class and gives:

    axes: of velocities, 2 of vessels or 3 of aircraft. radius: of a vehicle, m. known: the input of the controller; the
        gate uses its `sensor.obstacles`. written, write: its observations.
    """

    axes: int
    radius: float
    written: Mapping[str, int]
    """Terms of its observations and their widths, in order."""

    def __init__(self, mission: Any, name: str):
        """Make team `name`; its controller is made when it is first needed."""
        super().__init__(mission, name)
        self._wanted: Wanted | None = self.scratch(None)
        self.ordered = self.scratch(None)
        self._shield: Shield | None = None

    @property
    def known(self) -> Knowledge:
        """What the vehicles know."""
        return cast(Knowledge, self)

    def truth(self, due: Due) -> None:
        """Drop the controller's demand, for the world has moved."""
        self._wanted = None

    def conclude(self, due: Due) -> None:
        """Drop the controller's demand, for the vehicles know more."""
        self._wanted = None

    def restored(self) -> None:
        """Drop the controller's demand after a snapshot was restored."""
        self._wanted = None

    def write(self) -> Tensor:
        """Write the terms of `written` into one fresh tensor [env, vehicle, n]."""
        raise NotImplementedError(f"{type(self).__name__}.write")

    def observe(self) -> dict[str, Tensor]:
        """The terms of `written`, as views of one tensor."""
        widths = self.written
        return dict(zip(widths, self.write().split(list(widths.values()), dim=-1), strict=True))

    @property
    def _as_written(self) -> bool:
        """Whether neither a derived class nor the scenario changes what is observed: it is one tensor already."""
        return type(self).observe is ResidualTeam.observe and self.section.observe is None

    def observations_now(self) -> Tensor:
        """Compute `observations`, a fresh tensor."""
        return self.write() if self._as_written else super().observations_now()

    @property
    def layout(self) -> Mapping[str, int]:
        """Terms of the observations and their widths, in order."""
        return self.written if self._as_written else super().layout

    @property
    def uses_controller(self) -> bool:
        """Whether the controller has been made, or is corrected."""
        return super().uses_controller or self.residual is not None

    @property
    def residual(self) -> ResidualConfig | None:
        """Configuration of the residual policy; None if the policy acts alone."""
        residual = self.section.residual
        return residual if residual is not None and residual.velocity > 0 else None

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's outputs, each in [-1, 1]: the vehicle's actions, or corrections."""
        return super().action_names if self.residual is None else CORRECTIONS

    def commanded(self, action: Tensor) -> Tensor:
        """Vehicle actions: the policy's own, or the classical controller's with its corrections."""
        residual = self.residual
        if residual is None:
            return action
        correction = action
        if residual.gate is not None:
            correction = correction * self._opened(residual.gate).unsqueeze(-1)
        wanted, pushed = self.wanted, self.pushed(residual.velocity * correction)
        if self._shield is None:
            velocity = wanted.velocity + pushed
        else:
            velocity = self._shield(self.known, wanted.velocity, pushed)
        self.ordered = velocity
        return self.corrected.act(self.known, wanted._replace(velocity=velocity))

    @property
    def plan_names(self) -> tuple[str, ...]:
        """Names of the corrections in a plan: of the classical velocity command, along and to starboard of the course,
        m/s; of the vehicle's actions if the controller commands no velocity.
        """
        return CORRECTIONS if isinstance(self.controller, SlotController) else super().plan_names

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Vehicle actions of the classical controller, whose velocity is corrected; see Team.planned."""
        if not isinstance(self.controller, SlotController):
            return super().planned(correction, known)
        view = cast(Knowledge, self if known is None else known)
        wanted = self.corrected.wanted(view)
        return self.corrected.act(view, wanted._replace(velocity=wanted.velocity + self.pushed(correction)))

    def _opened(self, gate: float) -> Tensor:
        """Share [env, vehicle] of a correction that the `gate` (m) lets through."""
        nearest = self.known.sensor.obstacles[..., 0, :]
        opened = (2 - (nearest[..., Obstacle.DISTANCE] - self.radius) * (2 / gate)).clamp(0.0, 1.0)
        return opened * (nearest[..., Obstacle.NUMBER] >= 0)  # no obstacle is sensed: the gate is closed

    @property
    def in_effect(self) -> Tensor:
        """Where the gate lets corrections through, bool [env, vehicle]."""
        residual = self.residual
        return super().in_effect if residual is None or residual.gate is None else self._opened(residual.gate) > 0

    def pushed(self, along: Tensor) -> Tensor:
        """Rotate `along` [env, vehicle, 2], along and to starboard of the course, to NED [env, vehicle, axes] (m/s)."""
        c, s = self.known.target.cos, self.known.target.sin
        ahead, aside = along.unbind(-1)
        level = (torch.zeros_like(ahead),) * (self.axes - 2)
        return torch.stack((c * ahead - s * aside, s * ahead + c * aside, *level), dim=-1)

    @property
    def controller(self) -> Controller | None:
        """The classical controller of the team."""
        residual = self.residual
        if self._controller is None and residual is not None:
            found = super().controller
            if not isinstance(found, SlotController):
                raise ConfigError(
                    f"{self.name}.residual: there is no classical controller to correct for "
                    f"{self.name}.vehicle = {self.section.vehicle!r}"
                )
            if residual.shield:
                self._shield = Shield(found.gains.model_copy(update={"horizon": residual.shield}))
        return super().controller

    @property
    def corrected(self) -> SlotController:
        """The classical controller, whose velocity command is corrected."""
        return cast(SlotController, self.controller)

    @property
    def wanted(self) -> Wanted:
        """The classical controller's demand now."""
        if self._wanted is None:
            self._wanted = self.corrected.wanted(self.known)
        return self._wanted

    @property
    def reference_width(self) -> int:
        """Axes of `reference`; 0 if the policy acts alone."""
        return 0 if self.residual is None else self.axes

    def reference(self) -> Tensor | None:
        """The velocity command [env, vehicle, axes] (NED, m/s) that the policy corrects; None if it acts alone."""
        return None if self.residual is None else self.wanted.velocity
