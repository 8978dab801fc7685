"""Runs: their folders, evaluation, recording, and the main job."""
