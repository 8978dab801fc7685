"""Rewards: one function for each term, and the terms of each team with their weights. Every term is [env, vehicle]."""

from typing import Protocol

from torch import Tensor

from rl.guidance.rewards import clear, coarse, ending, near, nearest, steady
from rl.terms import Term
from taichi_sim.config import Positive


class RewardedBoats(Protocol):
    """What the boats' terms read, too; tensors are [env, boat]."""

    before: Tensor  # the distance a decision ago, m
    interval: float  # of a decision, s

    @property
    def distance(self) -> Tensor:
        """Distance from the slot, m."""
        ...


class RewardedAircraft(Protocol):
    """What the aircraft's terms read, too; tensors are [env, aircraft]."""

    in_range: Tensor
    gap_error: Tensor
    distance: Tensor

    @property
    def sees(self) -> Tensor:
        """Whether each camera saw the vessel."""
        ...

    @property
    def boats_result(self) -> Tensor:
        """How near the boats are to their slots, [env]."""
        ...


def closing_rate(before: Tensor, now: Tensor, interval: float) -> Tensor:
    """Rate at which a distance falls, m/s."""
    return (before - now) / interval


def closing(team: RewardedBoats, scale: Positive = 2.0) -> Tensor:
    """Rate at which the distance from the slot about the vessel falls, over `scale` (m/s)."""
    return closing_rate(team.before, team.distance, team.interval) * (1 / scale)


def view(team: RewardedAircraft) -> Tensor:
    """1 where its own camera sees the vessel."""
    return team.sees.to(team.distance.dtype)


def any_view(team: RewardedAircraft) -> Tensor:
    """1 where any camera of the team sees the vessel."""
    return team.sees.any(-1, keepdim=True).to(team.distance.dtype).expand_as(team.distance)


def radio(team: RewardedAircraft) -> Tensor:
    """Share of the boats within radio range."""
    return team.in_range


def phases(team: RewardedAircraft, scale: Positive = 0.5) -> Tensor:
    """exp(-(gap error / scale)^2), rad, to those ahead and behind on the circle."""
    return coarse(team.gap_error, scale)


def boats(team: RewardedAircraft) -> Tensor:
    """Share in the boats' result: mean of 1 / (1 + (d / 8 m)^2)."""
    return team.boats_result.unsqueeze(-1).expand_as(team.distance)


BOAT_TERMS = {
    "closing": Term(closing, 1.0),
    "coarse": Term(near, 1.0, {"scale": 8.0}),
    "fine": Term(nearest, 1.0, {"scale": 1.0}),
    "action_rate": Term(steady, 0.02),
    "clearance": Term(clear, 0.5, {"range": 2.0}),
    "ending": Term(ending, 200.0),
}
"""Terms of boats (boats.py)."""

AIRCRAFT_TERMS = {
    "view": Term(view, 1.0),
    "any_view": Term(any_view, 1.0),
    "radio": Term(radio, 0.5),
    "phases": Term(phases, 0.5),
    "circle": Term(nearest, 0.5, {"scale": 20.0}),
    "boats": Term(boats, 0.5),
    "action_rate": Term(steady, 0.02),
    "clearance": Term(clear, 0.5, {"range": 15.0}),
    "ending": Term(ending, 200.0),
}
"""Terms of aircraft (aircraft.py)."""
