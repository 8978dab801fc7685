"""One team: the state of its vehicles in every environment, and quantities derived from it."""

from collections.abc import Mapping
from copy import copy
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.config.arguments import Envs, environments, numbers
from taichi_sim.config.base import number
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import (
    ANGULAR_VELOCITY,
    FREEBOARD,
    NO_DECK,
    POSITION,
    QUATERNION,
    STATE_LIMIT,
    STATE_SIZE,
    SURFACE_SIZE,
    VELOCITY,
)
from taichi_sim.kernels.lanes import filled, laned, width
from taichi_sim.kernels.packs import FleetPack
from taichi_sim.kernels.position import HALF_DIGIT
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.kernels.rotation import (
    DERIVED_SIZE,
    DOWN,
    HEADING_COS,
    HEADING_SIN,
    ROTATION,
    VELOCITY_N,
    derive,
    torch_euler_from_quaternion,
)
from taichi_sim.kernels.runtime import LARGE, Launcher
from taichi_sim.models.contact.leg_contact import Touch
from taichi_sim.state.memory import Remembers


class Model(Protocol):
    """What a fleet asks of the model of its vehicles: names and sizes of tensors, and numbers that may vary.

    The contract of a model is `Vehicle` (vehicle.py), which says what each of these is.
    """

    dt: float
    action_names: tuple[str, ...]
    aux_names: tuple[str, ...]
    aux_size: int
    varying: tuple[str, ...]
    free_step: bool
    longest_step: float

    @cached_property
    def nominal(self) -> dict[str, float]:
        """The value in the vehicle file of each key in `varying`."""
        ...

    @cached_property
    def constants(self) -> Any:
        """`own` of these values."""
        ...

    def own(self, values: Mapping[str, Number]) -> Any:
        """Numbers as the model uses them, by arithmetic on floats or tensors."""
        ...

    def numbers(self, vary: Tensor) -> Tensor:
        """`own` [.., n] for the values [.., len(varying)]."""
        ...

    def with_numbers(self, values: Mapping[str, float]) -> Any:
        """The vehicle file's parameters with other values; ValueError for one that the file could not hold."""
        ...

    def check_varies(self, key: str) -> None:
        """ConfigError for a key that is not in `varying`."""
        ...


M = TypeVar("M", bound=Model, covariant=True)


class Views(Remembers, Generic[M]):
    """Named views of a team's state and its derived quantities; they share memory with the tensors.

    Attributes:
        model: model of the vehicles.
        state: [env, vehicle, 13], packed as in conventions.py.
        derived: [env, vehicle, 14], quantities derived from the state (kernels/rotation.py).
        aux: [env, vehicle, n], the model's own state; `reading` names its columns.
    """

    def __init__(self, model: M, state: Tensor, derived: Tensor, aux: Tensor):
        """Take views of these tensors."""
        self.model = model
        self.state, self.derived, self.aux = map(self.remember, (state, derived, aux))

    def reading(self, name: str) -> Tensor:
        """An instrument of the model [env, vehicle], as of the last step; `name` is one of `model.aux_names`."""
        return self.aux[..., self.model.aux_names.index(name)]

    @property
    def position_n(self) -> Tensor:
        """Position [env, vehicle, 3], north, east, down, m."""
        return self.state[..., POSITION]

    @property
    def quaternion_nb(self) -> Tensor:
        """Attitude [env, vehicle, 4], (w, x, y, z), body to world."""
        return self.state[..., QUATERNION]

    @property
    def velocity_b(self) -> Tensor:
        """Velocity [env, vehicle, 3], forward, right, down, m/s."""
        return self.state[..., VELOCITY]

    @property
    def angular_velocity_b(self) -> Tensor:
        """Angular velocity [env, vehicle, 3], roll, pitch, yaw rate, rad/s."""
        return self.state[..., ANGULAR_VELOCITY]

    @property
    def R_nb(self) -> Tensor:  # noqa: N802
        """Rotation of body vectors into the world [env, vehicle, 3, 3], as of the last step."""
        return self.derived[..., ROTATION].unflatten(-1, (3, 3))

    @property
    def velocity_n(self) -> Tensor:
        """Velocity [env, vehicle, 3], north, east, down, m/s, as of the last step."""
        return self.derived[..., VELOCITY_N]

    @property
    def heading(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine [env, vehicle] of the heading, as of the last step."""
        return self.derived[..., HEADING_COS], self.derived[..., HEADING_SIN]

    def to_level(self, vector: Tensor) -> Tensor:
        """Rotate vectors [env, vehicle, 2 or 3] from n into the level frame: ahead, to starboard (, down)."""
        (c, s), (north, east, *down) = self.heading, vector.unbind(-1)
        return torch.stack((c * north + s * east, c * east - s * north, *down), dim=-1)

    @property
    def down_b(self) -> Tensor:
        """The world's down direction in b [env, vehicle, 3], as of the last step: roll and pitch without a jump."""
        return self.derived[..., DOWN]

    @property
    def euler(self) -> Tensor:
        """Roll, pitch and heading [env, vehicle, 3], rad (a copy)."""
        return torch_euler_from_quaternion(self.quaternion_nb)


def exact(position: Tensor, remainder: Tensor) -> Tensor:
    """Positions in float64, of those of a state and what it cannot hold of them."""
    place, rest = position.double(), remainder.double()
    return place + torch.where(rest.abs() <= HALF_DIGIT * place.abs(), rest, 0.0)


class Fleet(Views[M]):
    """Vehicles of one model in every environment; the views share memory with the tensors of the kernels.

    The type parameter is the class of the model: the teams of a world are `Fleet[Vehicle]`.

    Attributes, besides those of `Views`:
        remainder: [env, vehicle, 3], what `state` cannot hold of the position, m: `position_exact` reads it.
        surface: [env, vehicle, 2], elevation under a vessel and its freeboard (conventions.py).
        action: [env, vehicle, action], actions of the coming or the last step.
        never: bool [env, vehicle], false, for endings that cannot happen; read only.
        varied: whether numbers differ between environments (`set_numbers`).
        loaded: whether `load` has been used.
        touch: contact memory of a team with legs in a world with decks; None otherwise.
        dt: physics step, s (`set_step`).
        few: whether there are so few vehicles that kernels run on the calling thread only.
    """

    def __init__(self, name: str, model: M, num_envs: int, count: int):
        """Allocate `count` vehicles of `model` in each environment, at rest at the origin."""
        run = runtime.current()
        options: dict[str, Any] = {"dtype": run.torch_dtype, "device": run.device}
        self.name, self.count, self.num_envs, self.dt = name, count, num_envs, self.scratch(model.dt)
        sizes = STATE_SIZE, DERIVED_SIZE, max(model.aux_size, 1)
        super().__init__(model, *(torch.zeros((num_envs, count, size), **options) for size in sizes))
        self.state[..., QUATERNION.start] = 1.0
        self._rests = torch.zeros((3, filled(num_envs * count)), **options)
        rests = self._rests[:, : num_envs * count].unflatten(1, (num_envs, count))
        self.remainder = self.remember(rests.movedim(0, -1))
        self.surface = self.remember(torch.zeros((num_envs, count, SURFACE_SIZE), **options))
        self.surface[..., FREEBOARD] = NO_DECK
        self.action = self.remember(torch.zeros((num_envs, count, max(len(model.action_names), 1)), **options))
        self._vary: Tensor | None = self.remember(None)
        self._numbers: Tensor | None = self.remember(None)
        self._load: Tensor | None = self.remember(None)
        self.touch: Touch | None = self.remember(None)
        self._unused = torch.zeros((1, 1, 1), **options)
        self._pack = self._packed()
        self._launchers: dict[tuple[int, int], Launcher] = {}
        self._all = torch.arange(num_envs, device=run.device)
        self._which = self.scratch(torch.zeros(num_envs, dtype=torch.int32, device=run.device))
        self._derive = Launcher(derive)
        self.never = torch.zeros((num_envs, count), dtype=torch.bool, device=run.device)
        self.update()

    def __repr__(self) -> str:
        """Number and model of the vehicles, and their actions."""
        more = [word for word, holds in (("numbers vary", self.varied), ("loaded", self.loaded)) if holds]
        text = ", ".join([f"actions {' '.join(self.model.action_names)}", *more])
        return f"<Fleet {self.name!r}: {self.made_of}, {text}>"

    @property
    def made_of(self) -> str:
        """Number and model of the vehicles: "3 x Hull6Dof in 64 environments"."""
        return f"{self.count} x {type(self.model).__name__} in {number(self.num_envs, 'environment')}"

    # -- position --------------------------------------------------------------------------------------------------

    @property
    def position_exact(self) -> Tensor:
        """Position [env, vehicle, 3], float64, to the sum of all steps: `position_n` and its remainder (position.py).

        `position_n` has 24 bits: 1 mm at 10 km from the origin, 6 cm at 1,000 km.
        """
        return exact(self.position_n, self.remainder)

    def move(self, way: Tensor) -> None:
        """Move all vehicles by `way` [env, vehicle, 3] (NED, m): for models in torch, which lose no short way then."""
        place = self.position_exact + way
        self.position_n.copy_(place)
        self.remainder.copy_(place - self.position_n)

    def _copy_last(self) -> None:
        """Give the last vehicle's remainder to its copies in a group (abreast.py), which write its state, too."""
        last = self.num_envs * self.count
        self._rests[:, last:] = self._rests[:, last - 1 : last]

    # -- kernels ---------------------------------------------------------------------------------------------------

    @property
    def pack(self) -> Any:
        """The FleetPack for kernels; the same object until numbers or loads are first used."""
        return self._pack()

    def _packed(self) -> runtime.Packed:
        return runtime.Packed(
            FleetPack,
            state=self.state,
            derived=self.derived,
            aux=self.aux,
            surface=self.surface,
            action=self.action,
            numbers=self._unused if self._numbers is None else self._numbers,
            load=self._unused if self._load is None else self._load,
            remainder=self._rests,
            rests=laned(self._rests),
            lanes=laned(self._unused if self.aux.shape[-1] % width() else self.aux),
        )

    def restored(self) -> None:
        """Rebuild the packs after numbers or loads were restored."""
        self._copy_last()
        members = self._pack.members
        if members["numbers"] is not (self._unused if self._numbers is None else self._numbers) or (
            members["load"] is not (self._unused if self._load is None else self._load)
        ):
            self._pack = self._packed()

    def launch(self, kernel: Any, *args: Any, plain: bool = False) -> None:
        """Call a kernel of the model. A call with the same arguments as the last one costs a fraction.

        A `plain` one is compiled without Taichi's own passes (`runtime.Launcher`).
        """
        key = id(kernel._primal), id(getattr(kernel, "_kernel_owner", None))
        if key not in self._launchers:
            self._launchers[key] = Launcher(kernel, plain=plain, few=LARGE)
        self._launchers[key](*args)

    def diverged(self) -> Tensor | None:
        """Vehicles, bool [env, vehicle], whose state is not finite or beyond `STATE_LIMIT` (conventions.py); None if
        there are none.
        """
        low, high = (float(end) for end in self.state.aminmax())  # NaN if one is
        if low >= -STATE_LIMIT and high <= STATE_LIMIT:
            return None
        return ~(self.state.abs() <= STATE_LIMIT).all(-1)

    def update(self, envs: Tensor | None = None) -> None:
        """Recompute derived quantities in environments `envs` (default: all) after writing to `state` by hand."""
        self._copy_last()
        if envs is None:
            self._which.fill_(1)
        else:
            self._which.zero_()
            self._which[envs] = 1
        self._derive(self.derived, self.state, self._which, envs=None if envs is None else len(envs))

    # -- outside loads and numbers of its own ----------------------------------------------------------------------

    @property
    def loaded(self) -> bool:
        """Whether external loads are in use."""
        return self._load is not None

    @property
    def varied(self) -> bool:
        """Whether vehicles have numbers of their own."""
        return self._vary is not None

    @property
    def load(self) -> Tensor:
        """External load [env, vehicle, 6], N and N m about the origin, in b, held over a step; initially zero.

        It may be written in place. It costs nothing until its first use.
        """
        if self._load is None:
            self._load = self.state.new_zeros((*self.state.shape[:2], 6))
            self._pack = self._packed()
        return self._load

    @property
    def numbers(self) -> Tensor | None:
        """Each vehicle's numbers as the model uses them [env, vehicle, n]; None if all share those of the file."""
        return self._numbers

    @property
    def vary(self) -> dict[str, Tensor]:
        """Present values of the parameters that may vary: key -> [env, vehicle] (a copy)."""
        values = self.nominal if self._vary is None else self._vary
        return {key: values[..., k].expand(self.state.shape[:2]).clone() for k, key in enumerate(self.model.varying)}

    @runtime.own_settings()
    def set_numbers(self, values: Mapping[str, ArrayLike | Tensor], envs: Envs | None = None) -> None:
        """Set parameters of vehicles, until they are set or drawn again (randomisation/variation.py); other parameters
        stay.

        Args:
            values: key of `model.varying` -> number, or what broadcasts to [n, vehicle].
            envs: numbers of environments [n], or a bool mask [env]; default: all.

        Raises:
            ConfigError: for a key that does not vary, or a value that the vehicle file could not hold.
            ValueError: for a value that is not finite, or has a wrong shape, and for environments that do not exist.
        """
        rows = self._all if envs is None else environments(envs, self.num_envs)
        shape = (len(rows), self.count)
        fresh = self.nominal if self._vary is None else self._vary[rows]
        fresh = fresh.expand(*shape, -1).clone()
        for key, value in values.items():
            self.model.check_varies(key)
            fresh[..., self.model.varying.index(key)] = self._checked(key, value, shape)
        self.give_numbers(fresh, self.numbers_of(fresh), rows)

    def give_numbers(self, vary: Tensor, numbers: Tensor, envs: Tensor) -> None:
        """Set all numbers of the vehicles of environments `envs` [n], int64, without checks.

        Args:
            vary: [n, vehicle, len(model.varying)], float64.
            numbers: [n, vehicle, m], the model's numbers for them (`Vehicle.numbers`).
            envs: the environments.
        """
        if self._vary is None:
            self._vary = whole = self.nominal.expand(*self.state.shape[:2], -1).clone()
            self._numbers = self.numbers_of(whole).to(self.state.dtype).contiguous()
            self._pack = self._packed()
        assert self._vary is not None and self._numbers is not None
        self._vary[envs] = vary
        self._numbers[envs] = numbers.to(self.state.dtype)

    def set_step(self, dt: float) -> None:
        """Go on with steps of dt (s). After the first call, no kernel is compiled anew.

        Raises:
            ConfigError: for a model whose kernels are compiled for their step, or a dt that is not stable.
        """
        model = self.model
        if not model.free_step or not dt <= model.longest_step:
            why = f"at most {model.longest_step:.3g} s is stable" if model.free_step else "its kernels hold their step"
            raise ConfigError(f"{self.name}: {type(model).__name__} cannot step by {dt:g} s: {why}")
        self.dt = dt
        vary = (self.nominal if self._vary is None else self._vary).expand(*self.state.shape[:2], -1).clone()
        if bool((vary == self.nominal).all()):  # floats are faster: an autopilot's frames may change at each step
            numbers = torch.tensor(self._stepped.own(model.nominal), dtype=torch.float64, device=vary.device)
        else:
            numbers = self.numbers_of(vary)
        self.give_numbers(vary, numbers, self._all)

    @property
    def _stepped(self) -> M:
        """The model with steps of `dt`, for its numbers."""
        if self.model.dt == self.dt:
            return self.model
        stepped = copy(self.model)
        stepped.dt = self.dt
        return stepped

    def numbers_of(self, vary: Tensor) -> Tensor:
        """The model's numbers [.., n], float64, for the values `vary` [.., len(model.varying)] and steps of `dt`."""
        return self._stepped.numbers(vary)

    def _checked(self, key: str, value: ArrayLike | Tensor, shape: tuple[int, int]) -> Tensor:
        """Values [n, vehicle], float64, of a parameter; the vehicle file's rules check the extreme ones."""
        given = numbers(value, f"{self.name}: {key}").to(self.state.device, torch.float64)
        if not bool(given.isfinite().all()):
            raise ValueError(f"{self.name}: {key} = {value}: must be finite")
        try:
            full = given.expand(shape)
        except RuntimeError:
            raise ValueError(f"{self.name}: {key} has shape {tuple(given.shape)}, expected {list(shape)}") from None
        for extreme in {float(given.min()), float(given.max())}:
            if reason := self.refusal(key, extreme):
                raise ConfigError(f"{self.name}: {key} = {extreme:g} cannot be: {reason}")
        return full

    def refusal(self, key: str, value: float) -> str | None:
        """Reason why the vehicle file refuses a value of a varying number; None if it accepts it."""
        try:
            self.model.with_numbers({key: value})
        except ValueError as error:  # raised by pydantic
            return str(error).splitlines()[-2 if "\n" in str(error) else -1].strip()
        return None

    @property
    def own(self) -> Any:
        """Numbers as the model uses them (`Vehicle.own`): floats, or tensors [env, vehicle] if they vary."""
        if self._vary is None:
            return self.model.constants
        return self.model.own({key: self._vary[..., k].to(self.state) for k, key in enumerate(self.model.varying)})

    @property
    def nominal(self) -> Tensor:
        """Values [len(model.varying)] in the vehicle file, float64."""
        return torch.tensor(list(self.model.nominal.values()), dtype=torch.float64, device=self.state.device)
