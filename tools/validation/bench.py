"""Vehicles on a bench: one per environment, each with its own sea and current, and their states as arrays."""

from typing import NamedTuple

import numpy as np
import torch

from taichi_sim import runtime
from taichi_sim.conventions import ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.fleet import Team
from taichi_sim.maths.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler
from taichi_sim.sea import Sea
from taichi_sim.sea.spectrum import Components
from taichi_sim.surroundings import Surroundings


class Motion(NamedTuple):
    """State of every vehicle, float64: position [env, 3] (m, NED), euler [env, 3] (rad), nu [env, 6] (b)."""

    position: np.ndarray
    euler: np.ndarray
    nu: np.ndarray


def calm_sea() -> Sea:
    """One realisation without waves."""
    zero = np.zeros((1, 1))
    return Sea(Components(zero, zero + 1, zero + 1, zero, zero))


def pack_state(eta, nu) -> torch.Tensor:
    """State [n, 13], float64, of poses eta [n, 6] (m, rad; roll, pitch, yaw) and velocities nu [n, 6]."""
    eta, nu = (torch.as_tensor(np.atleast_2d(v), dtype=torch.float64) for v in (eta, nu))
    quaternion = torch_quaternion_from_euler(*eta[:, 3:].T)
    return torch.cat((eta[:, :3], quaternion, nu), dim=1)


class Bench:
    """`envs` vehicles of one model; environment e is on realisation e of the sea (again from 0 where there are few)."""

    def __init__(self, model, sea: Sea | None = None, envs: int = 1, current=(0.0, 0.0)):
        """At rest at the origin. `sea` is calm by default; `current` [2] or [env, 2] is north, east, m/s."""
        self.model, self.sea, self.calm = model, sea or calm_sea(), sea is None
        self.team = Team(model.team, model, envs, 1)
        self.env_sea = (torch.arange(envs) % self.sea.num_seas).to(torch.int32)
        self.time = torch.zeros(envs, dtype=torch.float64)
        flow = np.broadcast_to(np.asarray(current, dtype=np.float64), (envs, 2)).copy()
        self.current = torch.as_tensor(flow).to(runtime.current().torch_dtype)
        self._around = self._surroundings()

    def put(self, eta, nu=(0.0,) * 6) -> "Bench":
        """Place vehicles at eta [6] or [env, 6] (m, rad) with nu [6] or [env, 6] (b)."""
        self.team.state[:, 0] = pack_state(eta, nu).to(self.team.state.dtype)
        self.model.reset_aux(self.team.aux, self.team.state)
        return self

    def step(self, action, times: int = 1) -> None:
        """Hold `action` [2] or [env, 2] for `times` control steps."""
        envs, dtype = self.team.state.shape[0], self.team.state.dtype
        held = torch.as_tensor(np.asarray(action), dtype=dtype).reshape(-1, 1, 2).expand(envs, 1, 2).contiguous()
        for _ in range(times):
            around = self._around if self.calm else self._surroundings()
            self.model.step(self.team, held, around)
            self.time += self.model.dt * self.model.substeps

    def read(self) -> Motion:
        """The state now."""
        state = self.team.state[:, 0].double().cpu()
        euler = torch_euler_from_quaternion(state[:, QUATERNION])
        nu = torch.cat((state[:, VELOCITY], state[:, ANGULAR_VELOCITY]), dim=1)
        return Motion(state[:, POSITION].numpy().copy(), euler.numpy(), nu.numpy())

    def _surroundings(self) -> Surroundings:
        return Surroundings.of(self.sea, self.env_sea, self.time)._replace(current=self.current)
