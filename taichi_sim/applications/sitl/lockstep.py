"""A world some of whose vehicles autopilots drive, in lockstep.

The world moves in equal steps, `rate` of them a second or a few more, so that a decision has a whole number. It makes a
step once each autopilot has sent a frame that ends beyond the present time. Outputs are held from one step to the next:
those of a frame that begins between two steps act from the later one on, at most a step late, and at once where frames
and steps begin together. A frame that ends between two steps is answered by the motion on the straight way between
them: velocities are exact to the mean acceleration of a step, and the specific force is the mean over the frame.

Aircraft whose team autopilots drive take their actuators as actions, whatever the scenario says.
"""

import math
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import torch
from torch import Tensor

from taichi_sim.applications.sitl.ardupilot import Session, answer_all
from taichi_sim.applications.sitl.channels import Mixer, changes_for, default_channels
from taichi_sim.applications.sitl.driven import Driven, Sensors
from taichi_sim.config import ConfigError, WorldConfig
from taichi_sim.config.io import vehicle_file
from taichi_sim.errors import UserError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, BELOW, DOWN, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.vehicle import Vehicle, Waters
from taichi_sim.world import World

RATE = 400.0  # steps of the world per second; of it, ArduPilot's copters run their loop as often
ROUNDING = 1e-6  # of a number of steps
REACHED = 1e-3  # of a step: a frame that ends so little after it is over
SILENT = 5.0  # s, of the clock, without a packet, after which the terminal says who holds the world
AGAIN = 3.0  # factor of that time until it says so again


class SilentError(UserError, RuntimeError):
    """An autopilot has been silent for too long."""


class LockstepWorld(World):
    """A world that makes a decision in steps of 1/`rate` s, and asks the autopilots before each.

    Attributes:
        crew: the vehicles that autopilots drive. wait: returns when each of them has outputs for the next step.
    """

    def __init__(self, config: WorldConfig, num_envs: int = 1, *, direct: Sequence[str] = (), rate: float, **options):
        """Build a world (see `World`), whose teams `direct` take their actuators as actions."""
        parts = max(1, math.ceil(config.decision_interval * rate - ROUNDING))
        step = config.decision_interval / parts
        given: dict[str, object] = {"dt": None if config.dt is None or config.dt > step else config.dt}
        for name, team in config.teams.items():
            given[name] = team if team.dt is None or team.dt <= step else team.model_copy(update={"dt": None})
        self.parts, self._direct = parts, tuple(direct)
        self.crew: list[Aboard] = []
        self.wait: Callable[[], None] = lambda: None
        super().__init__(config.model_copy(update={"decision_interval": step, **given}), num_envs, **options)

    def _model(self, name: str) -> Vehicle:
        model = super()._model(name)
        if name not in self._direct or not (changes := changes_for(model)):
            return model
        file = vehicle_file(self.config.teams[name], self._source)
        return load_vehicle(file, model.dt, model.substeps, source=self._source, **changes)

    def advance(self, actions: dict[str, Tensor]) -> dict[str, Tensor]:
        """Advance by a decision; return the actions as taken, those of the autopilots in its last step included."""
        taken = actions
        self.let_scripts_act(taken)
        touches = [fleet.touch for fleet in self.contacts.legged.values() if fleet.touch is not None]
        blows = [torch.zeros_like(touch.blow) for touch in touches]
        for left in reversed(range(self.parts)):
            self.wait()
            for craft in self.crew:
                craft.keep()
                taken[craft.team][craft.env, craft.number] = craft.actions()
            self._advance(taken)
            for touch, blow in zip(touches, blows, strict=True):
                torch.maximum(blow, touch.blow, out=blow)
            held = {craft.team for craft in self.crew if craft.held}
            for craft in self.crew:
                craft.stepped(wet=not left)
            for name in held:
                self.teams[name].update()
        for touch, blow in zip(touches, blows, strict=True):
            touch.blow.copy_(blow)  # of the whole decision, as missions read it
        return taken

    def put(self, name: str, env: int, number: int, state: Tensor, *, settle: bool) -> None:
        """Place vehicle `number` of a team in environment `env` at `state` [13]; `settle` as in `place`."""
        fleet, only, its = self.teams[name], slice(env, env + 1), slice(number, number + 1)
        around, surface = self._placing(name, self._everywhere[only]), fleet.surface[only, its].clone()
        row = state.clone().view(1, 1, -1)
        if settle:
            row = fleet.model.settle(row, surface, around)
        fleet.model.reset_aux(fleet.aux[only, its], row, around)
        fleet.state[env, number], fleet.surface[env, number] = row[0, 0], surface[0, 0]
        fleet.remainder[env, number] = 0.0
        fleet.update()
        self.contacts.put(fleet, env, number)


class Aboard(Driven):
    """A vehicle of a world that an autopilot drives. Positions are from the world's origin.

    Attributes:
        team, number, env: which one. carrier: the vessel on whose deck it begins, if it does. asked: frames that are
            not over: end (s, since its beginning) and outputs.
    """

    def __init__(
        self, world: LockstepWorld, team: str, number: int, carrier: tuple[str, int] | None = None, env: int = 0
    ):
        """Let vehicle `number` of a team begin where it is, or on the deck of the vessel `carrier` (team, number)."""
        super().__init__()
        self.world, self.team, self.number, self.carrier, self.env = world, team, number, carrier, env
        self.model = self.fleet.model
        self.channels = default_channels(self.model)
        self.mixer = Mixer(self.model, self.channels)
        self._felt = world.felt(team)  # which the world keeps
        self.crest = float(world.sea.components.amplitude.sum(axis=1).max())
        self.rate, self.step = 0, world.config.decision_interval
        self._start, self._moved = self._row.clone(), False
        self._outputs = (), torch.from_numpy(np.asarray(self.mixer.actions(())))
        self._place()

    @property
    def name(self) -> str:
        """TEAM.NUMBER, and which environment of several."""
        return f"{self.team}.{self.number}" + f" of environment {self.env}" * (self.world.num_envs > 1)

    @property
    def fleet(self) -> Fleet[Vehicle]:
        """The team's."""
        return self.world.teams[self.team]

    @property
    def waters(self) -> Waters:
        """The world."""
        return self.world

    def settled(self, state: Tensor) -> Tensor:
        """`Vehicle.settle` of a `state` [1, 1, 13]."""
        only, its = slice(self.env, self.env + 1), slice(self.number, self.number + 1)
        around = self.world._placing(self.team, self.world._everywhere[only])
        return self.model.settle(state, self.fleet.surface[only, its].clone(), around)

    @property
    def steady_wind(self) -> Tensor:
        """Velocity of the air at the vehicle's height [3], NED, m/s."""
        return self._felt.wind[self.env]

    @property
    def flown(self) -> bool:
        """Whether it is an aircraft in flight."""
        touch = self.fleet.touch
        return super().flown and not (touch is not None and bool(touch.on[self.env, self.number]))

    def _place(self) -> None:
        """Place the vehicle at its beginning."""
        if self.carrier is not None:
            self.world.put(self.team, self.env, self.number, self._on_deck(*self.carrier), settle=False)
        elif self._moved:
            self.world.put(self.team, self.env, self.number, self._start, settle=True)
        self._begun(held=self.model.medium == "air" and self.carrier is None)
        self.ground = False  # it is gone once the aircraft has left it
        self._end, self._moved = 0.0, False
        self.asked: deque[tuple[float, tuple[int, ...]]] = deque()
        self._then = self._now = self._frame = self._frame_before = self.moment()

    def _on_deck(self, team: str, number: int) -> Tensor:
        """State [13] of the aircraft that stands on a deck, and moves with it."""
        vessel = self.world.teams[team]
        deck, row = vessel.model.deck, vessel.state[self.env, number].double()
        assert deck is not None
        soles = self.model.soles(self.fleet)
        arm = torch.tensor(deck.centre, dtype=torch.float64, device=row.device)
        arm[BELOW] -= soles[min(self.env, len(soles) - 1), min(self.number, soles.shape[1] - 1), :, BELOW].max()
        state = row.clone()
        state[POSITION] += torch_rotation_matrix(row[QUATERNION]) @ arm
        state[VELOCITY] += torch.linalg.cross(row[ANGULAR_VELOCITY], arm)
        return state.to(self._row)

    def begin(self, rate: int) -> None:
        """Begin with an autopilot of `rate` Hz; a vehicle that has moved is back at its beginning."""
        self.rate = rate
        if self._moved:
            self._place()

    def change_rate(self, rate: int) -> None:
        """Continue with frames of another rate, Hz."""
        self.rate = rate

    def advance(self, pwm: tuple[int, ...]) -> None:
        """Ask for a frame under the servo outputs `pwm` (microseconds)."""
        self._end += 1 / self.rate
        self.asked.append((self._end, pwm))
        self.frames += 1
        self._take()

    @property
    def pwm(self) -> tuple[int, ...]:
        """Outputs in the coming step."""
        return self.asked[0][1] if self.asked else ()

    def actions(self) -> Tensor:
        """Actions [action] of the coming step."""
        if self.pwm != self._outputs[0]:
            self._outputs = self.pwm, torch.from_numpy(np.asarray(self.mixer.actions(self.pwm)))
        return self._outputs[1]

    def keep(self) -> None:
        """Remember what a step is about to change."""
        self.before, self._down = self._now.velocity, self._now.position[DOWN]
        self._kept = (self._row.clone(), self._view(1).clone()) if self.held else None

    @property
    def ready(self) -> bool:
        """Whether all frames are over."""
        return not self.asked

    def stepped(self, *, wet: bool) -> None:
        """The world has made a step; whether the vehicle may have met water is to be looked at if `wet`."""
        self.happen(self.pwm, wet=wet)
        self._then, self._now, self._moved = self._now, self.moment(), True
        self._take()

    def _take(self) -> None:
        """Measure at the end of each frame that is over."""
        while self.asked and self.asked[0][0] <= self._now.time + REACHED * self.step:
            end, _ = self.asked.popleft()
            self._frame_before, self._frame = self._frame, self._then.toward(self._now, end)

    def sensors(self) -> Sensors:
        """Measurements at the end of the last frame; the specific force is the mean over that frame."""
        begun, now = self._frame_before, self._frame
        return self.measured(now, begun.velocity, now.time - begun.time, self.origin)


class Station:
    """The autopilots' sockets: it lets a world wait for them all, and answers frames that are over."""

    def __init__(
        self, world: LockstepWorld, places: Mapping[tuple[str, int], int] | Mapping[tuple[str, int, int], int],
        decks: Mapping[tuple[str, int], tuple[str, int]], *, address: str, timeout: float,
        tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic,
    ):  # fmt: skip
        """Listen for the autopilot of each vehicle of `places` (team, number, environment [0]) at its UDP port there.

        Args:
            world: the world, which then waits for them. decks: vehicle -> vessel on whose deck it begins.
            address: to listen on. timeout: s of silence after which `SilentError` is raised; 0: never. tell: takes
            lines for the terminal. clock: s.
        """
        self.address, self.timeout, self.tell, self.clock = address, timeout, tell, clock
        self.sessions: list[Session[Aboard]] = []
        self.wires, self._sockets, self._ports = selectors.DefaultSelector(), {}, {}
        for (team, number, *env), port in places.items():
            wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                wire.bind((address, port))
            except OSError as error:
                wire.close()
                self.close()
                raise ConfigError(f"{team}.{number}={port}: {address}:{port}: {error.strerror or error}") from None
            wire.setblocking(False)
            session = Session(Aboard(world, team, number, decks.get((team, number)), *env), clock)
            self.sessions.append(session)
            self._sockets[session], self._ports[session] = wire, port
            self.wires.register(wire, selectors.EVENT_READ, session)
        self.world, world.crew, world.wait = world, [session.craft for session in self.sessions], self.wait

    def leave(self, session: Session[Aboard]) -> None:
        """Hear an autopilot no more; the world goes on without it."""
        self.sessions.remove(session)
        self.world.crew.remove(session.craft)
        self.wires.unregister(self._sockets[session])
        self._sockets.pop(session).close()

    def close(self) -> None:
        """Close all sockets."""
        for wire in self._sockets.values():
            wire.close()
        self.wires.close()

    def told(self, session: Session[Aboard]) -> str:
        """The vehicle and port of a session, and whether its autopilot has come."""
        where = f"{session.craft.name} on {self.address}:{self._ports[session]}"
        return f"{where} (has not come)" if session.last is None else where

    def wait(self) -> None:
        """Answer frames that are over, and return when every autopilot has sent one that is not."""
        for session in self.sessions:
            if session.answer is None and session.craft.ready:
                self._send(session, session.complete())
            for news in session.craft.news:
                self.tell(f"{self.told(session)}, t {session.craft.time:.1f} s: it {news}")
            session.craft.news.clear()
        begun, due, waited = self.clock(), SILENT, 0.0
        while missing := [session for session in self.sessions if session.craft.ready]:
            for key, _ in self.wires.select(timeout=max(min(due, self.timeout or due) - waited, 0.0)):
                answer_all(self._sockets[key.data], key.data, self.tell)
            waited = self.clock() - begun
            ends = self.timeout and waited >= self.timeout
            if ends or waited >= due:
                due *= AGAIN
                late = ", ".join(self.told(session) for session in missing if session.craft.ready)
                if late and ends:
                    raise SilentError(f"no frame for {waited:.0f} s from the autopilot of {late}")
                if late:
                    self.tell(f"the world has waited for {waited:.0f} s for the autopilot of {late}")

    def _send(self, session: Session[Aboard], answer: bytes) -> None:
        if session.peer is not None:
            with suppress(BlockingIOError):  # lost: it is asked for again
                self._sockets[session].sendto(answer, session.peer)
