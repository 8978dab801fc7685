"""Radio between vehicles: each keeps the last message that has arrived from every other.

Every vehicle transmits a message `rate` times a second, in turn: place and velocity as it measures them, and what a
mission adds. A message arrives after `delay` at each vehicle within `range`, and is lost with the probability `loss`,
independently at each. Receivers keep it, with its age, until a newer one arrives. What they do not keep of it they may
read once, when it arrives, where it lies (`arrived`).

For experiments, vehicles may receive the messages of another environment, `shift` environments on.

Random numbers are counted (kernels/random.py): same seed, same bits. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import Annotated, NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from rl.step import BEGINS, GOES_ON, NOT_DUE, Due
from taichi_sim.config import Fraction, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import CLOCK, KEY, RADIO, SEED, uniform4
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.state.memory import Remembers

NEVER = 1e6  # s, age of a message that was never received
MOST = 64  # vehicles of a team
INTERVAL, RANGE, LOSS = range(3)  # numbers of the kernel: of a decision, s; m; of all messages


class Message:
    """The first numbers of every message: place and velocity of its sender, as the sender measures them."""

    PLACE, VELOCITY = slice(0, 3), slice(3, 6)
    V_NORTH, SIZE = 3, 6


class RadioConfig(Strict):
    """`[radio]` between vehicles."""

    range: Annotated[Positive, Plausible(5.0, 1e5, "m")] = 1000.0  # m; assumed
    delay: Annotated[float, Field(ge=0, le=10)] = 0.0  # s, rounded to whole decisions
    loss: Fraction = 0.0  # of all messages
    # messages of each vehicle per second; default: one each decision
    rate: Annotated[Positive, Plausible(0.01, 100.0, "1/s")] | None = None


TalkPack = ti.types.argpack(heard=array4, sent=array4, said=array3, place=array3, numbers=array1)


class RadioForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    delay: int  # decisions
    period: int  # decisions between messages of one vehicle
    vehicles: int  # number of the first vehicle among the random numbers
    known: bool = True  # everybody has heard everybody as an episode begins
    shift: int = 0  # environments

    @property
    def slots(self) -> int:
        """Number of messages of one vehicle that are kept: in transit, and the present one."""
        return self.delay + 1


@ti.func
def source(radio: ti.template(), e, form: ti.template()):
    """The environment whose messages are heard in environment e."""
    other = e
    if ti.static(form.shift != 0):
        other = (e + ti.static(form.shift)) % radio.said.shape[0]
    return other


@ti.func
def arrived(radio: ti.template(), steps: ti.template(), e, i, k, form: ti.template()):
    """Slot of `sent` [source, slot, k] with the message that has just arrived at vehicle i from k; -1: none has."""
    age, step = radio.heard[e, i, k, radio.heard.shape[3] - 1], ti.cast(steps[source(radio, e, form)], ti.i32)
    old, slot = ti.cast(ti.round(age / radio.numbers[INTERVAL]), ti.i32), -1
    if old <= step and old == form.delay:
        slot = (step - old) % ti.static(form.slots)
    return slot


@ti.func
def hear(radio: ti.template(), e, i, other, k, slot, age):
    """Vehicle i receives the message of vehicle k of environment `other` in `slot`."""
    kept = radio.heard.shape[3] - 1
    for a in range(kept):
        radio.heard[e, i, k, a] = radio.sent[other, slot, k, a]
    radio.heard[e, i, k, kept] = age


@ti.func
def gets_there(radio: ti.template(), e, i, k, env, clock, seed, form: ti.template()):
    """Whether a message of k arrives at i over this link."""
    far = ti.Vector([radio.place[e, i, a] - radio.place[e, k, a] for a in ti.static(range(3))])
    u = uniform4(seed, RADIO, env, ti.static(form.vehicles) + i * radio.place.shape[1] + k, clock)
    return far.norm() <= radio.numbers[RANGE] and u[0] >= radio.numbers[LOSS]


@ti.kernel
def _send(radio: TalkPack, which: whole1, steps: ti.types.ndarray(dtype=ti.i64, ndim=1), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(radio.said.shape[0], radio.said.shape[1]):
        if which[e] == GOES_ON:
            slot = ti.cast(steps[e], ti.i32) % ti.static(form.slots)
            for a in range(radio.said.shape[2]):
                radio.sent[e, slot, i, a] = radio.said[e, i, a]
        if which[e] == BEGINS:
            for slot in range(form.slots):
                for a in range(radio.said.shape[2]):
                    radio.sent[e, slot, i, a] = radio.said[e, i, a]


@ti.kernel
def _receive(
    radio: TalkPack, which: whole1, steps: ti.types.ndarray(dtype=ti.i64, ndim=1), draws: whole1, form: ti.template()
):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(radio.said.shape[0], radio.said.shape[1]):
        if which[e] != NOT_DUE:
            n, age, other = radio.said.shape[1], radio.heard.shape[3] - 1, source(radio, e, form)
            step, seed, env = ti.cast(steps[other], ti.i32), draws[SEED], draws[KEY + e]
            for k in range(n):
                if which[e] == BEGINS:
                    if ti.static(form.known):
                        hear(radio, e, i, e, k, 0, 0.0)
                    else:
                        for a in range(age):
                            radio.heard[e, i, k, a] = 0.0
                        radio.heard[e, i, k, age] = NEVER
                else:
                    radio.heard[e, i, k, age] += radio.numbers[INTERVAL]
                    then = step - form.delay  # when what arrives now was sent
                    if (then + k) % form.period == 0 and then >= 0:
                        if gets_there(radio, e, i, k, env, draws[CLOCK], seed, form):
                            slot = then % ti.static(form.slots)
                            hear(radio, e, i, other, k, slot, ti.static(form.delay) * radio.numbers[INTERVAL])


class Radio(Remembers):
    """The radio of a group of vehicles.

    Attributes:
        said: [env, vehicle, n] next message of each, to be written before `talk`: place and velocity (NED, m and m/s),
            then what a mission adds. heard: [env, receiver, sender, kept + 1] what is kept of the last message
            received, and its age (s). sent: [env, slot, vehicle, n] messages on their way.
        form, pack: arguments of kernels that read messages as they arrive (`arrived`).
    """

    def __init__(
        self,
        config: RadioConfig,
        place: Tensor,
        interval: float,
        *,
        width: int = Message.SIZE,
        kept: int | None = None,
        vehicles: int = 0,
        known: bool = True,
        shift: int = 0,
    ):
        """Connect vehicles at `place` [env, vehicle, 3 or more] (m, read in place).

        Args:
            interval: of a decision, s. width: n, numbers of a message. kept: the first of them that receivers keep
                (default: all). vehicles: of other teams before them, among the random numbers. known: an episode begins
                with everybody heard, else nobody. shift: environments on, whose messages are heard.
        """
        envs, n = place.shape[:2]
        delay, period = round(config.delay / interval), 1
        if config.rate is not None:
            period = max(1, round(1 / (config.rate * interval)))
        self.form, self._each = RadioForm(delay, period, vehicles * MOST, known, shift), n
        self._interval = interval
        self.said = self.remember(place.new_zeros((envs, n, width)))
        self.heard = self.remember(place.new_zeros((envs, n, n, (width if kept is None else kept) + 1)))
        self.sent = self.remember(place.new_zeros((envs, self.form.slots, n, width)))
        self.pack = runtime.Packed(
            TalkPack, heard=self.heard, sent=self.sent, said=self.said,
            place=place, numbers=place.new_tensor([interval, config.range, config.loss]),
        )  # fmt: skip
        self._send, self._receive = runtime.Launcher(_send), runtime.Launcher(_receive)

    @property
    def delay(self) -> float:
        """Delay of a message, s, a whole number of decisions."""
        return self.form.delay * self._interval

    def due(self, step: int) -> NDArray[np.bool_]:
        """Whether a message is due [receiver, sender] after `step` decisions of an episode, unless it is lost."""
        then = step - self.form.delay
        sender = (then + np.arange(self._each)) % self.form.period == 0
        return (then >= 0) & sender & ~np.eye(self._each, dtype=bool)

    def talk(self, due: Due) -> None:
        """Send and receive in the environments that are `due`."""
        self._send(self.pack(), due.which, due.steps, self.form, envs=due.count)
        self._receive(self.pack(), due.which, due.steps, due.draws, self.form, envs=due.count)
