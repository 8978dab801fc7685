"""Boats with decks, and how the middle of each deck moves."""

from typing import NamedTuple

import torch
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet, Views
from taichi_sim.kernels.conventions import BELOW
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle


class DeckMotion(NamedTuple):
    """Motion of the middle of each deck."""

    place: Tensor  # [env, boat, 3] NED, m
    velocity: Tensor  # [env, boat, 3] NED, m/s
    R: Tensor  # [env, boat, 3, 3] R_nb
    tilt: Tensor  # [env, boat] rad, of its normal to the vertical
    heading: tuple[Tensor, Tensor]  # cosine and sine [env, boat]

    @property
    def down(self) -> Tensor:
        """Normal of each deck, into it, [env, boat, 3] (NED)."""
        return self.R[..., BELOW]


def deck_motion(boats: Views, centre: Tensor) -> DeckMotion:
    """Return the motion of the decks of `boats`; `centre` [3] (m, b) is the middle of a deck."""
    R = boats.R_nb
    arm = torch.linalg.cross(boats.angular_velocity_b, centre.expand_as(boats.angular_velocity_b), dim=-1)
    place = boats.position_n + (R * centre).sum(-1)  # products of small matrices are slower
    velocity = boats.velocity_n + (R * arm.unsqueeze(-2)).sum(-1)
    return DeckMotion(place, velocity, R, R[..., 2, 2].clamp(-1.0, 1.0).acos(), boats.heading)


class Decks(Remembers):
    """The decks of a fleet of boats, as they are.

    Attributes:
        fleet: the boats. centre: [3] middle of a deck, m, b. deck: its motion, as of the last `follow`.
    """

    def __init__(self, fleet: Fleet[Vehicle]):
        """Follow the decks of `fleet`."""
        if fleet.model.deck is None:
            raise ConfigError(f"{fleet.name}.vehicle has no [deck] on which aircraft could land")
        self.fleet, self.centre = fleet, fleet.state.new_tensor(fleet.model.deck.centre)
        self.deck = deck_motion(fleet, self.centre)

    def follow(self) -> None:
        """Compute `deck` anew."""
        self.deck = deck_motion(self.fleet, self.centre)

    def restored(self) -> None:
        """Compute the motion of the decks again after a snapshot was restored."""
        self.follow()
