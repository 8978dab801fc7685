"""What a `hull_6dof` is before it moves: its tables, limits and the numbers that its kernels compile in."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti
import torch
from torch import Tensor

from taichi_sim import runtime
from taichi_sim.config import ConfigError
from taichi_sim.conventions import GRAVITY
from taichi_sim.fleet import Fleet
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull.database import HydroDatabase, hull_hash
from taichi_sim.usv.hull.diffraction import Diffraction
from taichi_sim.usv.hull.geometry import HullGeometry
from taichi_sim.usv.hull.hydrostatics import check_floats
from taichi_sim.usv.hull.numbers import hull_numbers, varying_keys
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.hull.radiation import Radiation
from taichi_sim.usv.hull.stability import largest_stable_dt, linear_motion, remembering, runge_kutta_step
from taichi_sim.usv.hull.thruster_set import ThrusterSet
from taichi_sim.usv.vessel import Vessel, steady_speed
from taichi_sim.vehicle import Limits

# Columns of the auxiliary state: displacement of the label under the hull and its change in a step (m); forces of the
# last step in b (N) and its nu_dot (m/s^2, rad/s^2); then what the thrusters do (thruster_set.py); then the wave's
# pressure head (m) at each point of the wave lines, and its change across them (m/m); then the states of the
# radiation's memory.
AUX = (
    "label_north", "label_east", "label_change_north", "label_change_east",
    "pressure_x", "pressure_y", "pressure_z", "drag_x", "drag_y", "drag_z",
    "wind_x", "wind_y", "wind_z",
    "u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot",
)  # fmt: skip
LABEL, LABEL_CHANGE, PRESSURE, DRAG, WIND, NU_DOT = map(  # where each begins
    AUX.index, ("label_north", "label_change_north", "pressure_x", "drag_x", "wind_x", "u_dot")
)
CONTROLS = len(AUX)  # the thrusters' first column

TablesPack = ti.types.argpack(
    panels=ti.types.ndarray(ndim=1),
    node=ti.types.ndarray(dtype=ti.i32, ndim=1),
    lines=ti.types.ndarray(ndim=2),
    deck=ti.types.ndarray(ndim=2),
    filters=ti.types.ndarray(ndim=1),
    thrown=ti.types.ndarray(ndim=3),
)
"""A hull's tables (geometry.py): panels (flat), the column of each panel's head in aux, pairs of wave lines, deck; the
numbers of the memory's filters (memory.py); for one sea, the loads of diffraction (diffraction.py)."""
DEEP_ENOUGH = 4.0  # draughts: shallower water than this is not deep to a hull; assumed
DEPTH_RATIO = 1.25  # of the water to a database's own depth, either way; assumed
SEAS = 4  # for which a model keeps tables


class HullModel(Vessel):
    """Numbers of one hull at one step; holds no state of any vehicle."""

    Params = Hull6DofParams
    file_keys = ("hydrodynamics.database",)

    def __init__(self, params: Hull6DofParams, dt: float, substeps: int):
        """Mesh the hull, check that it floats and that dt (s) is stable.

        Raises:
            ConfigError: if the hull does not float upright, or dt is too large.
        """
        super().__init__(params, dt, substeps)
        self.thrusters = ThrusterSet(params, dt, CONTROLS)
        self.action_names, self.control_names = self.thrusters.action_names, self.thrusters.control_names
        self.signals = self.thrusters.signals
        self.aux_names = (*AUX, *self.thrusters.columns)
        self.head = len(self.aux_names)  # columns before those of the pressure heads
        if self.thrusters.allocation is not None:
            self.wrench_max, self.wrench_min = self.thrusters.allocation.largest, self.thrusters.allocation.smallest
        self.varying = varying_keys(params)
        body = params.rigid_body
        self.geometry = HullGeometry.of(params.hull, body.mass, body.cg)
        self.gauge, self.points = self.geometry.gauge, self.geometry.lines.points
        self.nodes = len(self.geometry.lines.start) * self.points
        self.database: HydroDatabase | None = None
        self.stretch = 1  # steps for which diffraction is summed once
        self.courses = 0  # of the table of diffraction
        self.radiation = Radiation.constant(params.hydrodynamics.added_mass)
        self.by_panels, self.has_linear = params.restoring == "panels", params.linear is not None
        self.source: Any = params.linear  # None: no published restoring
        if self.by_panels:
            try:
                check_floats(self.geometry.hydrostatics)
            except ValueError as error:
                raise ConfigError(f"hull: {error}") from None
        if params.remembers:
            self._take_database(Path(str(params.hydrodynamics.database)))
        self.filters = self.radiation.memory.modes.bank(dt)
        self.aux_size = self.head + 2 * self.nodes + 2 * self.filters.size
        self.payload = params.linear.payload_mass * GRAVITY if params.linear else 0.0
        self._check_dt(dt)
        self._tables: dict[Any, Any] = {}  # packs of the running Taichi program, by sea
        self._generation = -1

    def _take_database(self, file: Path) -> None:
        """Radiation and diffraction of a boundary-element database.

        Raises:
            ConfigError: if it is not this hull's, or lacks what is asked for.
        """
        database, own = HydroDatabase.read(file), hull_hash(self.geometry.panels)
        if database.hull != own:
            raise ConfigError(
                f"hydrodynamics.database = {file.name!r} is of another hull (its hash is {database.hull}, this hull's "
                f"{own}): make it anew with tools/hydrodynamics.py"
            )
        if database.by_panels is None or (self.params.hydrodynamics.drift and database.drift is None):
            lacks = "the panels' own excitation" if database.by_panels is None else "mean drift"
            raise ConfigError(f"{file}: has no table of {lacks}: make it anew with tools/hydrodynamics.py")
        stiffness = self.geometry.hydrostatics.stiffness()
        try:
            self.radiation = Radiation.of(database, self.params.M_rb, stiffness)
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from None
        self.database, self._diffraction = database, Diffraction(database, self.params.hydrodynamics.drift)
        self.stretch = min(self._diffraction.stretch(self.dt), self.substeps)
        self.courses = self._diffraction.courses

    @property
    def remembers(self) -> bool:
        """Whether radiation and diffraction are those of a database."""
        return self.params.remembers

    def _check_depth(self, around: Surroundings) -> None:
        """Refuse water that the database is not of."""
        assert self.database is not None
        ours, water = self.database.depth, around.depth if around.depth > 0 else None
        if ours is None and (water is None or water >= DEEP_ENOUGH * self.draft):
            return
        if ours is not None and water is not None and 1 / DEPTH_RATIO <= water / ours <= DEPTH_RATIO:
            return
        of_water = "deep" if water is None else f"{water:g} m deep"
        of_data = "deep water" if ours is None else f"water of {ours:g} m"
        raise ConfigError(
            f"sea.depth: the water is {of_water}, the hydrodynamic database of the hull is of {of_data} (deep counts "
            f"from {DEEP_ENOUGH:g} draughts, {DEEP_ENOUGH * self.draft:.3g} m, on; another depth within 25 %): make "
            'one with tools/hydrodynamics.py --depth, or set hydrodynamics.radiation = "constant"'
        )

    # -- numbers that vary -----------------------------------------------------------------------------------------

    def own(self, values: Mapping[str, Any]) -> Any:
        """What the kernel works with (numbers.py)."""
        return hull_numbers(self.params, self.radiation, self.dt, values)

    def with_numbers(self, values: Mapping[str, float]) -> Hull6DofParams:
        """The `Params` of a vehicle file that differs from this one in `values`; a published M_rb follows mass and CG
        (rigid_body.changed_mass).

        Raises:
            ValueError: for a key that does not vary, or a value that the file could not hold.
        """
        params = super().with_numbers(values)
        return params.model_copy(update={"rigid_body": self.params.rigid_body.changed(params.rigid_body)})

    # -- what it is ------------------------------------------------------------------------------------------------

    @property
    def capsize_cosine(self) -> float:
        """Cosine of the tilt from which the hull no longer rights itself."""
        if not self.by_panels:
            return 0.0
        return math.cos(min(self.geometry.hydrostatics.angle_of_vanishing_stability, math.pi / 2))

    @property
    def limits(self) -> Limits:
        """Its top speed is where damping takes all the thrust, if it has thrusters."""
        h = self.params.hydrodynamics
        if not self.thrusters:
            return Limits()
        force = sum(t.ahead for t in self.thrusters.thrusters)
        return Limits((0.0, 0.0, steady_speed(force, h.linear[0], h.quadratic[0])))

    def power(self, fleet: Fleet) -> Tensor | None:
        """Of its thrusters [env, vehicle], W; None without any."""
        return self.thrusters.power(fleet)

    @property
    def draft(self) -> float:
        """Deepest point of the hull below CO, m."""
        return self.geometry.panels.draft

    @property
    def slow_mass(self) -> np.ndarray:
        """Mass [6, 6] (kg, kg m, kg m^2) of slow motion about CO, added mass included: what a controller moves."""
        memory = self.radiation.memory
        return self.params.M_rb + self.radiation.inertia + memory.slow_inertia

    @property
    def wind_height(self) -> float:
        """Height above the sea at which the hull feels the wind, m."""
        return self.params.windage.height

    @property
    def deck_height(self) -> float:
        """Lowest height of the deck above CO, m."""
        return -float(self.geometry.panels.deck[:, 2].max())

    @property
    def panels(self) -> int:
        """Number of panels whose pressure is integrated."""
        return len(self.geometry.panels) if self.by_panels else 0

    @property
    def forces(self) -> Mapping[str, tuple[tuple[float, float, float], tuple[str | None, str | None, str | None]]]:
        """Load arrows of a recording: name -> where it attacks (m, b), columns of its x, y, z (N, b)."""
        origin = (0.0, 0.0, 0.0)
        found: dict[str, Any] = {"pressure_less_weight": (origin, ("pressure_x", "pressure_y", "pressure_z"))}
        found |= self.thrusters.arrows
        found["drag"] = (origin, ("drag_x", "drag_y", "drag_z"))
        found["wind"] = ((0.0, 0.0, -self.params.windage.height), ("wind_x", "wind_y", "wind_z"))
        return found

    def body(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [4 N, 3] (m, b) and triangles [2 N, 3], counter-clockwise from outside, of the panels."""
        return self.geometry.panels.surface()

    # -- steps -----------------------------------------------------------------------------------------------------

    def largest_dt(self) -> float:
        """Largest stable step, s."""
        p = self.params
        h, speed = p.hydrodynamics, self.top_speed
        D = np.diag(np.array(h.linear) + np.array(h.quadratic) * np.array([speed, speed, speed, 1.0, 1.0, 1.0]))
        if self.by_panels:
            G, M = self.geometry.hydrostatics.stiffness(), p.M_rb + self.radiation.inertia
            D = np.maximum(D - np.diag(self.radiation.counted), 0.0)
            step = remembering(self.radiation.memory.modes, M)
        else:
            g = self.source
            G, step = np.array([[g.G33, 0, g.G35], [0, g.G44, 0], [g.G35, 0, g.G55]]), runge_kutta_step
        return largest_stable_dt(linear_motion(p.M_rb + self.radiation.inertia, D, G), step)

    @property
    def top_speed(self) -> float:
        """Steady speed (m/s) under full thrust in calm water; 0 without thrusters."""
        h = self.params.hydrodynamics
        if not self.thrusters:
            return 0.0
        a, b = h.quadratic[0], h.linear[0]
        force = sum(gain * t.ahead for gain, t in zip(self.params.gains, self.thrusters.thrusters, strict=True))
        return force / b if a == 0 else (math.sqrt(b * b + 4 * a * force) - b) / (2 * a)

    def _check_dt(self, dt: float) -> None:
        limit = self.largest_dt()
        if dt > limit:
            raise ConfigError(
                f"dt = {dt} s is unstable for this hull: the largest stable step is {limit:.3g} s (its stiffest motion "
                "in heave, roll or pitch, or its fastest decay); lower dt"
            )

    def tables(self, around: Surroundings | None = None) -> Any:
        """What kernels take of the hull: a TablesPack, the same object from step to step in the sea of `around`; for no
        sea, without diffraction.

        Raises:
            ConfigError: for water that the hydrodynamic database is not of.
        """
        if self._generation != runtime.generation():
            self._tables, self._generation = {}, runtime.generation()
        sea = around.sea if around is not None and self.remembers else None
        key = None if sea is None else (sea.data_ptr(), sea._version, tuple(sea.shape))
        if key not in self._tables:
            if around is not None and sea is not None:
                self._check_depth(around)
            if len(self._tables) >= SEAS:
                self._tables.pop(next(iter(self._tables)))
            self._tables[key] = self._made_tables(sea)
        return self._tables[key]

    def _made_tables(self, sea: Tensor | None) -> Any:
        run, geometry = runtime.current(), self.geometry

        def table(values: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(values), dtype=run.torch_dtype, device=run.device)

        thrown = table(np.zeros((1, 1, 1))) if sea is None else self._diffraction.of(sea)
        return runtime.pack(
            TablesPack,
            panels=table(geometry.panel_table.ravel()),
            node=torch.as_tensor(geometry.lines.node + self.head, dtype=torch.int32, device=run.device),
            lines=table(geometry.line_table),
            deck=table(geometry.deck_corners),
            filters=table(np.append(self.filters.numbers, 0.0)),  # an array has at least one
            thrown=thrown,
        )
