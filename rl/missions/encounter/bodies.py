"""Own ships and ships of traffic as hulls in the plane: rectangles, their gaps, and their tracks as others know."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from enum import IntEnum

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.kernels.rotation import torch_heading
from taichi_sim.vehicle import Vehicle


class Body(IntEnum):
    """Columns of a body: place (m), velocity (m/s), NED; heading; length and beam (m)."""

    NORTH, EAST, V_NORTH, V_EAST, COS, SIN, LENGTH, BEAM = range(8)


class Track(IntEnum):
    """Columns of a body's track as another knows it: estimates; age of the last measurement (s), below 0 if there is no
    track; covariance of place, both, velocity; time (s) until the next report.
    """

    NORTH, EAST, V_NORTH, V_EAST, LENGTH, BEAM, AGE, P_PP, P_PV, P_VV, NEXT, SIZE = range(12)


def bodies_of(own: Fleet[Vehicle], ships: Fleet[Vehicle]) -> Tensor:
    """The bodies [env, own ships and ships, Body], own ships first."""
    rows = []
    for fleet in (own, ships):
        psi = torch_heading(fleet.quaternion_nb)
        size = sizes_of(fleet)
        flat = torch.cat((fleet.position_n[..., HORIZONTAL], fleet.velocity_n[..., HORIZONTAL]), dim=-1)
        rows.append(torch.cat((flat, psi.cos().unsqueeze(-1), psi.sin().unsqueeze(-1), size), dim=-1))
    return torch.cat(rows, dim=1)


def sizes_of(fleet: Fleet[Vehicle]) -> Tensor:
    """Length and beam [env, vehicle, 2] (m) of vehicles, which may differ from their file's."""
    length, beam, _ = fleet.model.size
    size = fleet.state.new_tensor([length, beam]).expand(*fleet.state.shape[:2], 2)
    if "length" in fleet.model.varying and fleet.varied:
        size = size * (fleet.vary["length"].to(size) / length).unsqueeze(-1)
    return size


@ti.func
def to_rectangle(p, at, c, s, length, beam):
    """Distance (m) of point p from a rectangle at `at` with heading (c, s); 0 inside."""
    d = p - at
    x = ti.max(ti.abs(c * d[0] + s * d[1]) - 0.5 * length, 0.0)
    y = ti.max(ti.abs(c * d[1] - s * d[0]) - 0.5 * beam, 0.0)
    return ti.sqrt(x * x + y * y)


@ti.func
def corner(k: ti.template(), at, c, s, length, beam):
    """Corner k of a rectangle."""
    x, y = ti.static(0.5 - k // 2) * length, ti.static(0.5 - k % 2) * beam
    return at + ti.Vector([c * x - s * y, s * x + c * y])


@ti.func
def spans(d, c, s, length, beam):
    """Half the width of a rectangle with heading (c, s) along the direction d."""
    return 0.5 * (length * ti.abs(d[0] * c + d[1] * s) + beam * ti.abs(d[1] * c - d[0] * s))


@ti.func
def rectangle_gap(a, ac, as_, al, ab, b, bc, bs, bl, bb):
    """Gap (m) between two rectangles: 0 where they touch or overlap.

    Two convex bodies that do not overlap are nearest at a corner of one of them; they overlap if no side separates
    them.
    """
    gap = a[0] * 0.0 + 1e9
    for k in ti.static(range(4)):
        gap = ti.min(gap, to_rectangle(corner(k, a, ac, as_, al, ab), b, bc, bs, bl, bb))
        gap = ti.min(gap, to_rectangle(corner(k, b, bc, bs, bl, bb), a, ac, as_, al, ab))
    apart, between = 0, b - a
    for k in ti.static(range(4)):
        c, s = ti.static((ac, as_) if k < 2 else (bc, bs))
        d = ti.Vector([c, s])
        if ti.static(k % 2 == 1):
            d = ti.Vector([-s, c])
        if ti.abs(between.dot(d)) > spans(d, ac, as_, al, ab) + spans(d, bc, bs, bl, bb):
            apart = 1
    return ti.select(apart == 1, gap, 0.0)
