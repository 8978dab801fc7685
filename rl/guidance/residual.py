"""A team whose policy may correct the classical controller instead of acting alone (config.ResidualConfig)."""

from typing import Any

import torch
from torch import Tensor

from rl.guidance.avoidance import Shield
from rl.guidance.config import ResidualConfig
from rl.guidance.knowledge import Knowledge
from rl.mission import Mission, Team
from rl.perception.columns import Mate, Obstacle
from taichi_sim.config import ConfigError

CHANGE_SCALE = 3.0  # m/s, where a squashed change of velocity is half way to 1


class ResidualTeam(Team):
    """What a controller wants, and what of it the policy changes. A mission's own team derives from it, and gives:

    axes: of velocities, 2 of vessels or 3. radius: of a vehicle, m. known: the input of the controller; the gate uses
    its
        `sensor.obstacles`, the room its `sensor.team_mates`.
    """

    STATE = ()

    axes: int
    radius: float
    known: Knowledge

    def __init__(self, mission: Mission, name: str):
        """Of team `name`; the controller is asked for when it is first needed."""
        super().__init__(mission, name)
        self._wanted: Any = None
        self._shield: Any = None

    def forget(self) -> None:
        """The world has moved: what was wanted is no longer."""
        self._wanted = None

    def restored(self) -> None:
        """Another state: what was wanted in the last one is not wanted in this."""
        self.forget()

    @property
    def _in_use(self) -> Any:
        """The controller, whose memory is state, where it has been used or is corrected."""
        return self._controller if self.residual is None else self.controller

    @property
    def residual(self) -> ResidualConfig | None:
        """How its policy corrects the classical controller; None if it acts alone."""
        residual = self.section.residual
        return residual if residual is not None and (residual.share > 0 or residual.velocity > 0) else None

    @property
    def action_names(self) -> tuple[str, ...]:
        """What its policy commands, each in [-1, 1]: the vehicle's actions, or corrections."""
        names = super().action_names
        if self.residual is None:
            return names
        velocity = ("velocity ahead (correction)", "velocity to starboard (correction)")
        actions = tuple(f"{name} (correction)" for name in names)
        return (velocity if self.residual.velocity else ()) + (actions if self.residual.share else ())

    def command(self, action: Tensor) -> Tensor:
        """The vehicles' actions: the policy's, or the classical ones that they correct (config.ResidualConfig)."""
        residual = self.residual
        if residual is None:
            return action
        correction = action.clamp(-1.0, 1.0) + 0.0 * action  # what is not finite stays so
        if residual.gate is not None:
            correction = correction * self._opened(residual.gate).unsqueeze(-1)
        mates = self.known.sensor
        if residual.room and mates.num_mates:
            nearest = mates.team_mates[..., Mate.DISTANCE].amin(-1, keepdim=True)
            correction = correction * (nearest * (2 / residual.room) - 1).clamp(0.0, 1.0)
        wanted = self.wanted
        if residual.velocity:
            pushed = self.pushed(residual.velocity * correction[..., :2])
            velocity = wanted.velocity + pushed
            if residual.shield:
                velocity = self._shield.corrected(self.known, wanted.velocity, pushed)
            wanted, correction = wanted._replace(velocity=velocity), correction[..., 2:]
        actions = self.controller.act(self.known, wanted)
        return (actions + residual.share * correction if residual.share else actions).clamp(-1.0, 1.0)

    def _opened(self, gate: float) -> Tensor:
        """The share of corrections [env, vehicle] that an obstacle nearer than `gate` (m) lets through."""
        nearest = self.known.sensor.obstacles[..., 0, :]
        opened = (2 - (nearest[..., Obstacle.DISTANCE] - self.radius) * (2 / gate)).clamp(0.0, 1.0)
        return opened * (nearest[..., Obstacle.NUMBER] >= 0)  # none is seen: none is near

    @property
    def in_effect(self) -> Tensor:
        """Where corrections pass the gate, bool [env, vehicle]."""
        residual = self.residual
        return super().in_effect if residual is None or residual.gate is None else self._opened(residual.gate) > 0

    def pushed(self, along: Tensor) -> Tensor:
        """A velocity [env, vehicle, axes] (m/s, NED) of one [env, vehicle, 2] along and to starboard of the course."""
        c, s = self.known.target.cos, self.known.target.sin
        ahead, aside = along.unbind(-1)
        level = (torch.zeros_like(ahead),) * (self.axes - 2)
        return torch.stack((c * ahead - s * aside, s * ahead + c * aside, *level), dim=-1)

    @property
    def controller(self) -> Any:
        """The classical controller that its policy corrects.

        Raises:
            ConfigError: if there is none to correct.
        """
        if self._controller is None and self.residual is not None:
            found = super().controller
            if not hasattr(found, "wanted"):
                raise ConfigError(
                    f"{self.name}.residual: there is no classical controller to correct for "
                    f"{self.name}.vehicle = {self.section.vehicle!r}"
                )
            if self.residual.shield:
                self._shield = Shield(self._cautious(found.gains, self.residual))
        return super().controller

    @staticmethod
    def _cautious(gains: Any, residual: ResidualConfig) -> Any:
        """The numbers that the shield judges by."""
        risks = {"soft": residual.caution * gains.soft, "hard": residual.caution * gains.hard}
        return gains.model_copy(update={"horizon": residual.shield} | risks)

    @property
    def wanted(self) -> Any:
        """What the classical controller wants to be done now."""
        if self._wanted is None:
            self._wanted = self.controller.wanted(self.known)
        return self._wanted

    @property
    def reference_width(self) -> int:
        """Number of values of `reference`; 0 if the policy acts alone."""
        if self.residual is None:
            return 0
        return self.axes if self.residual.velocity else len(self.fleet.model.action_names)

    def reference(self) -> Tensor | None:
        """Observation of what the policy corrects; None if it acts alone.

        It is the desired change of velocity in the vehicle's frame [env, vehicle, axes], squashed; or the classical
        actions, if the policy corrects only these.
        """
        if self.residual is None:
            return None
        if not self.residual.velocity:
            return self.controller.act(self.known, self.wanted)
        fleet, change = self.known.fleet, self.wanted.velocity - self.known.fleet.velocity_n[..., : self.axes]
        if self.axes == 3:
            own = (change.unsqueeze(-2) @ fleet.R_nb).squeeze(-2)
        else:
            c, s = fleet.heading
            north, east = change.unbind(-1)
            own = torch.stack((c * north + s * east, c * east - s * north), dim=-1)
        return own / (own.abs() + CHANGE_SCALE)
