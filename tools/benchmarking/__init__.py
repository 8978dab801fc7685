"""Cases of tools/benchmark.py: what is timed, and how."""
