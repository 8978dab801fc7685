"""Initial states of multirotors: steady flight over ground in any wind, with instruments and controller settled
in it.
"""

import torch
from torch import Tensor

from taichi_sim.conventions import ANGULAR_VELOCITY, DOWN, GRAVITY, HEADING, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.surroundings import Surroundings
from taichi_sim.uav.local_air import wind_at
from taichi_sim.uav.multirotor import instruments as at
from taichi_sim.uav.multirotor.params import MultirotorParams
from taichi_sim.uav.multirotor.trim import MOMENT, PHI, SPECIFIC, SPEEDS, THETA, solve


def steady(craft: MultirotorParams, state: Tensor, wind: Tensor) -> Tensor:
    """Steady flight [n, vehicle, column] at the velocity over ground and the heading of `state` [n, vehicle, 13].

    The columns are those of trim.py; `wind` [n, vehicle, 3] is NED, m/s.
    """
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., HEADING:]
    air = torch.cat((_velocity_n(state) - wind, torch.cos(heading), torch.sin(heading)), dim=-1)
    out = state.new_empty((*state.shape[:2], SPEEDS + len(craft.rotors)))
    solve(craft, air.flatten(0, 1).contiguous(), out.flatten(0, 1))
    return out


def trimmed(craft: MultirotorParams, state: Tensor, around: Surroundings) -> Tensor:
    """States [n, vehicle, 13] at places, headings, velocities over ground of `state`, tilted into the mean wind."""
    found = steady(craft, state, wind_at(state, around))
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., HEADING]
    new = state.clone()
    new[..., QUATERNION] = torch_quaternion_from_euler(found[..., PHI], found[..., THETA], heading)
    R = torch_rotation_matrix(new[..., QUATERNION])
    new[..., VELOCITY] = (R.mT @ _velocity_n(state).unsqueeze(-1)).squeeze(-1)
    new[..., ANGULAR_VELOCITY] = 0.0
    return new


def show(craft: MultirotorParams, aux: Tensor, state: Tensor, around: Surroundings) -> None:
    """Write aux [n, vehicle, ..] of vehicles that begin at `state` [n, vehicle, 13].

    Rotor speeds and the controller's integrals are those of steady flight there. The first step draws the turbulence.
    """
    aux.zero_()
    wind, rotor = wind_at(state, around), craft.rotor
    found = steady(craft, state, wind)
    velocity = _velocity_n(state)
    aux[..., at.SPEEDS :] = found[..., SPEEDS:].clamp(rotor.omega_min, rotor.omega_max)
    aux[..., at.WIND : at.WIND + 3] = wind
    aux[..., at.AIRSPEED] = (velocity - wind).norm(dim=-1)
    aux[..., at.GROUND] = 1.0
    for first in (at.VELOCITY_WANTED, at.VELOCITY_N):
        aux[..., first : first + 3] = velocity
    specific, moment = found[..., SPECIFIC : SPECIFIC + 3], found[..., MOMENT : MOMENT + 3]
    inverse = torch.linalg.inv(torch.tensor(craft.physical.inertia)).to(state)
    aux[..., at.INTEGRALS : at.INTEGRALS + 3] = moment @ inverse
    aux[..., at.INTEGRALS + 3 : at.INTEGRALS + 6] = specific.new_tensor((0.0, 0.0, GRAVITY)) - specific
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., HEADING]
    aux[..., at.HEADING], aux[..., at.HEADING + 1] = torch.cos(heading), torch.sin(heading)
    aux[..., at.THRUST] = craft.physical.mass * specific.norm(dim=-1)
    aux[..., at.TILT] = torch.acos((specific[..., DOWN] / specific.norm(dim=-1)).clamp(-1.0, 1.0))
    if craft.battery is not None:
        aux[..., at.CHARGE], aux[..., at.VOLTAGE] = craft.battery.charge, craft.battery.full


def _velocity_n(state: Tensor) -> Tensor:
    """Velocity over ground [.., 3] (n, m/s) of `state` [.., 13]."""
    return (torch_rotation_matrix(state[..., QUATERNION]) @ state[..., VELOCITY].unsqueeze(-1)).squeeze(-1)
