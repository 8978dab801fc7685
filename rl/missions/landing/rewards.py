"""Rewards: one function for each term, and the terms of each team with their weights. Every term is [env, vehicle]."""

import math
from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.rewards import coarse, penalty, steady
from rl.step import Endings
from rl.terms import Term
from taichi_sim.config import Positive
from taichi_sim.fleet import Fleet


def touchdown(
    settling: Tensor, error: Tensor, speed: Tensor, tilt: Tensor, scales: tuple[float, float, float]
) -> Tensor:
    """Reward of a touchdown when all soles are down: at most 1; `scales` of error, speed and tilt (m, m/s, deg).

    `error` (m, from the deck's middle) and `tilt` (rad, to the deck) are those of the first touch. `speed` (m/s) is the
    greatest of any sole along the deck's normal.
    """
    level = coarse(tilt, math.radians(scales[2]))
    return torch.where(settling, (coarse(error, scales[0]) + coarse(speed, scales[1]) + level) / 3, 0.0)


class RewardedAircraft(Protocol):
    """What the aircraft's terms read (aircraft.py); tensors are [env, aircraft, ...]."""

    fleet: Fleet
    interval: float
    action: Tensor
    previous_action: Tensor
    distance: Tensor
    to_go: Tensor
    before: Tensor
    touched: Tensor
    settling: Tensor
    touch_error: Tensor
    touch_speed: Tensor
    touch_tilt: Tensor


def closing(team: RewardedAircraft) -> Tensor:
    """How fast the time falls that it takes to the deck's middle, s/s."""
    return (team.before - team.to_go) / team.interval


def time(team: RewardedAircraft) -> Tensor:
    """-1 until the first touch."""
    return penalty(~team.touched)


def touch(team: RewardedAircraft, error: Positive = 0.2, speed: Positive = 0.6, tilt_deg: Positive = 7.0) -> Tensor:
    """Once all soles are down: a third each for how near the middle (m), how soft (m/s) and how level (deg)."""
    return touchdown(team.settling, team.touch_error, team.touch_speed, team.touch_tilt, (error, speed, tilt_deg))


def landed(ended: Endings) -> Tensor:
    """1 when it has landed."""
    return -penalty(ended["landed"])


def failed(ended: Endings) -> Tensor:
    """-1 at any other end."""
    return penalty(ended.any & ~ended["landed"])


AIRCRAFT_TERMS = {
    "closing": Term(closing, 1.0),
    "time": Term(time, 0.6),
    "touch": Term(touch, 100.0),
    "landed": Term(landed, 60.0),
    "failed": Term(failed, 200.0),
    "action_rate": Term(steady, 0.02),
}
"""Terms of aircraft (aircraft.py)."""
