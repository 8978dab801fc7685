"""Estimates numbers of a vehicle file from logs of its motion (docs/fit.md)."""
