"""Plots and HTML pages: one style."""
