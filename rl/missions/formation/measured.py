"""What the vehicles of a team know: what policies and classical controllers see instead of the truth.

It is the truth itself where the scenario has neither `[sensors]` nor `[radio]`. Rewards, endings and figures are of the
truth always. Everybody knows the target and the formation: they are the plan.
"""

from typing import Any

import torch
from torch import Tensor

from rl.guidance.geometry import Geometry
from rl.perception.contacts import Contacts
from rl.perception.instruments import Readings
from rl.perception.radio import Radio

MOST = 64  # vehicles of a team, among the random numbers


class Measured:
    """One team's knowledge; what is not here is as in the team (team.py).

    Attributes:
        fleet: state as measured (rl/perception/instruments.py). now: errors as far as known (geometry.py). sensor:
            obstacles and team mates as measured (rl/perception/contacts.py). radio: what has been heard
            (rl/perception/radio.py), or None.
    """

    STATE = ("fleet", "now", "sensor", "radio")

    def __init__(self, team: Any, number: int):
        """Of `team`, the `number`-th of its mission, which has begun to follow its target."""
        config, interval = team.mission.config, team.mission.config.decision_interval
        self._team, self._count = team, team.mission.noise.table
        own = number * MOST
        exact, true = config.sensors.exact, team.sensor
        self.fleet = team.fleet if exact else Readings(team.fleet, config.sensors, interval, own)
        self.radio = None
        if config.radio is not None:
            self.radio = Radio(config.radio, team.fleet.state, interval, vehicles=own)
        heard = None if self.radio is None else self.radio.heard
        down, slots = team.down, team.slots.table
        self.now: Geometry = team.now
        if not exact or heard is not None:
            self.now = Geometry(self.fleet, team.targets.table, down, slots, team.axes, heard)
        self.sensor = true
        contacts = config.sensors.scaled_contacts
        if not (exact and contacts.exact):
            self.sensor = Contacts(contacts, true, team.fleet, self.fleet, interval, own)

    def __getattr__(self, name: str) -> Any:
        """What is not known otherwise is known as it is."""
        return getattr(self._team, name)

    def measure(self, which: Tensor, rows: int, steps: Tensor) -> None:
        """After the truth has been measured; see `Geometry.measure`."""
        if isinstance(self.fleet, Readings):
            self.fleet.read(which, rows, self._count)
        if self.radio is not None:
            torch.cat((self.fleet.position_n, self.fleet.velocity_n), dim=-1, out=self.radio.said)
            self.radio.talk(which, rows, steps, self._count)
        if self.now is not self._team.now:
            self.now.measure(which, rows)
        if isinstance(self.sensor, Contacts):
            self.sensor.update(which, rows, steps, self._count)
