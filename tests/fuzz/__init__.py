"""Inputs made wrong on purpose, by the thousand: files, overrides, states. All slow; the kinds have a test each elsewhere."""
