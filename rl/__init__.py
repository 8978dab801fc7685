"""Formation control of USV and UAV teams: the task, PPO stage by stage, evaluation, recordings."""
