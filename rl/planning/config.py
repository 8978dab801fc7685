"""How a team's planner searches, `[TEAM.plan]`."""

from typing import Annotated

from pydantic import Field, model_validator

from taichi_sim.config import NonNegative, Positive, Strict


class PlanConfig(Strict):
    """Sampling MPC over knots of a correction of the classical controller (planner.py)."""

    samples: Annotated[int, Field(ge=4, le=65536)] = 64  # futures tried in each round, of each environment
    rounds: Annotated[int, Field(ge=1, le=50)] = 3  # of samples for each plan
    horizon: Positive = 6.0  # s
    every: Positive = 0.5  # s between plans
    knots: Annotated[int, Field(ge=2, le=50)] = 5  # of a plan, evenly spaced over the horizon, linear in between
    spread: Positive = 3.0  # standard deviation of a knot in the first round: m/s, or share of an action's range
    berth: NonNegative = 0.5  # m of clearance: a plan that comes nearer to anything costs more
    share: NonNegative = 0.2  # of its followers' costs in a leader's own

    @model_validator(mode="after")
    def _looks_ahead(self):
        if self.every >= self.horizon:
            raise ValueError(f"every = {self.every} s must be below horizon = {self.horizon} s")
        return self
