"""Panels: closed, outward, the volumes and surfaces of the shapes they stand for."""

import numpy as np
import pytest
from pydantic import ValidationError

from taichi_sim.models.usv.hull.mesh import BoxHull, StationsHull, TwinPontoons, WigleyHull, mesh

VEE = TwinPontoons(
    y=0.4, freeboard=0.12, stations=((-1.0, 0.4, 0.17), (-0.5, 0.3, 0.15), (0.5, 0.3, 0.24), (1.0, 0.0, 0.3))
)
ROUND = TwinPontoons(
    y=1.0, freeboard=0.3, section="round", panels_girth=5, stations=((-2.0, 0.4, 0.1), (0.0, 0.4, 0.1), (2.0, 0.2, 0.1))
)
SHAPES = [
    BoxHull(length=4.0, beam=2.0, draft=0.5, freeboard=0.4),
    BoxHull(length=4.0, beam=2.0, draft=0.5, freeboard=0.4, panels_along=3, panels_across=1, panels_up=1),
    WigleyHull(length=3.0, beam=0.3, draft=0.2, freeboard=0.1),
    VEE,
    ROUND,
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.shape)
def test_every_hull_is_closed(shape):
    panels = mesh(shape)
    assert np.linalg.norm(panels.area.sum(axis=0)) < 1e-12 * np.abs(panels.area).sum()


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.shape)
def test_area_vectors_point_outwards(shape):
    panels = mesh(shape)
    y = shape.y * np.sign(panels.centre[:, 1]) if isinstance(shape, TwinPontoons) else 0.0
    outward = panels.centre - np.stack(
        [0.9 * panels.centre[:, 0], y + 0 * panels.centre[:, 0], 0 * panels.centre[:, 0]], 1
    )
    assert np.all(np.sum(outward * panels.area, axis=1) > 0)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.shape)
def test_up_is_the_steeper_edge_and_the_area_is_the_cross_product_of_the_edges(shape):
    panels = mesh(shape)
    slope = [np.abs(e[:, 2]) / np.linalg.norm(e, axis=1) for e in (panels.along, panels.up)]
    assert np.all(slope[1] >= slope[0] - 1e-6)
    size = 4 * np.linalg.norm(np.cross(panels.along, panels.up), axis=1)
    assert size == pytest.approx(np.linalg.norm(panels.area, axis=1))


def test_area_of_a_tapered_strip_follows_from_the_slopes_of_the_area():
    # The transom is a triangle with its point at the keel: no width at its lower end, twice the mean at the deck.
    panels = mesh(VEE)
    transom = np.argmin(panels.area[:, 0] / np.linalg.norm(panels.area, axis=1) + (panels.centre[:, 1] < 0))
    along_s, along_t = (a[transom, 0] / panels.area[transom, 0] for a in panels.area_slopes)
    assert along_s == pytest.approx(0.0, abs=1e-12)
    assert abs(along_t) == pytest.approx(1.0)


def test_box_faces_have_the_sizes_of_the_box():
    panels = mesh(SHAPES[0])
    assert len(panels) == 24
    assert np.abs(panels.area).sum(axis=0) == pytest.approx([2 * 2 * 0.9, 2 * 4 * 0.9, 2 * 4 * 2])
    assert panels.draft == pytest.approx(0.5)
    assert panels.deck.min(axis=0) == pytest.approx([-2, -1, -0.4])
    below = panels.centre[:, 2] > 0
    assert np.all((np.abs(panels.up[:, 2]) + np.abs(panels.centre[:, 2]) <= 0.5 + 1e-12)[below])  # cut at the waterline


def test_pontoons_of_five_segments_have_24_panels():
    x = np.linspace(-1, 1, 6)
    stations = tuple((float(a), 0.3 * float(a < 1), 0.2) for a in x)
    assert len(mesh(TwinPontoons(y=0.4, freeboard=0.1, stations=stations))) == 24


def test_pontoons_mirror_each_other():
    panels = mesh(VEE)
    port = panels.centre[:, 1] < 0
    mirrored = panels.centre[port] * [1, -1, 1]
    starboard = panels.centre[~port]
    assert np.abs(mirrored[:, None] - starboard[None]).sum(-1).min(axis=1).max() < 1e-12


@pytest.mark.parametrize(
    "change, word",
    [
        ({"stations": ((0.0, 0.2, 0.1), (0.0, 0.2, 0.1))}, "forward"),
        ({"stations": ((-1.0, 1.2, 0.1), (1.0, 0.2, 0.1))}, "centreline"),
        ({"stations": ((-1.0, 0.2, -0.3), (1.0, 0.2, 0.1))}, "keel"),
        ({"section": "round", "stations": ((-1.0, 0.6, 0.1), (1.0, 0.6, 0.1))}, "at least 0.2"),
        ({"y": -1.0}, "greater than 0"),
    ],
)
def test_impossible_pontoons_are_refused(change, word):
    good = {"y": 0.5, "freeboard": 0.1, "stations": ((-1.0, 0.2, 0.1), (1.0, 0.2, 0.1))}
    TwinPontoons(**good)
    with pytest.raises(ValidationError, match=word):
        TwinPontoons(**(good | change))


KEEL, BILGE, SIDE, DECK = (0.0, 0.3), (0.5, 0.3), (0.6, 0.0), (0.6, -0.2)
INNER = ((0.2, -0.1), (0.25, 0.0), (0.4, 0.3), (0.55, 0.0), (0.6, -0.1))


@pytest.mark.parametrize(
    "section",
    [
        (KEEL, SIDE, BILGE, DECK, (0.3, -0.2)),  # out of order
        (KEEL, (0.6, -0.1), (0.2, 0.4), DECK),
        tuple((y, -z) for y, z in (KEEL, BILGE, SIDE, DECK)),  # z up
        INNER[::-1],
    ],
)
def test_sections_that_cross_themselves_or_run_backwards_are_refused(section):
    StationsHull(stations=((-1.0, (KEEL, BILGE, SIDE, DECK)), (1.0, (KEEL, BILGE, SIDE, DECK))))
    StationsHull(stations=((-1.0, INNER), (1.0, INNER)))
    with pytest.raises(ValidationError, match="crosses itself or runs backwards"):
        StationsHull(stations=((-1.0, section), (1.0, section)))
