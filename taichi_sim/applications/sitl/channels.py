"""From servo pulse widths to a vehicle's actions.

| vehicle | channels, as ArduPilot numbers them by default |
|---|---|
| vessel | 1 helm (high: to starboard), 3 ahead (middle: stopped) |
| vessel of two propellers, actions = "left_right" | 1 left, 3 right (skid steering: ThrottleLeft, ThrottleRight) |
| fixed wing | 1 aileron (high: rolls right), 2 elevator (high: nose up), 3 throttle, 4 rudder (high: nose right) |
| multirotor | 1, 2 ... the rotors, in the order of the vehicle file: speed from omega_min to omega_max |

Pulse widths from `low` to `high` give -1 to 1 for controls with a middle position, and 0 to 1 for throttles and rotors.
A width of 0 (no output) gives 0.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.models.catalogue import Changes
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.vehicle import Vehicle

PWM = (1000, 2000)  # lowest and highest pulse width of ArduPilot's SITL, microseconds

MOST_ROTORS = 12
FUNCTIONS: Mapping[str, int] = {
    "helm": 26, "ahead": 70, "left": 73, "right": 74, "aileron": 4, "elevator": 19, "throttle": 70, "rudder": 21,
    **{f"rotor_{k + 1}": (33 if k < 8 else 74) + k for k in range(MOST_ROTORS)},
}  # fmt: skip
"""ArduPilot's SERVOn_FUNCTION of a control."""
FRAMES: Mapping[int, int] = {4: 1, 6: 2, 8: 3, 12: 12}
"""ArduCopter's FRAME_CLASS for a number of rotors; with 0 it drives none."""
RESTS = 0.25, 0.5  # largest share of an output at rest: of throttles and rotors, of controls with a middle; assumed

DIRECT: Mapping[type, Changes] = {
    FixedWingParams: {"autopilot": {"actions": "surfaces"}},
    MultirotorParams: {"control": {"actions": "rotors"}},
}
"""Changes of a vehicle file that make its actions its actuators: parameters -> section -> key -> value."""


def changes_for(model: Vehicle) -> Changes:
    """Changes of the vehicle file that let an autopilot command the actuators: section -> key -> value."""
    return DIRECT.get(type(model.params), {})


def default_channels(model: Vehicle) -> dict[str, int]:
    """Default channels: control -> channel, negative if a high pulse width gives a negative control."""
    if isinstance(model, Vessel):
        if model.action_names == ("left", "right"):
            return {"left": 1, "right": 3}
        if model.steer(0.0, 0.0) is not None:
            return {"helm": 1, "ahead": 3}
        return {name: k + 1 for k, name in enumerate(model.action_names)}
    if isinstance(model.params, FixedWingParams):
        return {"aileron": 1, "elevator": -2, "throttle": 3, "rudder": -4}
    if isinstance(model.params, MultirotorParams):
        return {name: k + 1 for k, name in enumerate(model.action_names)}
    raise ConfigError(f"an autopilot cannot drive a {type(model).__name__}: it has no actuators of its own")


def read_channels(text: str, model: Vehicle) -> dict[str, int]:
    """Channels from NAME=CHANNEL,... in `text`, over the defaults; -CHANNEL reverses the control."""
    found = default_channels(model)
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\w+)\s*=\s*(-?\d+)\s*", part)
        if match is None or not 1 <= abs(int(match[2])) <= 32:
            raise ConfigError(
                f"--channels {part!r}: expected NAME=CHANNEL, channels 1 to 32, for example helm=1,ahead=-3"
            )
        if match[1] not in found:
            raise ConfigError(f"--channels {match[1]}: this vehicle has {', '.join(found)}")
        found[match[1]] = int(match[2])
    return found


class Mixer:
    """Turns pulse widths into the actions of one vehicle."""

    def __init__(self, model: Vehicle, channels: Mapping[str, int], pwm: tuple[float, float] = PWM):
        """Take `model`, whose actions must be its actuators (`changes_for`)."""
        self.model, self.channels, self.low, self.high = model, dict(channels), *pwm
        self.one_sided = {"throttle"} | set(model.action_names if isinstance(model.params, MultirotorParams) else ())

    def share(self, name: str, pwm: tuple[int, ...]) -> float:
        """Value of the control `name`: -1 to 1, or 0 to 1 for throttles and rotors."""
        channel = self.channels[name]
        width = pwm[abs(channel) - 1] if abs(channel) <= len(pwm) else 0
        if name in self.one_sided:
            return min(max((width - self.low) / (self.high - self.low), 0.0), 1.0) if width else 0.0
        middle = 0.5 * (self.low + self.high)
        x = min(max((width - middle) / (self.high - middle), -1.0), 1.0) if width else 0.0
        return -x if channel < 0 else x

    def strange(self, pwm: tuple[int, ...]) -> list[str]:
        """What an autopilot at rest would not send to this vehicle, in one sentence with the functions it should have;
        empty for the autopilot of such a vehicle.

        An autopilot sends no functions. At rest, controls with a middle are near it, throttles and rotors near zero.
        """
        known = {name: channel for name, channel in self.channels.items() if name in FUNCTIONS}
        found, frame = list[str](), ""
        for name, channel in known.items():
            width = pwm[abs(channel) - 1] if abs(channel) <= len(pwm) else 0
            if not width or abs(self.share(name, pwm)) > RESTS[name not in self.one_sided]:
                found.append(f"output {abs(channel)} ({name}) is {f'at {width} us' if width else 'not driven'}")
        if isinstance(self.model.params, MultirotorParams):
            idle = self.low + RESTS[0] * (self.high - self.low)
            taken = {abs(channel) for channel in self.channels.values()}
            more = [n for n, width in enumerate(pwm[:MOST_ROTORS], 1) if n not in taken and 0 < width <= idle]
            found += [f"output {n} drives a rotor that is not there" for n in more]
            frame = f"FRAME_CLASS {FRAMES.get(len(known), 'of its rotors')} (0 drives no rotor), "
        if not found:
            return []
        needed = frame + ", ".join(
            f"SERVO{abs(channel)}_FUNCTION {FUNCTIONS[name]} ({name})" for name, channel in known.items()
        )
        return [f"is driven by an autopilot of another vehicle, it seems: {'; '.join(found)}. This one needs {needed}"]

    def actions(self, pwm: tuple[int, ...]) -> NDArray[np.float64]:
        """Actions [action] for the pulse widths `pwm` (microseconds)."""
        shares = {name: self.share(name, pwm) for name in self.channels}
        model: Any = self.model
        if "helm" in shares:
            ahead = shares["ahead"] if model.backs else max(shares["ahead"], 0.0)
            return model.steer(ahead, shares["helm"])
        if isinstance(model.params, FixedWingParams):
            lower, upper = (np.array(x) for x in (model.p.actuators.lower, model.p.actuators.upper))
            names = ("elevator", "aileron", "rudder")
            wanted = [shares[n] * (upper[k] if shares[n] > 0 else -lower[k]) for k, n in enumerate(names)]
            wanted.append(lower[3] + shares["throttle"] * (upper[3] - lower[3]))
            return model.action(torch.tensor(wanted, dtype=torch.float64)).numpy().clip(-1.0, 1.0)
        if isinstance(model.params, MultirotorParams):
            rotor = model.plan.rotor
            speeds = [rotor.omega_min + shares[n] * (rotor.omega_max - rotor.omega_min) for n in model.action_names]
            return model.action(torch.tensor(speeds, dtype=torch.float64)).numpy().clip(-1.0, 1.0)
        return np.array([shares[name] for name in model.action_names])
