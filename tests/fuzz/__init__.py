"""Inputs made wrong on purpose, by the thousand: files, overrides, states. All of these tests are slow."""
