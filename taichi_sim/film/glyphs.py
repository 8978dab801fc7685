"""Small text on pictures: Pillow draws words once in matplotlib's sans serif; they are then laid over pixels."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.palette import Colour

INK, PAPER = (248, 250, 252), (10, 24, 36)


@lru_cache(maxsize=8)
def _font(size: int):
    import matplotlib
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"), size)


@lru_cache(maxsize=512)
def _words(text: str, size: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Coverage [height, width, 1], 0 to 1, of letters and of their edges."""
    from PIL import Image, ImageDraw

    font, edge = _font(size), max(1, size // 9)
    left, top, right, bottom = (int(number) for number in font.getbbox(text, stroke_width=edge))
    covers = []
    for stroke in (0, edge):
        page = Image.new("L", (right - left + 2, bottom - top + 2))
        ImageDraw.Draw(page).text((1 - left, 1 - top), text, fill=255, font=font, stroke_width=stroke)
        covers.append(np.asarray(page, np.float32)[..., None] / 255.0)
    return covers[0], covers[1]


@lru_cache(maxsize=512)
def _tinted(text: str, size: int, colour: Colour) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Share of the pixels that remains visible under the words, 0 to 1, and the colour added to them."""
    letters, around = _words(text, size)
    edge = PAPER if np.dot(colour, (0.3, 0.6, 0.1)) > 90 else INK
    shade = 0.75 * around * (1.0 - letters)
    added = shade * np.array(edge, np.float32) + letters * np.array(colour, np.float32) + 0.5
    return (1.0 - letters - shade).astype(np.float32), added.astype(np.float32)


def write(
    picture: NDArray[np.uint8],
    text: str,
    at: tuple[float, float],
    *,
    size: int,
    colour: Colour = INK,
    anchor: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Write `text` into a picture [height, width, 3]. Letters have dark edges, or light ones if they are dark.

    Args:
        picture: the pixels.
        text: the words.
        at: column and row.
        size: size of letters, px.
        colour: colour of letters.
        anchor: point of the text that lies at `at`, in its widths and heights from the upper left; the text is moved to
            stay inside the picture.
    """
    left, added = _tinted(text, size, colour)
    high, wide = left.shape[:2]
    if high > picture.shape[0] or wide > picture.shape[1]:
        return
    x = min(max(round(at[0] - anchor[0] * wide), 0), picture.shape[1] - wide)
    y = min(max(round(at[1] - anchor[1] * high), 0), picture.shape[0] - high)
    part = picture[y : y + high, x : x + wide]
    part[:] = part * left + added


def lines_of(text: str, size: int, wide: int) -> bool:
    """Whether `text` fits into one line of `wide` px."""
    return _words(text, size)[0].shape[1] <= wide
