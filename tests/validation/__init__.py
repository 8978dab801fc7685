"""Checks of this package against tables of published figures and of independent codes (see validate.py)."""
