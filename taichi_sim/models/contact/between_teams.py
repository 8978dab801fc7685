"""Contact between teams: a vehicle with legs can stand on any deck in the same environment.

A control step (World.step) has this order:

1. `begin`: each carrier's load gets the mean load of the vehicles that pressed on its decks in the last step.
2. Carriers step, alone. Then `meet` finds the decks near each vehicle with legs, and their motion (deck_motion.py).
3. Vehicles with legs step. Where a sole may touch, the physics step is split into contact steps of about a millisecond,
   against a deck that answers at once. Elsewhere the step is the same as in free flight.
4. `end`: carriers receive the displacement and impulse that the loads of 1 did not include.

A stiff leg needs steps of a millisecond, which would be far too expensive for a hull in waves. A reaction that is
applied one control step late would violate Newton's third law and add energy. A constant reaction can be applied as a
load: it is smooth, and right while the contact does not change. The rest, in a touchdown or a take-off, is applied as
an impulse at the end of the step.

A vehicle is near one deck at a time. Where several press on one carrier, each one sees the others' loads of the
previous step. A team with legs carries nobody.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from taichi_sim.errors import UserError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import BELOW, HORIZONTAL, POSITION, QUATERNION
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.kernels.runtime import LARGE, Launcher
from taichi_sim.models.contact import deck_motion
from taichi_sim.models.contact.deck_and_legs import Deck
from taichi_sim.models.contact.leg_contact import DOWN, SOLE_SIZE, Touch
from taichi_sim.state.memory import Remembers
from taichi_sim.state.snapshot import entries
from taichi_sim.vehicle import Vehicle

FRICTION_KEY = "deck.friction"  # may differ between environments if `Vehicle.varying` has it
DEEPEST_START = 0.02  # m; a sole that begins deeper below a deck's plane is inside the deck, not on it; assumed


class PlacementError(UserError, ValueError):
    """A vehicle was placed where it cannot be."""


class Carriers:
    """A team with decks.

    Attributes:
        fleet: the team.
        base: number of the team's first deck.
        reach: of the deck from the vehicle's origin, m.
        before: states at the beginning of a step, [env, vehicle, 13].
    """

    def __init__(self, fleet: Fleet[Vehicle], deck: Deck, base: int):
        """Take a team whose vehicles all carry `deck`."""
        self.fleet, self.deck, self.base = fleet, deck, base
        self.before = torch.zeros_like(fleet.state)
        self.reach = math.hypot(*deck.centre) + math.hypot(*deck.half)
        kernels = deck_motion.press, deck_motion.meet, deck_motion.react
        self.press, self.meet, self.react = (Launcher(kernel, few=LARGE) for kernel in kernels)
        self._numbers: Tensor | None = None
        self._version = -1
        self._table = self._fresh_table()

    @property
    def table(self) -> Tensor:
        """Deck and mobility of each carrier (deck_motion.py) with current numbers: [env or 1, vehicle or 1,
        TABLE_SIZE]."""
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


class Contacts(Remembers):
    """All decks and legs of a world (see the module's docstring).

    Attributes:
        carriers: teams with decks.
        legged: name -> team with legs, if the world has a deck for them; each of these teams has a `Touch`.
    """

    def __init__(self, teams: Mapping[str, Fleet[Vehicle]], interval: float):
        """Find the decks and legs of `teams`, whose control steps take `interval` (s)."""
        self.interval = interval
        self.carriers: list[Carriers] = []
        self.legged: dict[str, Fleet[Vehicle]] = {}
        self.placed: Tensor | None = self.remember(None)
        legged = {name: fleet for name, fleet in teams.items() if fleet.model.legs is not None}
        decks = {name: fleet for name, fleet in teams.items() if fleet.model.deck is not None and name not in legged}
        if not legged or not decks:
            return
        self.legged = legged
        for fleet in decks.values():
            assert fleet.model.deck is not None
            base = self.carriers[-1].base + self.carriers[-1].fleet.count if self.carriers else 0
            self.carriers.append(Carriers(fleet, fleet.model.deck, base))
            fleet.load  # noqa: B018 - creates the tensor, so that kernels are compiled with a load from the beginning
        for fleet in legged.values():
            legs = fleet.model.legs
            assert legs is not None
            fleet.touch = Touch(fleet.num_envs, fleet.count, len(legs.points))
            self.placed = torch.zeros(fleet.num_envs, dtype=torch.bool, device=fleet.state.device)

    def __bool__(self) -> bool:
        """Whether any contact is possible."""
        return bool(self.legged)

    def ordered(self, teams: Mapping[str, Fleet[Vehicle]]) -> list[str]:
        """Names of `teams` in the order in which they step: those with legs after their carriers."""
        return sorted(teams, key=lambda name: name in self.legged)

    # -- a step ----------------------------------------------------------------------------------------------------

    def begin(self) -> dict[str, Tensor]:
        """Add the loads of vehicles on decks to the carriers' loads; return the loads without them, for `meet`."""
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
                    carriers.press.once(fleet.load, touch.pressing, carriers.base)
        return held

    def meet(self, held: Mapping[str, Tensor]) -> None:
        """Restore the carriers' loads `held` after their step, and find the decks near each vehicle with legs."""
        for carriers in self.carriers:
            if carriers.fleet.name in held:
                carriers.fleet.load.copy_(held[carriers.fleet.name])
            for fleet, touch in zip(self.legged.values(), self._touches, strict=True):
                carriers.meet(
                    fleet.state, touch.pressing, touch.way, carriers.before, carriers.fleet.state, carriers.table,
                    carriers.base, fleet.model.deck_reach, self.interval,
                )  # fmt: skip

    def end(self) -> None:
        """Apply the remaining reactions to the carriers after the vehicles with legs have stepped."""
        for touch in self._touches:
            if not bool(touch.way[..., deck_motion.WHICH].any()):
                continue
            for carriers in self.carriers:
                fleet = carriers.fleet
                carriers.react(
                    fleet.state, fleet.derived, carriers.before, carriers.table, touch.way, carriers.base
                )

    def remembered(self) -> dict[str, dict[str, Tensor]]:
        """Copies of the memory of teams with legs: team -> name -> [env, vehicle, n]."""
        return {
            fleet.name: {entry.key: entry.value.clone() for entry in entries(fleet.touch)}
            for fleet in self.legged.values()
        }

    @property
    def _touches(self) -> list[Touch]:
        return [fleet.touch for fleet in self.legged.values() if fleet.touch is not None]

    def suppose(self, within: float) -> None:
        """Let all soles that are less than `within` (m) above a deck stand on it, and no others.

        For vehicles that move elsewhere: no contact is computed then.
        """
        for fleet, touch in zip(self.legged.values(), self._touches, strict=True):
            touch.pressing.zero_()
            touch.soles.zero_()
            for carriers in self.carriers:
                height, over = soles_over_deck(fleet, carriers)
                on = (height < within) & over  # [env, vehicle, carrier, leg]
                touch.soles[..., SOLE_SIZE - 1 :: SOLE_SIZE] += DOWN * on.any(dim=2)
                first = on.any(dim=3).to(torch.int8).argmax(dim=2)
                deck = torch.where(on.any(dim=3).any(dim=2), 1 + carriers.base + first, 0)
                touch.pressing[..., deck_motion.PRESSED] += deck

    # -- beginning -------------------------------------------------------------------------------------------------

    def place(self, fleet: Fleet[Vehicle], envs: Tensor) -> None:
        """Forget the contacts of a team whose vehicles were placed anew in environments `envs` [n]."""
        if self.placed is None:
            return
        self.placed[envs] = True
        if fleet.touch is not None:
            fleet.touch.forget(envs)
        self._leave(fleet, envs, 0, fleet.count)

    def put(self, fleet: Fleet[Vehicle], env: int, number: int) -> None:
        """Forget the contacts of vehicle `number` of a team, which was placed anew in environment `env`."""
        if self.placed is None:
            return
        self.placed[env] = True
        if fleet.touch is not None:
            fleet.touch.forget(env, number)
        self._leave(fleet, torch.tensor([env], device=self.placed.device), number, number + 1)

    def _leave(self, fleet: Fleet[Vehicle], envs: Tensor, first: int, last: int) -> None:
        """Forget the contacts with vehicles `first` to `last` - 1 of a team in environments `envs` [n]."""
        for carriers in self.carriers:
            if carriers.fleet is fleet:
                for touch in self._touches:
                    touch.leave(envs, carriers.base + first, carriers.base + last)

    def _check_starts(self, envs: Tensor) -> None:
        """Refuse a start in environments `envs` [n] in which a deck's plane passes through a vehicle with legs."""
        for name, fleet in self.legged.items():
            for carriers in self.carriers:
                away = fleet.position_n[envs].unsqueeze(2) - carriers.fleet.position_n[envs].unsqueeze(1)
                if bool((away.norm(dim=-1) > _reach(fleet) + carriers.reach).all()):
                    continue
                depth = soles_in_deck(fleet, carriers, envs)
                deep = (depth > DEEPEST_START).nonzero()
                if len(deep):
                    row, i, j = deep[0].tolist()
                    raise PlacementError(
                        f"{name}: vehicle {i} in environment {int(envs[row])} begins inside the deck of vehicle {j} of "
                        f"{carriers.fleet.name}: its soles are {float(depth[row, i, j]):.3g} m below the deck's plane, "
                        f"allowed are {DEEPEST_START:g} m"
                    )


def _reach(fleet: Fleet[Vehicle]) -> float:
    """Distance (m) of the soles of vehicles with legs from their own centre of gravity, wherever it varies, at most."""
    legs = fleet.model.legs
    return 0.0 if legs is None else 2 * max(math.hypot(*point) for point in legs.points)


def soles_in_deck(fleet: Fleet[Vehicle], carriers: Carriers, envs: Tensor) -> Tensor:
    """Depth [n, vehicle, carrier] (m) of the deepest sole below the plane of a deck and within its rectangle.

    It is 0 where no sole is below, or where the vehicle's centre of gravity is not above the plane.
    """
    height, over = soles_over_deck(fleet, carriers, envs)
    depth = torch.where(over, -height, torch.zeros_like(height))
    return depth.amax(dim=-1).clamp(min=0.0)


def soles_over_deck(
    fleet: Fleet[Vehicle], carriers: Carriers, envs: Tensor | slice = slice(None)
) -> tuple[Tensor, Tensor]:
    """Height [n, vehicle, carrier, leg] (m) of soles above the plane of decks; whether they are over their rectangles.

    No sole is over a deck above whose plane the vehicle's centre of gravity is not.
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
    return -in_b[..., 1:, BELOW], (over & above)[..., 1:]
