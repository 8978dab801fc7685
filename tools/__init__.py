"""Tools for developers and reviewers: `python -m tools.NAME`, or `python tools/NAME.py` once taichi-sim is
installed.
"""
