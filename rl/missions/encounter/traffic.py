"""Ships of traffic: a script that keeps, obeys or breaks the rules.

A ship keeps its course and speed until it is in danger of a collision with an own ship: nearest approach within
`notice` seconds, and closer than `clear`. In that moment it draws what it will do (`[encounter.behaviours]`); what it
does at random afterwards, too, is drawn as it happens. So all is decided by counted noise, and the future of an
encounter can branch (rl/evaluation/odds).

    keeps    goes on
    obeys    gives way by SB-MPC over all others, every `EVERY` seconds, as it senses them; stands on, if the own ship
             is to port or comes up from astern, until `LATE` of the notice (rule 17(b))
    late     SB-MPC from then on in any case
    port     turns 30 to 60 degrees to port until they have passed          stops     stops
    weaves   changes course by up to 60 degrees at random times

Write a class of your own, derived from `Script`, for traffic of your own (docs/tutorials/traffic.md).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false, reportArgumentType=false

import math
from enum import IntEnum
from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.missions.encounter.avoidance import CANDIDATES, SbmpcGains, danger_of, effort, offset_of
from rl.missions.encounter.bodies import Body, Track, sizes_of
from rl.missions.encounter.config import BehavioursConfig, EncounterScenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import validate
from taichi_sim.errors import refuse
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CLOCK, KEY, SEED, TRAFFIC, normal6, uniform4
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.models.usv.steered_ship import SteeredShip
from taichi_sim.state.memory import Remembers
from taichi_sim.world import Script, World

EVERY = 10.0  # s between two decisions of a ship that obeys; assumed
LATE = 0.2  # of the notice
WEAVE = 30.0  # s between changes of course, on average; assumed
AHEAD, ABAFT = math.radians(10.0), math.radians(112.5)  # bearings of who has right of way
PORT, WEAVES = (math.radians(30.0), math.radians(60.0)), math.radians(60.0)
LAG = 0.7  # L / U, of a ship that changes its velocity, in place of SB-MPC's; assumed
SEEN_NOISE = 5.0  # m, standard deviation of a place as a ship senses it; assumed


class Sailing(IntEnum):
    """Columns of a ship: planned course (rad) and speed (m/s), behaviour, offset of course (rad), factor of speed, time
    (s) until it decides again.
    """

    COURSE, SPEED, BEHAVIOUR, OFFSET, FACTOR, WAIT, SIZE = range(7)


class Behaviour(IntEnum):
    """What a ship does."""

    UNDECIDED, KEEPS, OBEYS, LATE, PORT, STOPS, WEAVES = range(7)


class Manners(NamedTuple):
    """Numbers of the kernel besides those of SB-MPC, SI; sums of the shares of behaviours."""

    interval: float
    notice: float
    clear: float
    own: float
    to_keeps: float
    to_obeys: float
    to_late: float
    to_port: float
    to_stops: float


@ti.kernel
def _sail(
    out: array3, ships: array3, tracks: array4, bodies: array3, tops: array3, manners: array1, gains: array1,
    draws: whole1, kind: ti.template(), sbmpc: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, k in ti.ndrange(ships.shape[0], ships.shape[1]):
        m = values_at(kind, manners)
        own = ti.cast(m.own, ti.i32)
        i = own + k
        here = ti.Vector([bodies[e, i, Body.NORTH], bodies[e, i, Body.EAST]])
        now = ti.Vector([bodies[e, i, Body.V_NORTH], bodies[e, i, Body.V_EAST]])
        length, course, planned = bodies[e, i, Body.LENGTH], ships[e, k, 0], ti.max(ships[e, k, 1], 0.1)
        soonest, coming, stands = m.notice * 2, 0, 1
        for j in range(own):
            to = ti.Vector([bodies[e, j, Body.NORTH], bodies[e, j, Body.EAST]]) - here
            w = now - ti.Vector([bodies[e, j, Body.V_NORTH], bodies[e, j, Body.V_EAST]])
            closing = to.dot(w) / ti.max(w.dot(w), 1e-4)
            miss = (to - closing * w).norm() - 0.5 * (length + bodies[e, j, Body.LENGTH])
            if closing > 0 and miss < m.clear:
                coming, soonest = 1, ti.min(soonest, closing)
                bearing = ti.atan2(now[0] * to[1] - now[1] * to[0], now.dot(to))
                if bearing > -AHEAD and bearing < ti.static(ABAFT):
                    stands = 0  # it meets us head-on, from starboard, or is overtaken
        u = uniform4(draws[SEED], TRAFFIC, draws[KEY + e], k, draws[CLOCK])
        behaviour = ti.cast(ships[e, k, Sailing.BEHAVIOUR], ti.i32)
        if behaviour == 0 and coming == 1 and soonest < m.notice:
            behaviour = 1 + ti.cast(u[0] > m.to_keeps, ti.i32) + ti.cast(u[0] > m.to_obeys, ti.i32)
            behaviour += ti.cast(u[0] > m.to_late, ti.i32) + ti.cast(u[0] > m.to_port, ti.i32)
            behaviour += ti.cast(u[0] > m.to_stops, ti.i32)
            ships[e, k, Sailing.BEHAVIOUR], ships[e, k, Sailing.WAIT] = behaviour, u[1] * EVERY
            if behaviour == ti.static(int(Behaviour.PORT)):
                ships[e, k, Sailing.OFFSET] = -ti.static(PORT[0]) - u[2] * ti.static(PORT[1] - PORT[0])
            if behaviour == ti.static(int(Behaviour.STOPS)):
                ships[e, k, Sailing.FACTOR] = 0.0
        ships[e, k, Sailing.WAIT] -= m.interval
        obeys = behaviour == ti.static(int(Behaviour.OBEYS))
        waits = stands == 1 or behaviour == ti.static(int(Behaviour.LATE))  # rule 17; or too long
        evades = ships[e, k, Sailing.OFFSET] != 0.0 or ships[e, k, Sailing.FACTOR] != 1.0
        acts = obeys or behaviour == ti.static(int(Behaviour.LATE))
        acts = acts and (not waits or evades or soonest < LATE * m.notice)
        if behaviour == ti.static(int(Behaviour.PORT)) and coming == 0:
            ships[e, k, Sailing.OFFSET] = 0.0
        if behaviour == ti.static(int(Behaviour.WEAVES)) and u[3] * WEAVE < m.interval:
            ships[e, k, Sailing.OFFSET] = (2 * u[2] - 1) * WEAVES
        if acts and ships[e, k, Sailing.WAIT] <= 0:
            ships[e, k, Sailing.WAIT] = EVERY
            g = values_at(sbmpc, gains)
            for j in range(bodies.shape[1]):
                z = normal6(draws[SEED], TRAFFIC + 1 + j, draws[KEY + e], k, draws[CLOCK])
                for a in ti.static(range(2)):
                    tracks[e, k, j, a] = bodies[e, j, a] + SEEN_NOISE * z[a]
                    tracks[e, k, j, Track.V_NORTH + a] = bodies[e, j, Body.V_NORTH + a]
                    tracks[e, k, j, Track.LENGTH + a] = bodies[e, j, Body.LENGTH + a]
                tracks[e, k, j, Track.AGE] = ti.select(j != i, 0.0, -1.0)
            held_x, held_P = ships[e, k, Sailing.OFFSET], ships[e, k, Sailing.FACTOR]
            lag, hull = LAG * length / planned, ti.Vector([length, bodies[e, i, Body.BEAM]])
            least, best = length * 0.0 + 1e30, 0
            for c in range(CANDIDATES):
                cost = effort(c, held_x, held_P, g)
                if cost < least:
                    worst, _ = danger_of(c, here, now, hull, lag, course, course, planned, tracks, e, k, g)
                    if cost + worst < least:
                        least, best = cost + worst, c
            x, P = offset_of(best)
            ships[e, k, Sailing.OFFSET], ships[e, k, Sailing.FACTOR] = x, P
        ordered = course + ships[e, k, Sailing.OFFSET]
        ordered -= ti.static(2 * math.pi) * ti.round(ordered / ti.static(2 * math.pi))
        out[e, k, 0] = ti.min(ti.max(ordered / ti.static(math.pi), -1.0), 1.0)
        speed = ships[e, k, Sailing.SPEED] * ships[e, k, Sailing.FACTOR]
        out[e, k, 1] = ti.min(2.0 * speed / tops[e, k, 0] - 1.0, 1.0)


class Traffic(Script, Remembers):
    """The ships of team `encounter.traffic`; see the module.

    Attributes:
        ships: [env, ship, Sailing].
    """

    def __init__(self, world: World, name: str):
        """Command team `name`, of steered ships."""
        super().__init__(world, name)
        config, self.fleet = world.config, world.teams[name]
        alone = (
            f"{name}.script: these ships sail in the mission 'encounter', and this world has no mission: make the "
            f"environments by rl.BatchedEnv or gymnasium.make, or name the teams of the world without {name!r}"
        )
        other = f"{name}.vehicle = {config.teams[name].vehicle!r}: the script sails steered_ship only"
        sails = isinstance(self.fleet.model, SteeredShip)
        refuse(ConfigError, (not isinstance(config, EncounterScenario), alone), (not sails, other))
        assert isinstance(config, EncounterScenario)
        state, part, shares = self.fleet.state, config.encounter, _sums(config.encounter.behaviours)
        bodies = config.teams[part.own].count + self.fleet.count
        self.ships = self.remember(state.new_zeros((*state.shape[:2], Sailing.SIZE)))
        self._tracks = self.scratch(state.new_zeros((*state.shape[:2], bodies, Track.SIZE)))
        gains = validate(SbmpcGains, {**config.parts[name].control}, f"{name}.control").model_dump()
        manners = Manners(
            config.decision_interval, part.notice, part.clear, float(config.teams[part.own].count), *shares
        )
        self._manners, self._gains = state.new_tensor(manners), state.new_tensor(tuple(gains.values()))
        self._names = tuple(gains)
        self._out = self.scratch(state.new_zeros((*state.shape[:2], 2)))
        self._launch = runtime.Launcher(_sail, plain=True, few=runtime.MEDIUM)
        self._among: tuple[Tensor, Tensor] | None = None

    def attach(self, bodies: Tensor, draws: Tensor) -> None:
        """Sail among `bodies` [env, own ships and ships, Body] by the counted noise of a mission."""
        self._among = bodies, draws

    @property
    def tops(self) -> Tensor:
        """Top speed [env, ship], m/s."""
        model, length = self.fleet.model, sizes_of(self.fleet)[..., 0]
        assert isinstance(model, SteeredShip)
        return model.own({"length": length}).top_speed  # pyright: ignore[reportReturnType]

    def start(self, envs: Tensor, course: Tensor, speed: Tensor) -> None:
        """Begin episodes in environments `envs` [n] with planned courses (rad) and speeds (m/s) [n, ship]."""
        plan = torch.zeros_like(self.ships[envs])
        plan[..., Sailing.COURSE], plan[..., Sailing.SPEED] = course.to(plan), speed.to(plan)
        plan[..., Sailing.FACTOR] = 1.0
        self.ships[envs] = plan

    def __call__(self, world: World) -> Tensor:
        """Actions for this decision."""
        if self._among is None:
            return self._out
        bodies, draws = self._among
        precision = runtime.current().precision
        kinds = struct_of(Manners._fields, precision), struct_of(self._names, precision)
        self._launch.once(
            self._out, self.ships, self._tracks, bodies, self.tops.unsqueeze(-1).contiguous(), self._manners,
            self._gains, draws, *kinds,
        )  # fmt: skip
        return self._out


def _sums(behaviours: BehavioursConfig) -> tuple[float, ...]:
    """Sums of the shares but the last."""
    total, sums = 0.0, []
    for share in behaviours.shares[:-1]:
        total += share
        sums.append(total)
    return tuple(sums)
