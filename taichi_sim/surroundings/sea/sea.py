"""The sea: a table of wave components, and queries at any place and time.

Realisations in one table may differ in height, period and direction. Not every pair of height and period can exist. A
drawn period is raised, for its realisation alone, until

    hs / (g tp^2 / 2 pi) <= 1/15   the steepest sea of DNV-RP-C205 (2010), sec. 3.5.4, for tp up to 8 s, and
    sum of k a < 0.98              with a margin to 1, where a Gerstner surface could loop.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from taichi_sim.config import SeaConfig, SwellConfig
from taichi_sim.config.arguments import whole_number
from taichi_sim.config.base import number, span
from taichi_sim.errors import UserError
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import AMPLITUDE, BX, BY, GRAVITY, KX, KY, OMEGA, PHASE, RHO_SEA, SEA_ROWS
from taichi_sim.surroundings.sea import query_kernels
from taichi_sim.surroundings.sea.measured import MeasuredSystem, WaveRecord, records_of
from taichi_sim.surroundings.sea.sampling import System, WaveSystem, draw_components
from taichi_sim.surroundings.sea.spectrum import Components, jonswap
from taichi_sim.surroundings.sea.wind_sea import SeaSize, sea_size, sea_state, swell_size

DEEP = -1.0  # value of the depth of deep water in kernels
STEEPEST = 1 / 15  # significant steepness
ROOM = 0.98  # limit of the sum of k a; the surface could loop from 1 on
TRIES = 8  # attempts with longer periods; in deep water without swell the first one suffices


class SteepSeaError(UserError, ValueError):
    """The sum of k a reaches 1, so that the Gerstner surface could loop through itself."""


class Surface(NamedTuple):
    """Free surface at horizontal points; each tensor has the points' shape [...] plus the axis given.

    Attributes:
        elevation: [...], m, up.
        normal: [..., 3], unit vector, NED, out of the water (its down component is negative).
        velocity: of the surface particle, [..., 3], NED, m/s.
        label: of the surface particle, [..., 2], m.
        jacobian: of the map from label to position, [...].
        acceleration: of the surface particle, [..., 3], NED, m/s^2.
    """

    elevation: torch.Tensor
    normal: torch.Tensor
    velocity: torch.Tensor
    label: torch.Tensor
    jacobian: torch.Tensor
    acceleration: torch.Tensor


class Kinematics(NamedTuple):
    """Orbital motion of the water at points [...]: velocity [..., 3] (m/s) and acceleration [..., 3] (m/s^2), NED."""

    velocity: torch.Tensor
    acceleration: torch.Tensor


def realised_systems(config: SeaConfig) -> list[Sequence[System]]:
    """Wave systems of each realisation; those of a measured sea take its records in turn."""
    if not config.measured:
        return [wave_systems(config)] * config.realisations
    each = [wave_systems(config, record=record) for record in records_of(config)]
    return [each[r % len(each)] for r in range(config.realisations)]


def wave_systems(
    config: SeaConfig, size: SeaSize | None = None, direction_deg: float | None = None, record: WaveRecord | None = None
) -> list[System]:
    """Wave systems of a configuration: its wind sea or measured sea, then its swell if it has one.

    Args:
        config: configuration of the sea.
        size, direction_deg: of the wind sea; default: those of the configuration.
        record: of a measured sea; default: the configuration's first.
    """
    gamma = config.gamma_js if config.spectrum == "jonswap" else 1.0
    heading = config.direction_deg if direction_deg is None else direction_deg
    systems: list[System] = []
    if config.measured:
        systems.append(MeasuredSystem(record or records_of(config)[0], config.components))
    else:
        systems.append(_system(config, size or sea_size(config), heading, gamma))
    if swell := config.swell:
        systems.append(_system(swell, swell_size(swell), swell.direction_deg, swell.gamma_js))
    return systems


def _system(config: SeaConfig | SwellConfig, size: SeaSize, direction_deg: float, gamma_js: float) -> WaveSystem:
    direction = float(np.deg2rad(direction_deg))
    density = partial(jonswap, hs=1.0, tp=size.tp, gamma_js=gamma_js)  # shape only, so that a calm sea has one, too
    return WaveSystem(density, size.hs, size.tp, direction, config.spreading_s, config.components)


class Sea:
    """Sea realisations in one table. Each environment uses one of them, at its own time.

    Attributes:
        table: [sea, 8, component], rows as in conventions.py, in run precision.
        depth: m, or None for deep water.
    """

    def __init__(self, components: Components, depth: float | None = None):
        """Build the table.

        Args:
            components: arrays [sea, component].
            depth: depth of the water, m; None for deep water.
        """
        run = runtime.current()
        self.depth = depth
        self.components = components
        b, steepness = components.semi_axis(depth), components.steepness(depth)
        if not steepness.max(initial=0.0) < 1.0:
            raise SteepSeaError(
                f"the sea is too steep to exist: sum of k a = {steepness.max():.2f} in realisation "
                f"{steepness.argmax()}, allowed below 1 (the surface would loop). Lower sea.hs (or sea.sea_state, "
                "sea.wind_speed, sea.swell.hs), raise sea.tp (or sea.fetch, sea.depth), or use fewer sea.components "
                "(the only remedy for a measured sea)"
            )
        cos, sin = np.cos(components.direction), np.sin(components.direction)
        rows = np.stack(
            (components.amplitude, components.k * cos, components.k * sin, components.k, components.omega,
             components.phase, b * cos, b * sin),
            axis=1,
        )  # fmt: skip
        assert rows.shape[1] == SEA_ROWS
        self.table = torch.as_tensor(rows, dtype=run.torch_dtype, device=run.device).contiguous()
        # f64 copies of the table's own frequencies, so that phases agree with the table over any length of time
        self._omega64 = self.table[:, OMEGA].double().contiguous()
        self._advance = runtime.Launcher(query_kernels.advance_phases)
        self._phase64 = torch.as_tensor(rows[:, PHASE], dtype=torch.float64, device=run.device).contiguous()

    def __repr__(self) -> str:
        """State the wave heights, the depth and the number of realisations."""
        hs, depth = self.components.hs, "deep water" if self.depth is None else f"{self.depth:g} m deep"
        codes = sorted({sea_state(float(x)) for x in (hs.min(), hs.max())})
        state = f"hs {span(hs, 'm')}, sea state {' to '.join(map(str, codes))}" if hs.any() else "calm"
        size = f"{number(self.num_seas, 'realisation')} of {number(self.num_components, 'component')}"
        return f"<Sea: {state}, {depth}, {size}>"

    def __reduce__(self) -> tuple[type["Sea"], tuple[Components, float | None]]:
        """Build it anew from its components, in another process or of a pickle."""
        return type(self), (self.components, self.depth)

    @classmethod
    def from_config(cls, config: SeaConfig, seed: int) -> "Sea":
        """Draw the sea of a configuration from `seed`; hs = 0 is a calm sea."""
        random = config.amplitudes == "random"
        systems = realised_systems(config)
        return cls(draw_components(systems, seed=seed, depth=config.depth, random_amplitudes=random), config.depth)

    @property
    def num_seas(self) -> int:
        """Number of realisations."""
        return self.table.shape[0]

    @property
    def num_components(self) -> int:
        """Number of components per realisation."""
        return self.table.shape[2]

    def mean_level(self, sea: int = 0) -> float:
        """Mean elevation (m) of a realisation, -sum k a b / 2: troughs of Gerstner waves are wider than crests."""
        c, sea = self.components, self._one(sea)
        coth = 1.0 if self.depth is None else 1 / np.tanh(c.k[sea] * self.depth)
        return float(-(c.k[sea] * c.amplitude[sea] ** 2 * coth).sum() / 2)

    def phases(self, env_sea: torch.Tensor, time: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
        """Return phase - omega t of every component, [row, component], reduced to [0, 2 pi) in f64.

        Args:
            env_sea: realisation of each row, int32 [row].
            time: float64 [row], s.
            out: [row, component] to write to; None for a new tensor.
        """
        launch, components = self._advance, self.num_components
        if out is None:
            launch, out = self._advance.once, self.table.new_empty((env_sea.shape[0], components))
        launch(env_sea, out, self._omega64, self._phase64, time, components)
        return out

    def waves_at(self, time: float, sea: int = 0) -> np.ndarray:
        """Return the waves of a realisation at `time` (s), [6, component], for drawing.

        The rows are amplitude (m), k_x, k_y (rad/m), phase at that time (rad, in [0, 2 pi)), b_x, b_y (m), as in
        gerstner.py.
        """
        device, sea = self.table.device, self._one(sea)
        which = torch.tensor([sea], dtype=torch.int32, device=device)
        phase = self.phases(which, torch.tensor([time], dtype=torch.float64, device=device))
        a, kx, ky, bx, by = self.table[sea, [AMPLITUDE, KX, KY, BX, BY]]
        return torch.stack((a, kx, ky, phase[0], bx, by)).double().cpu().numpy()

    def surface(self, north, east, time, sea=0) -> Surface:
        """Return the surface at points [...] (m) and times (s) of realisation `sea`; arguments broadcast."""
        points, env_sea, time64, shape = self._points((north, east), time, sea)
        raw = self.table.new_empty((points.shape[0], query_kernels.SURFACE_COLUMNS))
        query_kernels.surface(raw, points, self.phases(env_sea, time64), self.table, env_sea, self.num_components)
        slope = raw[:, query_kernels.SLOPE]
        normal = torch.cat((-slope, -torch.ones_like(slope[:, :1])), dim=1)
        normal = normal / normal.norm(dim=1, keepdim=True)
        return Surface(
            raw[:, query_kernels.HEIGHT].reshape(shape),
            normal.reshape(*shape, 3),
            raw[:, query_kernels.VELOCITY].reshape(*shape, 3),
            raw[:, query_kernels.LABEL].reshape(*shape, 2),
            raw[:, query_kernels.JACOBIAN].reshape(shape),
            raw[:, query_kernels.ACCELERATION].reshape(*shape, 3),
        )

    def elevation(self, north, east, time=0.0, sea=0) -> torch.Tensor:
        """Elevation zeta (m, up) at points [...] (m) and times (s) of realisation `sea`; arguments broadcast."""
        return self.surface(north, east, time, sea).elevation

    def elevation_at(
        self, points: torch.Tensor, point_row: torch.Tensor, env_sea: torch.Tensor, phase: torch.Tensor
    ) -> torch.Tensor:
        """Elevation [point] (m, up) at points [point, 2]; point_row [point]: its row in `env_sea` and `phase`."""
        return query_kernels.elevations(self.table, points, point_row, env_sea, phase)

    def elevation_grid(self, north, east, time: float = 0.0, sea: int = 0) -> np.ndarray:
        """Elevation (m, up) of the sea surface on a grid, to plot, record or export.

        Args:
            north, east: axes of the grid, m, any sequences of numbers.
            time: s.
            sea: realisation.

        Returns:
            NumPy array [len(north), len(east)]; `heights[i, j]` is at (north[i], east[j]). For scattered points use
            `elevation`; for normals, velocities and accelerations use `surface`.
        """
        run = runtime.current()
        axes = [torch.as_tensor(np.asarray(a), dtype=run.torch_dtype, device=run.device) for a in (north, east)]
        mesh = torch.meshgrid(*axes, indexing="ij")
        points = torch.stack([m.reshape(-1) for m in mesh], dim=1).contiguous()
        env_sea = torch.tensor([self._one(sea)], dtype=torch.int32, device=run.device)
        phase = self.phases(env_sea, torch.tensor([time], dtype=torch.float64, device=run.device))
        rows = torch.zeros(points.shape[0], dtype=torch.int32, device=run.device)
        return self.elevation_at(points, rows, env_sea, phase).reshape(mesh[0].shape).cpu().numpy()

    def airy(self, north, east, down, time) -> tuple[torch.Tensor, torch.Tensor]:
        """Velocity [..., 3] (NED, m/s) and dynamic pressure [...] (Pa) of realisation 0 by linear wave theory.

        `down` (m, >= 0) is the depth of the point below mean sea level.
        """
        points, env_sea, time64, shape = self._points((north, east, down), time, 0)
        raw = self.table.new_empty((points.shape[0], query_kernels.AIRY_COLUMNS))
        query_kernels.airy(
            raw, points, self.phases(env_sea, time64), self.table, self.kernel_depth, self.num_components
        )
        velocity, pressure = raw[:, query_kernels.AIRY_VELOCITY], raw[:, query_kernels.AIRY_PRESSURE]
        return velocity.reshape(*shape, 3), RHO_SEA * pressure.reshape(shape)

    def pressure(self, north, east, down, time, sea=0) -> torch.Tensor:
        """Gauge pressure [...] (Pa), hydrostatic plus dynamic; 0 at the instantaneous surface and above it.

        Arguments broadcast: `down` (m) counts from mean sea level (negative in a crest), `sea` is the realisation. The
        theory is stretched linear theory (gerstner.py). Below the bottom the pressure continues hydrostatically.
        """
        raw, shape = self._column(north, east, down, time, sea)
        return RHO_SEA * GRAVITY * raw[:, query_kernels.COLUMN_PRESSURE].reshape(shape)

    def kinematics(self, north, east, down, time, sea=0) -> Kinematics:
        """Orbital velocity and acceleration of the water, from the instantaneous surface to the bottom.

        Arguments are those of `pressure`. At and above the surface the result is that of the surface particle.
        """
        raw, shape = self._column(north, east, down, time, sea)
        velocity, acceleration = raw[:, query_kernels.COLUMN_VELOCITY], raw[:, query_kernels.COLUMN_ACCELERATION]
        return Kinematics(velocity.reshape(*shape, 3), acceleration.reshape(*shape, 3))

    @property
    def kernel_depth(self) -> float:
        """Depth (m) as kernels take it; DEEP for deep water."""
        return DEEP if self.depth is None else self.depth

    def _column(self, north, east, down, time, sea) -> tuple[torch.Tensor, torch.Size]:
        points, env_sea, time64, shape = self._points((north, east, down), time, sea)
        raw = self.table.new_empty((points.shape[0], query_kernels.COLUMN_COLUMNS))
        phase = self.phases(env_sea, time64)
        query_kernels.column(raw, points, phase, self.table, env_sea, self.kernel_depth, self.num_components)
        return raw, shape

    def _points(self, coordinates, time, sea):
        """Broadcast coordinates, time and sea to flat contiguous tensors; also return their common shape."""
        run = runtime.current()
        values = [torch.as_tensor(v, dtype=torch.float64) for v in (*coordinates, time, sea)]
        values = torch.broadcast_tensors(*values)
        shape = values[0].shape
        flat = [v.reshape(-1).to(run.device) for v in values]
        points = torch.stack(flat[:-2], dim=1).to(run.torch_dtype).contiguous()
        if not torch.equal(flat[-1], flat[-1].round()):
            raise ValueError("sea: numbers of realisations are whole")
        index = flat[-1].to(torch.int32).contiguous()
        self.check(index)
        return points, index, flat[-2].contiguous(), shape

    def _one(self, sea: int) -> int:
        """The number of a realisation."""
        sea = whole_number(sea, "sea")
        self.check(torch.tensor([sea]))
        return sea

    def check(self, env_sea: torch.Tensor) -> None:
        """Refuse numbers [n] of realisations that do not exist."""
        if env_sea.numel():
            least, most = map(int, env_sea.aminmax())
            if least < 0 or most >= self.num_seas:
                raise IndexError(f"sea {least if least < 0 else most}: there are 0 to {self.num_seas - 1}")


def varied_components(
    config: SeaConfig, hs: np.ndarray, tp: np.ndarray, direction_deg: np.ndarray, seed: int
) -> tuple[Components, np.ndarray]:
    """Draw components of realisations like `config`, each with its own wind sea; also return their periods.

    hs (m), tp (s) and direction_deg describe the wind seas, [realisation]. Periods too short for their height are
    raised. Realisation r depends on `seed`, its own numbers and r alone.
    """
    tp = np.maximum(tp, np.sqrt(2 * math.pi * hs / (GRAVITY * STEEPEST)))
    for _ in range(TRIES):
        sizes = [SeaSize(float(height), float(period)) for height, period in zip(hs, tp, strict=True)]
        systems = [wave_systems(config, *each) for each in zip(sizes, map(float, direction_deg), strict=True)]
        random = config.amplitudes == "random"
        components = draw_components(systems, seed=seed, depth=config.depth, random_amplitudes=random)
        over = components.steepness(config.depth) / ROOM
        if not (over >= 1).any():
            break
        tp = np.where(over >= 1, tp * np.sqrt(over) * (1 + 1e-9), tp)
    return components, tp
