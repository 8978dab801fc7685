"""Slots: where each vehicle should be about its leader now, in every environment, and how that changes.

An episode begins with the shape (shapes.py) and the spacing that its start was drawn with. Where the formation changes
during an episode, every `change_every` seconds of it, both are drawn anew, and all slots of an environment set out
for their new places in straight lines of the path frame, to arrive together: the one with the longest way at `glide`,
the others slower.

New slots are assigned to followers so that x . g >= 0 for any two, x being the vector from one slot to the other before
the change and g after it. Two slots that violate this swap their goals, which shortens the sum of the squared ways,
until none does. On the way they are then never nearer than |x| |g| / sqrt(x^2 + g^2), which is spacing / sqrt(2) where
both formations have one spacing (Turpin, Michael & Kumar 2014, CAPT, Int. J. Robotics Research 33(1)). In a change that
begins before the last one has ended, x is smaller. The leader keeps its place, so there is no bound between it and a
follower's slot: the least found was 0.38 spacings, in teams of up to 16. The bounds are on slots, not on vehicles.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.shapes import formation_offsets
from rl.guidance.targets_and_errors import GOAL, OFFSET, RATE, SLOT_SIZE
from rl.missions.formation.config import FormationTeam
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import array1, array3
from taichi_sim.state.memory import Remembers

INTERVAL, GLIDE = range(2)  # parameters of the kernel
SHAPE, SPACING = range(2)  # of a change

CLOSE = 1e-4  # share of a squared spacing: a smaller gain is rounding
SWEEPS = 64  # over all pairs, at most; up to 16 vehicles need 5

SlotsPack = ti.types.argpack(table=array3, left=array1, changes=array3, units=array3, numbers=array1)


class Drawn(NamedTuple):
    """Drawn formations: index of the shape among those of the team (int64), and spacing (float64, m)."""

    shape: Tensor
    spacing: Tensor

    def at(self, *index: Tensor) -> "Drawn":
        """The formations at an index."""
        return Drawn(self.shape[index], self.spacing[index])


def draw_formations(section: FormationTeam, size: tuple[int, ...], generator: torch.Generator) -> Drawn:
    """Draw formations of a team; no random numbers are used if there is no choice."""
    shape, (low, high) = torch.zeros(size, dtype=torch.int64), section.spacings
    spacing = torch.full(size, low, dtype=torch.float64)
    if len(section.shapes) > 1:
        shape = torch.randint(len(section.shapes), size, generator=generator)
    if low < high:
        spacing = low + (high - low) * torch.rand(size, generator=generator, dtype=torch.float64)
    return Drawn(shape, spacing)


def unit_offsets(section: FormationTeam) -> Tensor:
    """Offsets [shape, vehicle, 2] (float64) of a team's shapes with a spacing of 1."""
    return torch.stack([formation_offsets(shape, section.count, 1.0) for shape in section.shapes])


def offsets_of(units: Tensor, drawn: Drawn) -> Tensor:
    """Offsets [.., vehicle, 2] (m, float64) of formations `drawn` [..], of a team's `unit_offsets`."""
    return units[drawn.shape] * drawn.spacing[..., None, None]


@ti.func
def untangle(table: ti.template(), e, least):
    """Swap goals of followers until x . g >= 0 for any two (see the module); gains below `least` (m^2) are rounding."""
    sweep, swapped = 0, True
    while swapped and sweep < SWEEPS:
        sweep, swapped = sweep + 1, False
        for i in range(1, table.shape[1]):
            for j in range(i + 1, table.shape[1]):
                gain = table[e, i, 0] * 0.0
                for a in ti.static(range(2)):
                    x = table[e, j, OFFSET + a] - table[e, i, OFFSET + a]
                    gain -= x * (table[e, j, GOAL + a] - table[e, i, GOAL + a])
                if gain > least:
                    swapped = True
                    for a in ti.static(range(2)):
                        goal = table[e, i, GOAL + a]
                        table[e, i, GOAL + a] = table[e, j, GOAL + a]
                        table[e, j, GOAL + a] = goal


@ti.func
def set_out(table: ti.template(), e, glide):
    """Give every slot the rate at which all arrive together; return the time until then (s)."""
    longest = table[e, 0, 0] * 0.0
    for i in range(1, table.shape[1]):
        square = longest * 0.0
        for a in ti.static(range(2)):
            way = table[e, i, GOAL + a] - table[e, i, OFFSET + a]
            square += way * way
        longest = ti.max(longest, ti.sqrt(square))
    left = longest / glide
    for i in range(1, table.shape[1]):
        for a in ti.static(range(2)):
            way = table[e, i, GOAL + a] - table[e, i, OFFSET + a]
            table[e, i, RATE + a] = ti.select(left > 0, way / ti.max(left, 1e-9), 0.0)
    return left


@ti.kernel
def _advance(slots: SlotsPack, steps: ti.types.ndarray(dtype=ti.i64, ndim=1), every: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e in range(slots.table.shape[0]):
        if slots.left[e] > 0:
            step = ti.min(slots.left[e], slots.numbers[INTERVAL])
            slots.left[e] -= step
            arrived = slots.left[e] <= 0
            for i in range(1, slots.table.shape[1]):
                for a in ti.static(range(2)):
                    there = slots.table[e, i, OFFSET + a] + slots.table[e, i, RATE + a] * step
                    slots.table[e, i, OFFSET + a] = ti.select(arrived, slots.table[e, i, GOAL + a], there)
                    slots.table[e, i, RATE + a] = ti.select(arrived, 0.0, slots.table[e, i, RATE + a])
        step = ti.cast(steps[e], ti.i32)
        if step > 0 and step % every == 0:
            k = (step // every - 1) % slots.changes.shape[1]
            shape, spacing = ti.cast(slots.changes[e, k, SHAPE], ti.i32), slots.changes[e, k, SPACING]
            for i in range(1, slots.table.shape[1]):
                for a in ti.static(range(2)):
                    slots.table[e, i, GOAL + a] = spacing * slots.units[shape, i, a]
            untangle(slots.table, e, ti.static(CLOSE) * spacing * spacing)
            slots.left[e] = set_out(slots.table, e, slots.numbers[GLIDE])


class Slots(Remembers):
    """Slots of a team; a formation that cannot change is written once.

    Attributes:
        table: [env, vehicle, 6]; see the columns. offsets, rates: [env, vehicle, 2] views of it, ahead and to starboard
            of the leader: a slot (m), and how fast it glides (m/s).
    """

    def __init__(self, section: FormationTeam, state: Tensor, *, interval: float, glide: float, steps: int):
        """Hold the slots of a team whose state is `state` [env, vehicle, 13].

        `interval` is of a decision (s), `glide` in m/s, `steps` the decisions in an episode.
        """
        envs, every = state.shape[0], section.formation.change_every
        self._section, self._units = section, unit_offsets(section).to(state.device)
        self.table = self.remember(state.new_zeros((envs, section.count, SLOT_SIZE)))
        self.offsets, self.rates = self.table[..., OFFSET:RATE], self.table[..., RATE:GOAL]
        self._choice = len(section.shapes) > 1 or section.spacings[0] < section.spacings[1]
        self._every = max(1, round(every / interval)) if every and self._choice else 0
        if self._every:
            self._left = self.remember(state.new_zeros(envs))
            self._changes = self.remember(state.new_zeros((envs, max(1, (steps - 1) // self._every), 2)))
            self._pack = runtime.Packed(
                SlotsPack, table=self.table, left=self._left, changes=self._changes, units=self._units.to(state),
                numbers=state.new_tensor([interval, glide]),
            )  # fmt: skip
            self._launch = runtime.Launcher(_advance)
        everywhere = torch.zeros(envs, dtype=torch.int64, device=state.device)
        self._place(slice(None), Drawn(everywhere, everywhere + torch.tensor(section.spacings[0], dtype=torch.float64)))

    def begin(self, envs: Tensor, drawn: Drawn, generator: torch.Generator) -> None:
        """Put slots of environments `envs` [n] into formations `drawn` [n], and draw the later ones of the episode."""
        if not self._choice:
            return
        self._place(envs, drawn)
        if self._every:
            self._left[envs] = 0.0
            later = draw_formations(self._section, (len(envs), self._changes.shape[1]), generator)
            self._changes[envs] = torch.stack(later, dim=-1).to(self._changes)

    def advance(self, steps: Tensor) -> None:
        """Glide for one decision, and begin changes that are due; `steps` int64 [env] have gone by."""
        if self._every:
            self._launch(self._pack(), steps, self._every)

    def _place(self, envs: Tensor | slice, drawn: Drawn) -> None:
        offsets = offsets_of(self._units, drawn)
        self.table[envs] = torch.cat((offsets, torch.zeros_like(offsets), offsets), dim=-1).to(self.table)
