"""Formation control of USV and UAV teams: the task, PPO stage by stage, evaluation, recordings."""

import taichi_sim as _taichi_sim  # noqa: F401  (registers the Gymnasium environments)
