"""Rewards: one function for each term, by the truth, [env, own ship]."""

from typing import Protocol

from torch import Tensor

from rl.guidance.rewards import ending
from rl.missions.encounter.config import EncounterConfig
from rl.missions.encounter.pairs import Pair, Pairs, Role
from rl.terms import Term


class Meeting(Protocol):
    """What rewards read of a team (team.py)."""

    part: EncounterConfig
    pairs: Pairs
    offsets: Tensor
    before: Tensor

    @property
    def along(self) -> Tensor:
        """Speed made good along the route, m/s."""
        ...

    @property
    def across(self) -> Tensor:
        """Distance from the route, to starboard, m."""
        ...


def progress(team: Meeting) -> Tensor:
    """Speed made good along the route over the planned one, less 1, at most 0."""
    return (team.along / team.part.speed - 1.0).clamp(-2.0, 0.0)


def track(team: Meeting) -> Tensor:
    """Minus the distance from the route, over itself plus `clear`."""
    off = team.across.abs() / team.part.clear
    return -off / (1.0 + off)


def risk(team: Meeting) -> Tensor:
    """Minus the greatest risk of collision (pairs.py): how soon and how close."""
    return -team.pairs.of(Pair.RISK).amax(-1)


def room(team: Meeting) -> Tensor:
    """Minus the square of how much of `clear` the least gap lacks."""
    return -(1.0 - team.pairs.gap / team.part.clear).clamp(0.0, 1.0).square()


def near_miss(team: Meeting) -> Tensor:
    """Minus how much of `near` the least gap lacks."""
    return -(1.0 - team.pairs.gap / team.part.near).clamp(0.0, 1.0)


def wrong_side(team: Meeting) -> Tensor:
    """Minus an offset to port (rad) while head-on or giving way (rules 14 and 15)."""
    role = team.pairs.of(Pair.ROLE)
    gives = ((role == int(Role.HEAD_ON)) | (role == int(Role.GIVE_WAY))).any(-1)
    return gives * team.offsets[..., 0].clamp(max=0.0)


def stand_on(team: Meeting) -> Tensor:
    """Minus the offset of course (rad) and speed while only standing on, with time left (rule 17)."""
    role, soon = team.pairs.of(Pair.ROLE), team.pairs.of(Pair.RISK)
    stands = (role == int(Role.STAND_ON)) | (role == int(Role.OVERTAKEN))
    only = stands.any(-1) & ~((role > 0) & ~stands).any(-1) & (soon.amax(-1) < 0.5)
    return only * -(team.offsets[..., 0].abs() + (1.0 - team.offsets[..., 1]))


def calm(team: Meeting) -> Tensor:
    """Minus the squared change of the offsets of course (rad) and speed."""
    return -(team.offsets - team.before).square().sum(-1)


TERMS = {
    "progress": Term(progress, 0.3),
    "track": Term(track, 0.2),
    "risk": Term(risk, 1.0),
    "room": Term(room, 3.0),
    "near_miss": Term(near_miss, 20.0),
    "wrong_side": Term(wrong_side, 0.5),
    "stand_on": Term(stand_on, 0.2),
    "calm": Term(calm, 0.2),
    "ending": Term(ending, 200.0),
}
