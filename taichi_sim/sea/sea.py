"""The sea: a table of wave components and what may be asked of it anywhere, at any time."""

from typing import NamedTuple

import numpy as np
import taichi as ti
import torch

from taichi_sim import runtime
from taichi_sim.config import SeaConfig
from taichi_sim.conventions import GRAVITY, OMEGA, PHASE, RHO_SEA, SEA_ROWS
from taichi_sim.sea import waves
from taichi_sim.sea.spectrum import Components, sample_components

NEWTON_ITERATIONS = 12  # queries are exact to rounding for seas, and for one wave of k a up to 0.99
TWO_PI = 2 * np.pi


class SteepSeaError(ValueError):
    """The sum of k a reaches 1: the Gerstner surface could loop through itself."""


class Surface(NamedTuple):
    """The free surface at horizontal points, all tensors of the points' shape [...] plus the last axis given.

    elevation [...] m, up; normal [..., 3] unit, NED, pointing out of the water (down component < 0);
    velocity [..., 3] of the surface particle, NED, m/s; label [..., 2] m; jacobian [...] of label -> position.
    """

    elevation: torch.Tensor
    normal: torch.Tensor
    velocity: torch.Tensor
    label: torch.Tensor
    jacobian: torch.Tensor


@ti.kernel
def _advance_phases(
    phase: ti.types.ndarray(ndim=2),
    omega64: ti.types.ndarray(dtype=ti.f64, ndim=2),
    phase64: ti.types.ndarray(dtype=ti.f64, ndim=2),
    env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
    time: ti.types.ndarray(dtype=ti.f64, ndim=1),
):
    for row in range(phase.shape[0]):
        s = env_sea[row]
        for c in range(phase.shape[1]):
            turns = (phase64[s, c] - omega64[s, c] * time[row]) * ti.f64(1.0 / TWO_PI)
            phase[row, c] = (turns - ti.floor(turns)) * ti.f64(TWO_PI)


@ti.kernel
def _query(
    out: ti.types.ndarray(ndim=2),
    points: ti.types.ndarray(ndim=2),
    phase: ti.types.ndarray(ndim=2),
    sea: ti.types.ndarray(ndim=3),
    env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
    count: ti.template(),
):
    for i in range(points.shape[0]):
        s, zero = env_sea[i], points[i, 0] * 0.0
        L = waves.invert_label(sea, phase, count, s, i, points[i, 0], points[i, 1], zero, NEWTON_ITERATIONS)
        j = waves.jacobian(sea, phase, count, s, i, L[0], L[1], zero)
        slope = waves.slope_at_label(sea, phase, count, s, i, L[0], L[1], zero)
        v = waves.surface_velocity(sea, phase, count, s, i, L[0], L[1], zero)
        out[i, 0] = waves.elevation_at_label(sea, phase, count, s, i, L[0], L[1], zero)
        out[i, 1], out[i, 2] = L[0], L[1]
        out[i, 3] = j[0] * j[2] - j[1] * j[1]
        out[i, 4], out[i, 5] = slope[0], slope[1]
        out[i, 6], out[i, 7], out[i, 8] = v[0], v[1], -v[2]


@ti.kernel
def _elevation(
    out: ti.types.ndarray(ndim=1),
    points: ti.types.ndarray(ndim=2),
    phase: ti.types.ndarray(ndim=2),
    sea: ti.types.ndarray(ndim=3),
    point_row: ti.types.ndarray(dtype=ti.i32, ndim=1),
    env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
    count: ti.template(),
):
    for i in range(points.shape[0]):
        row = point_row[i]
        s, zero = env_sea[row], points[i, 0] * 0.0
        L = waves.invert_label(sea, phase, count, s, row, points[i, 0], points[i, 1], zero, NEWTON_ITERATIONS)
        out[i] = waves.elevation_at_label(sea, phase, count, s, row, L[0], L[1], zero)


@ti.kernel
def _airy(
    out: ti.types.ndarray(ndim=2),
    points: ti.types.ndarray(ndim=2),
    phase: ti.types.ndarray(ndim=2),
    sea: ti.types.ndarray(ndim=3),
    depth: float,
    count: ti.template(),
):
    for i in range(points.shape[0]):
        zero = points[i, 0] * 0.0
        r = waves.airy_at(sea, phase, count, 0, i, points[i, 0], points[i, 1], -points[i, 2], depth, GRAVITY, zero)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = r[0], r[1], -r[2], r[3]


class Sea:
    """Sea realisations in one table; each environment points at one and has its own time.

    Attributes:
        table: [sea, 8, component], rows as in conventions.py, run precision.
        depth: m, or None for deep water.
    """

    def __init__(self, components: Components, depth: float | None = None):
        """Build the table.

        Args:
            components: arrays [sea, component].
            depth: water depth in m, None for deep.

        Raises:
            SteepSeaError: if any realisation's sum of k a coth(k depth) is 1 or more.
        """
        run = runtime.current()
        self.depth = depth
        self.components = components
        coth = 1.0 if depth is None else 1 / np.tanh(components.k * depth)
        b = components.amplitude * coth
        steepness = (components.k * b).sum(axis=1)
        if steepness.max(initial=0.0) >= 1.0:
            raise SteepSeaError(
                f"the sea is too steep to exist: sum of k a = {steepness.max():.2f} in realisation "
                f"{steepness.argmax()}, allowed below 1 (the surface would loop); lower sea.hs, raise sea.tp, "
                "or use fewer sea.components"
            )
        cos, sin = np.cos(components.direction), np.sin(components.direction)
        rows = np.stack(
            (components.amplitude, components.k * cos, components.k * sin, components.k, components.omega,
             components.phase, b * cos, b * sin),
            axis=1,
        )  # fmt: skip
        assert rows.shape[1] == SEA_ROWS
        self.table = torch.as_tensor(rows, dtype=run.torch_dtype, device=run.device).contiguous()
        # The frequencies that kernels use, in f64, so that phases agree with the table over any length of time.
        self._omega64 = self.table[:, OMEGA].double().contiguous()
        self._phase64 = torch.as_tensor(rows[:, PHASE], dtype=torch.float64, device=run.device).contiguous()

    @classmethod
    def from_config(cls, config: SeaConfig, seed: int) -> "Sea":
        """A sea from its configuration (a calm sea when hs is 0); `seed` draws the realisations."""
        components = sample_components(
            hs=config.hs,
            tp=config.tp,
            gamma_js=config.gamma_js,
            direction=float(np.deg2rad(config.direction_deg)),
            spreading_s=config.spreading_s,
            components=config.components,
            realisations=config.realisations,
            seed=seed,
        )
        return cls(components)

    @property
    def num_seas(self) -> int:
        """Number of realisations."""
        return self.table.shape[0]

    @property
    def num_components(self) -> int:
        """Components per realisation."""
        return self.table.shape[2]

    def mean_level(self, sea: int = 0) -> float:
        """Mean elevation (m) of a realisation: -sum k a b / 2 (troughs of Gerstner waves are wider)."""
        c = self.components
        coth = 1.0 if self.depth is None else 1 / np.tanh(c.k[sea] * self.depth)
        return float(-(c.k[sea] * c.amplitude[sea] ** 2 * coth).sum() / 2)

    def phases(self, env_sea: torch.Tensor, time: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
        """phase - omega t of every component, reduced to [0, 2 pi) in f64.

        Args:
            env_sea: int32 [row], the realisation of each row. time: float64 [row], s.
            out: [row, component] to write to, or None for a new tensor.
        """
        if out is None:
            out = self.table.new_empty((env_sea.shape[0], self.num_components))
        _advance_phases(out, self._omega64, self._phase64, env_sea, time)
        return out

    def surface(self, north, east, time, sea=0) -> Surface:
        """The surface at points [...] (m) and times (s); arguments broadcast, `sea` is the realisation."""
        points, env_sea, time64, shape = self._points((north, east), time, sea)
        raw = self.table.new_empty((points.shape[0], 9))
        _query(raw, points, self.phases(env_sea, time64), self.table, env_sea, self.num_components)
        slope = raw[:, 4:6]
        normal = torch.cat((-slope, -torch.ones_like(slope[:, :1])), dim=1)
        normal = normal / normal.norm(dim=1, keepdim=True)
        return Surface(
            raw[:, 0].reshape(shape),
            normal.reshape(*shape, 3),
            raw[:, 6:9].reshape(*shape, 3),
            raw[:, 1:3].reshape(*shape, 2),
            raw[:, 3].reshape(shape),
        )

    def elevation(self, north, east, time=0.0, sea=0) -> torch.Tensor:
        """Elevation zeta (m, up) at points [...] (m) and times (s); arguments broadcast."""
        return self.surface(north, east, time, sea).elevation

    def elevation_at(
        self, points: torch.Tensor, point_row: torch.Tensor, env_sea: torch.Tensor, phase: torch.Tensor
    ) -> torch.Tensor:
        """Elevation [point] at points [point, 2] whose sea and phases are rows of `env_sea` and `phase`."""
        out = self.table.new_empty(points.shape[0])
        _elevation(out, points.contiguous(), phase, self.table, point_row, env_sea, self.num_components)
        return out

    def elevation_grid(self, north, east, time: float = 0.0, sea: int = 0) -> np.ndarray:
        """Elevation (m, up) on the grid of two axes: array [len(north), len(east)] to plot or to record."""
        run = runtime.current()
        axes = [torch.as_tensor(np.asarray(a), dtype=run.torch_dtype, device=run.device) for a in (north, east)]
        mesh = torch.meshgrid(*axes, indexing="ij")
        points = torch.stack([m.reshape(-1) for m in mesh], dim=1).contiguous()
        env_sea = torch.tensor([sea], dtype=torch.int32, device=run.device)
        phase = self.phases(env_sea, torch.tensor([time], dtype=torch.float64, device=run.device))
        rows = torch.zeros(points.shape[0], dtype=torch.int32, device=run.device)
        return self.elevation_at(points, rows, env_sea, phase).reshape(mesh[0].shape).cpu().numpy()

    def airy(self, north, east, down, time) -> tuple[torch.Tensor, torch.Tensor]:
        """Linear-theory water velocity [..., 3] (NED, m/s) and dynamic pressure [...] (Pa) of realisation 0.

        `down` (m) is the depth of the point below mean sea level (>= 0).
        """
        points, env_sea, time64, shape = self._points((north, east, down), time, 0)
        raw = self.table.new_empty((points.shape[0], 4))
        depth = -1.0 if self.depth is None else self.depth
        _airy(raw, points, self.phases(env_sea, time64), self.table, depth, self.num_components)
        return raw[:, :3].reshape(*shape, 3), RHO_SEA * raw[:, 3].reshape(shape)

    def _points(self, coordinates, time, sea):
        """Broadcast coordinates, time and sea to flat contiguous tensors, and their common shape."""
        run = runtime.current()
        values = [torch.as_tensor(v, dtype=torch.float64) for v in (*coordinates, time, sea)]
        values = torch.broadcast_tensors(*values)
        shape = values[0].shape
        flat = [v.reshape(-1).to(run.device) for v in values]
        points = torch.stack(flat[:-2], dim=1).to(run.torch_dtype).contiguous()
        index = flat[-1].to(torch.int32).contiguous()
        if index.numel() and not (int(index.min()) >= 0 and int(index.max()) < self.num_seas):
            raise IndexError(f"sea index outside 0..{self.num_seas - 1}")
        return points, index, flat[-2].contiguous(), shape
