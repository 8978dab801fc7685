"""Restoring loads besides the pressure on the panels (pressure.py): the weight, or a published restoring matrix.

The weight m g acts at the centre of gravity. With `restoring = "linear"` there are no panels. The load is then

    -G eta,   eta = (heave, roll, pitch) relative to the mean surface plane (water.py),

with G of the source (Fossen 2021, sec. 4.2), plus the weight's component down the slope of that plane. It also has the
payload's weight if the source adds it (PythonVehicleSimulator's otter). Loads are in N and N m about CO, in b.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import GRAVITY
from taichi_sim.kernels.rigid_body import cross, six
from taichi_sim.usv.hull import water


@ti.func
def down(R):
    """Unit vector downwards, in b."""
    return ti.Vector([R[2, 0], R[2, 1], R[2, 2]])


@ti.func
def weight_load(weight: ti.template(), position: ti.template(), k):
    """Load of a weight (N) at `position` (three numbers, m, b); k is the unit vector downwards in b."""
    force = weight * k
    return six(force, cross(ti.Vector([position[0], position[1], position[2]]), force))


@ti.func
def linear_load(source: ti.template(), p: ti.template(), z, R, sums):
    """Load of linear restoring at the depth z (m) of CO.

    `source` is the LinearRestoring section, `sums` come from water.at.
    """
    along, across = sums[water.ALONG], sums[water.ACROSS]
    heave = z + sums[water.ELEVATION]
    roll = ti.atan2(R[2, 1], R[2, 2]) + across
    pitch = ti.asin(ti.max(ti.min(-R[2, 0], 1.0), -1.0)) - along
    Z = -source.G33 * heave - source.G35 * pitch
    M = -source.G55 * pitch - source.G35 * heave
    K = -source.G44 * roll
    load = ti.Vector([-p.weight * along, -p.weight * across, Z, K, M, 0.0])
    load += weight_load(ti.static(source.payload_mass * GRAVITY), source.payload_position, down(R))
    return load
