"""Sweeps: policy and classical controller on the same episodes under a grid of conditions.

config.py reads a sweep's file, cells.py lists its conditions for a run, run.py evaluates and writes them.
"""
