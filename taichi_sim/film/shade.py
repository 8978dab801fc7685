"""Light that reaches the eye along a ray: sky, water, painted surfaces, haze. Colours are RGB from 0 to 1.

Water reflects the sky by Schlick's approximation of Fresnel's equations (Schlick 1994, 0.02 at normal incidence) and
shows its own colour in the rest. Waves too short for the grid make it rough (`rough`, mean square slope); without them
the far sea would be a mirror. Surfaces take sunlight by Lambert's law and skylight from above.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import taichi as ti
from taichi.math import vec3

from taichi_sim.recording.sea_patch import CREST, DEEP, FOAM, HAZE, SUN_ENU

SUN_NED = vec3(SUN_ENU[1], SUN_ENU[0], -SUN_ENU[2])  # towards the sun
HORIZON, ZENITH = vec3(*(HAZE / 255.0)), vec3(0.30, 0.50, 0.74)
WARM = vec3(1.0, 0.95, 0.82)  # colour of sunlight
ABYSS, SHALLOW, WHITE = (vec3(*(colour / 255.0)) for colour in (DEEP, CREST, FOAM))
F0 = 0.02  # reflectance of water at normal incidence
SHINE = 7  # doublings: the exponent of the sun's glitter is 2 ** SHINE
FOAM_FROM = 0.9  # height over that of a tall crest, above which there is foam


@ti.func
def sky(ray: vec3):
    """Colour of the sky along the unit vector `ray`."""
    up = ti.max(-ray.z, 0.0)
    glow = ti.max(ray.dot(SUN_NED), 0.0)
    glow *= glow
    glow *= glow
    return ti.math.mix(HORIZON, ZENITH, ti.sqrt(up)) + 0.12 * glow * glow * WARM


@ti.func
def hazy(colour: vec3, distance, half):
    """`colour` seen through haze at `distance` (m); at the distance `half` (m) the haze gives half of the light."""
    far = distance * distance
    return ti.math.mix(colour, HORIZON, far / (far + half * half))


@ti.func
def water(ray: vec3, normal: vec3, rough, height):
    """Colour of the sea along the unit vector `ray`; `height` is 1 on a tall crest and -1 in a trough."""
    facing = ti.max(-ray.dot(normal), 0.0)
    facing = ti.sqrt(facing * facing + 0.35 * rough)
    graze = 1.0 - ti.min(facing, 1.0)
    g2 = graze * graze
    mirror = F0 + (1.0 - F0) * g2 * g2 * graze
    bounced = ray + 2.0 * ti.max(-ray.dot(normal), 0.0) * normal
    bounced.z = -ti.sqrt(bounced.z * bounced.z + 0.5 * rough)  # rough water mirrors the sky at a higher elevation
    bounced = bounced.normalized()
    glitter = ti.max(bounced.dot(SUN_NED), 0.0)
    for _ in ti.static(range(SHINE)):
        glitter *= glitter
    lit = ti.max(normal.dot(SUN_NED), 0.0)
    own = ti.math.mix(ABYSS, SHALLOW, ti.math.clamp(0.32 + 0.3 * height, 0.0, 1.0)) * (0.25 + 0.95 * lit * lit)
    foam = 0.3 * ti.math.clamp((height - FOAM_FROM) / 0.8, 0.0, 1.0)
    own = ti.math.mix(own, WHITE, foam)
    return ti.math.mix(own, sky(bounced), mirror) + 0.25 * glitter * WARM


@ti.func
def painted(colour: vec3, normal: vec3):
    """Colour of a dull surface in sunlight and skylight."""
    sun = ti.max(normal.dot(SUN_NED), 0.0)
    return colour * ((0.42 - 0.14 * normal.z) + 0.62 * sun * WARM)
