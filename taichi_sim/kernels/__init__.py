"""What kernels share: start of Taichi, arguments, vectors, fast functions, rotations, rigid bodies, random numbers."""

from taichi_sim.kernels import taichi_patches

taichi_patches.install()
