"""An episode drawn part by part, as a live view has it, and how many bytes one takes."""

from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from recorded import make_episode
from rerun.chunk import RrdReader

from taichi_sim.visualisation.recording import Episode, Event, Force
from taichi_sim.visualisation.recording.overlays import Ellipsoids, Lines, Plot
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.rrd import draw, write_recording

STEPS = 60
LONGER = 1_000_000  # bytes of a file that do not grow with the episode: layout, bodies, index


def cut(thing: Any, begin: int, end: int, steps: int, **others: Any) -> Any:
    """A dataclass with those of its arrays that have a row for each step cut to the steps from `begin` to `end`."""
    values = {field.name: getattr(thing, field.name) for field in fields(thing)}
    arrays = {name: one for name, one in values.items() if isinstance(one, np.ndarray) and len(one) == steps}
    return replace(thing, **{name: one[begin:end] for name, one in arrays.items()}, **others)


def part(episode: Episode, begin: int, end: int) -> Episode:
    """Some steps of an episode, drawn like all of it."""
    steps = len(episode.time_s)
    teams = {}
    for name, team in episode.teams.items():
        forces = {key: Force(one.origin_b, one.vector_b[begin:end]) for key, one in team.forces.items()}
        teams[name] = cut(team, begin, end, steps, forces=forces)
    times = episode.time_s[[begin, end - 1]]
    return cut(
        episode, begin, end, steps,
        teams=teams,
        events=tuple(event for event in episode.events if times[0] - 0.05 < event.time_s <= times[1]),
        overlays=tuple(cut(overlay, begin, end, steps) for overlay in episode.overlays),
        like=episode,
    )  # fmt: skip


def busy() -> Episode:
    """Boats and aircraft with loads, wind, events and overlays: one keeps its shape for a while, one does not."""
    episode = make_episode(3, steps=STEPS)
    push = np.zeros((STEPS, 3, 3))
    push[20:, :, 0] = 30.0  # nothing acts at first
    usv = replace(episode.teams["usv"], forces={"thrust": Force((-0.8, 0.0, 0.1), push)})
    uav = replace(episode.teams["uav"], air_n=np.ones((STEPS, 3, 3)))
    middle = usv.position_n[:, :1, None]
    circle = np.stack([np.cos(np.arange(9.0)), np.sin(np.arange(9.0)), np.zeros(9)], axis=-1)
    size = np.where(np.arange(STEPS) < 40, 5.0, 6.0)[:, None, None, None]
    overlays = (
        Lines(name="circle", colour=(1, 2, 3), points_n=middle + size * circle),
        Ellipsoids(
            name="guess", colour=(1, 2, 3), position_n=usv.position_n[:, :1], half_axes_m=np.ones((STEPS, 1, 3)),
            heading=np.zeros((STEPS, 1)),
        ),
        Plot(name="risk", unit="", lines=("one",), values=np.arange(STEPS)[:, None]),
    )  # fmt: skip
    flow = np.ones((STEPS, 3)) * [3.0, -2.0, 0.0]
    events = (*episode.events, Event(4.9, "usv", 1, "collision", "obstacle 2"))
    return replace(episode, teams={"usv": usv, "uav": uav}, overlays=overlays, wind_n=flow, events=events)


def contents(path: Path) -> dict[tuple[str, str], list]:
    """What a viewer has of each component of each entity at each step, whatever the rows that it came in."""
    found: dict[tuple[str, str], dict[int, Any]] = defaultdict(dict)
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        steps = batch.column("step").to_pylist() if "step" in batch.schema.names else [-1] * batch.num_rows
        for name in batch.schema.names:
            if ":" in name:
                values = batch.column(name).to_pylist()
                found[chunk.entity_path, name] |= {s: v for s, v in zip(steps, values, strict=True) if v is not None}
    return {key: sorted(of.items()) for key, of in found.items()}


def test_drawn_in_parts_it_is_the_same_as_drawn_at_once(tmp_path: Path) -> None:
    episode, files = busy(), [tmp_path / "once.rrd", tmp_path / "parts.rrd"]
    for file, cuts in zip(files, ([0, STEPS], [0, 25, 26, 27, 45, STEPS]), strict=True):
        with rr.RecordingStream("parts", send_properties=False) as rec:
            rec.save(file)
            stream = Stream(rec)
            for begin, end in zip(cuts, cuts[1:], strict=False):
                draw(stream, part(episode, begin, end))
    once, parts = map(contents, files)
    # a shape that moves as one piece in a part may not do so in all; a view looks ahead, as far as the part goes
    other = ("overlay/circle", "/world/uav/follow")
    assert {key for key in once if not key[0].endswith(other)} == {key for key in parts if not key[0].endswith(other)}
    for (entity, component), values in once.items():
        assert entity.endswith(other) or values == parts[entity, component], (entity, component)
    # where it is drawn, shape and place together, the circle is the same
    for root, kind in (("/world", "LineStrips3D"), ("/map", "LineStrips2D")):
        lines = [_placed(of, f"{root}/overlay/circle", f"{kind}:strips") for of in (once, parts)]
        np.testing.assert_allclose(*lines, atol=5e-3)


def _placed(of: dict, entity: str, component: str) -> np.ndarray:
    """[STEPS, 9, n] points of one line at each step, under its transform."""
    strips, places = dict(of[entity, component]), dict(of.get((entity, "Transform3D:translation"), []))
    shape, place, lines = np.zeros(0), np.zeros(3), []
    for step in range(STEPS):
        shape = np.array(strips[step][0]) if step in strips else shape
        place = np.ravel(places[step]) if step in places else place
        lines.append(shape + place[: shape.shape[1]])
    return np.stack(lines)


def test_a_minute_of_six_vehicles_takes_five_megabytes(tmp_path: Path) -> None:
    short, long = (
        write_recording(make_episode(3, steps=steps), tmp_path / f"{steps}.rrd").stat().st_size for steps in (40, 160)
    )
    per_second = (long - short) / 12.0
    assert short < LONGER
    assert LONGER + 60.0 * per_second < 5_000_000
