"""The command `taichi-sim`, and those of its commands that need no learning."""
