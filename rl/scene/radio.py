"""Radio between vehicles: what each knows of others by the last message of theirs that has arrived.

Every vehicle sends its place and velocity over ground, as it measures them, `rate` times a second, in turn. A message
takes `delay` to arrive, at those within `range` then, and is lost with the probability `loss` on each way by itself.
What has arrived is kept, with its age, until a newer one comes. An episode begins with everybody's place known.
Random numbers are counted (maths/random.py): same seed, same bits. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import Annotated, NamedTuple

import taichi as ti
from pydantic import Field
from torch import Tensor

from taichi_sim import runtime
from taichi_sim.config import Fraction, Positive, Strict
from taichi_sim.fleet import Views
from taichi_sim.kinematics import VELOCITY_N
from taichi_sim.maths.random import RADIO, uniform4

AGE, HEARD = 6, 7  # columns of what is heard, after place (m) and velocity (m/s): age (s); and how many there are
V = VELOCITY_N.start
MOST = 64  # vehicles of a team
TALK = 40.0  # ns of one receiver and sender, about


class RadioConfig(Strict):
    """`[radio]` between the vehicles of a team."""

    range: Positive = 1000.0  # m, assumed
    delay: Annotated[float, Field(ge=0, le=10)] = 0.0  # s, rounded to whole decisions
    loss: Fraction = 0.0  # of all messages
    rate: Positive | None = None  # messages of each vehicle per second; default: one each decision


_array1, _array3, _array4 = (ti.types.ndarray(ndim=n) for n in (1, 3, 4))
TalkPack = ti.types.argpack(heard=_array4, sent=_array4, state=_array3, derived=_array3, place=_array3, numbers=_array1)


class Form(NamedTuple):
    """What the kernel is compiled for."""

    delay: int  # decisions
    period: int  # decisions between messages of one vehicle
    vehicles: int  # before these, among the random numbers: those of other teams
    serial: bool = False  # on the calling thread


@ti.func
def say(sent: ti.template(), e, slot, i, radio: ti.template()):
    """Keep what vehicle i sends now."""
    for a in ti.static(range(3)):
        sent[e, slot, i, a], sent[e, slot, i, 3 + a] = radio.state[e, i, a], radio.derived[e, i, V + a]


@ti.func
def hear(radio: ti.template(), e, i, k, slot, age):
    """Vehicle i receives what k sent, as it stands in the `slot`."""
    for a in ti.static(range(HEARD - 1)):
        radio.heard[e, i, k, a] = radio.sent[e, slot, k, a]
    radio.heard[e, i, k, AGE] = age


@ti.kernel
def _send(
    radio: TalkPack,
    which: ti.types.ndarray(dtype=ti.i32, ndim=1),
    steps: ti.types.ndarray(dtype=ti.i64, ndim=1),
    form: ti.template(),
):
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(radio.state.shape[0], radio.state.shape[1]):
        if which[e] == 1:
            say(radio.sent, e, ti.cast(steps[e], ti.i32) % ti.static(form.delay + 1), i, radio)
        if which[e] == 2:
            for slot in range(form.delay + 1):
                say(radio.sent, e, slot, i, radio)


@ti.kernel
def _receive(
    radio: TalkPack,
    which: ti.types.ndarray(dtype=ti.i32, ndim=1),
    steps: ti.types.ndarray(dtype=ti.i64, ndim=1),
    count: ti.types.ndarray(dtype=ti.i32, ndim=1),
    form: ti.template(),
):
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(radio.state.shape[0], radio.state.shape[1]):
        if which[e] != 0:
            n, step = radio.state.shape[1], ti.cast(steps[e], ti.i32)
            for k in range(n):
                if which[e] == 2:
                    hear(radio, e, i, k, 0, 0.0)
                else:
                    radio.heard[e, i, k, AGE] += radio.numbers[0]
                    then = step - form.delay  # when what arrives now was sent
                    if (then + k) % form.period == 0 and then >= 0:
                        far = ti.Vector([radio.place[e, i, a] - radio.place[e, k, a] for a in ti.static(range(3))])
                        pair = ti.static(form.vehicles) + i * n + k
                        u = uniform4(count[1], RADIO, count[2] + e, pair, count[0])
                        if far.norm() <= radio.numbers[1] and u[0] >= radio.numbers[2]:
                            age = ti.static(form.delay) * radio.numbers[0]
                            hear(radio, e, i, k, then % ti.static(form.delay + 1), age)


class Radio:
    """The radio of one team.

    Attributes:
        heard: [env, receiver, sender, 7] place (NED, m) and velocity (m/s) of the last message, and its age (s).
    """

    def __init__(self, config: RadioConfig, own: Views, place: Tensor, interval: float, vehicles: int = 0):
        """Between vehicles that measure themselves to be `own` and are at `place` [env, vehicle, 13] (states).

        `interval` (s) is of a decision; `vehicles` counts those of other teams before them.
        """
        envs, n = own.state.shape[:2]
        delay, period = round(config.delay / interval), 1
        if config.rate is not None:
            period = max(1, round(1 / (config.rate * interval)))
        self.heard = own.state.new_zeros((envs, n, n, HEARD))
        sent = own.state.new_zeros((envs, delay + 1, n, HEARD - 1))
        self._pack = runtime.Packed(
            TalkPack, heard=self.heard, sent=sent, state=own.state, derived=own.derived, place=place,
            numbers=own.state.new_tensor([interval, config.range, config.loss]),
        )  # fmt: skip
        self._form, self._each = Form(delay, period, vehicles * MOST), n
        self._send, self._receive = runtime.Launcher(_send), runtime.Launcher(_receive)

    def talk(self, which: Tensor, rows: int, steps: Tensor, count: Tensor) -> None:
        """Send and receive in environments [env] int32: 0 not at all, 1 after a step, 2 as an episode begins.

        `rows` of them are not 0; `steps` int64 [env] of their episodes have gone by; `count` int32 [3] counts the
        random numbers: clock, seed, first environment.
        """
        form = self._form._replace(serial=runtime.few(rows * self._each**2, TALK))
        self._send(self._pack(), which, steps, form)
        self._receive(self._pack(), which, steps, count, form)
