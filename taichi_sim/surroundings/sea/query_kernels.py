"""Kernels of `Sea`. Each evaluates gerstner.py at every row of a tensor of points.

`sea` is the table of conventions.py. `phase` and `env_sea` have one row per point unless a kernel says otherwise.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import math

import taichi as ti
from torch import Tensor

from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN, EAST, GRAVITY, NORTH
from taichi_sim.kernels.runtime import array1, array2, array3, whole1
from taichi_sim.surroundings.sea import gerstner

NEWTON_ITERATIONS = 12  # exact to rounding for seas, and for a single wave of k a up to 0.99
TWO_PI = 2 * math.pi
SURFACE_COLUMNS, COLUMN_COLUMNS, AIRY_COLUMNS = 12, 7, 4
# Columns of `surface`: elevation, label, Jacobian, slope, velocity, acceleration
HEIGHT, LABEL, JACOBIAN, SLOPE, VELOCITY, ACCELERATION = 0, slice(1, 3), 3, slice(4, 6), slice(6, 9), slice(9, 12)
COLUMN_PRESSURE, COLUMN_VELOCITY, COLUMN_ACCELERATION = 0, slice(1, 4), slice(4, 7)  # columns of `column`
AIRY_VELOCITY, AIRY_PRESSURE = slice(0, 3), 3  # columns of `airy`


@ti.kernel
def advance_phases(
    env_sea: whole1, phase: array2, omega64: ti.types.ndarray(dtype=ti.f64, ndim=2),
    phase64: ti.types.ndarray(dtype=ti.f64, ndim=2), time: ti.types.ndarray(dtype=ti.f64, ndim=1), count: ti.template(),
):  # fmt: skip
    """Write phase - omega t of every component of every row, in [0, 2 pi)."""
    ti.loop_config(serialize=runtime.loop.serial)
    for row in range(phase.shape[0]):
        s = env_sea[row]
        for c in range(count):
            turns = (phase64[s, c] - omega64[s, c] * time[row]) * ti.f64(1.0 / TWO_PI)
            phase[row, c] = (turns - ti.floor(turns)) * ti.f64(TWO_PI)


@ti.kernel
def surface(out: array2, points: array2, phase: array2, sea: array3, env_sea: whole1, count: ti.template()):
    """Elevation, label (2), Jacobian, slope (2), velocity (3, NED), acceleration (3, NED) at points [point, 2]."""
    for i in range(points.shape[0]):
        s, zero = env_sea[i], points[i, NORTH] * 0.0
        L = gerstner.invert_label(sea, phase, count, s, i, points[i, NORTH], points[i, EAST], zero, NEWTON_ITERATIONS)
        j = gerstner.jacobian(sea, phase, count, s, i, L[0], L[1], zero)
        slope = gerstner.slope_at_label(sea, phase, count, s, i, L[0], L[1], zero)
        v, a = gerstner.surface_motion(sea, phase, count, s, i, L[0], L[1], zero)
        out[i, HEIGHT] = gerstner.elevation_at_label(sea, phase, count, s, i, L[0], L[1], zero)
        out[i, JACOBIAN] = j[0] * j[2] - j[1] * j[1]
        for k in ti.static(range(2)):
            out[i, LABEL.start + k], out[i, SLOPE.start + k] = L[k], slope[k]
        for k in ti.static(range(3)):
            out[i, VELOCITY.start + k], out[i, ACCELERATION.start + k] = v[k], a[k]


@ti.kernel
def elevation(
    out: array1, points: array2, phase: array2, sea: array3, point_row: whole1, env_sea: whole1, count: ti.template(),
):  # fmt: skip
    """Elevation at points [point, 2]; point_row [point] is each point's row in `phase` and `env_sea`."""
    ti.loop_config(serialize=runtime.loop.serial)
    for i in range(points.shape[0]):
        row = point_row[i]
        s, zero = env_sea[row], points[i, NORTH] * 0.0
        L = gerstner.invert_label(sea, phase, count, s, row, points[i, NORTH], points[i, EAST], zero, NEWTON_ITERATIONS)
        out[i] = gerstner.elevation_at_label(sea, phase, count, s, row, L[0], L[1], zero)


_elevation = runtime.Launcher(elevation, few=runtime.LARGE)


def elevations(sea: Tensor, points: Tensor, point_row: Tensor, env_sea: Tensor, phase: Tensor) -> Tensor:
    """Elevation [point] (m, up) at points [point, 2]; point_row [point] (int32): row in `env_sea` and `phase`."""
    out, components = sea.new_empty(points.shape[0]), sea.shape[2]
    _elevation.once(out, points.contiguous(), phase, sea, point_row, env_sea, components)
    return out


@ti.kernel
def column(
    out: array2, points: array2, phase: array2, sea: array3, env_sea: whole1, depth: float, count: ti.template()
):
    """Gauge pressure over rho g (m), velocity (3) and acceleration (3), NED, at points [point, 3] (NED)."""
    for i in range(points.shape[0]):
        s, zero, z = env_sea[i], points[i, NORTH] * 0.0, -points[i, DOWN]
        L = gerstner.invert_label(sea, phase, count, s, i, points[i, NORTH], points[i, EAST], zero, NEWTON_ITERATIONS)
        zeta = gerstner.elevation_at_label(sea, phase, count, s, i, L[0], L[1], zero)
        below = gerstner.stretched(z, zeta, depth)
        r = gerstner.column_at_label(sea, phase, count, s, i, L[0], L[1], below, depth, zero)
        v, a = ti.Vector([r[1], r[2], -r[3]]), ti.Vector([r[4], r[5], -r[6]])
        out[i, COLUMN_PRESSURE] = ti.max(r[0] - z, 0.0) * ti.cast(z < zeta, float)
        for k in ti.static(range(3)):
            out[i, COLUMN_VELOCITY.start + k], out[i, COLUMN_ACCELERATION.start + k] = v[k], a[k]


@ti.kernel
def airy(out: array2, points: array2, phase: array2, sea: array3, depth: float, count: ti.template()):
    """Linear velocity (3, NED) and dynamic pressure over rho, in realisation 0, at points [point, 3] (NED)."""
    for i in range(points.shape[0]):
        zero = points[i, NORTH] * 0.0
        x, y, z = points[i, NORTH], points[i, EAST], -points[i, DOWN]
        r = gerstner.airy_at(sea, phase, count, 0, i, x, y, z, depth, GRAVITY, zero)
        r[2] = -r[2]  # down
        for k in ti.static(range(3)):
            out[i, AIRY_VELOCITY.start + k] = r[k]
        out[i, AIRY_PRESSURE] = r[3]
