"""Contact of legs with decks: the force of one sole, and what a team with legs remembers of decks.

The force is a spring and a damper along the deck's normal, and Coulomb friction that sticks or slips. The sole is at
depth d (m) below the deck's plane, and sinks at the speed d'. It has the displacement s (m, in the plane) from the
point where it was set down, and the velocity v (m/s, in the plane). All are relative to the deck's point there.

    N = max(0, k d + c d'),    |k s| <= mu N,    f = -k s - c v,  |f| <= mu N.

A contact pushes and never pulls. Friction is elastic until the sole slips: s is the elastic displacement, and the point
where the sole was set down follows a sole that slips (Cundall and Strack 1979, A discrete numerical model for granular
assemblies, Geotechnique 29:47-65). A sole that sticks therefore does not creep, however fast the deck moves. With
constant N friction only takes energy: f v + k s v <= 0.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import TouchPack
from taichi_sim.models.contact.deck_motion import PRESSED, PRESSING_SIZE, WAY_SIZE
from taichi_sim.state.memory import Remembers

SOLE_SIZE = 3
"""Columns of a sole: x and y of the point where it was set down (carrier's b, from the deck's centre, m); mark."""
FREE, DOWN, UNDER = 0.0, 1.0, -1.0
"""Marks of a sole: above the deck; set down on it; below its plane without having come from above."""
SMALLEST = 1e-12  # m or N; a shorter vector has no direction


@ti.func
def shortened(a, most):
    """The plane vector a, shortened to a length of at most `most`."""
    length = ti.sqrt(a[0] * a[0] + a[1] * a[1])
    return a * ti.select(length > most, most / ti.max(length, SMALLEST), 1.0)


@ti.func
def sole_force(depth, sinking, bent, sliding, stiffness, damping, friction):
    """Return the normal force N (N), the friction [2] (N), and the remaining elastic displacement [2] (m) of one sole.

    depth: of the sole below the deck's plane, m. sinking: its rate, m/s. bent: displacement [2] from the point where
    the sole was set down, m. sliding: velocity [2] in the plane, m/s.
    """
    N = ti.max(stiffness * depth + damping * sinking, 0.0)
    left = shortened(bent, friction * N / stiffness)
    return N, shortened(-stiffness * left - damping * sliding, friction * N), left


class Touch(Remembers):
    """Contact of a team with legs with the decks around it.

    Attributes:
        pressing: [env, vehicle, 7]: 1 + number of the deck that the vehicle presses on (0: none), and the mean wrench
            on the carrier in the last step (N, N m, in the carrier's b, about its origin).
        soles: [env, vehicle, 3 legs], SOLE_SIZE columns per sole.
        struck: [env, vehicle, 1], 1 where a rotor has hit a deck.
        blow: [env, vehicle, 1], greatest speed (m/s) of a sole normal to and relative to the deck at a touchdown in
            this step; 0 without a touchdown.
        way: [env, vehicle, WAY_SIZE], motion of the nearby deck in this step (deck_motion.py).
    """

    def __init__(self, num_envs: int, count: int, legs: int):
        """Begin without any contact."""
        run = runtime.current()
        self.pressing, self.soles, self.struck, self.blow = (
            self.remember(torch.zeros((num_envs, count, size), dtype=run.torch_dtype, device=run.device))
            for size in (PRESSING_SIZE, SOLE_SIZE * legs, 1, 1)
        )
        self.way = self.scratch(self.blow.new_zeros((num_envs, count, WAY_SIZE)))
        self.pack = runtime.Packed(
            TouchPack, way=self.way, pressing=self.pressing, soles=self.soles, struck=self.struck, blow=self.blow
        )

    @property
    def on(self) -> Tensor:
        """Whether each vehicle stands on a deck, bool [env, vehicle]."""
        return self.pressing[..., PRESSED] > 0

    @property
    def all_down(self) -> Tensor:
        """Whether all soles of each vehicle are on a deck, bool [env, vehicle]."""
        return (self.soles[..., SOLE_SIZE - 1 :: SOLE_SIZE] == DOWN).all(dim=-1)

    def forget(self, envs: Tensor | int, vehicle: int | slice = slice(None)) -> None:
        """Forget the contacts of vehicles (default: all) in environments `envs` [n]."""
        for memory in (self.pressing, self.soles, self.struck, self.blow):
            memory[envs, vehicle] = 0.0

    def leave(self, envs: Tensor, first: int, last: int) -> None:
        """Forget the contacts with decks `first` to `last` - 1 in environments `envs` [n]."""
        deck = self.pressing[envs, :, PRESSED].long() - 1
        gone = (deck >= first) & (deck < last)
        for memory in (self.pressing, self.soles):
            memory[envs] = torch.where(gone.unsqueeze(-1), torch.zeros_like(memory[envs]), memory[envs])
