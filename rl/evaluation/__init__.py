"""Evaluation: episodes never trained on, intervals, headroom, sweeps, reports."""
