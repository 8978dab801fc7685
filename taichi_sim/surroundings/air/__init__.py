"""Air: mean wind and its profile over height, Dryden turbulence, discrete gusts."""

from taichi_sim.surroundings.air.wind import Wind

__all__ = ["Wind"]
