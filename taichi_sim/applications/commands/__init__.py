"""Subcommands of `taichi-sim` that need no learning."""
