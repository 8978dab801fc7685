"""Kernels' functions over many numbers at once: turbulence's step as matrices, rotors' rates, ground effect."""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportGeneralTypeIssues=false

import numpy as np
import taichi as ti
import torch

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.runtime import array1, array2, array3
from taichi_sim.models.uav.multirotor import ground, rotors
from taichi_sim.models.uav.multirotor.params import MultirotorParams, nominal_numbers
from taichi_sim.surroundings.air.turbulence import STATES, dryden_advance, dryden_filter, dryden_output, dryden_sigma


@ti.func
def dryden_step(x, V, h, dt, z):
    """State (5) after dt (s) at airspeed V (m/s, >= 0) and height h (m); z holds five standard normal numbers."""
    return dryden_advance(x, dryden_filter(V, h, dt), z)


@ti.func
def dryden_gust(x, h, W20):
    """Gust (u, v, w; m/s) in the turbulence axes, from the state x (5), the height h (m) and W20 (m/s)."""
    return dryden_output(x, dryden_sigma(h, W20))


@ti.kernel
def _matrices(out: array3, V: array1, h: array1, W20: float, dt: float):
    for row, k in ti.ndrange(out.shape[0], STATES):
        unit, zero = ti.Vector([0.0] * STATES), ti.Vector([0.0] * STATES)
        for i in ti.static(range(STATES)):
            unit[i] = ti.select(i == k, 1.0, 0.0)
        F = dryden_step(unit, V[row], h[row], dt, zero)
        N = dryden_step(zero, V[row], h[row], dt, unit)
        C = dryden_gust(unit, h[row], W20)
        for i in ti.static(range(STATES)):
            out[row, i, k], out[row, STATES + i, k] = F[i], N[i]
        for i in ti.static(range(3)):
            out[row, 2 * STATES + i, k] = C[i]


def dryden_matrices(V, h, W20: float, dt: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the kernels' step as matrices: x' = F x + N z and gust = C x.

    Args:
        V, h: airspeeds (m/s) and heights (m), [n] each.
        W20: wind at 20 ft, m/s.
        dt: step, s.

    Returns:
        F [n, 5, 5], N [n, 5, 5] and C [n, 3, 5], in run precision.
    """
    run = runtime.current()
    V, h = (torch.as_tensor(v, dtype=run.torch_dtype, device=run.device).contiguous() for v in (V, h))
    out = torch.zeros((h.shape[0], 2 * STATES + 3, STATES), dtype=run.torch_dtype, device=run.device)
    _matrices(out, V, h, W20, dt)
    return out[:, :STATES], out[:, STATES : 2 * STATES], out[:, 2 * STATES :]


def dryden_scales(h) -> tuple[torch.Tensor, torch.Tensor]:
    """Return lengths (L_u = L_v, L_w; m) and intensities over W20 (sigma_u = sigma_v, sigma_w), [n, 2] each.

    They are read off the kernels' step at 1 m/s and their gust, at heights h (m, [n]).
    """
    h = torch.as_tensor(h, dtype=runtime.current().torch_dtype)
    F, _, C = dryden_matrices(torch.ones_like(h), h, 1.0, 1.0)
    # F21 = -2 tau a, and tau = 1 m / L
    lengths = torch.stack((-2 * F[:, 1, 1] / F[:, 2, 1], -2 * F[:, 3, 3] / F[:, 4, 3]), dim=1)
    return lengths, torch.stack((C[:, 0, 0], (C[:, 2] ** 2).sum(dim=1).sqrt()), dim=1)


@ti.kernel
def _rates(craft: ti.template(), omega: array2, command: array2, out: array2):
    for n in range(omega.shape[0]):
        speed = taken2(omega, n, ti.static(len(craft.rotors)))
        asked = taken2(command, n, ti.static(len(craft.rotors)))
        held = rotors.clipped(craft, asked, craft.rotor.omega_max)
        rate = rotors.acceleration(craft, ti.static(nominal_numbers(craft)), speed, held)
        for k in ti.static(range(len(craft.rotors))):
            out[n, k] = rate[k]


def rotor_rates(craft: MultirotorParams, omega, command) -> np.ndarray:
    """Rates [n, rotor] (rad/s^2) of rotors at omega [n, rotor] with commands `command` [n, rotor] (rad/s)."""
    omega, command = (np.ascontiguousarray(x, dtype=np.float64) for x in (omega, command))
    out = np.empty_like(omega)
    _rates(craft, omega, command, out)
    return out


@ti.kernel
def _ratios(craft: ti.template(), heights: array2, weights: array2, omega: array2, speed: array2, out: array2):
    for n in range(heights.shape[0]):
        h = taken2(heights, n, ti.static(len(craft.rotors)))
        w = taken2(weights, n, ti.static(len(craft.rotors)))
        turning = taken2(omega, n, ti.static(len(craft.rotors)))
        p = ti.static(nominal_numbers(craft))
        ratio = ground.thrust_ratios(craft, p, h, w, turning, speed[n, 0] * speed[n, 0])
        for k in ti.static(range(len(craft.rotors))):
            out[n, k] = ratio[k]


def ground_ratios(craft: MultirotorParams, heights, weights, omega, speed=0.0) -> np.ndarray:
    """Thrust over that in free air [n, rotor] of rotors at `heights` [n, rotor] (m) over a ground of `weights`
    [n, rotor].

    Weights are from 0 to 1 (ground.py); omega [n, rotor] are the speeds (rad/s), `speed` the airspeed across the axes
    (m/s).
    """
    heights = np.ascontiguousarray(np.atleast_2d(heights), dtype=np.float64)
    weights, omega = (
        np.ascontiguousarray(np.broadcast_to(x, heights.shape), dtype=np.float64) for x in (weights, omega)
    )
    fast, out = np.full((len(heights), 1), float(speed)), np.empty_like(heights)
    _ratios(craft, heights, weights, omega, fast, out)
    return out
