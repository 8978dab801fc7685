"""What a team with legs remembers of decks, and what its kernels take of it."""

import torch
from torch import Tensor

from taichi_sim.contact.carrier import PRESSING_SIZE, WAY_SIZE
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import TouchPack

SOLE_SIZE = 3  # where it was set down (x and y of the carrier's b, from the deck's centre, m); mark
FREE, DOWN, UNDER = 0.0, 1.0, -1.0
"""Marks of a sole: above the deck; set down on it; below its plane, where it has not come from above."""


class Touch:
    """A team with legs and the decks around it.

    Attributes:
        pressing: [env, vehicle, 7] 1 + number of the deck it presses on (0: none), mean wrench on the carrier in the
            last step (N, N m, b of the carrier, about its origin). soles: [env, vehicle, 3 legs], see above.
        struck: [env, vehicle, 1] 1 where a rotor has met a deck. blow: [env, vehicle, 1] greatest speed (m/s) normal to
            the deck, relative to it, of a sole that has come down in this step; 0 where none has.
        way: [env, vehicle, WAY_SIZE] of the deck near by in this step (carrier.py).
    """

    STATE = ("pressing", "soles", "struck", "blow")

    def __init__(self, num_envs: int, count: int, legs: int):
        """Nothing touches."""
        run = runtime.current()
        self.pressing, self.soles, self.struck, self.blow, self.way = (
            torch.zeros((num_envs, count, size), dtype=run.torch_dtype, device=run.device)
            for size in (PRESSING_SIZE, SOLE_SIZE * legs, 1, 1, WAY_SIZE)
        )
        self.pack = runtime.Packed(
            TouchPack, way=self.way, pressing=self.pressing, soles=self.soles, struck=self.struck, blow=self.blow
        )

    @property
    def on(self) -> Tensor:
        """Bool [env, vehicle]: whether it stands on a deck."""
        return self.pressing[..., 0] > 0

    @property
    def all_down(self) -> Tensor:
        """Bool [env, vehicle]: whether all soles are on a deck."""
        return (self.soles[..., SOLE_SIZE - 1 :: SOLE_SIZE] == DOWN).all(dim=-1)

    def forget(self, envs: Tensor) -> None:
        """Vehicles of environments `envs` [n] begin anew."""
        for memory in (self.pressing, self.soles, self.struck, self.blow):
            memory[envs] = 0.0

    def leave(self, envs: Tensor, first: int, last: int) -> None:
        """Carriers with decks `first` to `last` - 1 begin anew in environments `envs` [n]: nothing presses on them."""
        deck = self.pressing[envs, :, 0].long() - 1
        gone = (deck >= first) & (deck < last)
        for memory in (self.pressing, self.soles):
            memory[envs] = torch.where(gone.unsqueeze(-1), torch.zeros_like(memory[envs]), memory[envs])
