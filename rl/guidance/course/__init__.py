"""The course of a mission: tracks, obstacles, traffic."""
