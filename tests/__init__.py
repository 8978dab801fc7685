"""Tests of taichi_sim, rl and tools; `validation` holds the checks of reference tables (tools/validate.py)."""
