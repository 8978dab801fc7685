"""Learning: rsl-rl's view of a mission, its runner, stages, policies."""
