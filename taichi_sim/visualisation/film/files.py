"""Films of an episode: mp4 by imageio-ffmpeg (the extra `film`), animated PNG, GIF and WebP by Pillow.

A film is written to a temporary file and then renamed, so that a file under its name is complete. Bad arguments are
refused before the first picture is drawn; `check_film` refuses them before there is an episode.
"""

import errno
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from taichi_sim.config.io import replacing
from taichi_sim.errors import UserError, needs
from taichi_sim.visualisation.film.moment import moment_of
from taichi_sim.visualisation.film.picture import Beside, check_picture
from taichi_sim.visualisation.recording.episode import Episode

if TYPE_CHECKING:
    from PIL.Image import Image

SIZE, FPS = (640, 480), 25.0
CRF = 26  # quality of x264; lower means larger files and better pictures
COLOURS = 128  # colours of an animated PNG or GIF
SAMPLED, BINS, RARE = 8, 2, 0.45  # sampled pictures; dropped bits of a colour; exponent of its frequency
Samples = Callable[[], Iterable[NDArray[np.uint8]]]
KINDS = (".mp4", ".png", ".gif", ".webp")


class FilmError(UserError, ValueError):
    """A film cannot be written; the message says why."""


def check_film(
    path: str | Path,
    *,
    size: tuple[int, int] = SIZE,
    fps: float = FPS,
    speed: float = 1.0,
    view: str = "auto",
    teams: Collection[str] | None = None,
    columns: int = 1,
) -> Path:
    """Check the arguments of `write_film`, and `teams` if known, for `columns` episodes side by side; return the path.

    Raises:
        OSError: if the folder does not exist.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise FilmError(f"{path}: a film's suffix is one of {', '.join(KINDS)}")
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder for the film", str(path.parent))
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "the film's name is that of a folder", str(path))
    if kind == ".mp4":
        _ffmpeg()
        if size[0] % 2 or size[1] % 2:
            raise FilmError(f"an mp4 of {size[0]}x{size[1]}: width and height must be even")
    if not 0.1 <= fps <= 240 or not 0.01 <= speed <= 1000:
        raise FilmError(f"a film with fps = {fps:g} and speed = {speed:g}: allowed are 0.1 to 240 and 0.01 to 1000")
    try:
        rows = len(teams) if teams and columns > 1 else 1
        check_picture((size[0] // columns, size[1] // rows), view, teams)
    except ValueError as fault:
        raise FilmError(str(fault)) from fault
    return path


def write_film(
    episode: Episode | Mapping[str, Episode],
    path: str | Path,
    *,
    size: tuple[int, int] = SIZE,
    fps: float = FPS,
    speed: float = 1.0,
    view: str = "auto",
    until: float = np.inf,
    show_progress: bool = False,
) -> Path:
    """Write a film of `episode`; return its path.

    Args:
        episode: the episode, or several by caption, side by side; the last moment of a shorter one stays.
        path: a file that ends in .mp4, .png, .gif or .webp.
        size: width and height, px.
        fps: pictures per second of the film.
        speed: seconds of the episode per second of the film.
        view: "auto" (picture.py), or one view alone: "overview", "map", or a team's name.
        until: time on the episode's clock at which the film ends, s.
        show_progress: whether to print progress.

    Raises:
        OSError: for a folder that does not exist, or a full disk. Nothing is written then.
    """
    episodes = {"": episode} if isinstance(episode, Episode) else episode
    teams = next(iter(episodes.values())).teams
    path = check_film(path, size=size, fps=fps, speed=speed, view=view, teams=teams, columns=len(episodes))
    times = film_times(episodes.values(), fps, speed, until)
    note = "" if speed == 1.0 else f"   {speed:g}x"

    def painted(times: Iterable[float]) -> Iterator[NDArray[np.uint8]]:
        picture = None
        for time in times:
            moments = {caption: moment_of(one, time) for caption, one in episodes.items()}
            picture = picture or Beside(moments, size, view)
            yield picture.paint(moments, note)

    frames = painted(tqdm(times, desc="film", unit="frame", disable=not show_progress))

    def samples() -> Iterator[NDArray[np.uint8]]:
        return painted(times[:: -(-len(times) // SAMPLED)])

    kind = path.suffix.lower()
    with replacing(path) as part:
        if kind == ".mp4":
            _write_mp4(frames, part, size, fps)
        else:
            _write_animation(frames, part, kind, fps, samples)
    return path


def film_times(episodes: Collection[Episode], fps: float, speed: float, until: float = np.inf) -> NDArray[np.floating]:
    """Times (s, on the episodes' clock) of a film's pictures, to the end of the longest or `until`; at least one."""
    first = min(float(one.time_s[0]) for one in episodes)
    last = min(until, max(float(one.time_s[-1]) for one in episodes))
    return np.arange(first, max(last, first) + 1e-6, speed / fps)


def _ffmpeg() -> ModuleType:
    with needs("imageio-ffmpeg (for .mp4; .png, .gif and .webp do without)", "film"):
        import imageio_ffmpeg
    return imageio_ffmpeg


def _write_mp4(frames: Iterable[NDArray[np.uint8]], part: Path, size: tuple[int, int], fps: float) -> None:
    """Write H.264 that all common players and browsers show."""
    options = ["-crf", str(CRF), "-preset", "veryfast", "-movflags", "+faststart", "-f", "mp4"]
    file = _ffmpeg().write_frames(
        str(part), size, fps=fps, codec="libx264", quality=None, macro_block_size=2, output_params=options,
        pix_fmt_in="rgb24", ffmpeg_log_level="error",
    )  # fmt: skip
    file.send(None)
    try:
        for frame in frames:
            file.send(np.ascontiguousarray(frame))
    finally:
        file.close()
    if not part.is_file() or not part.stat().st_size:
        raise OSError(errno.EIO, "the film was not written", str(part))


def _write_animation(frames: Iterable[NDArray[np.uint8]], part: Path, kind: str, fps: float, samples: Samples) -> None:
    """Write an animated picture that repeats."""
    from PIL import Image

    pages = map(Image.fromarray, frames)
    if kind != ".webp":
        palette = _palette(samples())  # dithering would compress badly
        pages = (page.quantize(palette=palette, dither=Image.Dither.NONE) for page in pages)
    first, *others = pages
    how: dict[str, int] = {".webp": {"quality": 55, "method": 2}, ".gif": {"optimize": False}, ".png": {}}[kind]
    with part.open("wb") as file:
        every = round(1000.0 / fps)
        first.save(file, kind[1:].upper(), save_all=True, append_images=others, duration=every, loop=0, **how)


def _palette(samples: Iterable[NDArray[np.uint8]]) -> "Image":
    """A palette of COLOURS colours from some pictures; rare ones have extra weight, because boats have few pixels."""
    from PIL import Image

    pixels = np.concatenate([sample.reshape(-1, 3) for sample in samples])
    kinds, counts = np.unique(pixels >> BINS, axis=0, return_counts=True)
    often = np.repeat(kinds, np.ceil(counts**RARE).astype(int), axis=0)
    colours = ((often << BINS) + (1 << BINS >> 1)).astype(np.uint8)
    return Image.fromarray(colours[None]).quantize(COLOURS)
