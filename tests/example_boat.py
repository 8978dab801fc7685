"""A vehicle of somebody else's, as short as the contract allows, and without a Taichi kernel: a point mass with drag.

Tests copy it, as my_boat.py, to where a vehicle file that says model = "my_boat:MyBoat" is to find it.
"""

from typing import Any, NamedTuple

import torch

from taichi_sim.config import Positive, Strict
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, ELEVATION, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.usv.vessel_base import Vessel


class MyBoatParams(Strict):
    """Numbers of its vehicle file."""

    mass: Positive  # kg
    drag: Positive  # N s/m
    force_max: Positive  # N
    size: tuple[float, float, float]  # m
    collision_radius: Positive  # m


class Numbers(NamedTuple):
    """What moves it."""

    mass: Any  # kg
    drag: Any  # N s/m


class MyBoat(Vessel):
    """Two forces move it ahead and to starboard; nothing turns it."""

    Params = MyBoatParams
    action_names = ("ahead", "right")
    control_names = ("X", "Y")
    varying = ("mass", "drag")

    def own(self, values):
        """Numbers of `values`."""
        return Numbers(values["mass"], values["drag"])

    def step(self, fleet, around):
        """Euler steps."""
        force = self.params.force_max * fleet.action
        own = self.constants
        if fleet.varied:
            own = self.own({key: value.to(force).unsqueeze(-1) for key, value in fleet.vary.items()})
        load = fleet.load if fleet.loaded else torch.zeros_like(fleet.state[..., :6])
        for _ in range(self.substeps):
            fleet.state += self.dt * self._rates(own, fleet.state, force, around.current[:, None], load)
        fleet.surface[..., ELEVATION] = around.elevation(fleet.state[..., :2])
        fleet.state[..., 2] = -fleet.surface[..., ELEVATION]
        fleet.update()

    def equations(self, state, controls, current, wind, load):
        """d(state)/dt."""
        return self._rates(self.constants, state, controls, current, load)

    def _rates(self, own, state, force, current, load):
        R = torch_rotation_matrix(state[..., QUATERNION])
        push = load[..., :3].clone()
        push[..., :2] += force
        water = torch.nn.functional.pad(current, (0, 1)).expand_as(push)
        through = state[..., VELOCITY] - (R.mT @ water.unsqueeze(-1)).squeeze(-1)
        rates = torch.zeros_like(state)
        rates[..., POSITION] = (R @ state[..., VELOCITY].unsqueeze(-1)).squeeze(-1)
        rates[..., VELOCITY] = (push - own.drag * through) / own.mass
        rates[..., 9] = 0.0  # it stays on the water
        rates[..., ANGULAR_VELOCITY] = 0.0
        return rates
