"""Where a flight begins: in steady flight, whatever the wind, its instruments showing it."""

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
from taichi_sim.uav.fixed_wing.trim import Trim


def trimmed(state: Tensor, at: Trim, wind: Tensor, air: Wind | None = None) -> Tensor:
    """States [n, vehicle, 13] at the positions and headings of `state`, otherwise in the straight flight `at`, in the
    mean `wind` [n, 3] (NED, m/s, 10 m above the sea) with the profile of `air` (None: the same at any height).
    """
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., 2]
    phi, theta = (torch.full_like(heading, angle) for angle in (at.phi, at.theta))
    q = torch_quaternion_from_euler(phi, theta, heading)
    new = torch.zeros_like(state)
    new[..., POSITION], new[..., QUATERNION] = state[..., POSITION], q
    through_air = torch.tensor(at.state[VELOCITY], dtype=state.dtype, device=state.device)
    new[..., VELOCITY] = through_air + _to_body(wind_at(state, wind, air), q)
    new[..., ANGULAR_VELOCITY] = 0.0
    return new


def wind_at(state: Tensor, wind: Tensor, air: Wind | None = None) -> Tensor:
    """Mean wind [n, vehicle, 3] (NED, m/s) at the heights of `state` [n, vehicle, 13]; see trimmed."""
    here = wind.to(state).unsqueeze(1).expand(*state.shape[:2], 3)
    if air is None:
        return here
    factor = wind_factor(air.profile, air.shear, (-state[..., 2]).double().cpu().numpy())
    return here * torch.from_numpy(factor).to(state).unsqueeze(-1)


def air_readings(state: Tensor, wind: Tensor) -> Tensor:
    """Airspeed (m/s), angle of attack and of sideslip (rad) [.., 3] of `state` [.., 13] in the wind [.., 3] there."""
    u, v, w = (state[..., VELOCITY] - _to_body(wind, state[..., QUATERNION])).unbind(-1)
    return torch.stack(
        (torch.sqrt(u * u + v * v + w * w), torch.atan2(w, u), torch.atan2(v, torch.hypot(u, w))), dim=-1
    )


def _to_body(v_n: Tensor, q: Tensor) -> Tensor:
    return (torch_rotation_matrix(q).mT @ v_n.unsqueeze(-1)).squeeze(-1)
