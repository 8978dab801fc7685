"""The contract of a vehicle model: everything that World, missions, recordings and tools may ask of one.

A vehicle file (configs/vehicles/*.toml) names its model: one of ours (catalogue.py), or a user's as `module:Class`. The
class derives from `Vehicle`, describes itself in class attributes, and defines at least `step` and `equations`.
Defaults for everything else are below. A model holds numbers and kernels, never the state of a vehicle: one model
serves any number of fleets (fleet.py), whose tensors it steps in place.

Frames and units: NED world n, forward-right-down body b, SI, radians (conventions.py).

A model's kernels take packs, not lists of tensors:

    fleet    FleetPack: state, derived, aux, surface, action, numbers, load of one team (fleet.py)
    around   AroundPack: sea, phases, current, wind of one step (around_vehicles.py)
    build    Build: what the kernel is compiled for; read inside `ti.static` (packs.py)

Numbers that differ between environments: `varying` names keys of the vehicle file, and `own` computes the kernel's
numbers from their values, as a NamedTuple. Its entries are floats, compiled in, until numbers of the fleet are varied.
From then on (`build.varied`) they are tensors, whose rows the kernel reads. The physics takes either as `p`, from
`own_numbers(self, build, fleet.numbers, e, i)`. Loads from outside (`build.loaded`) are `load_at(...)`: N and N m about
the origin, b, held over a step.
"""

import math
from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike
from pydantic import Field
from torch import Tensor

from taichi_sim.config import ConfigError, Strict, WorldConfig
from taichi_sim.config.base import meant
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN, ELEVATION, HORIZONTAL, QW, STATE_SIZE, SURGE
from taichi_sim.kernels.packs import Build, struct_of
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.models.contact.deck_and_legs import Deck, Legs
from taichi_sim.surroundings.around_vehicles import Surroundings

Medium = Literal["water", "air"]
DEFAULT_STEP, LARGEST_STEP = 0.02, 0.1  # s, of a physics step


class VehicleParams(Strict):
    """Keys that every vehicle file of ours has."""

    # its motion errs by 1 % (docs/step.md)
    dt: Annotated[float, Field(gt=0, le=LARGEST_STEP), Plausible(5e-4, LARGEST_STEP, "s")] = DEFAULT_STEP


class UnstableStepError(ConfigError):
    """A physics step above the largest stable one; the message names that one."""


@dataclass(frozen=True)
class Limits:
    """Capabilities of a vehicle; planning stays within them."""

    speeds: tuple[float, float, float] = (0.0, 0.0, math.inf)  # speeds through its medium: least, cruise, greatest, m/s
    turn_radius: float = 0.0  # smallest turning radius at cruise, m

    @property
    def stops(self) -> bool:
        """Whether the vehicle can stop."""
        return self.speeds[0] == 0.0


class Waters(Protocol):
    """What endings may ask of the world (world.py)."""

    config: WorldConfig

    def elevation_below(self, team: Fleet, height: Tensor) -> Tensor:
        """Elevation (m, up) of the sea under each vehicle that flies at `height` [env, vehicle] (m)."""
        ...


class Vehicle:
    """A vehicle model; see the module.

    Required class attributes: `Params`, the strict pydantic model of the vehicle file's numbers; `medium`;
    `action_names`, the actions, each in [-1, 1] (an instance may set its own); `control_names`, the settings of its
    actuators, in the order of the `controls` of `equations`.

    Optional: `aux_names`, the first columns of the auxiliary state, which are its instruments; `aux_size`, the number
    of all its columns; `varying`, dotted keys of the vehicle file that may differ between environments, with the index
    for an entry of a list ("rigid_body.cg.0"); `file_keys`, keys that name files beside the vehicle file;
    `ending_names`, the keys of `endings`; `signals`, `forces`, `air` and `airframe` for recordings.

    Contact (contact/between_teams.py): `deck`, a place on it where others land; `legs`, on which it lands, with `soles`
    and `deck_reach`. A model with legs steps against the decks in `fleet.touch`, if that is not None.

    Attributes:
        params: the vehicle file's numbers.
        dt: physics step, s; that of a fleet is `Fleet.dt`.
        substeps: physics steps of a control step.
    """

    Params: ClassVar[type[Strict]]
    medium: ClassVar[Medium] = "water"
    action_names: tuple[str, ...] = ()
    control_names: tuple[str, ...] = ()
    aux_names: tuple[str, ...] = ()
    aux_size: int = 0
    varying: tuple[str, ...] = ()
    file_keys: ClassVar[tuple[str, ...]] = ()
    ending_names: tuple[str, ...] = ()
    free_step: bool = False
    """Whether kernels take the physics step from the numbers (`own`, whose entry `dt` it is), so that `Fleet.set_step`
    changes it without compiling anything."""
    longest_step: float = math.inf
    """Largest stable physics step, s."""
    controller: ClassVar[Any] = None
    """A classical controller class for missions that have none for this vehicle; it is built from the model."""

    signals: Mapping[str, tuple[str, tuple[str, ...]]] = {}
    """Plots of a recording: name -> SI unit ("" for a ratio) and the columns of `aux_names` that share the plot."""
    air: tuple[str, str, str] | None = None
    """Columns of `aux_names` that hold the velocity of the air that it meets (north, east, down, m/s)."""
    airframe: tuple[float, bool] | None = None
    """For recordings of an aircraft: mean chord (m), and whether it has a tail."""

    deck: Deck | None = None
    """The deck on which others may land; its frame is b."""
    legs: Legs | None = None
    """The legs on which it stands."""
    deck_reach: float = 0.0
    """Distance from a deck within which it feels it, by its legs, its rotors and their ground effect, m."""

    def __init__(self, params: Any, dt: float, substeps: int):
        """Take the numbers of a vehicle file, the physics step (s) and the substeps of a control step.

        Raises:
            ConfigError: if a model refuses its numbers; UnstableStepError, if it refuses dt.
        """
        self.params, self.dt, self.substeps = params, dt, substeps

    # -- what it is ------------------------------------------------------------------------------------------------

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width, height, m."""
        return self.params.size

    @property
    def collision_radius(self) -> float:
        """Radius of the sphere around it for collisions, m."""
        return self.params.collision_radius

    @property
    def limits(self) -> Limits:
        """Capabilities of the vehicle."""
        return Limits()

    @property
    def draft(self) -> float:
        """Depth below the origin over which it feels the current, m; 0: the current at the surface."""
        return 0.0

    @property
    def wind_height(self) -> float:
        """Height above the sea at which it feels the wind, m."""
        return 10.0

    @property
    def forces(self) -> Mapping[str, tuple[tuple[float, float, float], tuple[str | None, str | None, str | None]]]:
        """Load arrows of a recording: name -> point of attack (m, b), columns of its x, y, z (N, b; None is zero).

        Names that agree up to the first "_" share a colour.
        """
        return {}

    def body(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Surface of the vehicle: vertices [N, 3] (m, b), triangles' corners [F, 3], counter-clockwise from outside."""
        return None

    # -- beginning -------------------------------------------------------------------------------------------------

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """States [n, vehicle, 13] at rest, or in trim, in the surroundings `around` (one row for each of n).

        Position (for a vessel, its horizontal part) and heading of `state` are kept, and the velocity through the
        medium (over ground for a model that hovers) if the model can begin with it. A model that feels the sea writes
        `surface` [n, vehicle, 2] (conventions.py). Default: a vessel is lifted onto the wave under it, an aircraft
        stays as placed.
        """
        if self.medium == "air":
            return state
        state = state.clone()
        surface[..., ELEVATION] = around.elevation(state[..., HORIZONTAL])
        state[..., DOWN] -= surface[..., ELEVATION]
        return state

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Write the auxiliary state [n, vehicle, aux_size] of vehicles that begin at `state` [n, vehicle, 13]."""
        aux.zero_()

    # -- moving ----------------------------------------------------------------------------------------------------

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance `fleet` (fleet.py) by one control step, in place: state, derived, aux, surface.

        `fleet.action` [env, vehicle, action] holds the actions, finite and within [-1, 1]. Launch a kernel with
        `fleet.launch(self.kernel, fleet.pack, around.pack, ..., build)`, which costs less than calling it. A model in
        plain torch writes `fleet.state`, and `fleet.surface` if it feels the sea, and calls `fleet.update()`, which
        writes `derived`; `fleet.own` are its numbers, `around.current.unsqueeze(1)` is [env, 1, 2].
        """
        raise NotImplementedError(f"{type(self).__name__} has no step (taichi_sim/vehicle.py)")

    def build(self, fleet: Fleet, around: Surroundings) -> Build:
        """Compile-time choices of a kernel for `fleet` in these surroundings."""
        return Build(around.sea.shape[2], around.depth > 0, fleet.varied, fleet.loaded)

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """The right-hand side alone: `rhs` with checked, contiguous tensors of the run's precision and device."""
        raise NotImplementedError(f"{type(self).__name__} has no equations (taichi_sim/vehicle.py)")

    def rhs(
        self,
        state: ArrayLike,
        controls: ArrayLike,
        current: ArrayLike = (0.0, 0.0),
        wind: ArrayLike = (0.0, 0.0, 0.0),
        load: ArrayLike = (0.0,) * 6,
    ) -> np.ndarray:
        """d(state)/dt in calm water and in air that moves steadily.

        Args:
            state: [n, 13], packed as in conventions.py.
            controls: [n, control], actual settings of the actuators (not the commanded ones), in the order and units of
                `control_names`.
            current: [2] or [n, 2], velocity of the water, north and east, m/s.
            wind: [3] or [n, 3], velocity of the air, NED, m/s.
            load: [6] or [n, 6], load from outside, N and N m about the origin, b.

        Returns:
            [n, 13] float64: velocity in n, quaternion's rate, accelerations in b.
        """
        run, rows = runtime.current(), np.atleast_2d(np.asarray(state, dtype=np.float64))
        sizes = (STATE_SIZE, len(self.control_names), 2, 3, 6)
        names = ("state", "controls", "current", "wind", "load")
        given = []
        for name, size, value in zip(names, sizes, (rows, controls, current, wind, load), strict=True):
            array = np.asarray(value, dtype=np.float64)
            try:
                full = np.broadcast_to(array, (len(rows), size))
            except ValueError:
                raise ValueError(f"{name} has shape {array.shape}, expected [{len(rows)}, {size}]") from None
            tensor = torch.from_numpy(np.array(full))
            given.append(tensor.to(run.device, run.torch_dtype).contiguous())
        return self.equations(*given).double().cpu().numpy()

    def mobility(self, fleet: Fleet) -> Tensor:
        """Response to a load: W [env or 1, vehicle or 1, 6, 6], float64, symmetric, for the fleet's vehicles.

        d(accelerations in b) = W d(load about the origin, b); zero for motions that no load can cause. A model whose
        numbers vary returns each vehicle's own. Default: that of the vehicle file, by `rhs`.
        """
        still = np.zeros((7, STATE_SIZE))
        still[:, QW] = 1.0
        loads = np.vstack((np.zeros(6), np.eye(6)))
        rates = self.rhs(still, np.zeros(len(self.control_names)), load=loads)[:, SURGE:]
        return torch.from_numpy((rates[1:] - rates[:1]).T.copy())[None, None]

    def soles(self, fleet: Fleet) -> Tensor:
        """Soles of its legs [env or 1, vehicle or 1, leg, 3], float64, from the origin, b, m."""
        points = () if self.legs is None else self.legs.points
        return torch.tensor(points, dtype=torch.float64).view(1, 1, -1, 3)

    # -- ending ----------------------------------------------------------------------------------------------------

    def endings(self, fleet: Fleet, world: Waters) -> dict[str, Tensor]:
        """Endings of vehicles of `fleet` in `world`, in any mission: each of `ending_names` -> bool [env, vehicle]."""
        return {}

    def power(self, fleet: Fleet) -> Tensor | None:
        """Propulsive power [env, vehicle] of the vehicles of `fleet` in the last step, W; None if the model does not
        compute it.

        It is thrust times the speed through the medium (for a vessel, the speed ahead), or the shaft power of rotors of
        a vehicle that hovers.
        """
        return None

    # -- numbers that vary -----------------------------------------------------------------------------------------

    @cached_property
    def nominal(self) -> dict[str, float]:
        """The value in the vehicle file of each key in `varying`."""
        data = self.params.model_dump()
        return {key: float(value_at(data, key)) for key in self.varying}

    def own(self, values: Mapping[str, Number]) -> Any:
        """Compute the kernel's numbers, a NamedTuple, by arithmetic that works on floats and on tensors.

        `values` has each key of `varying`; other numbers are those of the vehicle file. Default: the values themselves,
        with underscores instead of the dots in their keys.
        """
        names = [key.replace(".", "_") for key in self.varying]
        return namedtuple(f"{type(self).__name__}Numbers", names)(*(values[key] for key in self.varying))

    @cached_property
    def constants(self) -> Any:
        """`own` of the vehicle file's numbers: floats, which kernels compile in."""
        return self.own(self.nominal)

    @property
    def Own(self) -> Any:  # noqa: N802
        """Struct type of `own` of one vehicle, for a kernel that is being compiled."""
        return struct_of(self.constants._fields, runtime.current().precision)

    def numbers(self, vary: Tensor) -> Tensor:
        """`own` [.., n], float64, for the varied values [.., len(varying)], float64."""
        found = self.own({key: vary[..., k] for k, key in enumerate(self.varying)})
        shape = vary.shape[:-1]
        return torch.stack([torch.as_tensor(x, dtype=vary.dtype, device=vary.device).expand(shape) for x in found], -1)

    @classmethod
    def following(cls, data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the keys of a vehicle file with `changes` of whole keys, and with what follows from these."""
        return {**data, **changes}

    def with_numbers(self, values: Mapping[str, float]) -> Any:
        """`Params` of the vehicle file with other `values`, by keys of `varying`."""
        data = self.params.model_dump()
        for key, value in values.items():
            self.check_varies(key)
            *parents, last = key.split(".")
            node = value_at(data, ".".join(parents)) if parents else data
            if last.isdigit():  # a tuple: rebuilt with the one number changed
                holder = value_at(data, ".".join(parents[:-1])) if len(parents) > 1 else data
                holder[parents[-1]] = tuple(value if i == int(last) else x for i, x in enumerate(node))
            else:
                node[last] = value
        return type(self.params).model_validate(self.following(self.params.model_dump(), data))

    def check_varies(self, key: str) -> None:
        """Refuse a key that cannot vary; the message names the nearest one that can."""
        if key not in self.varying:
            raise ConfigError(
                f"{type(self).__name__}: {key!r} cannot vary{meant(key, self.varying)}; allowed are "
                f"{', '.join(self.varying) or 'none'}"
            )


def value_at(data: Any, key: str) -> Any:
    """The value at a dotted key of nested dictionaries and sequences."""
    for part in key.split("."):
        data = data[int(part)] if part.isdigit() else data[part]
    return data


def left_of(time: float, lag: Number) -> Number:
    """exp(-time / lag): share of a deviation that a first-order lag (s) leaves after `time` (s); 0 without a lag."""
    if isinstance(lag, Tensor):
        return torch.exp(-time / lag)
    return math.exp(-time / lag) if lag > 0 else 0.0


def edge(good: float, bad: float, holds: Callable[[float], bool], halvings: int) -> float:
    """The last number, on the way from `good` to `bad`, for which `holds` is true; it is for `good`."""
    if holds(bad):
        return bad
    for _ in range(halvings):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good
