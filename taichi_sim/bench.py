"""One fleet in a sea and a wind, without a scenario: for tests, tools and notebooks.

    import taichi_sim as ts

    bench = ts.Bench("otter", sea=ts.SeaConfig(hs=0.5, tp=4.0), envs=64)
    bench.put(velocity_b=(1.0, 0.0, 0.0), settle=True)      # afloat, moving with the water
    bench.step((0.5, 0.1), times=500)                       # ten seconds of steps of 0.02 s
    print(bench.position, bench.euler)                      # of the first vehicle, arrays

Results read from it are float64, whatever the precision of the run.
"""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.config import AirConfig, SeaConfig, WorldConfig
from taichi_sim.config.arguments import ActionError, numbers, whole_number
from taichi_sim.config.base import span
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.random import Noise
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.randomisation.conditions import resolved_sea
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.current import Current
from taichi_sim.surroundings.sea.spectrum import Components
from taichi_sim.vehicle import Vehicle

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Motion of the first vehicle in each environment: position [env, 3] (NED, m), euler [env, 3] (roll, pitch,
    heading, rad)
    """

    position: Array
    euler: Array
    nu: Array


def pack_state(eta: ArrayLike, nu: ArrayLike = (0.0,) * 6) -> Array:
    """Pack poses eta [n, 6] (NED m; roll, pitch, heading, rad) and velocities nu [n, 6] into states [n, 13].

    Either may be [6]: one, or the same for all.
    """
    eta, nu = np.broadcast_arrays(*(np.atleast_2d(np.asarray(x, dtype=np.float64)) for x in (eta, nu)))
    quaternion = torch_quaternion_from_euler(*torch.from_numpy(eta[:, 3:].copy()).unbind(-1)).numpy()
    return np.hstack((eta[:, :3], quaternion, nu))


def calm_sea(depth: float | None = None) -> Sea:
    """A sea of one realisation without waves; depth in m, None is deep."""
    zero = np.zeros((1, 1))
    return Sea(Components(zero, zero + 1, zero + 1, zero, zero), depth)


class Bench:
    """`envs` x `count` vehicles of one model; environment e has realisation e of the sea (modulo their number).

    Attributes:
        fleet: the vehicles, their state, loads and numbers (fleet.py).
        model: model of the vehicles.
        sea: the realisations.
        time: float64 [env], s.
        around: surroundings that the vehicles feel; as in a World, the current is averaged over their draft and the
            wind is that at their height.
    """

    @runtime.own_settings()
    def __init__(
        self,
        vehicle: str | Path | Vehicle,
        *,
        sea: Sea | SeaConfig | None = None,
        air: AirConfig | None = None,
        envs: int = 1,
        count: int = 1,
        dt: float = 0.02,
        substeps: int = 1,
        seed: int = 0,
        name: str = "fleet",
    ):
        """Make the vehicles, at rest at the origin.

        Args:
            vehicle: a model, or the file or name of one.
            sea: default: calm.
            air: default: calm; otherwise a configuration with wind, turbulence and gusts.
            envs, count: environments, and vehicles in each.
            dt, substeps: physics step, s, and physics steps of a control step, for a file or name.
            seed: seed of the sea's realisations, of slow variations, and of the turbulence.
            name: name of the fleet.

        A SeaConfig includes its current, an AirConfig its wind; both may vary slowly or follow a series, the current
        also a tide. They are stepped as in a World (world.py), from time 0 on. A `Sea` has no current.
        """
        run = runtime.current()
        envs, count = whole_number(envs, "envs", 1), whole_number(count, "count", 1)
        self.model = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle, dt, substeps)
        flow = None
        if isinstance(sea, SeaConfig):
            sea = resolved_sea(WorldConfig(sea=sea, air=air or AirConfig()))
            flow, sea = sea.current, Sea.from_config(sea, seed)
        self.sea = sea or calm_sea()
        self.fleet = Fleet(name, self.model, envs, count)
        self._told = False
        self.time = torch.zeros(envs, dtype=torch.float64, device=run.device)
        self._everywhere = torch.arange(envs, device=run.device)
        env_sea = (self._everywhere % self.sea.num_seas).to(torch.int32)
        self._current = Current(flow, envs, seed, self.sea.depth)
        self._weather = None if air is None else Wind(air, envs, seed)
        calm = torch.zeros((envs, 3), dtype=run.torch_dtype, device=run.device)
        self._wind = calm if self._weather is None else self._weather.velocity
        in_water = self._current.mean_factor(self.model.draft)
        in_air = 1.0 if self._weather is None else self._weather.speed_factor(self.model.wind_height)
        self._factors = in_water, in_air
        self.noise = Noise(envs, seed)
        self.around = Surroundings(
            self.sea.table,
            env_sea,
            self.sea.phases(env_sea, self.time),
            self.current if in_water == 1.0 else self.current * in_water,
            self.wind if in_air == 1.0 else self.wind * in_air,
            self.sea.kernel_depth,
            self._weather,
            self.noise,
        )

    def __repr__(self) -> str:
        """Vehicles and time; present sea, current and wind."""
        flow, air = (span(x.norm(dim=-1), "m/s") for x in (self.current, self.wind))
        return f"<Bench: {self.fleet.made_of}, t = {span(self.time, 's')};\n {self.sea}, current {flow}, wind {air}>"

    # -- placing ---------------------------------------------------------------------------------------------------

    @runtime.own_settings()
    def put(
        self,
        position: ArrayLike = (0.0, 0.0, 0.0),
        euler: ArrayLike = (0.0, 0.0, 0.0),
        velocity_b: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity_b: ArrayLike = (0.0, 0.0, 0.0),
        *,
        settle: bool = False,
    ) -> "Bench":
        """Place every vehicle; each argument is [3] or broadcasts to [env, vehicle, 3]: NED m, rad, m/s, rad/s.

        With `settle` the vehicles are brought to rest, or into trim, at these places (`Vehicle.settle`).

        Raises:
            ActionError: for what is not finite, or does not broadcast; nothing has moved.
        """
        place, angles = self._spread(position, "position", 3), self._spread(euler, "euler", 3)
        v, omega = self._spread(velocity_b, "velocity_b", 3), self._spread(angular_velocity_b, "angular_velocity_b", 3)
        self.state[..., POSITION], self.state[..., VELOCITY] = place, v
        self.fleet.remainder.zero_()
        self.state[..., QUATERNION] = torch_quaternion_from_euler(*angles.unbind(-1))
        self.state[..., ANGULAR_VELOCITY] = omega
        self.refresh()
        if settle:
            self.state.copy_(self.model.settle(self.state.clone(), self.fleet.surface, self.around))
        self.model.reset_aux(self.fleet.aux, self.state, self.around)
        self.fleet.update()
        return self

    def _spread(self, given: ArrayLike | Tensor, name: str, size: int) -> Tensor:
        """Finite numbers, spread over all vehicles: [env, vehicle, size]."""
        values, shape = numbers(given, f"{name}'s entries").to(self.state), (*self.state.shape[:2], size)
        if not values.isfinite().all():
            raise ActionError(f"an entry of {name} is not finite")
        try:
            return values.expand(shape)
        except RuntimeError:
            raise ActionError(
                f"{name} has shape {list(values.shape)}: [{size}], or what broadcasts to {list(shape)}, is expected"
            ) from None

    @runtime.own_settings()
    def refresh(self) -> None:
        """Copy time, current and wind to `around`; call it after setting them by hand."""
        self._follow()
        self._tell()

    def _follow(self) -> None:
        """Update a current and a wind that are given over time to the present time."""
        for air_or_water in (self._current, self._weather):
            if air_or_water is not None:
                air_or_water.follow(self._everywhere, self.time)

    def _tell(self) -> None:
        """Write the waves' phases, the current over the draft and the wind at the vehicles' height to `around`."""
        self.sea.phases(self.around.env_sea, self.time, out=self.around.phase)
        in_water, in_air = self._factors
        if in_water != 1.0:
            torch.mul(self.current, in_water, out=self.around.current)
        if in_air != 1.0:
            torch.mul(self.wind, in_air, out=self.around.wind)

    # -- moving ----------------------------------------------------------------------------------------------------

    @runtime.own_settings()
    def step(self, action: ArrayLike | Tensor, times: int = 1) -> "Bench":
        """Step `times` control steps with the action held: [action], or what broadcasts to [env, vehicle, action].

        A RuntimeWarning tells once that a state is not finite any more, or beyond its limits.

        Raises:
            ActionError: for an action that is not finite or no numbers; nothing has moved.
        """
        times = whole_number(times, "times")
        self.fleet.action.copy_(self._spread(action, "the action", self.fleet.action.shape[-1]))
        interval = self.fleet.dt * self.model.substeps
        for _ in range(times):
            self._tell()
            self.model.step(self.fleet, self.around)
            self.time += interval
            self.noise.tick()
            self._current.advance(interval)
            if self._weather is not None:
                self._weather.advance(interval)
            self._follow()
        if not self._told and (gone := self.fleet.diverged()) is not None:
            self._told, env = True, int(gone.any(1).nonzero()[0])
            cause = f"the state of a vehicle of {self.fleet.name!r} is not finite or beyond its limits"
            warnings.warn(f"{cause} in environment {env} (docs/troubleshooting.md; told once)", RuntimeWarning, 2)
        return self

    # -- reading ---------------------------------------------------------------------------------------------------

    @property
    def state(self) -> Tensor:
        """State [env, vehicle, 13], packed as in conventions.py; may be written in place."""
        return self.fleet.state

    @property
    def aux(self) -> Tensor:
        """Auxiliary state [env, vehicle, n] of the model."""
        return self.fleet.aux

    @property
    def surface(self) -> Tensor:
        """Elevation and freeboard [env, vehicle, 2], m."""
        return self.fleet.surface

    @property
    def current(self) -> Tensor:
        """Velocity of the water at the surface [env, 2], north and east, m/s.

        It may be written in place, unless the sea's configuration has a current that varies: that one overwrites it.
        """
        return self._current.velocity

    @property
    def wind(self) -> Tensor:
        """Velocity of the air 10 m above the sea [env, 3], NED, m/s.

        It may be written in place, unless the air's configuration has a wind that varies: that one overwrites it.
        """
        return self._wind

    def read(self) -> Motion:
        """Present motion of the first vehicles (copies)."""
        state = self.state[:, 0].double().cpu()
        nu = torch.cat((state[:, VELOCITY], state[:, ANGULAR_VELOCITY]), dim=1)
        euler = torch_euler_from_quaternion(state[:, QUATERNION])
        return Motion(self.fleet.position_exact[:, 0].cpu().numpy(), euler.numpy(), nu.numpy())

    @property
    def position(self) -> Array:
        """Position of the first vehicle [3], NED, m."""
        return self.fleet.position_exact[0, 0].cpu().numpy()

    @property
    def velocity(self) -> Array:
        """Velocity of the first vehicle over ground [3], NED, m/s."""
        state = self.state[0, 0].double().cpu()
        return (torch_rotation_matrix(state[QUATERNION]) @ state[VELOCITY]).numpy()

    @property
    def euler(self) -> Array:
        """Roll, pitch and heading of the first vehicle [3], rad."""
        return torch_euler_from_quaternion(self.state[0, 0, QUATERNION].double().cpu()).numpy()
