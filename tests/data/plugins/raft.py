"""A free rigid body with a deck, in neither water nor gravity: what contact is proved with."""

import torch
from torch import Tensor

import taichi_sim as ts
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.contact.deck_and_legs import Deck

FINE = 20  # steps of the classical Runge-Kutta method in a physics step


class RaftParams(ts.Strict):
    """Numbers of raft.toml."""

    mass: ts.NonNegative  # kg; 0: it moves as it was placed, whatever presses on it
    inertia: tuple[ts.Positive, ts.Positive, ts.Positive]  # about the origin, kg m^2
    deck: Deck

    size: tuple[float, float, float] = (3.0, 3.0, 0.5)  # m
    collision_radius: ts.Positive = 2.0  # m


class Raft(ts.Vehicle):
    """Newton and Euler about the centre of gravity."""

    Params = RaftParams
    action_names = control_names = ("nothing",)
    varying = ("mass", "deck.friction")

    def __init__(self, params: RaftParams, dt: float, substeps: int):
        super().__init__(params, dt, substeps)
        self.deck = params.deck

    def settle(self, state: Tensor, surface: Tensor, around: ts.Surroundings) -> Tensor:
        return state

    def mobility(self, fleet: ts.Fleet) -> Tensor:
        mass = fleet.vary["mass"].double()
        inverse = torch.where(mass > 0, 1 / mass.clamp(min=1e-9), torch.zeros_like(mass))
        turning = torch.where(mass > 0, 1.0, 0.0).unsqueeze(-1) / mass.new_tensor(self.params.inertia)
        return torch.diag_embed(torch.cat((inverse.unsqueeze(-1).expand(*mass.shape, 3), turning), dim=-1))

    def step(self, fleet: ts.Fleet, around: ts.Surroundings) -> None:
        h, y = self.dt / FINE, fleet.state.double()
        W, load = self.mobility(fleet), fleet.load.double()
        for _ in range(FINE * self.substeps):
            k1 = self._rate(y, load, W)
            k2 = self._rate(y + 0.5 * h * k1, load, W)
            k3 = self._rate(y + 0.5 * h * k2, load, W)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + self._rate(y + h * k3, load, W))
            y[..., 3:7] /= y[..., 3:7].norm(dim=-1, keepdim=True)
        fleet.state.copy_(y)
        fleet.update()

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        fleet_less = torch.diag_embed(
            state.new_tensor([1 / self.params.mass] * 3 + [1 / J for J in self.params.inertia])
        )
        return self._rate(state, load, fleet_less)

    def _rate(self, state: Tensor, load: Tensor, W: Tensor) -> Tensor:
        q, v, w = state[..., 3:7], state[..., 7:10], state[..., 10:]
        J = state.new_tensor(self.params.inertia)
        rate = torch.zeros_like(state)
        rate[..., :3] = (torch_rotation_matrix(q) @ v.unsqueeze(-1)).squeeze(-1)
        rate[..., 3] = -0.5 * (q[..., 1:] * w).sum(-1)
        rate[..., 4:7] = 0.5 * (q[..., :1] * w + torch.linalg.cross(q[..., 1:], w))
        push = (W @ load.unsqueeze(-1)).squeeze(-1)
        rate[..., 7:10] = push[..., :3] - torch.linalg.cross(w, v)
        rate[..., 10:] = push[..., 3:] - torch.linalg.cross(w, J * w) / J
        return rate
