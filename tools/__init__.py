"""What developers and reviewers run: `python -m tools.NAME`, or `python tools/NAME.py` once taichi-sim is installed."""
