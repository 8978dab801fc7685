"""Colours of the sea: light baked into its points, fading towards the horizon."""

import numpy as np

from taichi_sim.recording.episode import Array
from taichi_sim.recording.sea_grid import SeaGrid

LEVEL = 4.0  # colours (0 to 255) are rounded to this, so that the file compresses well
FADE_SHARE = 0.15  # width of the border in which the light of the waves fades, over the side
SUN_ENU = np.array([-0.45, -0.35, 0.82]) / np.linalg.norm([-0.45, -0.35, 0.82])
DEEP = np.array([12.0, 62.0, 92.0])
CREST = np.array([58.0, 142.0, 158.0])
FOAM = np.array([222.0, 234.0, 236.0])
HAZE = np.array([168.0, 196.0, 214.0])  # the horizon, and the sky behind it


def light(up: Array, cell: float, scale: float) -> Array:
    """Colours [side, side, 3] of elevations `up` [north, east], m; `scale` is a tall crest's height, m."""
    slope_n, slope_e = np.gradient(up, cell)
    normal = np.stack([-slope_e, -slope_n, np.ones_like(up)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    diffuse = np.clip(normal @ SUN_ENU, 0.0, 1.0) / SUN_ENU[2]
    height = np.clip(0.5 + 0.5 * up / scale, 0.0, 1.0)[..., None]
    colour = (DEEP + height * (CREST - DEEP)) * (0.2 + 0.8 * diffuse[..., None] ** 3)
    foam = np.clip(up / scale - 0.85, 0.0, 0.3)[..., None] / 0.3
    return colour + 0.6 * foam * (FOAM - colour)


def patch_colours(grid: SeaGrid, lights: list[Array]) -> Array:
    """Colours [N, 3] of the patch's points, in their order, from the `lights` of its squares; they fade towards the
    border.
    """
    flat = 0.5 * (DEEP + CREST)
    inside = np.minimum(np.arange(grid.cells + 1), np.arange(grid.cells, -1, -1)) / (FADE_SHARE * grid.cells)
    fade = np.clip(np.minimum(inside[:, None], inside), 0.0, 1.0)[..., None]
    coarse = flat + fade * (lights[0] - flat)
    fine = [one.reshape(-1, 3) for one in lights[1:]]
    rings = [np.broadcast_to(shade, (len(grid.rim), 3)) for shade in (flat, HAZE)]
    waves = np.concatenate([coarse.reshape(-1, 3)[grid.shown], *fine])
    return np.concatenate([flat + np.round((waves - flat) / LEVEL) * LEVEL, *rings])
