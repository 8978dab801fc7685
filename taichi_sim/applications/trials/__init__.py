"""Trials of a single ship, aircraft or multirotor: measured quantities by the field's definitions."""
