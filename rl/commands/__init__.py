"""The command `taichi-sim`, and starter files."""
