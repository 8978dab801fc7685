"""Shapes of formations: closed forms, numbers on sides, and no two vehicles nearer than the spacing."""

import math
from typing import get_args

import pytest
import torch

from rl.guidance.shapes import SHAPES, Shape, formation_offsets, lane_half_width

H = 10 * math.sqrt(0.5)
FIVE = {  # ahead and to starboard, 10 m apart
    "abreast": [(0, 0), (0, 10), (0, -10), (0, 20), (0, -20)],
    "astern": [(0, 0), (-10, 0), (-20, 0), (-30, 0), (-40, 0)],
    "wedge": [(0, 0), (-H, H), (-H, -H), (-2 * H, 2 * H), (-2 * H, -2 * H)],
    "echelon": [(0, 0), (-H, H), (-2 * H, 2 * H), (-3 * H, 3 * H), (-4 * H, 4 * H)],
    "pairs": [(0, 0), (0, 10), (-10, 0), (-10, 10), (-20, 0)],
}
CIRCLES = {  # a pair, an equilateral triangle, a square on its corner
    2: [(0, 0), (-10, 0)],
    3: [(0, 0), (-5 * math.sqrt(3), 5), (-5 * math.sqrt(3), -5)],
    4: [(0, 0), (-H, H), (-H, -H), (-2 * H, 0)],
}


def test_every_shape_has_its_closed_form():
    assert set(SHAPES) == set(get_args(Shape))
    wanted = [(shape, 5, places) for shape, places in FIVE.items()]
    wanted += [("circle", count, places) for count, places in CIRCLES.items()]
    for shape, count, places in wanted:
        offsets = formation_offsets(shape, count, 10.0)
        torch.testing.assert_close(offsets, torch.tensor(places, dtype=torch.float64), msg=f"{shape} of {count}")


@pytest.mark.parametrize("shape", SHAPES)
def test_neighbours_are_a_spacing_apart_and_nobody_is_nearer(shape):
    for count in range(1, 17):
        offsets = formation_offsets(shape, count, 15.0)
        assert offsets.shape == (count, 2) and not offsets[0].any()
        if count > 1:
            apart = torch.cdist(offsets, offsets) + 1e3 * torch.eye(count, dtype=torch.float64)
            assert apart.amin(dim=1).min() > 15.0 - 1e-9
            assert apart[0].min() < 15.0 + 1e-9  # somebody is next to the leader


def test_a_circle_is_one_and_its_foremost_place_is_the_leaders():
    for count in range(2, 17):
        offsets = formation_offsets("circle", count, 15.0)
        centre = offsets.mean(dim=0)
        radius = (offsets - centre).norm(dim=1)
        torch.testing.assert_close(radius, torch.full_like(radius, 7.5 / math.sin(math.pi / count)))
        assert (offsets[1:, 0] < 0).all()


@pytest.mark.parametrize("shape", ["abreast", "wedge", "circle"])
def test_two_sides_mirror_each_other_with_odd_numbers_to_starboard(shape):
    offsets = formation_offsets(shape, 15, 15.0)
    torch.testing.assert_close(offsets[1::2] * torch.tensor([1.0, -1.0]), offsets[2::2])
    assert (offsets[1::2, 1] > 0).all()


def test_the_lane_is_that_of_the_widest_shape():
    assert lane_half_width(SHAPES, 9, 10.0) == pytest.approx(80 * math.sqrt(0.5))  # an echelon's last
    assert lane_half_width(("astern",), 9, 10.0) == 0.0
