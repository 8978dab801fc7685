"""Where a flight begins: in steady flight, whatever the wind."""

import torch
from torch import Tensor

from taichi_sim.air import Wind
from taichi_sim.air.wind import wind_factor
from taichi_sim.conventions import ANGULAR_VELOCITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.maths.rotation import (
    torch_euler_from_quaternion,
    torch_quaternion_from_euler,
    torch_rotation_matrix,
)
from taichi_sim.uav.trim import Trim


def trimmed(state: Tensor, at: Trim, wind: Tensor, air: Wind | None = None) -> Tensor:
    """States [n, vehicle, 13] at the positions and headings of `state`, otherwise in the straight flight `at`, in the
    mean `wind` [n, 3] (NED, m/s, 10 m above the sea) with the profile of `air` (None: the same at any height).
    """
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., 2]
    phi, theta = (torch.full_like(heading, angle) for angle in (at.phi, at.theta))
    q = torch_quaternion_from_euler(phi, theta, heading)
    here = wind.to(state).unsqueeze(1)
    if air is not None:
        factor = wind_factor(air.profile, air.shear, (-state[..., 2]).double().cpu().numpy())
        here = here * torch.from_numpy(factor).to(state).unsqueeze(-1)
    new = torch.zeros_like(state)
    new[..., POSITION], new[..., QUATERNION] = state[..., POSITION], q
    through_air = torch.tensor(at.state[VELOCITY], dtype=state.dtype, device=state.device)
    new[..., VELOCITY] = through_air + (torch_rotation_matrix(q).mT @ here.unsqueeze(-1)).squeeze(-1)
    new[..., ANGULAR_VELOCITY] = 0.0
    return new
