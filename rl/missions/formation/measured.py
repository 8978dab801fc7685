"""Measured knowledge of a formation: the input of policies and classical controllers in place of the truth.

Rewards, endings and figures always use the truth. Target and formation are the plan, which every vehicle knows exactly.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.guidance.geometry import Geometry, SlotErrors
from rl.perception.contacts import TrackedContacts
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby
from taichi_sim.fleet import Fleet

if TYPE_CHECKING:
    from rl.missions.formation.team import TeamTask


class MeasuredFormation:
    """One team's measured knowledge (rl/guidance/knowledge.py); parts without errors are those of the team itself."""

    STATE = ("fleet", "now", "sensor", "radio")

    def __init__(self, team: "TeamTask", down: float):
        """Measure for `team`, whose target is at `down` (m)."""
        mission = team.mission
        config, interval = mission.config, mission.config.decision_interval
        number = config.first_number(team.name)
        exact, contacts = config.sensors.exact, config.sensors.scaled_contacts
        self.axes, self.radius = team.axes, team.radius
        self.target, self.slot_table = team.target, team.slot_table
        self._team, self._count = team, mission.noise.table
        self.fleet: Fleet | Readings = team.fleet if exact else Readings(team.fleet, config.sensors, interval, number)
        self.radio = None if config.radio is None else Radio(config.radio, team.fleet.state, interval, vehicles=number)
        self.now: SlotErrors = team.now
        if not exact or self.radio is not None:
            heard = None if self.radio is None else self.radio.heard
            self.now = Geometry(self.fleet, team.target.table, down, team.slot_table, team.axes, heard)
        self.sensor: Nearby = team.sensor
        if not (exact and contacts.exact):
            self.sensor = TrackedContacts(contacts, team.sensor, team.fleet, self.fleet, interval, number)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def measure(self, which: Tensor, rows: int) -> None:
        """Measure after the truth has been measured; arguments as of `Geometry.measure`."""
        if isinstance(self.fleet, Readings):
            self.fleet.read(which, rows, self._count)
        if self.radio is not None:
            torch.cat((self.fleet.position_n, self.fleet.velocity_n), dim=-1, out=self.radio.said)
            self.radio.talk(which, rows, self.steps, self._count)
        if isinstance(self.now, Geometry) and self.now is not self._team.now:
            self.now.measure(which, rows)
        if isinstance(self.sensor, TrackedContacts):
            self.sensor.update(which, rows, self.steps, self._count)
