"""`hull_6dof`: a USV in six degrees of freedom by Fossen's vectorial model, on the instantaneous surface of the water.

    M nu_dot = M nu_c_dot + M_a nu_o_dot + tau - C_rb (nu - nu_c) - C_a(nu_r) nu_r - D(nu_r) nu_r,   M = M_rb + M_a

with nu_r = nu - nu_c - nu_o. nu_c is the current (constant in n), nu_o the orbital motion of the waves averaged over
the hull. Added mass and damping act on the motion relative to the water; this represents radiation and diffraction
(Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 6, 8 and 10; Faltinsen 1990, Sea Loads on
Ships and Offshore Structures, ch. 3). tau is the sum of thrust, wind, external loads and restoring:

- `restoring = "panels"`: weight, and pressure on panels of the hull under the instantaneous surface, hydrostatic plus
  Froude-Krylov. With `hydrodynamics.radiation = "memory"`, radiation and diffraction come from a boundary-element code.
- `restoring = "linear"`: -G eta of the source, for comparison with published codes.

A hull is composed of parts. Each is a module of functions that kernels inline, with a table of compile-time numbers:

    water.py                      mean surface plane, orbital motion, current        HullGeometry.gauge
                                  hydrostatic and Froude-Krylov load                 water.Pressure
    radiation.py                  radiation and diffraction                          Radiation
    thruster_set.py               from action to thrust                              ThrusterSet
    mmg_drive.py                  instead: propellers and rudders, polynomial        MmgDrive
    motion.py                     other loads, auxiliary state, equations of motion, integrators, start on the waves
    params.py                     `p`: the numbers that may differ between vehicles
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportOptionalCall=false

import math
import weakref
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from taichi.lang.argpack import ArgPack
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.errors import named
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.conventions import EAST, ELEVATION, FREEBOARD, NORTH, QW
from taichi_sim.kernels.lanes import laned, laned1, laned3, vectors
from taichi_sim.kernels.packs import AroundPack, Build, FleetPack, load_at, own_numbers
from taichi_sim.kernels.position import move
from taichi_sim.kernels.rigid_body import angular, linear
from taichi_sim.kernels.rotation import quaternion_advance, rotation_matrix, store
from taichi_sim.kernels.runtime import array2, array3, whole1
from taichi_sim.models.usv.hull import mmg_drive, motion, thruster_set, water
from taichi_sim.models.usv.hull.geometry import HullGeometry, device_table
from taichi_sim.models.usv.hull.hydrostatic_stability import check_floats
from taichi_sim.models.usv.hull.mmg_drive import MmgDrive
from taichi_sim.models.usv.hull.motion import largest_stable_dt, linear_motion, runge_kutta_step, strang_step
from taichi_sim.models.usv.hull.params import (
    Hull6DofParams,
    hull_numbers,
    mass_followed,
    symmetric,
    varying_keys,
    vector,
)
from taichi_sim.models.usv.hull.radiation import radiation_of
from taichi_sim.models.usv.hull.thruster_set import ThrusterSet
from taichi_sim.models.usv.vessel_base import Number, Vessel, steady_speed
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits, UnstableStepError

__all__ = ["Hull6Dof", "Hull6DofParams"]

TablesPack = ti.types.argpack(
    panels=laned1,
    corners=laned1,
    node=whole1,
    lines=array2,
    deck=array2,
    filters=laned1,
    diffraction=laned1,
)
"""Tables of the parts: panels, their corners, the columns of the heads that they read, and wave lines (water.py);
corners of the deck (geometry.py); filters of the memory, and diffraction in one sea (radiation.py)."""
LIKE_PANELS, LIKE_DIAGONAL = (0.7, 1.4), (0.3, 2.0)  # sizes of the file over those of the panels; assumed
KEPT = 4  # number of seas, and of steps in each, for which a model keeps tables
SeaKey = tuple[int, int, tuple[int, ...]]  # address, version and shape of a sea's tensor


@ti.data_oriented
class Hull6Dof(Vessel):
    """Steps a team of hulls in place (see the module's docstring).

    Actions [env, vehicle, action] are in [-1, 1]. Their meaning depends on `actions`:

    - "surge_yaw" (acceleration, yaw), for two propellers: surge force from 0 to full thrust, as in the paper, and yaw
      moment to either side by differential thrust. The latter changes the surge force if a propeller is at its limit.
    - "left_right", for two propellers: shaft speed of each, from n_min to n_max.
    - "wrench" (surge, sway, yaw): force and moment as shares of the largest of each alone, distributed to the thrusters
      (thruster_set.py). A wrench beyond their limits is reduced to the largest one in the same direction.
    - "units": speed of each thruster, from n_min to n_max, then the angle of each azimuth thruster, over its range.
    - "propeller_rudder", with [mmg]: revolutions of each propeller, from -n_astern to n_ahead, and rudder angle, to
      port and to starboard.

    Controls are the speeds of the thrusters (rad/s), then the angles of the azimuth thrusters (rad); with [mmg], the
    revolutions (1/s) and the rudder angle (rad).

    Attributes:
        geometry, pressure, radiation, thrusters: the parts.
        drive: the module with the functions of `thrusters`.
        gauge: gauge of the geometry.
        by_panels: whether `restoring = "panels"`.
        wrench_max, wrench_min: X, Y (N), N (N m) of the actions 1 and -1, with `actions = "wrench"`.
    """

    Params = Hull6DofParams
    file_keys = ("hydrodynamics.database",)
    free_step = True

    def __init__(self, params: Hull6DofParams, dt: float, substeps: int):
        """Mesh the hull; check that it floats and that dt (s) is stable."""
        super().__init__(params, dt, substeps)
        body = params.rigid_body
        self.deck, self.by_panels = params.deck, params.restoring == "panels"
        self.geometry = HullGeometry.of(params.hull, body.mass, body.cg)
        self.gauge = self.geometry.gauge
        self._check_sizes()
        if self.by_panels:
            with named("hull: ", ConfigError, ValueError):
                check_floats(self.geometry.hydrostatics)
        if params.mmg is None:
            self.thrusters, self.drive = ThrusterSet(params, dt, motion.CONTROLS), thruster_set
        else:
            self.thrusters, self.drive = MmgDrive(params.mmg, motion.CONTROLS), mmg_drive
        self.aux_names = (*motion.AUX, *self.thrusters.columns)
        self.pressure = water.Pressure.of(self.geometry, len(self.aux_names))
        self.radiation = radiation_of(params, self.geometry, dt, substeps, self.pressure.end)
        self.aux_size = self.pressure.end + self.radiation.columns
        self.action_names, self.control_names = self.thrusters.action_names, self.thrusters.control_names
        self.backs, self.helm_max = self.thrusters.backs, self.thrusters.helm_max
        self.signals, self.varying = self.thrusters.signals, varying_keys(params)
        if self.thrusters.allocation is not None:
            self.wrench_max, self.wrench_min = self.thrusters.allocation.largest, self.thrusters.allocation.smallest
        limit = self.longest_step = self.largest_dt()
        if dt > limit:
            raise UnstableStepError(
                f"dt = {dt} s is unstable for this hull: the largest stable step is {limit:.3g} s (its stiffest motion "
                "in heave, roll or pitch, or its fastest decay); lower dt"
            )
        # packs of the running Taichi program, with their sea: a later one may lie at the same address
        self._tables: dict[
            SeaKey | None, tuple[weakref.ref[Tensor] | None, Mapping[str, Tensor], dict[float, ArgPack]]
        ] = {}  # fmt: skip
        self._generation = -1
        self._float, self._label = (
            runtime.Launcher(kernel, few=0) for kernel in (motion.float_on_waves, motion.find_label)
        )

    def _check_sizes(self) -> None:
        """Refuse sizes of the file that are not those of its panels: wind, thrusters and collisions count with them."""
        p, corners = self.params, self.geometry.panels.corners.reshape(-1, 3)
        length, beam = np.ptp(corners, axis=0)[:2]
        half = math.hypot(length, beam) / 2
        for key, value, own, (least, most) in (
            ("length", p.length, length, LIKE_PANELS), ("beam", p.beam, beam, LIKE_PANELS),
            ("collision_radius", p.collision_radius, half, LIKE_DIAGONAL),
        ):  # fmt: skip
            if not least * own <= value <= most * own:
                of = "half their diagonal" if own is half else "that of the panels"
                allowed = f"{least * own:.3g} to {most * own:.3g}"
                raise ConfigError(f"{key} = {value:g} m: allowed are {allowed}, for {of} is {own:.3g} m")

    @classmethod
    def following(cls, data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keys of a vehicle file with `changes`; a published M_rb follows mass and CG."""
        return mass_followed(data, changes)

    # -- numbers that vary -----------------------------------------------------------------------------------------

    def own(self, values: Mapping[str, Number]):
        """Compute the kernel's numbers (params.py) from `values`."""
        return hull_numbers(self.params, self.radiation, self.dt, values)

    def mobility(self, fleet: Fleet) -> Tensor:
        """Inverse [6, 6] of rigid-body inertia plus instantaneous added mass, from each vehicle's numbers."""
        one = fleet.state.new_ones(fleet.state.shape[:2] if fleet.varied else (1, 1)).double()
        rows = symmetric(fleet.own, "inverse")
        return torch.stack([torch.stack([one * x for x in row], dim=-1) for row in rows], dim=-2)

    # -- what it is ------------------------------------------------------------------------------------------------

    @property
    def capsize_cosine(self) -> float:
        """Cosine of the tilt beyond which the hull no longer rights itself."""
        if not self.by_panels:
            return 0.0
        return math.cos(min(self.geometry.hydrostatics.angle_of_vanishing_stability, math.pi / 2))

    @property
    def limits(self) -> Limits:
        """Limits of the hull; the top speed is that at which damping equals the whole thrust, if it has thrusters."""
        h, mmg = self.params.hydrodynamics, self.params.mmg
        if mmg is not None:
            return Limits((0.0, 0.0, mmg.steady_speed(h.linear[0], h.quadratic[0])))
        if not self.thrusters:
            return Limits()
        force = sum(t.ahead for t in self.thrusters.thrusters)
        return Limits((0.0, 0.0, steady_speed(force, h.linear[0], h.quadratic[0])))

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64] | None:
        """Return the actions of a helmsman (thruster_set.py, mmg_drive.py); None for single thrusters."""
        return self.thrusters.steer(ahead, helm)

    def power(self, fleet: Fleet) -> Tensor | None:
        """Power of the thrusters, [env, vehicle], W; None without thrusters."""
        return self.thrusters.power(fleet)

    @property
    def draft(self) -> float:
        """Deepest point of the hull below CO, m."""
        return self.geometry.panels.draft

    @property
    def slow_mass(self) -> np.ndarray:
        """Mass matrix [6, 6] (kg, kg m, kg m^2) of slow motion about CO, with added mass; the mass that a
        controller moves.
        """
        return self.params.M_rb + self.radiation.inertia + self.radiation.memory.slow_inertia

    @property
    def wind_height(self) -> float:
        """Height above the sea of the wind that acts on the hull, m."""
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
        """Load arrows of a recording: name -> (point of attack (m, b), columns of its x, y and z (N, b))."""
        origin = (0.0, 0.0, 0.0)
        return {
            "pressure_less_weight": (origin, ("pressure_x", "pressure_y", "pressure_z")),
            **self.thrusters.arrows,
            "drag": (origin, ("drag_x", "drag_y", "drag_z")),
            "wind": ((0.0, 0.0, -self.params.windage.height), ("wind_x", "wind_y", "wind_z")),
        }

    def body(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [4 N, 3] (m, b) and triangles [2 N, 3] of the panels, counter-clockwise from outside."""
        return self.geometry.panels.surface()

    def largest_dt(self) -> float:
        """Largest stable step, s."""
        p, M = self.params, self.params.M_rb + self.radiation.inertia
        h, speed = p.hydrodynamics, self.top_speed
        D = np.diag(np.array(h.linear) + np.array(h.quadratic) * np.array([speed, speed, speed, 1.0, 1.0, 1.0]))
        if p.mmg is not None and p.mmg.hull is not None:
            d, L = p.mmg.hull, p.mmg.length
            scale = 0.5 * p.mmg.density * L * p.mmg.draft * speed
            D[(0, 1, 5), (0, 1, 5)] = scale * 2 * d.R_0, scale * abs(d.Y_v), scale * L**2 * abs(d.N_r)
        if p.linear is None or self.by_panels:
            D = np.maximum(D - np.diag(self.radiation.counted), 0.0)
            G = self.geometry.hydrostatics.stiffness()
            step = partial(strang_step, modes=self.radiation.memory.modes, inverse=np.linalg.inv(M))
        else:
            g = p.linear
            G, step = np.array([[g.G33, 0, g.G35], [0, g.G44, 0], [g.G35, 0, g.G55]]), runge_kutta_step
        return largest_stable_dt(linear_motion(M, D, G), step)

    @property
    def top_speed(self) -> float:
        """Steady speed (m/s) under full thrust in calm water; 0 without thrusters."""
        h, mmg = self.params.hydrodynamics, self.params.mmg
        if mmg is not None:
            return mmg.steady_speed(h.linear[0], h.quadratic[0])
        if not self.thrusters:
            return 0.0
        a, b = h.quadratic[0], h.linear[0]
        force = sum(gain * t.ahead for gain, t in zip(self.params.gains, self.thrusters.thrusters, strict=True))
        return force / b if a == 0 else (math.sqrt(b * b + 4 * a * force) - b) / (2 * a)

    # -- beginning -------------------------------------------------------------------------------------------------

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """States [n, vehicle, 13] of hulls afloat on the waves of `around`, so that their first step is calm.

        `state` is a placement on level, still water: its heights are above the water, its velocities through the water.
        The hulls are raised and tilted with the mean surface plane below them. The current, and the orbital motion of
        the water averaged over the hull, are added to their velocity. `surface` [n, vehicle, 2] is written.
        """
        state, deck = state.contiguous(), device_table(self.geometry.deck_corners)
        out = torch.empty_like(state)
        with vectors():
            self._float.once(self, out, surface, state, deck, around.pack, self.water_build(around))
        return out

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Stop the propellers, and find the label of the water under the hull."""
        aux.zero_()
        with vectors():
            self._label.once(self, aux, state.contiguous(), around.pack, self.water_build(around))

    # -- moving ----------------------------------------------------------------------------------------------------

    def water_build(self, around: Surroundings) -> Build:
        """Compile-time options of a kernel that evaluates the water alone."""
        return Build(around.sea.shape[2], around.depth > 0)

    def tables(self, around: Surroundings | None = None, dt: float | None = None) -> ArgPack:
        """Return the hull's TablesPack for steps of `dt` (s; default: the model's), the same object in every step in
        the sea of `around`; without a sea, without diffraction.
        """
        if self._generation != runtime.generation():
            self._tables, self._generation = {}, runtime.generation()
        sea = None if around is None else self.radiation.sea(around)
        key, dt = None if sea is None else (sea.data_ptr(), sea._version, tuple(sea.shape)), dt or self.dt
        of, tables, packs = self._tables.get(key, (None, None, {}))
        if tables is None or (of is not None and of() is not sea):
            if len(self._tables) >= KEPT:
                self._tables.pop(next(iter(self._tables)))
            g = self.geometry
            tables, packs = {
                "panels": water.by_block(water.panel_table(g)),
                "corners": water.by_block(water.corner_table(g)),
                "node": device_table(self.pressure.column(g.lines.node)).int(),
                "lines": device_table(water.line_table(g)),
                "deck": device_table(g.deck_corners),
                **self.radiation.tables(sea),
            }, {}  # fmt: skip
            self._tables[key] = (None if sea is None else weakref.ref(sea)), tables, packs
        if dt not in packs:
            if len(packs) >= KEPT:
                packs.pop(next(iter(packs)))
            packs[dt] = runtime.pack(TablesPack, **tables, filters=self.radiation.filter_table(dt))
        return packs[dt]

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance by one control step."""
        with vectors():
            fleet.launch(self._step, fleet.pack, around.pack, self.tables(around, fleet.dt), self.build(fleet, around))

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, tables: TablesPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            self.advance(own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, tables, e, i)

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(),
        tables: ti.template(), e, i,
    ):  # fmt: skip
        """Advance vehicle i of environment e by one control step; `p` holds its numbers."""
        state, aux = ti.static(fleet.state, fleet.aux)
        pos, q, nu = motion.unpack(ti.Vector([state[e, i, c] for c in range(13)]))
        nu_dot, R = ti.Vector([aux[e, i, motion.NU_DOT + c] for c in range(6)]), rotation_matrix(q)
        controls = self.drive.controls_at(self.thrusters, aux, e, i)
        command = self.drive.commanded(self.thrusters, p, fleet.action, e, i, controls)
        D = ti.Vector([aux[e, i, motion.LABEL], aux[e, i, motion.LABEL + 1]])
        change = ti.Vector([aux[e, i, motion.LABEL_CHANGE], aux[e, i, motion.LABEL_CHANGE + 1]])
        V_c = ti.Vector([around.current[e, NORTH], around.current[e, EAST], 0.0])
        air = taken2(around.wind, e, 3)
        outside = load_at(build, fleet.load, e, i)
        start, way = pos, pos * 0.0
        plane = ti.Vector([pos[0] * 0.0, 0.0, 0.0])
        sums = ti.Vector([pos[0] * 0.0 for _ in range(water.SUMS)])
        tau_D, rate_D, bend_D = nu * 0.0, nu * 0.0, nu * 0.0  # diffraction load and its rates (radiation.py)
        up, blown = nu * 0.0, nu * 0.0
        for n in range(self.substeps):
            tau = (n + 0.5) * p.dt
            if ti.static(self.by_panels):  # the half turns of this step and the last one are made as one
                turn = ti.select(n == 0, 0.5 * p.dt, p.dt)
                way, q, R = motion.drift(p.dt, way, q, nu, turn)
                pos = start + way
            else:
                middle_way, _q, R = motion.drift(p.dt, way, q, nu, 0.5 * p.dt)
                pos = start + middle_way
            sums, L, J = water.at(self.gauge, build, around, e, tau, pos, R, D + change)
            D_next = L - ti.Vector([pos[0], pos[1]])
            fresh = D.norm_sqr() + change.norm_sqr() == 0.0  # without a last step there is no change
            change = ti.select(fresh, 0.0, 1.0) * (D_next - D)
            D = D_next
            plane = water.mean_plane(sums, R)
            middle = nu + 0.5 * p.dt * nu_dot  # with linear restoring, nu_dot is zero
            blown = motion.wind_load(self.params.windage.height, p, R, middle, air)
            if ti.static(self.by_panels):
                up = water.pressure_load(
                    self.pressure, build, around, tables, fleet.lanes, e, i, tau, pos, R, L, J, plane
                )
                up += motion.weight_load(p.weight, ti.static(vector(p, "cg", 3)), motion.down(R))
                now = self.drive.lagged(self.thrusters, p, controls, command, 0.5)
                driven = self.drive.load(self.thrusters, p, now)
                tau_D, rate_D, bend_D = self.radiation.diffraction_from(
                    p.dt, build, around, tables, e, n, tau, R, middle, L, change, tau_D, rate_D, bend_D
                )
                driven += self.radiation.diffraction_load(p.dt, n, tau_D, rate_D, bend_D)
                driven += self.radiation.memory_load(p.dt, tables, fleet.lanes, e, i, R, nu, nu_dot, V_c)
                driven = up + driven + blown + outside
                way, nu, nu_dot = motion.kick(self, p, way, nu, nu_dot, R, driven, now, V_c, sums)
            else:
                y = motion.pack(way, q, nu)
                way, q, nu = motion.runge_kutta(self, p, start[2], y, controls, command, blown + outside, V_c, sums)
                R = rotation_matrix(q)
            pos = start + way
            controls = self.drive.lagged(self.thrusters, p, controls, command, 1.0)
        if ti.static(self.by_panels):
            q = quaternion_advance(q, angular(nu), 0.5 * p.dt)
            R = rotation_matrix(q)
        store(fleet.derived, e, i, R, R @ linear(nu))
        y = motion.pack(pos, q, nu)
        move(fleet, e, i, start, way, [y[c] for c in ti.static(range(QW, 13))])
        nu_r, nu_m = motion.through_water(self, nu, R, V_c, sums)
        drag = linear(motion.damping_load(self.params.hydrodynamics, p, nu_r, nu_m))
        motion.note(aux, e, i, D, change, nu_dot, linear(up), drag, linear(blown))
        self.drive.note(self.thrusters, p, aux, e, i, controls, nu_r)
        fleet.surface[e, i, ELEVATION] = plane[0]
        fleet.surface[e, i, FREEBOARD] = water.freeboard(tables.deck, R, pos[2], plane)

    # -- loads and accelerations without a step ----------------------------------------------------------------------

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13]; the wind is that at `wind_height`."""
        out = torch.empty_like(state)
        no_waves = laned(state.new_zeros((len(state), 1, self.aux_size)))
        with vectors():
            self._rhs(out, state, controls, current, wind, load, no_waves, self.tables())
        return out

    @ti.kernel
    def _rhs(
        self, out: array2, state: array2, controls: array2, current: array2, wind_n: array2, load: array2,
        no_waves: laned3, tables: TablesPack,
    ):  # fmt: skip
        for n in range(state.shape[0]):
            y = ti.Vector([state[n, c] for c in range(13)])
            pos, q, nu = motion.unpack(y)
            R = rotation_matrix(q)
            V_c, air = ti.Vector([current[n, NORTH], current[n, EAST], 0.0]), taken2(wind_n, n, 3)
            calm = ti.Vector([y[0] * 0.0 for _ in range(water.SUMS)])
            p, height = ti.static(self.constants, self.params.windage.height)
            tau = ti.Vector([load[n, c] for c in range(6)]) + motion.wind_load(height, p, R, nu, air)
            now = ti.Vector([controls[n, c] for c in ti.static(range(len(self.control_names)))])
            tau += self.drive.load(self.thrusters, p, now)
            if ti.static(self.by_panels):
                tau += water.panel_load(self.pressure, tables, no_waves, n, 0, pos[2], R, linear(calm))
                tau += motion.weight_load(p.weight, ti.static(vector(p, "cg", 3)), motion.down(R))
            else:
                tau += motion.linear_load(self.params.linear, p, pos[2], R, calm)
            dy = motion.derivative(self, p, y, R, tau, now, V_c, calm)
            for c in ti.static(range(13)):
                out[n, c] = dy[c]

    def pressure_load(self, state: Tensor, around: Surroundings) -> Tensor:
        """Hydrostatic plus Froude-Krylov load [env, vehicle, 6] (N, N m, about CO, b) on hulls at `state` [env,
        vehicle, 13].

        The waves are those of `around` at the beginning of a step.
        """
        state = state.contiguous()
        out = state.new_empty((*state.shape[:2], 6))
        aux = state.new_zeros((*state.shape[:2], self.aux_size))
        with vectors():
            self._pressure_load(out, state, laned(aux), around.pack, self.tables(), self.water_build(around))
        return out

    @ti.kernel
    def _pressure_load(
        self, out: array3, state: array3, rows: laned3, around: AroundPack, tables: TablesPack, build: ti.template(),
    ):  # fmt: skip
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos, q, _nu = motion.unpack(ti.Vector([state[e, i, c] for c in range(13)]))
            R, now = rotation_matrix(q), pos[0] * 0.0
            D = water.displacement(self.gauge, build, around, e, pos, R)
            sums, L, J = water.at(self.gauge, build, around, e, now, pos, R, D)
            plane = water.mean_plane(sums, R)
            load = water.pressure_load(self.pressure, build, around, tables, rows, e, i, now, pos, R, L, J, plane)
            for c in ti.static(range(6)):
                out[e, i, c] = load[c]
