"""Initial states of fixed-wing aircraft: steady flight in any wind, with instruments that show it."""

import torch
from torch import Tensor

from taichi_sim.conventions import ANGULAR_VELOCITY, DOWN, HEADING, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import (
    torch_euler_from_quaternion,
    torch_quaternion_from_euler,
    torch_rotation_matrix,
)
from taichi_sim.surroundings import Surroundings
from taichi_sim.uav.fixed_wing.instruments import DEFLECTIONS, HEIGHT_DEMAND, LOAD_FACTOR, READINGS, WIND
from taichi_sim.uav.fixed_wing.trim import Trim
from taichi_sim.uav.local_air import wind_at


def trimmed(state: Tensor, at: Trim, around: Surroundings) -> Tensor:
    """States [n, vehicle, 13] in the straight flight `at` in the mean wind, at the positions and headings of
    `state`.
    """
    heading = torch_euler_from_quaternion(state[..., QUATERNION])[..., HEADING]
    phi, theta = (torch.full_like(heading, angle) for angle in (at.phi, at.theta))
    q = torch_quaternion_from_euler(phi, theta, heading)
    new = torch.zeros_like(state)
    new[..., POSITION], new[..., QUATERNION] = state[..., POSITION], q
    through_air = torch.tensor(at.state[VELOCITY], dtype=state.dtype, device=state.device)
    new[..., VELOCITY] = through_air + _to_body(wind_at(state, around), q)
    new[..., ANGULAR_VELOCITY] = 0.0
    return new


def show(aux: Tensor, state: Tensor, around: Surroundings, delta: tuple[float, ...]) -> None:
    """Write the instruments aux [n, vehicle, ..] of aircraft that begin at `state` [n, vehicle, 13].

    `delta` [4] are the actuators' positions. The air moves with the mean wind, and the present height is the one to
    hold. The first step draws the turbulence.
    """
    aux.zero_()
    wind = wind_at(state, around)
    aux[..., DEFLECTIONS : DEFLECTIONS + 4] = torch.tensor(delta, dtype=aux.dtype, device=aux.device)
    aux[..., READINGS : READINGS + 3] = air_readings(state, wind)
    aux[..., WIND : WIND + 3] = wind
    aux[..., LOAD_FACTOR] = 1.0
    aux[..., HEIGHT_DEMAND] = -state[..., DOWN]


def air_readings(state: Tensor, wind: Tensor) -> Tensor:
    """Airspeed (m/s), angles of attack and of sideslip (rad) [.., 3] of `state` [.., 13] in `wind` [.., 3] (NED,
    m/s).
    """
    u, v, w = (state[..., VELOCITY] - _to_body(wind, state[..., QUATERNION])).unbind(-1)
    return torch.stack(
        (torch.sqrt(u * u + v * v + w * w), torch.atan2(w, u), torch.atan2(v, torch.hypot(u, w))), dim=-1
    )


def _to_body(v_n: Tensor, q: Tensor) -> Tensor:
    return (torch_rotation_matrix(q).mT @ v_n.unsqueeze(-1)).squeeze(-1)
