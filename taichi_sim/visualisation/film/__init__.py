"""Pictures and films of episodes without a display or a GPU, by a rasteriser of our own.

moment.py      an episode at any time
draw.py        what a moment looks like; primitives.py collects its triangles, strokes and labels
camera.py      a pinhole camera, and what carries it: behind a team, over everybody, over the map
water.py       the sea to the horizon
projection.py  where things are on the screen, and their light
raster.py      triangles to pixels
picture.py     views side by side, with text; several episodes side by side
files.py       films
"""

from taichi_sim.visualisation.film.files import FilmError, check_film, write_film
from taichi_sim.visualisation.film.moment import Moment, moment_of
from taichi_sim.visualisation.film.picture import Picture

__all__ = ["FilmError", "Moment", "Picture", "check_film", "moment_of", "write_film"]
