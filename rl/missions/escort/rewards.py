"""Rewards: weights, one function for each term, and the terms of each team. Every term is [env, vehicle]."""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from rl.guidance.rewards import action_rate, clearance, coarse, fine, penalty
from rl.perception.sensors import Sensor
from rl.step import Endings
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.fleet import Fleet


class EscortBoatReward(Strict):
    """Weights and scales of a boat's terms; d is its distance from its slot about the vessel, m."""

    closing: NonNegative = 1.0  # -d(d)/dt / closing_scale
    closing_scale: Positive = 2.0  # m/s
    coarse: NonNegative = 1.0  # exp(-(d / coarse_scale)^2)
    coarse_scale: Positive = 8.0  # m
    fine: NonNegative = 1.0  # 1 / (1 + (d / fine_scale)^2)
    fine_scale: Positive = 1.0  # m
    action_rate: NonNegative = 0.02  # -|a - a_previous|^2
    clearance: NonNegative = 0.5  # -(1 - gap / clearance_range)^2 inside the range
    clearance_range: Positive = 2.0  # m
    ending: NonNegative = 200.0  # -1 at a collision, or any other early ending


class EscortAircraftReward(Strict):
    """Weights and scales of an aircraft's terms."""

    view: NonNegative = 1.0  # its own camera sees the vessel
    any_view: NonNegative = 1.0  # any camera of the team sees the vessel
    radio: NonNegative = 0.5  # share of boats within radio range
    phases: NonNegative = 0.5  # exp(-(gap error / phase_scale)^2) to those ahead and behind on the circle
    phase_scale: Positive = 0.5  # rad
    circle: NonNegative = 0.5  # 1 / (1 + (e / circle_scale)^2), e from the circle and its height
    circle_scale: Positive = 20.0  # m
    boats: NonNegative = 0.5  # share in the boats' result: mean of 1 / (1 + (d / 8 m)^2)
    action_rate: NonNegative = 0.02
    clearance: NonNegative = 0.5
    clearance_range: Positive = 15.0  # m
    ending: NonNegative = 200.0


def closing(before: Tensor, now: Tensor, interval: float) -> Tensor:
    """Rate at which a distance falls, m/s."""
    return (before - now) / interval


class Rewarded(Protocol):
    """What terms of both teams read; tensors are [env, vehicle, ...]."""

    fleet: Fleet
    action: Tensor
    previous_action: Tensor
    sensor: Sensor

    @property
    def distance(self) -> Tensor:
        """Distance from the slot or the circle, m."""
        ...


class RewardedBoats(Rewarded, Protocol):
    """What the boats' terms read, too."""

    before: Tensor  # the distance a decision ago, m
    interval: float  # of a decision, s


class RewardedAircraft(Rewarded, Protocol):
    """What the aircraft's terms read, too."""

    in_range: Tensor
    gap_error: Tensor

    @property
    def sees(self) -> Tensor:
        """Whether each camera saw the vessel."""
        ...

    @property
    def boats_result(self) -> Tensor:
        """How near the boats are to their slots, [env]."""
        ...


BOAT_TERMS: dict[str, Callable[[RewardedBoats, Endings, EscortBoatReward], Tensor]] = {
    "closing": lambda team, ended, w: closing(team.before, team.distance, team.interval) * (1 / w.closing_scale),
    "coarse": lambda team, ended, w: coarse(team.distance, w.coarse_scale),
    "fine": lambda team, ended, w: fine(team.distance, w.fine_scale),
    "action_rate": lambda team, ended, w: action_rate(team.action, team.previous_action),
    "clearance": lambda team, ended, w: clearance(team.sensor.gap, w.clearance_range),
    "ending": lambda team, ended, w: penalty(ended.any),
}
"""A weight's name -> its term, of boats (boats.py), their endings, and the weights."""

AIRCRAFT_TERMS: dict[str, Callable[[RewardedAircraft, Endings, EscortAircraftReward], Tensor]] = {
    "view": lambda team, ended, w: team.sees.to(team.distance.dtype),
    "any_view": lambda team, ended, w: team.sees.any(-1, keepdim=True).to(team.distance.dtype).expand_as(team.distance),
    "radio": lambda team, ended, w: team.in_range,
    "phases": lambda team, ended, w: coarse(team.gap_error, w.phase_scale),
    "circle": lambda team, ended, w: fine(team.distance, w.circle_scale),
    "boats": lambda team, ended, w: team.boats_result.unsqueeze(-1).expand_as(team.distance),
    "action_rate": lambda team, ended, w: action_rate(team.action, team.previous_action),
    "clearance": lambda team, ended, w: clearance(team.sensor.gap, w.clearance_range),
    "ending": lambda team, ended, w: penalty(ended.any),
}
"""A weight's name -> its term, of aircraft (aircraft.py), their endings, and the weights."""
