"""Sea: spectra, Gerstner waves, queries of the surface and of the water below it, current."""

from taichi_sim.surroundings.sea.current import Current
from taichi_sim.surroundings.sea.sea import Kinematics, Sea, SteepSeaError, Surface
from taichi_sim.surroundings.sea.wind_sea import SeaSize, sea_size

__all__ = ["Current", "Kinematics", "Sea", "SeaSize", "SteepSeaError", "Surface", "sea_size"]
