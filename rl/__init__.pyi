"""What type checkers see of rl/__init__.py."""

from rl.adapters.batched import BatchedEnv
from rl.adapters.gymnasium import TeamEnv, TeamVectorEnv
from rl.judge import Judge
from rl.learn.policy import load_policy
from rl.mission import Endings, Mission
from rl.missions import load_scenario, make_mission
from rl.scenario import Scenario
from rl.team import Team

__all__ = [
    "BatchedEnv", "Endings", "Judge", "Mission", "Scenario", "Team", "TeamEnv", "TeamVectorEnv", "load_policy",
    "load_scenario", "make_mission",
]  # fmt: skip
