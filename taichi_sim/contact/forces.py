"""The force of one sole on a deck: a spring and a damper along the normal, Coulomb friction that sticks or slips.

With the depth d (m) of a sole below the deck's plane, its speed d' into it, its displacement s (m, in the plane) from
where it was set down and its velocity v (m/s, in the plane), all relative to the deck's own point there,

    N = max(0, k d + c d'),    |k s| <= mu N,    f = -k s - c v,  |f| <= mu N.

A contact pushes and never pulls. Friction is elastic until it slips: s is what the sole has been bent by, and the point
where it was set down follows a sole that slips (Cundall and Strack 1979, A discrete numerical model for granular
assemblies, Geotechnique 29:47-65). So a sole that sticks does not creep, at whatever speed the deck moves. With N
constant, friction takes energy and never gives: f v + k s v <= 0.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti

SMALLEST = 1e-12  # m or N, below which a length or a force has no direction


@ti.func
def shortened(a, most):
    """The plane vector a, at most so long."""
    length = ti.sqrt(a[0] * a[0] + a[1] * a[1])
    return a * ti.select(length > most, most / ti.max(length, SMALLEST), 1.0)


@ti.func
def sole_force(depth, sinking, bent, sliding, stiffness, damping, friction):
    """Normal force N (N) of a sole `depth` (m) in the deck, friction [2] (N), and what it stays bent by [2] (m).

    sinking: speed into the deck, m/s. bent: displacement [2] from where it was set down, m. sliding: velocity [2], m/s.
    """
    N = ti.max(stiffness * depth + damping * sinking, 0.0)
    left = shortened(bent, friction * N / stiffness)
    return N, shortened(-stiffness * left - damping * sliding, friction * N), left
