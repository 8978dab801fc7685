"""One team: the state of its vehicles in every environment, and what follows from it."""

import torch

from taichi_sim import runtime
from taichi_sim.conventions import (
    ANGULAR_VELOCITY,
    FREEBOARD,
    NO_DECK,
    POSITION,
    QUATERNION,
    STATE_SIZE,
    SURFACE_SIZE,
    VELOCITY,
)
from taichi_sim.kinematics import DERIVED_SIZE, HEADING_COS, HEADING_SIN, VELOCITY_N, derive
from taichi_sim.maths.rotation import torch_euler_from_quaternion


class Team:
    """State of one team in every environment; the views share memory with what kernels work on.

    Attributes:
        state: [env, vehicle, 13], packed as in conventions.py.
        aux: [env, vehicle, n], the model's own state.
        surface: [env, vehicle, 2], what the sea does to a USV: elevation under it and freeboard (conventions.py).
        derived: [env, vehicle, 14], what follows from the state (kinematics.py).
    """

    def __init__(self, name: str, model, num_envs: int, count: int):
        """Allocate `count` vehicles of `model` in each environment, at rest at the origin."""
        run = runtime.current()
        options = {"dtype": run.torch_dtype, "device": run.device}
        self.name, self.model, self.count = name, model, count
        self.state = torch.zeros((num_envs, count, STATE_SIZE), **options)
        self.state[..., 3] = 1.0
        self.aux = torch.zeros((num_envs, count, model.aux_size), **options)
        self.surface = torch.zeros((num_envs, count, SURFACE_SIZE), **options)
        self.surface[..., FREEBOARD] = NO_DECK
        self.derived = torch.zeros((num_envs, count, DERIVED_SIZE), **options)
        self._all = torch.arange(num_envs, device=run.device)
        self.update()

    def update(self, envs: torch.Tensor | None = None) -> None:
        """Refresh what follows from `state` in environments `envs` (default: all) after writing to it by hand."""
        derive(self.derived, self.state, self._all if envs is None else envs)

    @property
    def position_n(self) -> torch.Tensor:
        """[env, vehicle, 3] north, east, down, m."""
        return self.state[..., POSITION]

    @property
    def quaternion_nb(self) -> torch.Tensor:
        """[env, vehicle, 4] w, x, y, z, body to world."""
        return self.state[..., QUATERNION]

    @property
    def velocity_b(self) -> torch.Tensor:
        """[env, vehicle, 3] forward, right, down, m/s."""
        return self.state[..., VELOCITY]

    @property
    def angular_velocity_b(self) -> torch.Tensor:
        """[env, vehicle, 3] roll, pitch, yaw rate, rad/s."""
        return self.state[..., ANGULAR_VELOCITY]

    @property
    def R_nb(self) -> torch.Tensor:  # noqa: N802
        """[env, vehicle, 3, 3] rotation of body vectors into the world, as of the last step."""
        return self.derived[..., :9].unflatten(-1, (3, 3))

    @property
    def velocity_n(self) -> torch.Tensor:
        """[env, vehicle, 3] north, east, down, m/s, as of the last step."""
        return self.derived[..., VELOCITY_N]

    @property
    def heading(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Cosine and sine [env, vehicle] of the heading, as of the last step."""
        return self.derived[..., HEADING_COS], self.derived[..., HEADING_SIN]

    @property
    def euler(self) -> torch.Tensor:
        """[env, vehicle, 3] roll, pitch, heading, rad (a copy)."""
        return torch_euler_from_quaternion(self.quaternion_nb)
