"""Sweeps: policy and classical controller on the same episodes under a grid of conditions.

config.py is what a file says; cells.py the conditions it means for a run; run.py goes through them; tables.py writes.
"""
