"""Rewards: the weights, one function per term, and the terms of each part. Every term is [env, vehicle]."""

import math
from collections.abc import Callable
from typing import Protocol

import torch
from pydantic import model_validator
from torch import Tensor

from rl.guidance.rewards import action_rate, coarse, penalty
from rl.step import Endings
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.fleet import Fleet


class AircraftReward(Strict):
    """Weights and scales of an aircraft's terms."""

    closing: NonNegative = 1.0  # how fast the time falls that it takes to the deck's middle, s/s
    time: NonNegative = 0.6  # -1 until the first touch
    touch: NonNegative = 100.0  # once all soles are down: a third each for how near the middle, how soft, how level
    touch_error: Positive = 0.2  # m
    touch_speed: Positive = 0.6  # m/s
    touch_tilt_deg: Positive = 7.0  # to the deck
    landed: NonNegative = 60.0  # 1 when it has landed
    failed: NonNegative = 200.0  # -1 at any other end
    action_rate: NonNegative = 0.02  # -|a - a_previous|^2

    @model_validator(mode="before")
    @classmethod
    def _without_scale(cls, data: object) -> object:
        """Accept files of earlier versions, in which metres of distance were paid for, over `closing_scale`."""
        return {key: value for key, value in data.items() if key != "closing_scale"} if isinstance(data, dict) else data


def touchdown(settling: Tensor, error: Tensor, speed: Tensor, tilt: Tensor, w: AircraftReward) -> Tensor:
    """Reward of a touchdown when all soles are down: at most 1.

    `error` (m, from the deck's middle) and `tilt` (rad, to the deck) are those of the first touch. `speed` (m/s) is the
    greatest of any sole along the deck's normal.
    """
    level = coarse(tilt, math.radians(w.touch_tilt_deg))
    return torch.where(settling, (coarse(error, w.touch_error) + coarse(speed, w.touch_speed) + level) / 3, 0.0)


def failure(ended: Endings) -> Tensor:
    """-1 where an aircraft's episode has ended in any way but a landing."""
    return penalty(ended.any & ~ended["landed"])


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


AIRCRAFT_TERMS: dict[str, Callable[[RewardedAircraft, Endings, AircraftReward], Tensor]] = {
    "closing": lambda team, ended, w: (team.before - team.to_go) / team.interval,
    "time": lambda team, ended, w: penalty(~team.touched),
    "touch": lambda team, ended, w: touchdown(team.settling, team.touch_error, team.touch_speed, team.touch_tilt, w),
    "landed": lambda team, ended, w: ended["landed"].to(team.distance),
    "failed": lambda team, ended, w: failure(ended),
    "action_rate": lambda team, ended, w: action_rate(team.action, team.previous_action),
}
"""A weight's name -> its term, of aircraft (aircraft.py), their endings, and the weights."""
