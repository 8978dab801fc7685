"""What a mission draws beside the vehicles: each shape where it says, in 3D and on the map."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded import assert_nothing_is_empty, column, entities, make_episode, rows
from rerun.chunk import RrdReader

from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.overlays import (
    Arrows,
    Cylinders,
    Ellipsoids,
    Lines,
    Note,
    Overlay,
    Plot,
    Points,
)
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.visualisation.recording.static_scene import line_lift

STEPS = 6
RED = (220, 40, 40)
STEP = np.arange(STEPS, dtype=float)


def moving(*starts: tuple[float, float, float]) -> np.ndarray:
    """[T, N, 3] m: things that go 10 m north in each step."""
    return np.array(starts) + 10.0 * STEP[:, None, None] * [1.0, 0.0, 0.0]


def overlays() -> tuple[Overlay, ...]:
    """Each kind; the second contact is seen in the last two steps only."""
    contacts = moving((0.0, 50.0, 0.0), (5.0, 60.0, -20.0))
    contacts[:-2, 1] = np.nan
    lane = np.array([[[[0.0, 10.0, 0.0], [100.0, 20.0, 0.0], [np.nan] * 3]]])
    return (
        Lines(name="lanes/left", colour=RED, points_n=lane, on_water=True),
        Lines(name="plan", colour=RED, points_n=np.stack([contacts[:, 0], contacts[:, 0] + (0, 5, -1)], 1)[:, None]),
        Points(name="contacts", colour=RED, labels=("Ann", "Bob"), position_n=contacts),
        Cylinders(name="piles", colour=RED, position_n=np.array([[[3, 4, -5]]]), size_m=np.array([[[2, 10]]])),
        Ellipsoids(
            name="domain", colour=RED, position_n=contacts, half_axes_m=np.array([[[40.0, 15.0, 1.0]] * 2]),
            heading=np.full((STEPS, 2), 0.5 * np.pi),
        ),
        Arrows(name="risk", colour=RED, where="map", origin_n=contacts, vector_n=np.ones((1, 2, 3)) * [0.0, 7.0, 0.0]),
        Plot(name="target bearing", unit="rad", lines=("to_Ann", "to_Bob"), values=np.stack([STEP, 0 * STEP], 1)),
        Note(time_s=0.2, text="Ann gives way", level="INFO"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Episode, Path]:
    episode = replace(make_episode(1, ("usv",), steps=STEPS), overlays=overlays())
    return episode, write_recording(episode, tmp_path_factory.mktemp("overlays") / "overlays.rrd")


def static(path: Path, entity: str, component: str) -> np.ndarray:
    """The values of a component that does not change."""
    for chunk in RrdReader(path).stream().filter(content=entity, is_static=True):
        batch = chunk.to_record_batch()
        if component in batch.schema.names:
            return np.array(batch.column(component).to_pylist()[-1], dtype=float)
    raise KeyError(component)


def test_moving_things_are_where_they_are_and_only_while_they_are_known(recorded: tuple[Episode, Path]) -> None:
    _, path = recorded
    _, steps, places = rows(path, "/world/overlay/contacts", "Points3D:positions")
    np.testing.assert_array_equal(steps, np.arange(STEPS))
    assert [len(place) for place in places] == [1, 1, 1, 1, 2, 2]
    np.testing.assert_allclose(places[5], [[50.0, 50.0, 0.0], [60.0, 55.0, 20.0]])  # east, north, up
    assert rows(path, "/world/overlay/contacts", "Points3D:labels")[2][5] == ["Ann", "Bob"]
    _, _, spots = rows(path, "/map/overlay/contacts", "Points2D:positions")
    np.testing.assert_allclose(spots[5], [[50.0, -50.0], [60.0, -55.0]])  # east, south
    # a line that moves as one piece is written once, and then where it is
    (first,), _, ((shape,),) = rows(path, "/world/overlay/plan", "LineStrips3D:strips")
    _, _, place = column(path, "/world/overlay/plan", "Transform3D:translation")
    np.testing.assert_allclose(shape + place[2], [[50.0, 20.0, 0.0], [55.0, 20.0, 1.0]])
    assert first == 0


def test_what_stands_still_is_written_once(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    lane = static(path, "/world/overlay/lanes/left", "LineStrips3D:strips")
    lift = line_lift(episode)  # above the waves, and without the point that is not known
    np.testing.assert_allclose(lane, [[[10.0, 0.0, lift], [20.0, 100.0, lift]]], rtol=1e-6)
    np.testing.assert_allclose(static(path, "/world/overlay/piles", "Cylinders3D:centers"), [[4.0, 3.0, 5.0]])
    np.testing.assert_allclose(static(path, "/map/overlay/piles", "Points2D:radii"), [2.0])


def test_an_ellipse_lies_along_its_heading(recorded: tuple[Episode, Path]) -> None:
    _, path = recorded
    _, _, outlines = rows(path, "/map/overlay/domain", "LineStrips2D:strips")
    east, south = np.array(outlines[0][0]).T  # bound east: 40 m each way along it, 15 m across
    assert (np.ptp(east), np.ptp(south)) == pytest.approx((80.0, 30.0))
    _, _, turns = rows(path, "/world/overlay/domain", "Ellipsoids3D:quaternions")
    x, y, z, w = turns[0][0]
    forward = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    np.testing.assert_allclose(forward, [1.0, 0.0, 0.0], atol=1e-6)


def test_an_overlay_is_only_where_it_was_asked_for(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    there = {entity for entity in entities(path) if "overlay/risk" in entity}
    assert there == {"/map/overlay/risk"}
    _, _, arrows = rows(path, "/map/overlay/risk", "Arrows2D:vectors")
    np.testing.assert_allclose(arrows[4], [[7.0, 0.0], [7.0, 0.0]])
    assert_nothing_is_empty(episode, path)


def test_numbers_have_a_plot_and_notes_a_line_in_the_log(recorded: tuple[Episode, Path]) -> None:
    _, path = recorded
    _, _, plotted = column(path, "/plots/overlay/target_bearing", "Scalars:scalars")
    np.testing.assert_allclose(plotted[:, 0], np.degrees(STEP))
    _, steps, texts = column(path, "/events", "TextLog:text")
    assert "Ann gives way" in texts.ravel().tolist()
    assert 2 in steps


@pytest.mark.parametrize(
    ("overlay", "fault"),
    [
        (Points(name="p", colour=RED, position_n=np.zeros((2, 1, 3))), r"position_n is \(2, 1, 3\), wanted \(1 or 6"),
        (Points(name="p", colour=RED, position_n=np.zeros((1, 3))), "position_n"),
        (Points(name="p", colour=RED, labels=("one", "two"), position_n=np.zeros((1, 1, 3))), "position_n"),
        (Arrows(name="a", colour=RED, origin_n=np.zeros((1, 2, 3)), vector_n=np.zeros((6, 1, 3))), "vector_n"),
        (Plot(name="q", unit="m", lines=("one",), values=np.zeros((6, 2))), "values"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(overlay: Overlay, fault: str) -> None:
    with pytest.raises(ValueError, match=f"overlay {overlay.name}: {fault}"):
        replace(make_episode(1, ("usv",), steps=STEPS), overlays=(overlay,))


def test_two_overlays_of_one_name_are_refused() -> None:
    point = Points(name="p", colour=RED, position_n=np.zeros((1, 1, 3)))
    with pytest.raises(ValueError, match="two overlays of one name"):
        replace(make_episode(1, ("usv",), steps=STEPS), overlays=(point, point))
