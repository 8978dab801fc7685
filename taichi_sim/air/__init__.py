"""The air: mean wind and its profile over the sea, Dryden turbulence, discrete gusts."""

from taichi_sim.air.wind import Wind

__all__ = ["Wind"]
