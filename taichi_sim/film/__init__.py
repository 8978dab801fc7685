"""Pictures and films of episodes without a display or a GPU, by a rasteriser of our own.

camera.py    a pinhole camera         rigs.py      what carries it: behind a team, over everybody, over the map
moment.py    an episode at any time   draw.py      what a moment looks like; pen.py collects triangles and strokes
water.py     the sea to the horizon   shade.py     light
screen.py    where they are on the screen
raster.py    triangles to pixels      glyphs.py    small text
picture.py   views side by side       files.py     films
"""

from taichi_sim.film.files import FilmError, check_film, write_film, write_strip
from taichi_sim.film.moment import Moment, moment_of
from taichi_sim.film.picture import Picture

__all__ = ["FilmError", "Moment", "Picture", "check_film", "moment_of", "write_film", "write_strip"]
