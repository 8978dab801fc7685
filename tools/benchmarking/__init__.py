"""The cases of tools/benchmark.py and their timing."""
