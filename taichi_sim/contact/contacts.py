"""Contact between teams: any vehicle with legs on any vehicle with a deck in the same environment.

The order of a control step (World.step):

1. `begin`: each carrier's load gets what vehicles pressed on its decks with in the last step, as a mean over it.
2. Carriers step, alone. `meet`: which vehicles with legs are near which decks, and how these have moved (carrier.py).
3. Vehicles with legs step. Where a sole may touch, their physics step is made in contact steps of about a millisecond,
   against a deck that answers at once; else nothing differs from a flight.
4. `end`: carriers are moved, and given the impulse, by what the loads of 1 were not.

Why so: a stiff leg needs steps of a millisecond, a hull in waves must not be stepped so; and a reaction that came a
control step late would be no law of motion: it would give energy. A reaction that is held as a load is smooth, and
right while it does not change; the rest, in a touchdown or a take-off, comes as an impulse at the end of the step.

A vehicle is near one deck at a time. Where several press on one carrier, each sees the others' loads of the step
before. A team that has legs carries nobody.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from taichi_sim.contact import carrier
from taichi_sim.contact.parts import Deck
from taichi_sim.contact.touch import Touch
from taichi_sim.conventions import BELOW, HORIZONTAL, POSITION, QUATERNION
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.kernels.runtime import Launcher

FRICTION_KEY = "deck.friction"  # in `Vehicle.varying`, it may differ between environments
DEEPEST_START = 0.02  # m: soles that begin further below a deck are in it, not on it; assumed


class PlacementError(ValueError):
    """Vehicles that have been placed where they cannot be."""


class Carriers:
    """A team with decks.

    Attributes:
        fleet: the team. base: number of its first deck. before: [env, vehicle, 13], at the beginning of a step.
    """

    def __init__(self, fleet: Fleet, deck: Deck, base: int):
        """`deck` is that of each of the team's vehicles."""
        self.fleet, self.deck, self.base = fleet, deck, base
        self.before = torch.zeros_like(fleet.state)
        self.press, self.meet, self.react = Launcher(carrier.press), Launcher(carrier.meet), Launcher(carrier.react)
        self._numbers: Tensor | None = None
        self._version = -1
        self._table = self._fresh_table()

    @property
    def table(self) -> Tensor:
        """[env or 1, vehicle or 1, TABLE_SIZE] deck and mobility (carrier.py), as the fleet's numbers are now."""
        numbers = self.fleet.numbers
        version = -1 if numbers is None else numbers._version
        if numbers is not self._numbers or version != self._version:
            self._numbers, self._version = numbers, version
            self._table = self._fresh_table()
        return self._table

    def _fresh_table(self) -> Tensor:
        mobility = self.fleet.model.mobility(self.fleet)
        free = mobility.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] > 0
        identity = torch.eye(6, dtype=mobility.dtype, device=mobility.device)
        mass = torch.where(free, torch.linalg.inv(torch.where(free, mobility, identity)), torch.zeros_like(mobility))
        place = mobility.new_tensor((*self.deck.centre, *self.deck.half)).expand(*mobility.shape[:2], -1)
        friction = mobility.new_full((*mobility.shape[:2], 1), self.deck.friction)
        if FRICTION_KEY in self.fleet.model.varying and self.fleet.varied:
            friction = self.fleet.vary[FRICTION_KEY].to(mobility).unsqueeze(-1)
        shape = torch.broadcast_shapes(mobility.shape[:2], friction.shape[:2])
        parts = (place, friction, mobility.flatten(-2), mass.flatten(-2))
        return torch.cat([part.expand(*shape, -1) for part in parts], dim=-1).to(self.fleet.state.dtype).contiguous()


class Contacts:
    """All decks and legs of a world; see the module.

    Attributes:
        carriers: teams with decks. legged: name -> team with legs, where there is a deck for them; each has a `Touch`.
    """

    STATE = ("placed",)

    def __init__(self, teams: Mapping[str, Fleet], interval: float):
        """Of `teams` that make control steps of `interval` (s)."""
        self.interval = interval
        self.carriers: list[Carriers] = []
        self.legged: dict[str, Fleet] = {}
        self.placed: Tensor | None = None
        legged = {name: fleet for name, fleet in teams.items() if fleet.model.legs is not None}
        decks = {name: fleet for name, fleet in teams.items() if fleet.model.deck is not None and name not in legged}
        if not legged or not decks:
            return
        self.legged = legged
        for fleet in decks.values():
            assert fleet.model.deck is not None
            base = self.carriers[-1].base + self.carriers[-1].fleet.count if self.carriers else 0
            self.carriers.append(Carriers(fleet, fleet.model.deck, base))
            fleet.load  # noqa: B018 - kernels are compiled with it from the beginning
        for fleet in legged.values():
            legs = fleet.model.legs
            assert legs is not None
            fleet.touch = Touch(fleet.num_envs, fleet.count, len(legs.points))
            self.placed = torch.zeros(fleet.num_envs, dtype=torch.bool, device=fleet.state.device)

    def __bool__(self) -> bool:
        """Whether anything can touch."""
        return bool(self.legged)

    def ordered(self, teams: Mapping[str, Fleet]) -> list[str]:
        """Names of `teams` as they step: those with legs after what may carry them."""
        return sorted(teams, key=lambda name: name in self.legged)

    # -- a step ----------------------------------------------------------------------------------------------------

    def begin(self) -> dict[str, Tensor]:
        """Carriers get the loads of what presses on them; returns the loads from others, for `restore`.

        Raises:
            PlacementError: for a vehicle that has been placed inside a deck.
        """
        if self.placed is not None and bool(self.placed.any()):
            self._check_starts(self.placed.nonzero().flatten())
            self.placed.zero_()
        held: dict[str, Tensor] = {}
        acting = any(bool(touch.pressing.any()) for touch in self._touches)
        for carriers in self.carriers:
            fleet = carriers.fleet
            carriers.before.copy_(fleet.state)
            if acting:
                held[fleet.name] = fleet.load.clone()
                for touch in self._touches:
                    carriers.press.once(fleet.load, touch.pressing, carriers.base, fleet.few)
        return held

    def meet(self, held: Mapping[str, Tensor]) -> None:
        """Carriers have stepped: `held` are their loads again; vehicles with legs learn of decks that are near."""
        for carriers in self.carriers:
            if carriers.fleet.name in held:
                carriers.fleet.load.copy_(held[carriers.fleet.name])
            for fleet, touch in zip(self.legged.values(), self._touches, strict=True):
                carriers.meet(
                    fleet.state, touch.pressing, touch.way, carriers.before, carriers.fleet.state, carriers.table,
                    carriers.base, fleet.model.deck_reach, self.interval, fleet.few,
                )  # fmt: skip

    def end(self) -> None:
        """Vehicles with legs have stepped: carriers get what is left of the reactions."""
        for touch in self._touches:
            if not bool(touch.way[..., carrier.WHICH].any()):
                continue
            for carriers in self.carriers:
                fleet = carriers.fleet
                carriers.react(
                    fleet.state, fleet.derived, carriers.before, carriers.table, touch.way, carriers.base, fleet.few
                )

    def remembered(self) -> dict[str, dict[str, Tensor]]:
        """Copies of what teams with legs remember: team -> name -> [env, vehicle, n]."""
        return {
            fleet.name: {name: getattr(fleet.touch, name).clone() for name in Touch.STATE}
            for fleet in self.legged.values()
        }

    @property
    def _touches(self) -> list[Touch]:
        return [fleet.touch for fleet in self.legged.values() if fleet.touch is not None]

    # -- beginning -------------------------------------------------------------------------------------------------

    def place(self, fleet: Fleet, envs: Tensor) -> None:
        """Vehicles of a team have been placed in environments `envs` [n]: what they touched is forgotten."""
        if self.placed is None:
            return
        self.placed[envs] = True
        if fleet.touch is not None:
            fleet.touch.forget(envs)
        for carriers in self.carriers:
            if carriers.fleet is fleet:
                for touch in self._touches:
                    touch.leave(envs, carriers.base, carriers.base + fleet.count)

    def _check_starts(self, envs: Tensor) -> None:
        """Refuse vehicles with legs that a deck's plane passes through, in environments `envs` [n]."""
        for name, fleet in self.legged.items():
            for carriers in self.carriers:
                depth = soles_in_deck(fleet, carriers, envs)
                deep = (depth > DEEPEST_START).nonzero()
                if len(deep):
                    row, i, j = deep[0].tolist()
                    raise PlacementError(
                        f"{name}: vehicle {i} in environment {int(envs[row])} begins inside the deck of vehicle {j} of "
                        f"{carriers.fleet.name}: its soles are {float(depth[row, i, j]):.3g} m below the deck's plane, "
                        f"allowed are {DEEPEST_START:g} m"
                    )


def soles_in_deck(fleet: Fleet, carriers: Carriers, envs: Tensor) -> Tensor:
    """How far [n, vehicle, carrier] (m) soles over a deck's rectangle are below its plane, of vehicles with legs whose
    centre of gravity is above that plane; 0 elsewhere.
    """
    own, theirs = fleet.state[envs].double(), carriers.fleet.state[envs].double()
    points = fleet.model.soles(fleet).to(own)
    points = points[envs] if len(points) > 1 else points
    R = torch_rotation_matrix(own[..., QUATERNION])
    soles = own[..., None, POSITION] + (R.unsqueeze(2) @ points.unsqueeze(-1)).squeeze(-1)  # [n, vehicle, leg, 3]
    both = torch.cat((own[..., None, POSITION], soles), dim=2)
    R_c = torch_rotation_matrix(theirs[..., QUATERNION])
    away = both[:, :, None] - theirs[:, None, :, None, POSITION]  # [n, vehicle, carrier, 1 + leg, 3]
    in_b = (R_c.mT[:, None, :, None] @ away.unsqueeze(-1)).squeeze(-1) - own.new_tensor(carriers.deck.centre)
    over = (in_b[..., HORIZONTAL].abs() <= own.new_tensor(carriers.deck.half)).all(dim=-1)
    above = in_b[..., :1, BELOW] < 0
    depth = in_b[..., BELOW]
    return torch.where(over & above, depth, torch.zeros_like(depth))[..., 1:].amax(dim=-1).clamp(min=0.0)
