"""One picture of a moment: views side by side, with labels.

With one team the picture follows it, with a small map in the corner. With several teams it has a large view (the
overview if the recording has one, else the first team), and beside it a view of another team above the map. A small
picture has one view without words. Pillow draws words once, in matplotlib's sans serif; they are then laid over pixels.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.film.camera import AWAY, Array, FilmCamera, FollowRig, MapRig, Overview, Rig
from taichi_sim.visualisation.film.draw import Cast, draw_moment
from taichi_sim.visualisation.film.moment import Moment
from taichi_sim.visualisation.film.primitives import Drawing, Pen, Solids, joined
from taichi_sim.visualisation.film.raster import Raster
from taichi_sim.visualisation.film.water import NO_WATER, water_seen
from taichi_sim.visualisation.recording.palette import Colour

INK, PAPER = (248, 250, 252), (10, 24, 36)
Pixels = NDArray[np.uint8]
LEAST, MOST_PX = (64, 48), 4096  # px of a picture
SMALL = 300  # px: pictures that are lower or less wide show one view
MAIN = 0.62  # width of the large view
INSET, GAP = 0.3, 2  # height of a map in the corner; px between views
FAR_PX, NEAR_PX = 36.0, 50.0  # least length of bodies in an overview, and behind aircraft, if team mates leave room
CLEAR = 0.8  # of the way to the nearest vehicle that a view follows, nothing else is drawn
MOST = 25.0  # greatest enlargement
ROOM = 0.8  # greatest length of an enlarged body over the distance to the nearest team mate
ARROW = np.array([(0.7, 0.0), (-0.5, 0.4), (-0.3, 0.0), (-0.5, -0.4), (0.7, 0.0)])
MARK_PX = 8.0  # length of a vehicle's mark on the map
PART_LETTERS, PART_TITLE = 1.7, 2.2  # sizes of letters in a part of a picture over those in a picture of its size
EVENT_S = 4.0  # time for which the text of an event is shown
DARK = (30, 52, 70)


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
    picture: Pixels, text: str, at: tuple[float, float], *, size: int, colour: Colour = INK,
    anchor: tuple[float, float] = (0.0, 0.0),
) -> None:  # fmt: skip
    """Write `text` at column and row `at` of a picture [height, width, 3], in letters of `size` px.

    Letters have dark edges, or light ones if they are dark. `anchor` is the point of the text that lies there, in its
    widths and heights from the upper left; the text is moved to stay inside the picture.
    """
    left, added = _tinted(text, size, colour)
    high, wide = left.shape[:2]
    if high > picture.shape[0] or wide > picture.shape[1]:
        return
    x = min(max(round(at[0] - anchor[0] * wide), 0), picture.shape[1] - wide)
    y = min(max(round(at[1] - anchor[1] * high), 0), picture.shape[0] - high)
    part = picture[y : y + high, x : x + wide]
    part[:] = part * left + added


class View(NamedTuple):
    """One view: its position in the picture, its camera and its kind."""

    left: int
    top: int
    raster: Raster
    rig: Rig
    kind: str  # "near", "far" or "map" (pen.SHOWN)
    title: str
    teams: dict[str, float]  # team -> least length of its bodies, px of a picture 480 px high


def check_picture(size: tuple[int, int], view: str, teams: Collection[str] | None) -> None:
    """Refuse a size or a view that cannot be drawn; `teams` if known."""
    if not (LEAST[0] <= size[0] <= MOST_PX and LEAST[1] <= size[1] <= MOST_PX):
        raise ValueError(f"a picture of {size[0]}x{size[1]}: allowed is {LEAST[0]}x{LEAST[1]} to {MOST_PX}x{MOST_PX}")
    if teams is not None and view not in (allowed := ("auto", "overview", "map", *teams)):
        raise ValueError(f"view {view!r}: allowed are {', '.join(allowed)}")


class Picture:
    """Draws pictures of one size; moments must come in order."""

    def __init__(
        self, moment: Moment, size: tuple[int, int], view: str = "auto", cast: Cast | None = None, *, part: bool = False
    ) -> None:
        """Arrange the views for the teams in `moment`, in a picture of `size` (width, height, px).

        `view` is "auto", or one view alone: "overview", "map", or a team's name. Several pictures of one mission share
        the bodies in `cast`. A `part` of a larger picture has no map in its corner, and larger letters.
        """
        check_picture(size, view, moment.teams)
        self.size, self._part = size, part
        self._last: Pixels = np.full((size[1], size[0], 3), 128, np.uint8)
        self._cast, self._views = cast or Cast(), _arranged(moment, size, view, part)

    def paint(self, moment: Moment, note: str = "", title: str | None = None) -> Pixels:
        """A picture [height, width, 3]; the last one again if a state is not finite.

        Its upper left corner has a `title` (default: the moment's name; "": none), the time, `note`, and recent events.
        """
        if not moment.finite():
            return self._last.copy()
        wide, high = self.size
        picture = np.full((high, wide, 3), 255, np.uint8)
        with_words = wide >= SMALL and high >= 0.7 * SMALL or self._part
        pen = Pen()
        draw_moment(pen, moment)
        for view in self._views:
            part = self._view(moment, view, pen, with_words)
            picture[view.top : view.top + part.shape[0], view.left : view.left + part.shape[1]] = part
        if with_words:
            self._words(picture, moment, note, moment.name if title is None else title)
        self._last = picture
        return picture.copy()

    def _view(self, moment: Moment, view: View, pen: Pen, with_words: bool) -> Pixels:
        """Draw one view."""
        size = view.raster.size
        camera = view.rig.camera(moment, size[0] / size[1])
        own, scales, water = Pen(), {}, NO_WATER
        if view.kind == "map":
            _mark(own, moment, MARK_PX * _metres(camera, size))
        else:
            scales = _scales(moment, camera, view)
            self._cast.bodies(own, moment, scales)
            water = water_seen(camera, size, moment)
        drawing = pen.drawing(view.kind)
        scenery = drawing.solids
        if isinstance(view.rig, FollowRig):
            scenery = _behind(scenery, camera, moment.teams[view.rig.team].position_n, size)
        solids = Solids(*joined((scenery, own.drawing(view.kind).solids)))
        strokes = drawing.strokes._replace(width_px=np.maximum(drawing.strokes.width_px * _thick(size), 1.0))
        part = view.raster.draw(camera, solids, strokes, water)
        if with_words:
            _label(part, moment, view, camera, drawing, scales)
            letters = _letters(PART_LETTERS * size[1] if self._part else max(size[1], 360))
            _caption(part, moment, view, camera, scales, letters)
        return part

    def _words(self, picture: Pixels, moment: Moment, note: str, title: str) -> None:
        """Write the clock and, but in a part, recent events."""
        size = _letters(self.size[1] * (PART_TITLE if self._part else 1.0))
        clock = f"{title}   {int(moment.time_s // 60)}:{moment.time_s % 60:04.1f}{note}"
        if title:
            write(picture, clock, (size * 0.6, size * 0.5), size=size)
        if self._part:
            return
        fresh = [event for event, _ in moment.events if moment.time_s - event.time_s < EVENT_S]
        for line, event in enumerate(fresh[-3:]):
            place, tint = (size * 0.6, size * (2.0 + 1.4 * line)), _light(event.colour)
            write(picture, event.text, place, size=size, colour=tint)


def _arranged(moment: Moment, size: tuple[int, int], view: str, part: bool) -> list[View]:
    """The views and their positions in the picture."""
    wide, high = size
    teams = list(moment.teams)
    wet = [name for name, team in moment.teams.items() if team.track.on_water]
    first = wet[0] if wet else teams[0]
    overview = moment.scene.overview

    def of(name: str, left: int, top: int, right: int, bottom: int) -> View:
        raster = Raster(right - left, bottom - top)
        if name == "map":
            return View(left, top, raster, MapRig(), "map", "", {})
        if name == "overview":
            rig = Overview(overview[0] if overview else first)
            return View(left, top, raster, rig, "far", "", dict.fromkeys(teams, FAR_PX))
        title = f"{name} team" if len(teams) > 1 else ""
        if name in wet:
            return View(left, top, raster, FollowRig(name), "near", title, {})
        return View(left, top, raster, FollowRig(name), "far", title, {name: NEAR_PX})

    large = ("overview" if overview else first) if view == "auto" else view
    if part or min(wide / 4 * 3, high) < 0.75 * SMALL or view in ("map", "overview"):
        return [of(large, 0, 0, wide, high)]
    if len(teams) == 1 or view != "auto":
        side = int(INSET * high)
        return [of(large, 0, 0, wide, high), of("map", wide - side - 3 * GAP, 3 * GAP, wide - 3 * GAP, side + 3 * GAP)]
    across, down = int(MAIN * wide) // 2 * 2, high // 2
    other = first if overview else next(name for name in teams if name != first)
    return [
        of(large, 0, 0, across, high),
        of(other, across + GAP, 0, wide, down),
        of("map", across + GAP, down + GAP, wide, high),
    ]


def _metres(camera: FilmCamera, size: tuple[int, int]) -> float:
    """Metres per px of the map."""
    return -float(camera.eye_n[2]) / (camera.focal * size[1])


def _thick(size: tuple[int, int]) -> float:
    """Factor on line widths: small views have thinner lines."""
    return float(np.clip(min(size[1], 0.75 * size[0]) / 480.0, 0.62, 3.0))


def _letters(high: float) -> int:
    """Size of letters (px) in a picture `high` px high."""
    return int(np.clip(round(0.029 * high), 10, 40))


def _behind(solids: Solids, camera: FilmCamera, places_n: Array, size: tuple[int, int]) -> Solids:
    """The faces that do not stand between the camera and vehicles at [V, 3], so that a view shows whom it follows."""
    near = CLEAR * float(camera.pixels(places_n, size)[..., AWAY].min())
    seen = camera.pixels(solids.corners_n.mean(axis=1), size)[..., AWAY] > near
    return Solids(solids.corners_n[seen], solids.normals_n[seen], solids.colours[seen])


def _scales(moment: Moment, camera: FilmCamera, view: View) -> dict[str, float]:
    """Factors by which bodies of teams are enlarged to be visible from afar; the same for all boats."""
    found, size = {}, view.raster.size
    for name, least in view.teams.items():
        team = moment.teams[name]
        length = max(team.track.size_m[:2])
        away = float(np.mean(camera.pixels(team.position_n, size)[..., AWAY]))
        wanted = least * _thick(size) * max(away, 1.0) / (camera.focal * size[1] * length)
        if len(team.position_n) > 1:
            apart = np.linalg.norm(team.position_n[:, None] - team.position_n, axis=-1)
            apart[np.diag_indices(len(apart))] = np.inf
            wanted = min(wanted, ROOM * float(np.median(apart.min(axis=1))) / length)
        found[name] = float(np.clip(wanted, 1.0, MOST))
    for name, room in room_at_decks(moment).items():
        if name in found:
            found[name] = max(1.0, min(found[name], room / max(moment.teams[name].track.size_m[:2])))
    media = {name: moment.teams[name].track.medium for name in found}
    return {name: min(found[other] for other in found if media[other] == media[name]) for name in found}


def room_at_decks(moment: Moment) -> dict[str, float]:
    """Largest length (m) of enlarged bodies in teams with decks: bodies near a deck keep their true size."""
    room: dict[str, float] = {}
    for deck, boats in moment.teams.items():
        if boats.track.deck is None:
            continue
        centre = np.array(boats.track.deck.centre_b)
        decks = boats.position_n + np.stack([numpy_rotation_matrix(q) @ centre for q in boats.quaternion_nb])
        for name, team in moment.teams.items():
            if name != deck:
                away = np.linalg.norm(team.position_n[:, None] - decks, axis=-1)
                for one in (deck, name):
                    room[one] = min(room.get(one, np.inf), ROOM * float(away.min()))
    return room


def _mark(pen: Pen, moment: Moment, metres: float) -> None:
    """An arrowhead for each vehicle on the map, `metres` long, edged in white."""
    for team in moment.teams.values():
        turn, count = team.heading, len(team.position_n)
        along, aside = np.stack([np.cos(turn), np.sin(turn)], -1), np.stack([-np.sin(turn), np.cos(turn)], -1)
        shape = metres * (ARROW[:, :1] * along[:, None] + ARROW[:, 1:] * aside[:, None])  # [V, 5, 2]
        own = np.array([team.livery.of(vehicle) for vehicle in range(count)], np.uint8)
        for grow, down, colours in ((1.5, -200.0, np.full_like(own, 255)), (1.0, -250.0, own)):
            corners = np.full((count, 5, 3), down)
            corners[..., HORIZONTAL] = team.position_n[:, None, HORIZONTAL] + grow * shape
            faces = corners[:, ((0, 1, 2), (0, 2, 3))].reshape(-1, 3, 3)
            pen.solids(Solids(faces, np.zeros((len(faces), 3)), colours.repeat(2, axis=0)), "map")


def _label(
    part: Pixels, moment: Moment, view: View, camera: FilmCamera, drawing: Drawing, scales: dict[str, float]
) -> None:
    """Write teams' names above their first vehicles, and a mission's labels, without overlaps."""
    letters = _letters(max(view.raster.size[1], 360))
    marks: list[tuple[Array, str, Colour, float]] = []
    if len(moment.teams) > 1 and not view.title:
        for name, team in moment.teams.items():
            rise = 0.5 * scales.get(name, 0.0) * max(team.track.size_m)
            marks.append((team.position_n[0], name.upper(), team.livery.first, rise))
    marks += [(label.place_n, label.text, label.colour, 0.0) for label in drawing.labels]
    taken: list[tuple[float, float, float]] = []
    for place, text, colour, rise in marks:
        column, row, ahead = camera.pixels(place, view.raster.size)
        if ahead > 0.0 and 0.0 <= column < part.shape[1] and 0.0 <= row < part.shape[0]:
            row -= 0.6 * letters + rise / ahead * camera.focal * view.raster.size[1]
            wide = 0.75 * letters * len(text)
            while any(abs(row - r) < 1.2 * letters and abs(column - c) < 0.5 * (wide + w) for c, r, w in taken):
                row -= 0.5 * letters
            taken.append((column, row, wide))
            tint = _light(colour) if view.kind != "map" else colour
            write(part, text, (column, row), size=letters, colour=tint, anchor=(0.5, 1.0))


def _light(colour: Colour) -> Colour:
    """A colour that is readable on the sea."""
    red, green, blue = (int(0.45 * part + 0.55 * 255) for part in colour)
    return red, green, blue


def _caption(
    part: Pixels, moment: Moment, view: View, camera: FilmCamera, scales: dict[str, float], letters: int
) -> None:
    """Write a view's caption at the lower left: a team's error and how many of it have ended, an overview's enlargement
    of bodies, a map's scale.
    """
    high, wide = part.shape[:2]
    if view.kind == "map":
        metres = _metres(camera, view.raster.size)
        power = 10.0 ** np.floor(np.log10(0.4 * wide * metres))
        length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= 0.4 * wide * metres)
        row, left = high - 6, 8
        part[row - 1 : row + 1, left : left + int(length / metres)] = DARK
        write(part, f"{length:g} m", (left, row - 3), size=letters, colour=DARK, anchor=(0.0, 1.0))
        part[[0, -1]], part[:, [0, -1]] = 250, 250
        return
    larger = ", ".join(f"{name} {scale:.0f}x" for name, scale in scales.items() if scale >= 1.5)
    told = (view.title, _error(moment, view), _ended(moment, view), f"drawn larger: {larger}" if larger else "")
    words = [words for words in told if words]
    while words and _words("; ".join(words), letters)[0].shape[1] > wide - 12:
        words.pop()
    if words:
        write(part, "; ".join(words), (6, high - 5), size=letters, anchor=(0.0, 1.0))


def _error(moment: Moment, view: View) -> str:
    """The rms error of the team that a view follows."""
    team = moment.teams[view.rig.team] if isinstance(view.rig, FollowRig) else None
    if team is None or team.error_m is None or not np.isfinite(team.error_m).all():
        return ""
    rms = float(np.sqrt(np.mean(np.square(team.error_m))))
    return f"error {rms:.{1 if rms < 9.95 else 0}f} m"


def _ended(moment: Moment, view: View) -> str:
    """How many vehicles of the team that a view follows have ended, by kind of event."""
    if not isinstance(view.rig, FollowRig):
        return ""
    kinds = Counter(event.kind for event, _ in moment.events if event.team == view.rig.team)
    return ", ".join(f"{count} {kind}" for kind, count in kinds.items())


class Beside:
    """Pictures of one or several episodes, by caption.

    Several are shown side by side, with a row for each team, or with the overview alone if the scene has one.
    """

    def __init__(self, moments: Mapping[str, Moment], size: tuple[int, int], view: str = "auto") -> None:
        """Arrange the pictures in one of `size` (width, height, px); see Picture."""
        first, self.size = next(iter(moments.values())), size
        several = len(moments) > 1
        rows = ["overview"] if first.scene.overview else list(first.teams)
        if view != "auto" or not several:
            rows = [view]
        wide, high = ((px + GAP) // n - GAP for px, n in zip(size, (len(moments), len(rows)), strict=True))
        self._cells = {
            caption: [Picture(moment, (wide, high), row, part=several) for row in rows]
            for caption, moment in moments.items()
        }

    def paint(self, moments: Mapping[str, Moment], note: str = "") -> Pixels:
        """A picture [height, width, 3] of the moments; `note` stands beside the time."""
        wide, high = self.size
        picture = np.full((high, wide, 3), 255, np.uint8)
        for column, (caption, cells) in enumerate(self._cells.items()):
            for row, cell in enumerate(cells):
                left, top = column * (cell.size[0] + GAP), row * (cell.size[1] + GAP)
                title = None if len(self._cells) == 1 else "" if row else caption
                part = cell.paint(moments[caption], note, title)
                picture[top : top + cell.size[1], left : left + cell.size[0]] = part
        return picture
