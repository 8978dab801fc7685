"""How encounters begin: where ships are, for all to meet at one time if all went on.

    drawn   kinds, courses, speeds, sizes and meeting times are drawn
    imazu   the 22 situations of Imazu, as printed by Sawada, Sato & Majima (2021), Automatic ship collision avoidance
            using deep reinforcement learning with LSTM in continuous action spaces, J. Mar. Sci. Technol. 26, 509-524,
            table 4, of which 19 are distinct
    clock   one ship, on 24 courses around

A ship of a table meets the own ship from the place that its course gives, at the own ship's speed, or at 0.7 of it
("slow", ahead of it from 0.7 of the distance).
"""

import hashlib
import math
from typing import NamedTuple

import torch
from torch import Tensor

from rl.missions.encounter.config import CASES, EncounterScenario
from taichi_sim.config import ConfigError
from taichi_sim.errors import refuse

SLOW = 0.7
FAR = 2.5  # of the own ship's way to a meeting: where ships sail that meet nobody
TRIES = 20  # draws of ships, until all are apart
IMAZU: tuple[tuple[tuple[float, float], ...], ...] = tuple(
    tuple((psi, SLOW if slow else 1.0) for psi, slow in case)
    for case in (
        ((180, 0),), ((-90, 0),), ((0, 1),), ((45, 0),), ((180, 0), (-90, 0)), ((-10, 0), (-45, 0)),
        ((0, 1), (-45, 0)), ((-30, 0), (-90, 0)), ((-90, 0), (15, 0)), ((90, 0), (-30, 0)),
        ((180, 0), (10, 0), (45, 0)), ((-10, 0), (-45, 0), (-90, 0)), ((0, 1), (-45, 0), (-90, 0)),
        ((45, 1), (90, 0), (-90, 0)), ((0, 1), (10, 0), (-45, 0)), ((-135, 0), (-15, 0), (-30, 0)),
        ((15, 0), (-15, 0), (-135, 0)), ((0, 1), (-15, 0), (-90, 0)), ((-15, 0), (15, 0), (-90, 0)),
    )
)  # fmt: skip
"""Course (deg) and share of the own ship's speed of each ship of the distinct situations."""
IMAZU_DIGEST = hashlib.sha256(repr(IMAZU).encode()).hexdigest()[:16]
CLOCK = tuple(((15.0 * k, 1.0 if k else SLOW),) for k in range(24))


class Situation(NamedTuple):
    """Starts of `n` episodes; bodies after the first own ship, which begins at the origin.

    Attributes:
        route: [n] course of the first own ship, rad. place: [n, body, 2] m. course, speed: [n, body] rad, m/s, through
            the water. Ships that meet nobody in an episode sail away from it, from afar.
    """

    route: Tensor
    place: Tensor
    course: Tensor
    speed: Tensor


def cases_of(config: EncounterScenario) -> tuple[tuple[tuple[float, float], ...], ...]:
    """The situations of a table that take part; none for `drawn`."""
    part = config.encounter
    table = dict(zip(CASES[part.set], {"imazu": IMAZU, "clock": CLOCK, "drawn": ()}[part.set], strict=True))
    return tuple(table[k] for k in part.cases or table)


def direction(course: Tensor) -> Tensor:
    """Unit vectors [.., 2]."""
    return torch.stack((course.cos(), course.sin()), dim=-1)


def from_table(config: EncounterScenario, cases: Tensor, tops: Tensor, generator: torch.Generator) -> Situation:
    """Situations `cases` [n] of the table, of bodies with top speeds `tops` [n, 1 + body] (m/s), the first own ship's
    first; the own course is off by up to `course_deg`.
    """
    part, table, n, bodies = config.encounter, cases_of(config), len(cases), tops.shape[1] - 1
    draw = torch.rand((n, 2), generator=generator, dtype=torch.float64)
    time = part.tcpa[0] + (part.tcpa[1] - part.tcpa[0]) * draw[:, 0]
    route = math.radians(part.course_deg) * (2 * draw[:, 1] - 1)
    rows = torch.zeros((len(table), bodies, 2), dtype=torch.float64)
    for k, case in enumerate(table):
        rows[k, : len(case)] = torch.tensor(case, dtype=torch.float64)
    course, share = rows[cases.cpu()].unbind(-1)
    course, speed = torch.deg2rad(course), part.speed * share
    slow = speed > tops[:, 1:].double().cpu() * (1 + 1e-6)
    why = (
        f"encounter.set = {part.set!r}, encounter.speed = {part.speed:g}: a ship would go at "
        f"{float(speed.max()):.3g} m/s, and the shortest can go at {float(tops[:, 1:].min()):.3g} m/s"
    )
    refuse(ConfigError, (slow.any(), why))
    meeting = torch.stack((part.speed * time, torch.zeros_like(time)), dim=-1)
    place = meeting.unsqueeze(1) - (speed * time.unsqueeze(-1)).unsqueeze(-1) * direction(course)
    return _sails_away(config, Situation(route, place, course, speed), speed > 0, generator)


def drawn(
    config: EncounterScenario, n: int, sizes: Tensor, tops: Tensor, own: int, current: Tensor,
    generator: torch.Generator,
) -> Situation:  # fmt: skip
    """Draw `n` situations.

    Args:
        config: the scenario. n: how many. sizes, tops: length (m) and top speed (m/s) [n, 1 + body], the first own
        ship's
            first. own: further own ships among the bodies, which come first; they go at their planned speed.
        current: [n, 2], m/s, which ships of traffic do not compensate. generator: of the draws.
    """
    part, bodies = config.encounter, sizes.shape[1] - 1
    sizes, tops, current = sizes.double().cpu(), tops.double().cpu(), current.double().cpu()
    route = 2 * math.pi * torch.rand(n, generator=generator, dtype=torch.float64)
    low, high = part.ships
    ships = torch.randint(low, high + 1, (n, 1), generator=generator)
    there = torch.arange(bodies).unsqueeze(0) < own + ships
    shares = torch.tensor(tuple(part.kinds.model_dump().values()), dtype=torch.float64)
    place = torch.zeros((n, bodies, 2), dtype=torch.float64)
    course, speed = torch.zeros((n, bodies), dtype=torch.float64), torch.zeros((n, bodies), dtype=torch.float64)
    wrong = there.clone()
    for _ in range(TRIES):
        u = torch.rand((n, bodies, 4), generator=generator, dtype=torch.float64)
        miss = torch.randn((n, bodies), generator=generator, dtype=torch.float64)
        kind = torch.multinomial(shares, n * bodies, replacement=True, generator=generator).view(n, bodies)
        time = part.tcpa[0] + (part.tcpa[1] - part.tcpa[0]) * u[..., 0]
        side, off = torch.where(u[..., 1] < 0.5, -1.0, 1.0), (2 * u[..., 1]).remainder(1.0)
        turn = torch.where(kind == 1, 67.5 + 102.5 * off, 60.0 * off)  # deg, of its course over ours
        turn = torch.where(kind == 0, 180.0 - part.course_deg * off, turn)
        fast = tops[:, 1:] * (0.4 + 0.6 * u[..., 2])
        fast = torch.where(kind == 2, part.speed * (0.3 + 0.4 * u[..., 2]), fast)
        fast = torch.where(kind == 3, part.speed * (1.3 + 1.7 * u[..., 2]), fast)
        fast = torch.minimum(fast, tops[:, 1:])
        fast[:, :own] = part.speed
        heading = route.unsqueeze(-1) + side * torch.deg2rad(turn)
        meeting = (part.speed * time).unsqueeze(-1) * direction(route).unsqueeze(1)
        drift = current.unsqueeze(1).expand(-1, bodies, -1) * (torch.arange(bodies) >= own).view(1, -1, 1)
        way = time.unsqueeze(-1) * (fast.unsqueeze(-1) * direction(heading) + drift)
        at = meeting - way + part.aim * miss.unsqueeze(-1) * direction(heading + math.pi / 2)
        place[wrong], course[wrong], speed[wrong] = at[wrong], heading[wrong], fast[wrong]
        all_of = torch.cat((torch.zeros((n, 1, 2), dtype=torch.float64), place), dim=1)
        gap = torch.cdist(all_of, all_of) - 0.5 * (sizes.unsqueeze(1) + sizes.unsqueeze(2)) - part.clear
        gap.diagonal(dim1=1, dim2=2).fill_(math.inf)
        gone = torch.cat((torch.zeros((n, 1), dtype=torch.bool), ~there), dim=1)
        gap.masked_fill_(gone.unsqueeze(1) | gone.unsqueeze(2), math.inf)
        wrong = (gap.triu().masked_fill(torch.ones_like(gap).tril().bool(), math.inf).amin(1) < 0)[:, 1:] & there
        if not wrong.any():
            break
    longest = float(sizes[:, 1:].max())
    why = (
        f"encounter.tcpa = {list(part.tcpa)}, encounter.speed = {part.speed:g}: ships of up to {longest:.0f} m would "
        f"begin less than encounter.clear = {part.clear:g} m from another: give longer times, or shorter ships"
    )
    refuse(ConfigError, (wrong.any(), why))
    return _sails_away(config, Situation(route, place, course, speed), there, generator)


def _sails_away(config: EncounterScenario, begun: Situation, there: Tensor, generator: torch.Generator) -> Situation:
    """The situation, in which bodies that are not `there` [n, body] sail away from far off, anywhere."""
    part = config.encounter
    course = 2 * math.pi * torch.rand(there.shape, generator=generator, dtype=torch.float64)
    place = FAR * part.speed * part.tcpa[1] * direction(course)
    speed = torch.full_like(begun.speed, part.speed)
    return Situation(
        begun.route, torch.where(there.unsqueeze(-1), begun.place, place), torch.where(there, begun.course, course),
        torch.where(there, begun.speed, speed),
    )  # fmt: skip
