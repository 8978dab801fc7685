"""Classical dynamic positioning: PID control of surge, sway and yaw (Fossen 2021, ch. 15.3), with feed-forward.

In the heading frame, with the error e of place and heading, its rate e', the sum z of errors, velocity v and
acceleration a of the place (all [surge, sway, yaw]):

    tau = M (a + w^2 e + 2 zeta w e' + w^2 sum_share w z) + d(v) - M wave_share g tilt.

The last term: a hull floats on the water's slope, so its tilt measures the push of the waves along the deck. M is the
inertia of slow motion, d the resistance; level motion and yaw have bandwidths w of their own.
"""

from typing import NamedTuple, Self

import torch
from torch import Tensor

from rl.guidance.controllers.vessel import Resistance, hull_dynamics, planar_dynamics
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle


class Known(NamedTuple):
    """What a keeper reads, as measured, in the heading frame: surge, sway, yaw [env, boat, 3]."""

    error: Tensor  # m, m, rad
    error_rate: Tensor  # m/s, m/s, rad/s
    pace: Tensor  # m/s, m/s, rad/s: velocity of the place
    push: Tensor  # its acceleration
    sum: Tensor  # m s, m s, rad s
    down: Tensor  # [env, boat, 2], the vertical's parts ahead and to starboard


class KeeperGains(Strict):
    """Numbers of the control law."""

    bandwidth: Positive = 0.5  # rad/s, of level motion
    damping: Positive = 0.9
    yaw_bandwidth: Positive = 0.8  # rad/s
    yaw_damping: Positive = 0.9
    sum_share: Positive = 0.1  # of the bandwidths, in the integrals
    wave_share: NonNegative = 0.3  # of the waves' push


class Craft(NamedTuple):
    """A craft in surge, sway and yaw: inertia, resistance a, b, c (vessel.py), limits of its forces; SI."""

    inertia: tuple[float, ...]
    drag: tuple[Resistance, ...]
    most: tuple[float, ...]
    least: tuple[float, ...]

    @classmethod
    def of(cls, model: Vehicle) -> Self | None:
        """Of a vessel that pushes in surge, sway and yaw; None of any other."""
        if isinstance(model, Hull6Dof) and model.params.actions == "wrench":
            most, least = model.wrench_max, model.wrench_min
            d = hull_dynamics(model, most[0], most[2])
        elif isinstance(model, Manoeuvring3dof) and model.params.actions == "surge_sway_yaw":
            p, d = model.params, planar_dynamics(model.params)
            most = (p.surge_force_max, p.sway_force_max, p.yaw_moment_max)
            least = tuple(-x for x in most)
        else:
            return None
        pushes = min(*most, *(-x for x in least)) > 0
        return cls((d.m11, d.m22, d.m33), (d.surge, d.sway, d.yaw), most, least) if pushes else None


class Keeper(Remembers):
    """Keeps place and heading, or follows where they move."""

    Gains = KeeperGains

    def __init__(self, model: Vehicle, gains: KeeperGains | None = None):
        """Compute what follows from the `model`, a craft, and the `gains`."""
        craft = Craft.of(model)
        assert craft is not None
        g = self.gains = gains or KeeperGains()
        w, zeta = ((level, level, yaw) for level, yaw in ((g.bandwidth, g.yaw_bandwidth), (g.damping, g.yaw_damping)))
        self._craft = craft
        self._numbers = [w, zeta, [g.sum_share * x for x in w], [g.wave_share * GRAVITY] * 2 + [0.0]]

    def __call__(self, known: Known) -> Tensor:
        """Actions [env, boat, 3], each a share of the largest force."""
        like, pace = known.error.new_tensor, known.pace
        mass, drag, most, least = map(like, self._craft)
        w, zeta, slow, waves = map(like, self._numbers)
        tilt = torch.nn.functional.pad(known.down, (0, 1))
        wanted = known.push + w * w * (known.error + slow * known.sum) + 2 * zeta * w * known.error_rate - waves * tilt
        force = mass * wanted + (drag[:, 0] + drag[:, 1] * pace.abs() + drag[:, 2] * pace * pace) * pace
        return torch.nan_to_num(torch.where(force > 0, force / most, -force / least)).clamp(-1.0, 1.0)
