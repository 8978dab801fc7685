"""The sea: spectra, Gerstner waves, and queries of the surface."""

from taichi_sim.sea.sea import Sea, SteepSeaError, Surface

__all__ = ["Sea", "SteepSeaError", "Surface"]
