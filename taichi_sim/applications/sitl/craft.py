"""A vehicle alone in a sea and a wind, which an autopilot steps frame by frame; what passes between the two.

A vessel begins afloat, at rest. Aircraft begin HELD_HEIGHT above the sea. A multirotor may land again where it began.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from torch import Tensor

from taichi_sim.applications.sitl.channels import PWM, Mixer, changes_for, default_channels
from taichi_sim.applications.sitl.driven import Driven, Sensors
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, SeaConfig, WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.models.catalogue import Changes, load_vehicle
from taichi_sim.vehicle import Vehicle, Waters

LONGEST_STEP = 0.02  # s, longest physics step; frames below 50 Hz have several
SHORT = 1e-3  # s, a step that is stable for every vehicle
ROUNDING = 1e-9  # of a number of steps
WARM_UP = 5  # frames
HELD_HEIGHT = 50.0  # m, height at which aircraft are held; they report their position from there
MOST_REASONS = 16  # largest number of reasons of refusals that are counted separately


class Servos(NamedTuple):
    """A packet from ArduPilot."""

    rate: int  # frame rate, Hz
    frame: int  # counts from 0; repeated if no answer arrived
    pwm: tuple[int, ...]  # microseconds; 0: no output


@dataclass
class Counts:
    """Counts frames, packets and messages, by kind."""

    frames: int = 0  # new frames
    repeated: int = 0
    lost: int = 0  # frames that never arrived
    late: int = 0  # of an older frame, or repeated controls
    waiting: int = 0  # frames before the first controls of PX4
    resent: int = 0  # frames that were sent to PX4 again
    restarts: int = 0
    refused: dict[str, int] = field(default_factory=dict)  # reason -> number
    told: dict[str, int] = field(default_factory=dict)  # of these, by the last status line

    def refuse(self, why: str) -> None:
        """Count a refusal by its reason `why`."""
        if why in self.refused or len(self.refused) < MOST_REASONS:
            self.refused[why] = self.refused.get(why, 0) + 1

    def refusals(self) -> str:
        """Refusals by reason, of those that have gone on since the last status line, as the end of one."""
        goes_on = {why: n for why, n in self.refused.items() if n > self.told.get(why, 0)}
        self.told = dict(self.refused)
        return "".join(f"; refused {n}: {why}" for why, n in goes_on.items())


class Pace:
    """Pace of a simulation between two status lines, as their text."""

    def __init__(self):
        """Nothing has been told."""
        self._before: tuple[float, float] | None = None

    def __call__(self, now: float, time: float) -> str:
        """The text at `now` (s, wall clock) and simulated `time` (s); empty at first, and after a restart."""
        before, self._before = self._before, (now, time)
        if before is None or now <= before[0] or time < before[1]:
            return ""
        return f", {(time - before[1]) / (now - before[0]):.2f} of real time"


class Craft(Driven):
    """One vehicle in a sea and a wind; its frames are the steps."""

    def __init__(
        self,
        vehicle: str,
        changes: Changes | None = None,
        *,
        sea: SeaConfig | None = None,
        air: AirConfig | None = None,
        channels: dict[str, int] | None = None,
        pwm: tuple[float, float] = PWM,
        heading: float = 0.0,
        seed: int = 0,
    ):
        """Load a vehicle file or name, with `changes` of its keys and the initial `heading` (rad).

        `channels` and `pwm` are explained in channels.py.
        """
        super().__init__()
        self.vehicle, self.changes = vehicle, dict(changes or {})
        self.sea, self.air, self.heading, self.seed, self.pwm = sea, air, heading, seed, pwm
        self.config = WorldConfig(sea=sea or SeaConfig(), air=air or AirConfig())
        first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        for section, values in changes_for(first).items():
            self.changes[section] = values | self.changes.get(section, {}) | values
        self.first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        self.model = self.first  # of the present rate, as are bench and mixer, if it has no free step
        self.channels = channels or default_channels(self.first)
        self.rate, self.steps = 0, 1  # steps: physics steps of a frame
        self.bench: Bench
        self.mixer: Mixer

    @property
    def fleet(self) -> Fleet[Vehicle]:
        """The fleet of the bench."""
        return self.bench.fleet

    @property
    def waters(self) -> Waters:
        """Itself."""
        return self

    def settled(self, state: Tensor) -> Tensor:
        """`Vehicle.settle` of a `state` [1, 1, 13]."""
        return self.model.settle(state, self.bench.surface, self.bench.around)

    @property
    def steady_wind(self) -> Tensor:
        """Velocity of the air at the vehicle's height [3], NED, m/s."""
        return self.bench.around.wind[0]

    def compile(self, rate: int) -> None:
        """Compile all kernels, so that no frame from the first one on, at `rate` Hz, waits for it."""
        self.begin(rate)
        self.advance(())
        if self.model.medium == "air":
            self.meets_water()

    def begin(self, rate: int) -> None:
        """Place the vehicle at rest at its initial position, for frames of `rate` Hz."""
        self._follow(rate)
        b, air = self.bench, self.model.medium == "air"
        b.time.zero_()
        down = -HELD_HEIGHT if air else 0.0
        b.put((0.0, 0.0, down), (0.0, 0.0, self.heading), settle=not air or self.flies_ahead)
        self._begun(held=air)
        self.origin = b.position
        if not air:  # let it reach the motion of the water under it
            b.step(self.mixer.actions(()), times=WARM_UP * self.steps)
            self.origin[2] = 0.0
        self.before = self._velocity()

    def change_rate(self, rate: int) -> None:
        """Continue with frames of another rate, Hz; motion and time stay."""
        old = self.bench
        self._follow(rate)
        if self.bench is not old:
            b, f, g = self.bench, self.bench.fleet, old.fleet
            for new, kept in ((f.state, g.state), (f.remainder, g.remainder), (f.aux, g.aux), (f.surface, g.surface)):
                new.copy_(kept)
            b.time.copy_(old.time)
            b.refresh()
            f.update()

    def _follow(self, rate: int) -> None:
        """Step by frames of `rate` Hz: in the same bench, or in a new one if the kernels hold their step."""
        if rate == self.rate:
            return
        longest = min(LONGEST_STEP, self.first.longest_step)
        self.rate, self.step, self.steps = rate, 1 / rate, max(1, math.ceil(1 / (rate * longest) - ROUNDING))
        dt, free = 1 / (rate * self.steps), self.first.free_step
        if not free or not hasattr(self, "bench"):
            self.model = self.first if free else load_vehicle(self.vehicle, dt, 1, **self.changes)
            sea = None if self.sea is None else self.sea.model_copy(update={"realisations": 1})
            self.bench = Bench(self.model, sea=sea, air=self.air, seed=self.seed)
            self.mixer = Mixer(self.model, self.channels, self.pwm)
            self.crest = float(self.bench.sea.components.amplitude.sum())
        if free:
            self.bench.fleet.set_step(dt)

    def advance(self, pwm: tuple[int, ...]) -> None:
        """Advance by one frame under the servo outputs `pwm` (microseconds)."""
        self.keep()
        self.bench.step(self.mixer.actions(pwm), times=self.steps)
        self.frames += 1
        held = self.held
        self.happen(pwm)
        if held:
            self.fleet.update()

    def elevation_below(self, team: Fleet, height: Tensor) -> Tensor:
        """Elevation (m, up) of the sea under each vehicle of `team`: a craft is the `Waters` of its model's endings."""
        return self.bench.around.elevation(team.position_n[..., HORIZONTAL])

    def sensors(self) -> Sensors:
        """Measurements at the end of the last frame; the specific force is the mean over that frame."""
        return self.measured(self.moment(), self.before, self.step, self.origin)
