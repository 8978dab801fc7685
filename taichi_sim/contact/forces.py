"""Force of one sole on a deck: a spring and a damper along the normal, and Coulomb friction that sticks or slips.

The sole is at depth d (m) below the deck's plane, and sinks at the speed d'. It has the displacement s (m, in the
plane) from the point where it was set down, and the velocity v (m/s, in the plane). All are relative to the deck's
point there.

    N = max(0, k d + c d'),    |k s| <= mu N,    f = -k s - c v,  |f| <= mu N.

A contact pushes and never pulls. Friction is elastic until the sole slips: s is the elastic displacement, and the point
where the sole was set down follows a sole that slips (Cundall and Strack 1979, A discrete numerical model for granular
assemblies, Geotechnique 29:47-65). A sole that sticks therefore does not creep, however fast the deck moves. With
constant N friction only takes energy: f v + k s v <= 0.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti

SMALLEST = 1e-12  # m or N; a shorter vector has no direction


@ti.func
def shortened(a, most):
    """The plane vector a, shortened to a length of at most `most`."""
    length = ti.sqrt(a[0] * a[0] + a[1] * a[1])
    return a * ti.select(length > most, most / ti.max(length, SMALLEST), 1.0)


@ti.func
def sole_force(depth, sinking, bent, sliding, stiffness, damping, friction):
    """Return the normal force N (N), the friction [2] (N), and the remaining elastic displacement [2] (m) of one sole.

    depth: of the sole below the deck's plane, m. sinking: its rate, m/s. bent: displacement [2] from the point where
    the sole was set down, m. sliding: velocity [2] in the plane, m/s.
    """
    N = ti.max(stiffness * depth + damping * sinking, 0.0)
    left = shortened(bent, friction * N / stiffness)
    return N, shortened(-stiffness * left - damping * sliding, friction * N), left
