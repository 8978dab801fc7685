"""Learning with rsl-rl: environments, PPO, stages, policies, export."""
